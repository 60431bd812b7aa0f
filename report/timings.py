"""Times of steps, kept in times.json: `python report/timings.py` measures them again.

Whatever is compared takes turns of a few steps, so that a busy machine is busy for all. Times are
of the processor, medians with quartiles, in milliseconds per step of 0.02 s; those of schedules
also relative to the same step with the sweep. Bodies have friction 0.5 and restitution 0. With
--before, the code of another checkout takes its turns on the heaps that collapse; without, its
times are kept.
"""

import argparse
import datetime
import importlib.util
import json
import subprocess
import sys
import time
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "benchmarks"))

import benchmark
import benchmarkPiles
import numpy as np
from laws import heap_scene, scene

from Quaternion import QConj, QRotate
from rbs.geometry.broadphase import grid_overlaps
from rbs.stepping.settings import SETTINGS

TIMES = Path(__file__).resolve().parent / "times.json"
MATERIAL = benchmarkPiles.MATERIALS["friction 0.5"]
RESTING = {"restitution": MATERIAL.restitution, "friction": MATERIAL.friction}
AWAKE = {"contactSolver": "soft-step", "sleeping": False}
# Steps after which a heap has settled, or has begun to collapse; uncounted and counted steps of a
# measurement; steps of a turn.
SETTLED, COLLAPSING, WARM, STEPS, TURN = 600, 150, 10, 30, 5
SIZES = [200, 1000, 5000]  # of heaps that have settled
ENGINES = {"PyBullet": 50, "MuJoCo, CG": 100}  # name → most iterations by default
# Sweeps of a soft step, two in each substep; end of the name of an engine that has as many.
FEW, LIMITED = 2 * SETTINGS["substeps"].default, ", limited"
STEP_SIZES = [5, 20, 50, 200, 1000, 5000]
MOST_LOOPED = 1000
SCHEDULED = ("cube", "two_chain", "bridge", "net")
SCHEDULES = ("sweep", "queue", "batches")


def quartiles(values):
    """Returns the quartiles of a list, the median in the middle."""
    return [float(f"{q:.4g}") for q in np.percentile(values, (25, 50, 75))]


def in_turns(steps, warm=WARM):
    """Calls the functions of a dict in turns; returns name → what each has returned, (STEPS,).

    A turn has TURN calls after one that is not counted, as it finds another's data in the caches.
    """
    times = {name: [] for name in steps}
    for _ in range((STEPS + warm) // TURN):
        for name, step in steps.items():
            step()
            times[name] += [step() for _ in range(TURN)]
    return {name: np.array(values[-STEPS:]) for name, values in times.items()}


def timed(run):
    """Returns a function that makes a step, and returns its milliseconds of processor time."""

    def step():
        begin = time.process_time()
        run.step()
        return 1e3 * (time.process_time() - begin)

    return step


def heap(count, steps=0, **settings):
    """Returns a Simulation of a heap, after so many steps of its collapse."""
    return scene(heap_scene(count), **RESTING, **settings).run(steps)


def peers(simulation):
    """Returns name → run of the installed engines, in the state of the simulation."""
    runs = {}
    for name in ENGINES:
        package, peer = benchmarkPiles.PEERS[name]
        if not importlib.util.find_spec(package):
            continue
        runs[name] = run = peer(simulation, MATERIAL)
        for k, mesh in enumerate(simulation.meshes):
            linear, angular = mesh.linVelocity[0], mesh.angVelocity
            if name == "PyBullet":
                velocity = linear.tolist(), angular[0].tolist()
                run.pybullet.resetBaseVelocity(k + 1, *velocity, physicsClientId=run.client)
            else:  # a free joint turns in the body's frame
                run.data.qvel[6 * k : 6 * k + 3] = linear
                run.data.qvel[6 * k + 3 : 6 * k + 6] = QRotate(QConj(mesh.orientation), angular)[0]
    return runs


def limited_peers(simulation):
    """Returns the `peers` with at most FEW iterations of their solvers."""
    runs = peers(simulation)
    for name, run in runs.items():
        if name == "PyBullet":
            options = {"numSolverIterations": FEW, "physicsClientId": run.client}
            run.pybullet.setPhysicsEngineParameter(**options)
        else:
            run.model.opt.iterations = FEW
    return {name + LIMITED: run for name, run in runs.items()}


def boxes_of(meshes):
    """Returns bounding boxes as `grid_overlaps` takes them, (6, n)."""
    low, high = np.split(np.array([mesh.bounding_box() for mesh in meshes]).T, 2)
    return np.concatenate([low, -high])


def reached(simulation, run, name):
    """Returns deepest overlap in m, by our measure, and median speed in m/s of an engine."""
    count = len(simulation.meshes)
    if "PyBullet" in name:
        here, poses, speeds = {"physicsClientId": run.client}, [], []
        for k in range(1, count + 1):
            place, (*xyz, w) = run.pybullet.getBasePositionAndOrientation(k, **here)
            poses.append((*place, w, *xyz))
            speeds.append(run.pybullet.getBaseVelocity(k, **here)[0])
        poses = np.array(poses)
    elif "MuJoCo" in name:
        poses, speeds = run.data.qpos.reshape(-1, 7), run.data.qvel.reshape(-1, 6)[:, :3]
    else:
        poses = np.array([(*mesh.position[0], *mesh.orientation[0]) for mesh in run.meshes])
        speeds = np.array([mesh.linVelocity[0] for mesh in run.meshes])
    meshes = simulation.meshes
    for mesh, pose in zip(meshes, poses, strict=True):
        mesh.position, mesh.orientation = pose[None, :3], pose[None, 3:]
    box = boxes_of(meshes)
    near = grid_overlaps(box, np.zeros(count, dtype=bool)).T.tolist()
    depths = [meshes[a].detect_collision(meshes[b])[1] for a, b in near]
    deepest = max(0.0, -box[1].min(), *depths)
    return float(f"{deepest:.3g}"), float(f"{np.median(np.linalg.norm(speeds, axis=1)):.3g}")


def measure_engines(count):
    """Returns engine → times and what it has reached, from a heap settled by the soft step."""
    own, measure, rows = heap(count, **AWAKE), heap(count), {}
    own.set_state(heap(count, SETTLED, **AWAKE).state())  # without its impulses, as peers start
    runs = {"soft step": own} | peers(own) | limited_peers(own)
    times = in_turns({name: timed(run) for name, run in runs.items()})
    for name, run in runs.items():
        deepest, speed = reached(measure, run, name)
        rows[name] = {"ms": quartiles(times[name]), "overlap": deepest, "speed": speed}
    return rows


BEFORE = " before"  # ends the name of what another checkout does
WAYS = {  # of making a step → settings
    "loop": {},
    "grid": {"broadPhase": "grid"},
    "batches": {"contactScheduling": "batches"},
    "soft step": AWAKE,
}


@contextmanager
def steps_before(path, count, names):
    """Yields name → step of a heap with the code of the checkout at `path`, in its own process."""
    ways = json.dumps({name: RESTING | WAYS[name] for name in names})
    words = [sys.executable, Path(__file__).with_name("before.py"), path, heap_scene(count)]
    words += [str(COLLAPSING), ways]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "bufsize": 1}
    with subprocess.Popen(words, **pipes) as process:

        def step(name):
            print(name, file=process.stdin)
            return 1e3 * float(process.stdout.readline())

        yield {name + BEFORE: partial(step, name) for name in names}
        process.stdin.close()


def measure_steps(count, before=None):
    """Returns step → quartiles, on a collapsing heap; before : path of another checkout."""
    names = [name for name in WAYS if count <= MOST_LOOPED or name not in ("loop", "grid")]
    runs = {name: heap(count, **WAYS[name]) for name in names}
    start = heap(count, COLLAPSING, **WAYS["batches"])
    for run in runs.values():
        run.set_state(start.state())
    former = [name for name in names if name != "grid"]  # the pairs of the loop, a little faster
    with steps_before(before, count, former) if before else nullcontext({}) as others:
        times = in_turns({name: timed(run) for name, run in runs.items()} | others)
    return {name: quartiles(values) for name, values in times.items()}


def measure_schedules(name):
    """Returns schedule → quartiles of a whole step of a scene with constraints, in milliseconds and
    relative to the same step with the sweep.
    """
    runs = {one: scene(name, constraintScheduling=one, broadPhase="grid") for one in SCHEDULES}
    times = in_turns({one: timed(run) for one, run in runs.items()}, warm=40)
    sweep = times["sweep"]
    return {
        one: {"ms": quartiles(values), "relative": quartiles(values / sweep)}
        for one, values in times.items()
    }


def commit_of(path):
    """Returns the short name of the commit that is checked out at `path`."""
    words = ["git", "-C", path, "rev-parse", "--short", "HEAD"]
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout.strip()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--keep", nargs="*", default=[], help="engines, steps or schedules to keep")
    parser.add_argument("--before", metavar="CHECKOUT", help="measures the steps there as well")
    options = parser.parse_args()
    kept = json.loads(TIMES.read_text())
    times = {"machine": benchmark.describe_machine(), "when": datetime.date.today().isoformat()}
    times["before"] = commit_of(options.before) if options.before else kept["before"]
    for part, function, cases in (
        ("engines", measure_engines, SIZES),
        ("steps", partial(measure_steps, before=options.before), STEP_SIZES),
        ("schedules", measure_schedules, SCHEDULED),
    ):
        times[part] = kept[part]
        for case in cases if part not in options.keep else ():
            old = kept[part][str(case)].items()
            before = {name: values for name, values in old if name.endswith(BEFORE)}
            times[part][str(case)] = before | function(case)
            print(part, case, times[part][str(case)], flush=True)
    TIMES.write_text(json.dumps(times, indent=1) + "\n")


if __name__ == "__main__":
    main()
