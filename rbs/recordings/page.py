"""Export of a run as one .html page, which plays it in any browser and requests nothing.

K3D-jupyter draws. The page has one K3D mesh for each shape in each colour. `player.js`, in this
folder, makes bodies from them, moves these, and has the controls.
Units: metres, seconds. The y axis points up.
"""

import html
import re
from functools import partial
from pathlib import Path

import numpy as np

from rbs.appearance.camera import video_timing
from rbs.appearance.colours import CONSTRAINT_COLOURS, SEEN_BACKGROUND, SHADOW_COLOUR
from rbs.appearance.drawables import SHADOW_SLANT, ground_lines
from rbs.recordings.poses import ASPECT, PoseWriter, frame_run, rod
from rbs.scenes.messages import counted, one_line
from rbs.scenes.scenefiles import scene_name
from rbs.scenes.settingtexts import BY_OPTION

# What title and controls cover of a picture of the size ASPECT: at the left, top, right and bottom.
# In narrower windows, the player moves the camera back.
COVERED = (0.0, 0.7, 0.0, 0.7)
# Radius of the visible ground, relative to the size of the scene.
REACH = 12.0
# Height of the shadows above the ground, relative to the size of the scene.
SHADOW_HEIGHT = 1e-3
# Where K3D draws in its page.
CANVAS = '<div id="canvasTarget"></div>'
# Height in pixels of the player in a notebook.
PLAYER_HEIGHT = 480


class Player:
    """A page that plays a run, as a notebook shows it. `page` is its HTML."""

    def __init__(self, page):
        self.page = page

    def _repr_html_(self):
        style = f"width: 100%; height: {PLAYER_HEIGHT}px; border: 0"
        return f'<iframe srcdoc="{html.escape(self.page)}" style="{style}"></iframe>'


class PageWriter(PoseWriter):
    """Writes the states of a run as a page at its end."""

    package = "k3d"

    def add(self, simulation):
        """Keeps as many states as a video would have frames; the player interpolates."""
        _, every = video_timing(simulation.settings.timeStep)
        if not self._steps or abs(simulation.stepCount - self._steps[-1]) >= every:
            super().add(simulation)

    def write(self, simulation):
        """Writes the page. Raises OSError."""
        self.partial.write_text(self.page(simulation), encoding="utf-8")

    def page(self, simulation):
        """Returns the page, which ends with the present state of the simulation."""
        super().add(simulation)
        positions, orientations, colours, span = self.poses()
        camera, size = frame_run(self.meshes, positions, orientations, COVERED)
        plot = self.module.plot(
            background_color=_packed(SEEN_BACKGROUND),
            camera_auto_fit=False,
            camera_fov=camera.angle,
            camera_mode="orbit",
            camera_up_axis="y",
            grid_visible=False,
            axes_helper=0.0,
            menu_visibility=False,
            renderer="simple",
            lighting=2.0,
            antialias=3,
            logarithmic_depth_buffer=False,
        )
        plot.camera = [*camera.eye, *camera.centre, 0.0, 1.0, 0.0]
        add = partial(_add_mesh, self.module, plot)
        shapes, numbers = self.shapes(colours[-1])
        ids = [
            add(points, corners, normals=normals, color=_packed(colour), flat_shading=False)
            for colour, _, points, normals, corners in shapes
        ]
        bodies, points, linkSpan = self.links()
        data = {
            "times": _bytes(self.times()),
            "poses": _bytes(np.concatenate([positions, orientations], axis=2).swapaxes(0, 1)),
            "span": span.T.tolist(),
            "shapes": [ids[number] for number in numbers],
            "linkSpan": linkSpan.T.tolist(),
            "linkBodies": bodies.tolist(),
            "linkPoints": points.tolist(),
            "aspect": ASPECT[0] / ASPECT[1],
        }
        if (colours != colours[-1]).any():
            data["colours"] = _bytes(_packed(colours).T)
        if len(bodies):
            data["link"] = add(*rod(size), color=_packed(CONSTRAINT_COLOURS[1]))
        if simulation.groundMesh is not None:
            vertices, faces, seen, _ = ground_lines(size, camera.centre, REACH * size)
            data["ground"] = add(vertices, faces, colors=_packed(seen), wireframe=True)
            data["shadow"] = [_packed(SHADOW_COLOUR), *SHADOW_SLANT, SHADOW_HEIGHT * size]
        plot.custom_data = data
        folder = Path(__file__).parent
        page = plot.get_snapshot(6, additional_js_code=(folder / "player.js").read_text("utf-8"))
        return _with_controls(page, (folder / "player.html").read_text("utf-8"), simulation)


def _add_mesh(k3d, plot, vertices, faces, **options):
    """Adds a mesh to a plot of K3D; returns its number."""
    arrays = np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(faces, np.uint32)
    mesh = k3d.mesh(*arrays, roughness=0.6, **options)
    plot += mesh
    return mesh.id


def _packed(colours):
    """Returns (..., 3) sRGB colours as whole numbers, 0xRRGGBB: an int, or an array of them."""
    parts = np.rint(255.0 * np.asarray(colours)).astype(np.uint32)
    packed = parts[..., 0] << 16 | parts[..., 1] << 8 | parts[..., 2]
    return packed if packed.ndim else int(packed)


def _bytes(array):
    return np.ascontiguousarray(array, dtype="<f4").tobytes()


def _with_controls(page, controls, simulation):
    """Returns K3D's page with the title, the controls, and a line about scene and settings."""
    name, settings = one_line(scene_name(simulation.scenePath)), simulation.settings
    chosen = [
        f"{one.option.replace('-', ' ')} {one.shown(settings)}"
        for one in BY_OPTION.values()
        if one.setting.kind is not bool and getattr(settings, one.name) != one.setting.default
    ]
    about = [counted(len(simulation.meshes), "body"), f"steps of {settings.timeStep:g} s", *chosen]
    texts = {"[NAME]": html.escape(name), "[ABOUT]": html.escape(" · ".join(about))}
    controls = re.sub(r"\[(NAME|ABOUT)\]", lambda found: texts[found[0]], controls)
    before, _, after = page.partition(CANVAS)
    before = re.sub("<title>.*?</title>", lambda _: f"<title>{texts['[NAME]']}</title>", before)
    return before + CANVAS + controls + after
