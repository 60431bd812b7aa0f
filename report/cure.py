"""Section 5: which part of the soft step cures what, its static sag, and compiled engines."""

import math

import numpy as np
import runs
import style
from basic import STACK_STEPS, flat_box, swaying
from engines import TURN, heap_states, in_turns, started
from friction import creep
from runs import AWAKE, BOX, RESTING, SUBSTEPS, G, H, box, experiment, finish, run

from rbs.geometry.broadphase import grid_overlaps
from rbs.softstep.contacts import FREQUENCY
from rbs.softstep.rows import RELAXATION

TALL = 20  # boxes
PARTS = {  # name → time step, options of run_timestep
    "basic": (H, {}),
    "small": (H / SUBSTEPS, {}),
    "shared": (H, AWAKE | {"substeps": 1}),
    "both": (H, AWAKE),
}


@experiment()
def ablation():
    """Small steps and shared contacts apart: sway in °/s, creep in cm, and by how much
    the top of a tall stack is too low in m after STACK_STEPS, all awake.
    """
    numbers = {"tall": TALL}
    for name, (h, options) in PARTS.items():
        steps, flat, tall = round(STACK_STEPS * H / h), flat_box(), runs.stacked(TALL)
        faster = options or {"contactScheduling": "batches"}
        finish(tall, steps, h, 0.0, mu=RESTING["friction"], **faster)
        numbers[name] = {
            "sway": swaying(run([flat], 1000, h, **options), flat)[0],
            "creep": 100 * creep(h, **options),
            "low": BOX[1] * (TALL - 0.5) - float(tall[-1].position[0, 1]),
        }
    return numbers


def sag_of(meshes, substeps):
    """Static sag in m of a stack's top by δ = W S K / (4 Ω²) at each contact.

    W : load; K : inverse effective mass of a corner, of both bodies; S : factor by which masses are
    split; Ω : frequency of the springs, 1/s
    """
    inverse = []
    for mesh in meshes:
        arm = np.cross(mesh.currVertices[0] - mesh.position[0], (0, 1, 0))
        contacts = 1 if mesh is meshes[-1] else 2
        K = mesh.invMass + arm @ mesh.get_rotated_inv_IT() @ arm
        inverse.append(K * max(contacts / RELAXATION, 1.0))
    weights = np.cumsum([G * mesh.mass for mesh in reversed(meshes)])[::-1]
    pairs = np.array(inverse) + np.append(0.0, inverse[:-1])  # with the body below, or the ground
    return float(weights @ pairs) / (4 * (2 * math.pi * FREQUENCY * substeps / H) ** 2)


SUBSTEPS_TRIED, RATIO = (1, 2, 3, 6), 30
# The sag counts once it changes by less than this fraction in PAUSE steps, or after MOST_STEPS.
SETTLED, PAUSE, MOST_STEPS = 1e-4, 100, 6000


@experiment((3.7, 4.1))
def sag(axis):
    """Sag of a stack against substeps, and that of a box on a light one, beside the law."""

    def measured(meshes, substeps, top):
        lows = []
        options = AWAKE | {"substeps": substeps, "mu": RESTING["friction"]}
        for _ in run(meshes, MOST_STEPS, e=0.0, **options):
            lows.append(float(top - meshes[-1].position[0, 1]))
            if abs(lows[-1] - lows[-PAUSE:][0]) < SETTLED * lows[-1] and len(lows) > PAUSE:
                break
        return lows[-1]

    tall, heavy = BOX[1] * (TALL - 0.5), runs.stacked(2)
    heavy[1] = box((0, 1.5 * BOX[1], 0), density=RATIO)
    found = {n: measured(runs.stacked(TALL), n, tall) for n in SUBSTEPS_TRIED}
    law = {n: sag_of(runs.stacked(TALL), n) for n in SUBSTEPS_TRIED}
    axis.loglog(SUBSTEPS_TRIED, law.values(), color=style.BLUE, label="law")
    axis.loglog(SUBSTEPS_TRIED, found.values(), "s", color=style.VERMILION, label="measured")
    style.ticks(axis, SUBSTEPS_TRIED, (0.1, 1))
    axis.set(xlabel="substeps", ylabel="top too low by / m", ylim=(0.04, 4))
    axis.legend(loc="upper right")
    numbers = {"worst": 100 * max(abs(found[n] / law[n] - 1) for n in law), "ratio": RATIO}
    numbers |= {f"law{n}": one for n, one in law.items()} | {
        "heavyLaw": 100 * sag_of(heavy, SUBSTEPS)
    }
    return numbers | {"heavy": 100 * measured(heavy, SUBSTEPS, 1.5 * BOX[1])}


KEYS = {"bullet": "PyBullet", "cg": "MuJoCo, CG", "soft": "soft step"}  # names in engines.py
SIZES, MIDDLE, LOOKS, FEW = (200, 1000, 5000), 1000, 25, 4


def deepest(engine):
    """Deepest overlap in cm of an engine's bodies."""
    engine.read()
    meshes = engine.meshes
    low, high = np.split(np.array([mesh.bounding_box() for mesh in meshes]), 2, axis=1)
    near = grid_overlaps(np.concatenate([low, -high], axis=1).T, np.zeros(len(meshes), dtype=bool))
    depths = [meshes[a].detect_collision(meshes[b])[1] for a, b in near.T.tolist()]
    return 100 * max(0.0, -low[:, 1].min(), *depths)


def compare(meshes, keys):
    """Returns engine → milliseconds of a step, and overlaps over time in cm: median and maximum.

    Overlaps are those of MIDDLE bodies. keys : short name → name in engines.py
    """
    runs = dict(zip(keys, started(meshes, keys.values()).values(), strict=True))
    isMiddle = len(meshes) == MIDDLE and "soft" in keys
    times, depths = ({key: [] for key in keys} for _ in range(2))
    for _ in range(LOOKS if isMiddle else FEW):
        for key, values in in_turns(runs, 1).items():
            times[key] += values.tolist()
            if isMiddle:
                depths[key].append(deepest(runs[key]))
    numbers = {key: {"ms": float(np.median(values))} for key, values in times.items()}
    for key, values in depths.items():
        numbers[key] |= {"overlap": np.median(values), "most": max(values)} if values else {}
    return numbers


@experiment((4.9, 4.1), isTimed=True)
def engines(axis):
    """Milliseconds of a step of engines, from the states of a heap that collapses or rests."""
    numbers = {"steps": (TURN + 1) * LOOKS}
    looks = {"collapse": ("-", "full"), "settled": ("--", "none")}
    rows = {regime: {} for regime in looks}
    for count in SIZES:
        for regime, meshes in heap_states(count, rows):
            rows[regime][count] = compare(meshes, KEYS)
            if count == MIDDLE:
                newton = compare(meshes, {"newton": "MuJoCo"})
                numbers[regime] = rows[regime][count] | newton
    for regime, (line, fill) in looks.items():
        for (key, name), (colour, mark) in zip(KEYS.items(), style.LOOKS, strict=True):
            how = {"color": colour, "fillstyle": fill, "label": name if fill == "full" else None}
            times = [row[key]["ms"] for row in rows[regime].values()]
            axis.loglog(SIZES, times, mark + line, **how)
    style.ticks(axis, SIZES, (1, 10, 100))
    axis.set(xlabel="bodies", ylabel="ms per step", ylim=(0.7, 400))
    axis.legend(loc="upper left")
    return numbers
