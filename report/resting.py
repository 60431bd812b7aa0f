"""The soft step compared with the impulse solver and other engines: speeds, overlaps, heights.

Each function returns the numbers in the text, as in `experiments.py`. Those of MuJoCo and PyBullet
are measured only if these are installed.
"""

import copy
import importlib.util
import sys

import numpy as np
import style
from experiments import BOX, ROOT, H, experiment, heap_scene, silent, text
from mechanisms import boxes

from rbs.geometry.broadphase import grid_overlaps
from rbs.scenes.scenefiles import find_scene
from rbs.scenes.simulation import Simulation
from rbs.stepping.settings import CHOSEN

sys.path.insert(0, str(ROOT / "tests" / "benchmarks"))
import benchmarkPiles

ENGINES = {  # name → key in numbers.json, label, colour, dash
    "basic": ("basic", "basic", style.VERMILION, "-"),
    "soft step": ("soft", "soft step", style.BLUE, "-"),
    "MuJoCo": ("mujoco", "MuJoCo", style.PURPLE, "--"),
    "PyBullet": ("pybullet", "PyBullet", style.GREEN, "--"),
}
HEAP, HEAP_STEPS, SAMPLE = 200, 1000, 20
FRICTION = benchmarkPiles.MATERIALS["friction 0.5"]
# Modules used only by the soft step, and those used only by the accelerated basic step.
SOLVER_ROOMS = (
    "springs",
    "manifolds",
    "contactdetection",
    "softcontacts",
    "softconstraints",
    "sleeping",
    "softstep",
)
GRID_ROOMS = ("broadphase", "batches")
NUMERALS = {4: "four", 6: "six", 8: "eight", 10: "ten", 12: "twelve"}


def engines(scenePath, material=FRICTION):
    """Returns name → object with `step()`, for our two solvers and the installed engines."""
    runs = {
        "basic": benchmarkPiles.OwnRun(scenePath, material, broadPhase="grid"),
        "soft step": benchmarkPiles.OwnRun(scenePath, material, contactSolver="soft-step"),
    }
    for name in ("MuJoCo", "PyBullet"):
        package, peer = benchmarkPiles.PEERS[name]
        if importlib.util.find_spec(package):
            runs[name] = peer(Simulation(scenePath), material)
    return runs


def motion_of(run, count):
    """`(positions (n, 3), orientations (n, 4), velocities (n, 3))` of a run of `engines`."""
    if hasattr(run, "simulation"):
        meshes = run.simulation.meshes
        return tuple(
            np.concatenate([getattr(mesh, name) for mesh in meshes])
            for name in ("position", "orientation", "linVelocity")
        )
    if hasattr(run, "data"):
        poses = run.data.qpos.reshape(count, 7)
        return poses[:, :3].copy(), poses[:, 3:].copy(), run.data.qvel.reshape(count, 6)[:, :3]
    bodies = range(1, count + 1)  # number 0 is the plane
    client = {"physicsClientId": run.client}
    poses = [run.pybullet.getBasePositionAndOrientation(b, **client) for b in bodies]
    speeds = [run.pybullet.getBaseVelocity(b, **client)[0] for b in bodies]
    turns = np.array([pose[1] for pose in poses])[:, [3, 0, 1, 2]]
    return np.array([pose[0] for pose in poses]), turns, np.array(speeds)


def overlaps(meshes, positions, orientations):
    """Depths of all overlapping pairs, from the program's exact collision test."""
    for mesh, position, orientation in zip(meshes, positions, orientations, strict=True):
        mesh.position, mesh.orientation = position[None].copy(), orientation[None].copy()
    pairs = np.stack(grid_overlaps(boxes(meshes), np.zeros(len(meshes), dtype=bool)), axis=1)
    found = [meshes[i].detect_collision(meshes[j]) for i, j in pairs.tolist()]
    return np.array([depth for isCollision, depth, *_ in found if isCollision] or [0.0])


@experiment
def resting(axis):
    """Median speed and deepest overlap of a collapsing heap, over time, in four engines."""
    path = heap_scene(HEAP)
    meshes = [copy.copy(mesh) for mesh in Simulation(path).meshes]
    runs, rows = engines(path), {}
    for name, run in runs.items():
        rows[name] = []
        for step in range(1, HEAP_STEPS + 1):
            run.step()
            if step % SAMPLE == 0:
                positions, orientations, velocities = motion_of(run, HEAP)
                speed = np.median(np.linalg.norm(velocities, axis=1))
                rows[name].append((speed, overlaps(meshes, positions, orientations).max()))
    t = H * SAMPLE * np.arange(1, HEAP_STEPS // SAMPLE + 1)
    figure = axis.figure
    axis.remove()
    upper, lower = figure.subplots(2, 1, sharex=True)
    numbers = {
        "bodies": str(HEAP),
        "seconds": f"{HEAP_STEPS * H:g}",
        "mu": f"{FRICTION.friction:g}",
        "late": f"{HEAP_STEPS * H - 2:g}",
    }
    for name, values in rows.items():
        key, label, colour, dash = ENGINES[name]
        speeds, depths = np.array(values).T
        upper.semilogy(t, np.maximum(speeds, 1e-4), dash, color=colour, label=label)
        lower.semilogy(t, np.maximum(depths, 1e-3), dash, color=colour)
        late = t > HEAP_STEPS * H - 2
        speed = 1e3 * speeds[late].mean()
        numbers[f"{key}Speed"] = text(speed, 1 if speed < 100 else 0)
        numbers[f"{key}Overlap"] = text(1e2 * depths[late].mean(), 1)
        numbers[f"{key}Worst"] = text(1e2 * depths.max(), 0)
    upper.set(ylabel="m/s", ylim=(7e-5, 2e6), yticks=[1e-4, 1e-2, 1])
    upper.minorticks_off()
    upper.legend(loc="upper right", ncols=2, columnspacing=0.8)
    lower.set(xlabel="time / s", ylabel="m", ylim=(8e-4, 8), yticks=[1e-3, 1e-1])
    lower.minorticks_off()
    for part, what in ((upper, "median speed"), (lower, "deepest overlap")):
        part.set_title(what, fontsize=7, loc="left", pad=2)
    return numbers


STANDING_STEPS = 500


@silent
def standing():
    """Distance in cm by which the top of a stack, and of a pyramid, has sunk, in four engines.

    "fallen" stands for more than half a box. Closing the initial gaps between the boxes does not
    count.
    """
    numbers = {"seconds": f"{STANDING_STEPS * H:g}"}
    for name in ("stack", "pyramid"):
        path = find_scene(name)
        start = Simulation(path).meshes
        top = int(np.argmax([mesh.position[0, 1] for mesh in start]))
        numbers[f"{name}Count"] = str(len(start))
        rows = round(start[top].position[0, 1] / BOX[1] + 0.5)
        closed = (rows - 0.5) * BOX[1]  # with closed gaps
        numbers[f"{name}Rows"] = str(rows)
        numbers[f"{name}Height"] = text(rows * BOX[1], 0)
        for engine, run in engines(path).items():
            for _ in range(STANDING_STEPS):
                run.step()
            positions, _, _ = motion_of(run, len(start))
            sunk = 1e2 * (closed - positions[top, 1])
            word = "fallen" if sunk > 50 * BOX[1] else text(sunk, 1)
            numbers[f"{name}{ENGINES[engine][0].capitalize()}"] = word
    return numbers


@silent
def code():
    """Lines of code of the soft step, and of grid and batches; number of substeps."""

    def lines(rooms):
        return sum(len((ROOT / "rbs" / f"{room}.py").read_text().splitlines()) for room in rooms)

    return {
        "solver": str(lines(SOLVER_ROOMS)),
        "solverRooms": str(len(SOLVER_ROOMS)),
        "grid": str(lines(GRID_ROOMS)),
        "substeps": NUMERALS[CHOSEN["substeps"].default],
    }
