"""Draws the gallery: `python report/gallery.py [NAME ...]`, such as `heap` or `wall.mp4`.

Every picture is in the studio look, drawn at twice its size and scaled down. A shot without a
camera is framed as by the command line, to which report/README.md gives the arguments.
"""

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import polyscope as ps

from rbs.appearance.camera import PictureOptions
from rbs.appearance.colours import FRICTION_COLOUR, BodyColours
from rbs.pictures.backends import find_backend
from rbs.pictures.capture import StudioLook, start_view, take_picture
from rbs.pictures.overlays import draw_lines, remove_lines
from rbs.recordings.encoder import CODECS, Encoder
from rbs.scenes.files import atomic_write
from rbs.scenes.suggestions import apply_settings
from RigidBodySimulation import Mesh, Settings, Simulation

FOLDER = Path(__file__).resolve().parent / "gallery"
SIZE, DRAWN = (960, 540), (1920, 1080)
# Colours by the beginning of a mesh's name.
SHAPES = dict(
    cylinder="2a6f97", box="e9c46a", tet="e76f51", oct="f4a261", ell="61a5c2", long="8ab17d"
)
BRICKS = "a8482f b85a3a c46a45 9c3f2c b04e38 c97b57".split()
SUNSET = "f2e2b0 efb366 dd7a4f b04a5a 6d3b66 2f3d6b".split()
# Name of a line that is drawn over bodies; an overlay that no shot shows.
LINE = "trails"
# Metres, from the line of thrust to an edge of the stones.
LINE_INSET = 0.6
TAIL_SECONDS, TAIL_RADIUS = 0.6, 1.1
IRON, STEEL, STONE = "33383f", "8c8f94", "a9a7a2"


def mp4(crf):
    """Returns arguments of FFmpeg for a small video; a lower crf is better, and larger."""
    words = f"-f mp4 -vcodec libx264 -pix_fmt yuv420p -crf {crf} -preset slow -movflags +faststart"
    return words.split()


def rgb(colours):
    """Returns hexadecimal colours as numbers from 0 to 1, (n, 3)."""
    return np.array([list(bytes.fromhex(colour)) for colour in colours]) / 255.0


def by_shape(meshes):
    """A colour for each shape; fixed bodies are grey."""
    names = [next((key for key in SHAPES if mesh.name.startswith(key)), "box") for mesh in meshes]
    return rgb(STEEL if m.isFixed else SHAPES[key] for key, m in zip(names, meshes, strict=True))


def in_brick(meshes):
    """Brick reds for boxes, iron for the ball, steel for its chain."""
    own, some = {"ball": IRON, "octahedron": STEEL}, np.random.default_rng(3)
    kinds = [mesh.name.split()[0] for mesh in meshes]
    return rgb(own.get(kind, BRICKS[some.integers(len(BRICKS))]) for kind in kinds)


def in_stone(meshes):
    """Greys that differ by a few per cent, so that joints show."""
    shade = 1.0 + 0.08 * np.sin(7.0 * np.arange(len(meshes)))
    return rgb([STONE]) * shade[:, None]


def along_row(meshes):
    """Blends from the first body to the last."""
    place = np.linspace(0.0, len(SUNSET) - 1.0, len(meshes))
    return np.stack([np.interp(place, range(len(SUNSET)), c) for c in rgb(SUNSET).T], axis=1)


def domino_spiral(count=60):
    """Dominoes on a spiral, from its outer end inwards; the first one is pushed.

    Metres: 2 × 12 × 6 each, 5.6 from one to the next, 10.5 from turn to turn.
    """
    sizes, gap, growth = (2.0, 12.0, 6.0), 5.6, 10.5 / (2.0 * math.pi)
    angles = [13.0 / growth]
    while len(angles) < count:
        angles.append(angles[-1] + gap / (growth * angles[-1]))
    bodies = []
    for angle in reversed(angles):
        x, z = growth * angle * np.array([math.cos(angle), math.sin(angle)])
        along = np.array([z - growth * math.cos(angle), 0.0, -x - growth * math.sin(angle)])
        half = math.atan2(-along[2], along[0]) / 2.0
        turned = (math.cos(half), 0.0, math.sin(half), 0.0)
        bodies.append(Mesh.box(sizes, 60.0, (x, 6.0, z), orientation=turned))
        if len(bodies) == 1:
            push = 1.6 * bodies[0].mass * along / np.linalg.norm(along)
    settings = Settings(contactSolver="soft-step", friction=0.4, restitution=0.0)
    simulation = Simulation.from_meshes(bodies, settings=settings, name="spiral")
    simulation.push(0, push, bodies[0].position + [0.0, 6.0, 0.0])
    return simulation


def line_of_thrust(simulation):
    """Draws a line through the centres of pressure of an arch's joints, on its front face.

    Where it runs along an edge, it is drawn beside it, on the stone.
    """
    front = max(mesh.currVertices[:, 2].max() for mesh in simulation.meshes) + 0.15
    joints = {}
    for contact in simulation.report.contacts:
        joints.setdefault((contact.body1, contact.body2), []).append(
            (contact.impulse, contact.point)
        )
    centres = []
    for rows in joints.values():
        impulses, points = (np.array(column) for column in zip(*rows, strict=True))
        centres.append(impulses @ points / impulses.sum())
    nodes = np.array(sorted(centres, key=lambda point: point[0]))
    outer = max(np.hypot(*mesh.currVertices[:, :2].T).max() for mesh in simulation.meshes)
    nodes[:, :2] *= np.minimum(1.0, (outer - LINE_INSET) / np.hypot(*nodes[:, :2].T))[:, None]
    nodes[:, 2] = front
    edges = np.stack([np.arange(len(nodes) - 1), np.arange(1, len(nodes))], axis=1)
    draw_lines(LINE, nodes, edges, FRICTION_COLOUR, radius=2e-3)


def tails(simulation):
    """Draws a tail behind each moving body: its way in TAIL_SECONDS at its present velocity."""
    bodies = [mesh for mesh in simulation.meshes if not mesh.isFixed]
    begins = np.concatenate([mesh.position for mesh in bodies])
    ways = TAIL_SECONDS * np.concatenate([mesh.linVelocity for mesh in bodies])
    edges = np.arange(2 * len(bodies)).reshape(2, -1).T
    network = ps.register_curve_network(LINE, np.concatenate([begins, begins - ways]), edges)
    network.set_material("flat")
    network.add_color_quantity("shapes", by_shape(bodies), defined_on="edges", enabled=True)
    radii = np.repeat([TAIL_RADIUS, 0.0], len(bodies))
    network.add_scalar_quantity("radii", radii, defined_on="nodes")
    network.set_node_radius_quantity("radii", autoscale=False)


class Shot(NamedTuple):
    """A moment of a scene.

    scene : name, or a function that returns a Simulation; step; given : settings, by field
    shown : overlays; hasLegend; colours : function of the meshes, (n, 3), or None
    camera : position (3,), target (3,) and vertical angle in degrees, or None to show everything
    paint : function of the simulation that draws more, under the name LINE
    """

    scene: str | Callable
    step: int
    given: dict = {}
    shown: tuple = ()
    hasLegend: bool = False
    colours: Callable | None = None
    camera: tuple | None = None
    paint: Callable | None = None

    def simulation(self):
        """Returns the simulation at its step."""
        if callable(self.scene):
            return self.scene().run(self.step)
        simulation = Simulation(self.scene)
        apply_settings(simulation, self.given)
        return simulation.run(self.step)


FORCES = ("contacts", "impulses", "friction impulses")
PICTURES = {
    "wrecking_ball": Shot(
        "wrecking_ball", 289, colours=in_brick, camera=((3, 3, 41), (12.5, 16, 0), 48)
    ),
    "net": Shot("net", 140),
    "pile": Shot("pile_200", 150, colours=by_shape, camera=((108, 74, 246), (-2, 6, 0), 31)),
    "stress": Shot(
        "stress",
        130,
        {"friction": 0.5},
        colours=by_shape,
        camera=((80, 66, 182), (-2, 6, 8), 32.5),
        paint=tails,
    ),
    "heap": Shot("heap", 600, camera=((150, 100, 300), (-6.3, 3, 1.7), 31)),
    "card_house": Shot(
        "card_house", 15, shown=FORCES, hasLegend=True, camera=((34, 18, 84), (0, 19.3, 0), 31)
    ),
    "arch": Shot(
        "arch", 40, colours=in_stone, camera=((24, 16, 96), (0, 22, 0), 34), paint=line_of_thrust
    ),
    "arch_blow": Shot("arch_blow", 190),
    "dominoes": Shot(domino_spiral, 760, colours=along_row, camera=((50, 48, 81), (1, 0.5, 3), 31)),
    "wall": Shot("wall", 302, colours=in_brick, camera=((-30, 6, -86), (0, 27.5, 0), 51)),
}


class Film(NamedTuple):
    """A video of a shot, from its step to `last`, a frame every `every` steps."""

    shot: Shot
    last: int
    every: int
    size: tuple = (1280, 720)
    rate: float = 25.0


WIDE_WALL, WIDE_BALL = ((-28, 12, -118), (0, 26, 6), 38), ((-34, 9, 48), (2, 15, 0), 40)
VIDEOS = {
    "wall.mp4": Film(PICTURES["wall"]._replace(step=210, camera=WIDE_WALL), 460, 2),
    "dominoes.mp4": Film(PICTURES["dominoes"]._replace(step=150), 1480, 8),
    "wrecking_ball.gif": Film(
        PICTURES["wrecking_ball"]._replace(step=190, camera=WIDE_BALL), 360, 4, (480, 270), 12.5
    ),
}


class StagedColours(BodyColours):
    """The colours of a shot."""

    def __init__(self, colours):
        self._colours = colours

    def of(self, simulation, colouring):
        return self._colours

    def legend(self, simulation, colouring):
        return []


def aim(view, position, target, angle):
    """Gives pictures one camera; position, target : (3,); angle : vertical, in degrees."""
    ps.set_vertical_fov_degrees(angle)
    ps.look_at(position, target)
    view.spread_ground()
    view.studio = StudioLook(framesAnew=False)


def stage(shot, size):
    """Returns the simulation of a shot and its SceneView, with colours, overlays and camera."""
    simulation = shot.simulation()
    options = PictureOptions(size, overlays=shot.shown, hasLegend=shot.hasLegend, look="studio")
    view = start_view(simulation, find_backend(window=False), options)
    if shot.colours:
        view.bodyColours = StagedColours(shot.colours(simulation.meshes))
    if shot.camera:
        aim(view, *shot.camera)
    view.refresh()
    if shot.paint:
        shot.paint(simulation)
    return simulation, view


def draw(name):
    """Writes gallery/<name>.jpg; name : a name of PICTURES."""
    _, view = stage(PICTURES[name], DRAWN)
    picture = Image.fromarray(take_picture(view)).resize(SIZE, Image.LANCZOS)
    remove_lines(LINE)
    with atomic_write(FOLDER / f"{name}.jpg") as partial:
        picture.save(partial, "JPEG", quality=95, subsampling=0, optimize=True)


def film(name):
    """Writes gallery/<name>; name : a name of VIDEOS."""
    shot, last, every, size, rate = VIDEOS[name]
    simulation, view = stage(shot, size)
    steps = range(shot.step, last + 1, every)
    view.studio.tell_cost(view, len(steps))
    with atomic_write(FOLDER / name) as partial:
        codec = CODECS[".gif"] if name.endswith(".gif") else mp4(20)
        encoder = Encoder(partial, size, rate, codec)
        for _ in tqdm(steps, name, disable=None):
            view.refresh()
            encoder.write(take_picture(view, isStill=False))
            simulation.run(every)
        encoder.finish()


if __name__ == "__main__":
    for name in sys.argv[1:] or (*PICTURES, *VIDEOS):
        film(name) if name in VIDEOS else draw(name)
