"""Films the window while a box lands on an edge and rocks: `python report/eventVideo.py`.

Its impacts are shown event by event, with the numbers of each formula, and the rest in slow motion.
Writes gallery/events.mp4, and the picture gallery/window-events.jpg of its first impulse.
"""

import sys
from pathlib import Path

import numpy as np
from gallery import FOLDER, mp4
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import polyscope as ps

from rbs.appearance.camera import PictureOptions
from rbs.glass.events import Kind
from rbs.pictures.backends import find_backend
from rbs.pictures.capture import start_view
from rbs.recordings.encoder import Encoder
from rbs.recordings.lookup import SceneOpener
from rbs.scenes.files import atomic_write
from rbs.stepping.settings import Settings
from rbs.window.panel import Panel
from rbs.window.viewer import Viewer
from RigidBodySimulation import Mesh, Simulation

SIZE, RATE, SECONDS = (1280, 720), 25, 20
# Sides of the box in m, its density, its height, and its turn about z: it falls onto an edge.
SIDES, DENSITY, HEIGHT, TURN = (3.0, 1.2, 2.0), 500.0, 1.9, (0.966, 0.0, 0.0, 0.259)
SETTINGS = {"friction": 0.6, "restitution": 0.6, "closingOnly": True, "timeStep": 0.01}
CAMERA, TARGET = (1.0, 2.6, 9.5), (0.1, -0.6, 0.0)  # m
# Frames that an event of the first impact lasts, and the impulse of a later one. A step lasts one.
FIRST_FRAMES, LATER_FRAMES = 34, 45
# Later impacts that are shown: their least impulse in N s, and steps since the one before.
LEAST_IMPULSE, APART = 1000.0, 10


def main():
    """Films until the video is long enough."""
    box = Mesh.box(SIDES, DENSITY, (0.0, HEIGHT, 0.0), "box", orientation=TURN)
    simulation = Simulation.from_meshes([box], settings=Settings(**SETTINGS), name="rocking box")
    view = start_view(simulation, find_backend(window=False), PictureOptions(SIZE))
    viewer = Viewer(simulation, view, SceneOpener())
    panel = Panel(viewer)
    panel.hint, glass = "", panel.glass
    panel.lay_out()
    view.set_callback(panel.frame)
    ps.set_frame_tick_limit_fps_mode("ignore_limits")
    ps.look_at(CAMERA, TARGET)
    left, lastShown = SECONDS * RATE, -APART
    with atomic_write(FOLDER / "events.mp4") as partial:
        encoder = Encoder(partial, SIZE, RATE, mp4(24))

        def show(count):
            """Adds so many frames of what is seen now, as far as there is time."""
            nonlocal left
            viewer.message = viewer.saved = ""
            for _ in range(2):  # panels take their sizes from the frame before
                ps.frame_tick()
            picture = np.ascontiguousarray(ps.screenshot_to_buffer(False, include_UI=True)[..., :3])
            count = min(count, left)
            left -= count
            for _ in range(count):
                encoder.write(picture)
            return picture

        while left:
            glass.close()
            viewer.step_once()
            show(1)
            step, impulses = simulation.stepCount, [c.impulse for c in simulation.report.contacts]
            if max(impulses, default=0.0) < LEAST_IMPULSE or step - lastShown < APART:
                continue
            isFirst, lastShown = lastShown < 0, step
            glass.open()
            for place in glass.shown():
                isImpulse = glass.events[place].kind == Kind.IMPULSE
                if isFirst or isImpulse:
                    glass.show(place)
                    picture = show(FIRST_FRAMES if isFirst else LATER_FRAMES)
                if isFirst and isImpulse:
                    with atomic_write(FOLDER / "window-events.jpg") as still:
                        Image.fromarray(picture).save(still, "JPEG", quality=90)
        encoder.finish()
    view.set_callback(None)


if __name__ == "__main__":
    main()
