"""Draws the report's pictures off-screen with the program itself: `python report/pictures.py NAME`.

Each shows a scene of data/, or one built here from its meshes, at some step, with a camera of its
own. A picture is drawn only if its caption is true of the state (`checked`).
"""

import copy
import math
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from experiments import BOX, ROOT, G, H, box, heap_scene, lowest_vertices, overlap_and_sinking

from rbs.appearance.pictureoptions import PictureOptions
from rbs.pictures.backends import find_backend
from rbs.pictures.capture import save_picture, start_view
from rbs.scenes.scenefiles import find_scene
from rbs.scenes.simulation import Settings, Simulation

SIZE = (960, 660)
FOLDER = Path(__file__).resolve().parent / "figures"
UPRIGHT = (1, 0, 0, 0)


class Camera(NamedTuple):
    """A camera: position and target (3,) in metres, and vertical field of view in degrees."""

    position: tuple
    target: tuple
    fieldOfView: float

    def apply(self, view):
        """Applies the camera to a SceneView."""
        import polyscope as ps

        ps.set_vertical_fov_degrees(self.fieldOfView)
        ps.look_at(self.position, self.target)
        view.spread_ground()


class Picture(NamedTuple):
    """A simulation in its state, and how to draw it.

    facts : the caption's statements about the state, sentence → whether it is true
    """

    simulation: Simulation
    camera: Camera
    facts: dict
    overlays: tuple = ()
    colouring: str = "body"
    transparent: bool = False


def made_scene(rows, **settings):
    """Returns a `Simulation` of rows `(mesh file, density, isFixed, position, orientation)`."""
    with tempfile.TemporaryDirectory() as folder:
        lines = [str(len(rows))]
        for mesh, density, isFixed, position, orientation in rows:
            numbers = " ".join(repr(float(x)) for x in (*position, *orientation))
            lines.append(f"{ROOT / 'data' / mesh} {density} {int(isFixed)} {numbers}")
        path = Path(folder) / "made-scene.txt"
        path.write_text("\n".join(lines) + "\n")
        return Simulation(path, Settings(**settings), allowOutsideMeshes=True)


def run(simulation, steps):
    for _ in range(steps):
        simulation.step()
    return simulation


def ghosts(mesh, index, states):
    """Copies of the body `index` at earlier states: positions and orientations."""
    copies = []
    for position, orientation in states:
        ghost = copy.copy(mesh)
        ghost.position, ghost.orientation = position.copy(), orientation.copy()
        ghost.colourIndex = index
        copies.append(ghost)
    return copies


def eight_boxes():
    rows = [("box.mesh", 500, False, (-6.5, 6 * k + 3, 0), UPRIGHT) for k in range(8)]
    rows += [("box.mesh", 500, True, (6.5, 6 * k + 3, 0), UPRIGHT) for k in range(8)]
    return made_scene(rows)


STACK_STEPS = 100


def stack():
    """The lowest of eight boxes after two seconds, beside fixed ones, which stay in place."""
    simulation = run(eight_boxes(), STACK_STEPS)
    overlap, sinking = overlap_and_sinking(simulation.meshes[:8])
    lowest = simulation.meshes[0].detect_collision(simulation.meshes[1])[1]
    return Picture(
        simulation,
        Camera((25, 20, 38), (0, 10.5, 0), 36),
        {
            "the boxes stand in each other, by a quarter of a box and more": overlap > BOX[1] / 4,
            "the lowest two overlap": lowest > 0.3,
            "the top is lower by more than three metres": sinking > 3.0,
            "the fixed boxes are where they were": simulation.meshes[15].position[0, 1] == 45.0,
        },
    )


TUNNEL_STEPS = 10
TUNNEL_SPEEDS = (40.0, 70.0, 100.0, 160.0)
WALL = (1, 10, 17)


def thrown_cubes():
    """Cubes thrown at a fixed wall at increasing speeds."""
    simulation = made_scene([("box.mesh", 500, True, (0, 0, 0), UPRIGHT)], closingOnly=True)
    wall = box(WALL, (0, 5, 0), isFixed=True)
    # the starts of fast cubes are such that no step ends in the wall's nearer half
    starts = (-6.5, -10.0, -13.6, -20.8)
    cubes = [box((2, 2, 2), (x, 6, z)) for x, z in zip(starts, (-6, -2, 2, 6), strict=True)]
    for cube, speed in zip(cubes, TUNNEL_SPEEDS, strict=True):
        cube.linVelocity = np.array([[speed, 0.0, 0.0]])
    simulation.meshes = [wall, *cubes]
    return simulation


def tunnel():
    """Cubes stopped by a wall, and others that pass it; the fast ones at every step."""
    simulation = thrown_cubes()
    wall, *cubes = simulation.meshes
    passed, states = [set() for _ in cubes], [[] for _ in cubes]
    for _ in range(TUNNEL_STEPS):
        for k, cube in enumerate(cubes):
            states[k].append((cube.position, cube.orientation))
        simulation.step()
        for contact in simulation.report.contacts:
            if contact.body1 == 0:
                passed[contact.body2 - 1].add(float(cubes[contact.body2 - 1].position[0, 0]) > 0)
    x = np.array([cube.position[0, 0] for cube in cubes])
    v = np.array([cube.linVelocity[0, 0] for cube in cubes])
    seen = [
        ghost
        for k in (2, 3)
        for ghost in ghosts(cubes[k], k + 1, states[k])
        if -9 < ghost.position[0, 0] < 8
    ]
    simulation.meshes = [wall, *cubes, *seen]
    return Picture(
        simulation,
        Camera((-4, 15, 25), (0.5, 4.5, 0.5), 42),
        {
            "two are thrown back": bool((x[:2] < 0).all() and (v[:2] < 0).all()),
            "two are behind the wall": bool((x[2:] > 0).all() and (v[2:] > 0).all()),
            "the fast ones were never in the nearer half": all(False not in p for p in passed[2:]),
            "the slow ones were": all(False in p for p in passed[:2]),
        },
    )


def cube():
    """Eight bodies, each constrained to all others, at their greatest depth in the ground."""
    simulation = Simulation(find_scene("cube"), Settings())
    deepest, best = 0.0, None
    for _ in range(200):
        simulation.step()
        low = lowest_vertices(simulation).min()
        if low < deepest:
            deepest, best = low, simulation.state()
    simulation.set_state(best)
    return Picture(
        simulation,
        Camera((11, 3.2, 20), (0, 3.4, 0), 40),
        {
            "a vertex is more than half a metre below the ground": deepest < -0.5,
        },
    )


SLOPE_SECONDS = 5.0


def slope():
    """Boxes on two slopes, with friction: one stays, the other leaves earlier copies."""
    simulation = Simulation(find_scene("incline"), Settings(friction=0.4))
    steep, gentle = simulation.meshes[1], simulation.meshes[3]
    starts = [steep.position.copy(), gentle.position.copy()]
    states = [(starts[0], steep.orientation.copy())]
    run(simulation, round(SLOPE_SECONDS / H))
    ways = [
        np.linalg.norm(mesh.position - start)
        for mesh, start in zip((steep, gentle), starts, strict=True)
    ]
    angle = 2 * math.atan(1 / 4)  # as in the scene
    law = 0.5 * G * SLOPE_SECONDS**2 * (math.sin(angle) - 0.4 * math.cos(angle))
    simulation.meshes = [*simulation.meshes, *ghosts(steep, 1, states)]
    return Picture(
        simulation,
        Camera((14, 26, 62), (0, 10, 0), 36),
        {
            "the box on the steep slope slides": ways[0] > 5.0,
            "as Coulomb's law has it, within a fifth": abs(ways[0] / law - 1) < 0.2,
            "the box on the gentle slope moves less than its own length": ways[1] < 2.0,
        },
    )


PYRAMID_STEPS = 500
RESTING = {"friction": 0.5, "restitution": 0.0}


def pyramid(**settings):
    simulation = Simulation(find_scene("pyramid"), Settings(**RESTING, **settings))
    rows = round(simulation.meshes[-1].position[0, 1] / BOX[1] + 0.5)
    run(simulation, PYRAMID_STEPS)
    # the scene starts with gaps between the boxes
    sunk = (rows - 0.5) * BOX[1] - max(mesh.position[0, 1] for mesh in simulation.meshes)
    return simulation, sunk, Camera((80, 56, 172), (4, 41, 0), 36)


def pyramid_basic():
    simulation, sunk, look = pyramid(broadPhase="grid")
    return Picture(simulation, look, {"the pyramid has collapsed": sunk > 20.0})


def pyramid_soft():
    simulation, sunk, look = pyramid(contactSolver="soft-step")
    return Picture(simulation, look, {"the pyramid stands, to a decimetre": abs(sunk) < 0.1})


HEAP_STEPS = 110


def heap():
    """A dense heap of a thousand bodies, with friction, during its collapse."""
    simulation = Simulation(heap_scene(1000), Settings(broadPhase="grid", **RESTING))
    start = max(mesh.position[0, 1] for mesh in simulation.meshes)
    run(simulation, HEAP_STEPS)
    top = max(mesh.position[0, 1] for mesh in simulation.meshes)
    speeds = np.linalg.norm([mesh.linVelocity[0] for mesh in simulation.meshes], axis=1)
    return Picture(
        simulation,
        Camera((115, 90, 205), (0, 32, 0), 38),
        {
            "it has come down by a fifth and more": top < 0.8 * start,
            "half of its bodies move with a metre a second or more": np.median(speeds) > 1.0,
            "bodies touch one other and more": len(simulation.report.contacts) > 500,
        },
    )


PICTURES = {
    f"picture_{function.__name__}": function
    for function in (stack, tunnel, cube, slope, heap, pyramid_basic, pyramid_soft)
}


# Name → statements of the caption, which `checked` compares with the facts.
CAPTIONS = {
    "picture_stack": (
        "the boxes stand in each other, by a quarter of a box and more",
        "the lowest two overlap",
        "the top is lower by more than three metres",
        "the fixed boxes are where they were",
    ),
    "picture_tunnel": (
        "two are thrown back",
        "two are behind the wall",
        "the fast ones were never in the nearer half",
        "the slow ones were",
    ),
    "picture_cube": ("a vertex is more than half a metre below the ground",),
    "picture_slope": (
        "the box on the steep slope slides",
        "as Coulomb's law has it, within a fifth",
        "the box on the gentle slope moves less than its own length",
    ),
    "picture_heap": (
        "it has come down by a fifth and more",
        "half of its bodies move with a metre a second or more",
        "bodies touch one other and more",
    ),
    "picture_pyramid_basic": ("the pyramid has collapsed",),
    "picture_pyramid_soft": ("the pyramid stands, to a decimetre",),
}


def checked(name):
    """Returns the Picture of this name; exits with a message if its caption is not true."""
    picture = PICTURES[name]()
    assert tuple(picture.facts) == CAPTIONS[name]
    wrong = [fact for fact, isTrue in picture.facts.items() if not isTrue]
    if wrong:
        sys.exit(f"{name}: the caption is not true of the state drawn: {'; '.join(wrong)}")
    return picture


def draw(name, size=SIZE):
    """Writes figures/<name>.png; name : a name of PICTURES."""
    picture = checked(name)
    backend = find_backend(window=False)
    if backend.name is None:
        sys.exit(f"cannot draw pictures: {backend.reason}. {backend.remedy}")
    options = PictureOptions(size, None, picture.transparent, picture.colouring, picture.overlays)
    view = start_view(picture.simulation, backend, options)
    picture.camera.apply(view)
    view.refresh()
    save_picture(FOLDER / f"{name}.png", view)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        draw(name)
