"""The report's pictures, drawn off-screen by the program itself: `python report/pictures.py NAME`.

Each is a scene of data/, or one made here of its meshes, at some step, seen by a camera of its own.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from experiments import ROOT, box

from rbs.backends import find_backend
from rbs.pictureoptions import PictureOptions
from rbs.pictures import save_picture, start_view
from rbs.scenes import find_scene
from rbs.simulation import Settings, Simulation

SIZE = (960, 640)
FOLDER = Path(__file__).resolve().parent / "figures"
UPRIGHT = (1, 0, 0, 0)


def made_scene(rows, **settings):
    """A `Simulation` of rows `(mesh file, density, isFixed, position, orientation)`."""
    with tempfile.TemporaryDirectory() as folder:
        lines = [str(len(rows))]
        for mesh, density, isFixed, position, orientation in rows:
            numbers = " ".join(repr(float(x)) for x in (*position, *orientation))
            lines.append(f"{ROOT / 'data' / mesh} {density} {int(isFixed)} {numbers}")
        path = Path(folder) / "made-scene.txt"
        path.write_text("\n".join(lines) + "\n")
        return Simulation(path, Settings(**settings), allowOutsideMeshes=True)


def stack():
    """Eight boxes after some seconds, beside eight fixed ones, which stand as they should."""
    rows = [("box.mesh", 500, False, (-9, 6 * k + 3, 0), UPRIGHT) for k in range(8)]
    rows += [("box.mesh", 500, True, (9, 6 * k + 3, 0), UPRIGHT) for k in range(8)]
    return made_scene(rows), 100, "body", (), camera((52, 40, 74), (0, 22.5, 0), 36)


def tunnel():
    """Cubes thrown at a fixed wall, each faster than the one before."""
    simulation = made_scene([("box.mesh", 500, True, (0, 0, 0), UPRIGHT)], closingOnly=True)
    lanes = (-9.0, -3.0, 3.0, 9.0)
    wall = box((1, 12, 26), (0, 6, 0), isFixed=True)
    # what is fast enough begins where none of its steps ends in the wall's nearer half
    starts, speeds = (-6.5, -10.0, -13.6, -20.8), (40.0, 70.0, 100.0, 160.0)
    cubes = [box((2, 2, 2), (x, 6, z)) for x, z in zip(starts, lanes, strict=True)]
    for cube, speed in zip(cubes, speeds, strict=True):
        cube.linVelocity = np.array([[speed, 0.0, 0.0]])
    simulation.meshes = [wall, *cubes]
    return simulation, 10, "body", ("trails",), camera((-6, 19, 34), (-1, 3.5, 0), 42)


def drift():
    """One of each shape, long after the fall, with where they have come from."""
    simulation = Simulation(find_scene("mixed"), Settings())
    return simulation, 300, "body", ("trails",), camera((60, 90, 150), (-3, 0, 12), 36)


def chains():
    """Two chains among posts."""
    look = camera((80, 90, 165), (34, 70, 0), 50)
    return Simulation(find_scene("two_chain"), Settings()), 150, "density", (), look


def cube():
    """Eight bodies, each with constraints to all others, long after they have landed."""
    look = camera((26, 30, 52), (0, 9, 0), 36)
    return Simulation(find_scene("cube"), Settings()), 450, "body", ("velocities",), look


def net():
    """Bodies in a net, which stretches."""
    settings = Settings(constraintScheduling="batches", broadPhase="grid")
    look = camera((120, 105, 190), (0, 42, 0), 40)
    return Simulation(find_scene("net"), settings), 140, "speed", (), look


def slope():
    """Boxes on two slopes, with friction, and their trails."""
    simulation = Simulation(find_scene("incline"), Settings(friction=0.4))
    return simulation, 340, "body", ("trails",), camera((28, 34, 78), (0, 9, 0), 40)


def pile():
    """A pile of a thousand bodies."""
    settings = Settings(broadPhase="grid", friction=0.5)
    look = camera((120, 95, 190), (0, -8, 10), 42)
    return Simulation(find_scene("pile_1000"), settings), 250, "body", (), look


def camera(position, target, fieldOfView):
    return {"position": np.array(position, dtype=float), "target": np.array(target, dtype=float),
            "fieldOfView": float(fieldOfView)}  # fmt: skip


PICTURES = {
    f"picture_{function.__name__}": function
    for function in (stack, tunnel, drift, chains, cube, net, slope, pile)
}


def draw(name, size=SIZE):
    """Writes figures/<name>.png; name : of PICTURES."""
    simulation, steps, colouring, overlays, where = PICTURES[name]()
    backend = find_backend(window=False)
    if backend.name is None:
        sys.exit(f"no pictures can be drawn: {backend.reason}. {backend.remedy}")
    options = PictureOptions(size, where, False, colouring, overlays)
    view = start_view(simulation, backend, options)
    for step in range(1, steps + 1):
        simulation.step()
        # a trail remembers some forty places: of a short run every one, of a long one its end
        if "trails" in overlays and (steps < 50 or step % 5 == 0):
            view.refresh()
    view.refresh()
    save_picture(FOLDER / f"{name}.png", view)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        draw(name)
