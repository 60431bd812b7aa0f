"""Which part of the soft step cures what, and where it ends. Functions are as in `laws.py`."""

import itertools
from unittest.mock import patch

import numpy as np
from laws import (
    BOX,
    GENTLE,
    SOFT,
    STACK_STEPS,
    H,
    box,
    finish,
    overlap_of,
    rocking,
    run,
    silent,
    slide,
    stacked,
)

from rbs.softstep import contacts

PARTS = {  # name → time step, options of run_timestep
    "basic": (H, {}),
    "small": (H / 6, {}),
    "shared": (H, SOFT | {"substeps": 1}),
    "both": (H, SOFT),
}
TALL, TALL_SECONDS = 20, 10


@silent
def ablation():
    """Rocking in °/s, creep, overlap in cm, sinking in m: small steps and shared contacts apart."""
    numbers = {"tall": TALL, "seconds": TALL_SECONDS}
    for name, (h, options) in PARTS.items():
        awake = options | {"sleeping": False} if options else {}
        stacks = stacked(), stacked(TALL)
        finish(run(stacks[0], round(STACK_STEPS * H / h), h, **options))
        faster = options or {"contactScheduling": "batches"}
        finish(run(stacks[1], round(TALL_SECONDS / h), h, 0.0, mu=0.5, **faster))
        sink = BOX[1] * (TALL - 0.5) - max(mesh.position[0, 1] for mesh in stacks[1])
        numbers[name] = {
            "sway": rocking(h, **awake)[0],
            "creep": 100 * slide(GENTLE, h, **awake),
            "overlap": 100 * overlap_of(stacks[0]),
            "sink": float(sink),
            "places": 2 if sink < 10.0 else 0,
        }
    return numbers


STIFFER = 1.2  # relative to our springs, in frequency


@silent
def springs():
    """Largest speed in cm/s in a stack of ten boxes after 8 s, with ours and with stiffer ones."""

    def speed(factor):
        meshes, late = stacked(10), []
        with patch.object(contacts, "FREQUENCY", factor * contacts.FREQUENCY):
            steps = run(meshes, 500, e=0.0, mu=0.5, **SOFT, sleeping=False)
            for _ in itertools.islice(steps, 400, None):
                late += [np.linalg.norm(mesh.linVelocity) for mesh in meshes]
        return 100 * max(late)

    return {"own": speed(1.0), "stiffer": speed(STIFFER)}


@silent
def ratios():
    """Largest overlap in cm of a heavy box on a light one, in 5 s of the soft step."""
    numbers = {"heavy": 1000}
    for name, ratio in (("hundred", 100.0), ("thousand", 1000.0)):
        heavy = box(BOX, (0, 1.5 * BOX[1], 0), density=ratio)
        meshes = [box(BOX, (0, BOX[1] / 2, 0)), heavy]
        steps = run(meshes, round(5.0 / H), e=0.0, mu=0.5, **SOFT)
        numbers[name] = 100 * max(overlap_of(meshes) for _ in steps)
    return numbers
