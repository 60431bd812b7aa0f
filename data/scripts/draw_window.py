"""Draws the gallery's pictures of the window, and the film of a step under glass, off-screen.

    python data/scripts/draw_window.py [NAME ...]

Names are those of report/gallery: window-first-sight.jpg, …, events.mp4.
"""

import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "report"))

import polyscope as ps
from PIL import Image
from staging import choose, write_mp4

from rbs.appearance.camera import PictureOptions
from rbs.glass.events import Kind
from rbs.pictures.backends import find_backend
from rbs.pictures.capture import start_view
from rbs.recordings.lookup import SceneOpener
from rbs.scenes.files import atomic_write
from rbs.window.panel import Panel
from rbs.window.viewer import Viewer
from RigidBodySimulation import Settings, Simulation, shapes

FOLDER = Path(__file__).resolve().parents[2] / "report/gallery"
SIZE, RATE = (1280, 720), 25
HELD, SETTLING = 40, 12  # frames for which an event is shown, and in which the camera comes near
HARD = 2500.0  # N s, of the impacts that are shown


def falling_box():
    """A box of 3 × 1 × 1.2 m that lands on an edge."""
    turned = np.cos(0.2), 0.0, 0.0, np.sin(0.2)
    box = shapes.box((3.0, 1.0, 1.2), 1000.0, (0.0, 2.2, 0.0), orientation=turned)
    settings = Settings(timeStep=0.01, friction=0.6, restitution=0.6)
    return Simulation.from_meshes([box], settings=settings, name="box")


def replayed():
    """A recording of the tower."""
    simulation = Simulation("tower")
    path = Path(tempfile.mkdtemp()) / "tower.h5"
    with simulation.record(path):
        simulation.run(200)
    return SceneOpener().open(path)


# name → function that makes a simulation, and steps
PICTURES = {
    "window-first-sight.jpg": (partial(Simulation, "mixed"), 60),
    "window-pile.jpg": (partial(Simulation, "pile_200"), 300),
    "window-chain.jpg": (partial(Simulation, "loaded_bridge"), 150),
    "window-replay.jpg": (replayed, 120),
    "window-events.jpg": (falling_box, 80),
    "events.mp4": (falling_box, 110),
}


def drawn():
    """Returns what the window shows, (720, 1280, 3)."""
    ps.frame_tick()
    return ps.screenshot_to_buffer(transparent_bg=False, include_UI=True)[:, :, :3].copy()


def film(panel, steps):
    """Yields frames: the box falls, and its hard impacts are shown event by event."""
    viewer, glass = panel.viewer, panel.glass
    for _ in range(steps):
        viewer.step_once()
        yield drawn()
        if any(contact.impulse > HARD for contact in viewer.simulation.report.contacts):
            glass.go()
            while True:
                for _ in range(SETTLING):
                    drawn()  # the camera comes nearer
                    yield drawn()
                yield from [drawn()] * HELD
                if glass.place == glass.shown()[-1]:
                    break
                glass.go()
            glass.close()
            yield drawn()


def draw(name):
    make, steps = PICTURES[name]
    view = start_view(make(), find_backend(window=False), PictureOptions(SIZE))
    panel = Panel(Viewer(view.simulation, view, SceneOpener()))
    view.set_callback(panel.frame)
    view.viewpoint.restart()
    with atomic_write(FOLDER / name) as partial_path:
        if name.endswith(".mp4"):
            write_mp4(partial_path, film(panel, steps), RATE, 30)
            return
        images = []
        if name == "window-events.jpg":
            for image in film(panel, steps):
                events, place = panel.glass.events, panel.glass.place
                if events and events[place].kind == Kind.IMPULSE:
                    images.append(image)
                elif images:
                    break
        else:
            for _ in range(steps):
                panel.viewer.step_once()
            images = [drawn() for _ in range(SETTLING)]
        Image.fromarray(images[-1]).save(partial_path, "JPEG", quality=88)


if __name__ == "__main__":
    names = choose(PICTURES, __doc__.splitlines()[0])
    for chosen in names:
        if len(names) == 1:
            draw(chosen)
        else:  # Polyscope can start only once per process
            subprocess.run([sys.executable, __file__, chosen], check=True)
