"""Which part of the soft step cures what, and where it ends. Functions are as in `laws.py`."""

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
    throw,
)

from RBSFunctions import Mesh

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
        top = max(mesh.position[0, 1] for mesh in stacks[1])
        numbers[name] = {
            "sway": rocking(h, **awake)[0],
            "creep": 100 * slide(GENTLE, h, **awake),
            "overlap": 100 * overlap_of(stacks[0]),
            "sink": float(BOX[1] * (TALL - 0.5) - top),
        }
    return numbers


@silent
def ratios():
    """Centimetres that a heavy box sinks into a light one in 5 s, and the height of its centre."""
    numbers = {"heavy": 1000}
    for name, ratio in (("hundred", 100.0), ("thousand", 1000.0)):
        for key, options in (("Basic", {}), ("Soft", SOFT)):
            heavy = box(BOX, (0, 1.5 * BOX[1], 0), density=ratio)
            meshes = [box(BOX, (0, BOX[1] / 2, 0)), heavy]
            finish(run(meshes, round(5.0 / H), e=0.0, mu=0.5, **options))
            numbers[name + key] = 100 * overlap_of(meshes)
            numbers[f"{name}{key}Height"] = float(heavy.position[0, 1])
    return numbers


@silent
def sleepers():
    """Speed in cm/s left after 10 s to boxes that slide without friction, asleep or not."""
    speed = 0.01
    numbers = {"speed": 100 * speed}
    for name, options in (("slow", {}), ("awake", {"sleeping": False})):
        mesh = throw(box(BOX, (0, BOX[1] / 2, 0)), (speed, 0, 0))
        finish(run([mesh], round(10.0 / H), e=0.0, **SOFT, **options))
        numbers[name] = 100 * float(mesh.linVelocity[0, 0])
    return numbers


@silent
def concave():
    """Depth of a cube in the notch of a body of two boxes, which touches neither box."""
    parts = box((3, 1, 1), (0.0, 0.5, 0)), box((1, 3, 1), (-1.0, 2.5, 0))
    corners = np.concatenate([part.currVertices for part in parts])
    faces, tets = (
        np.concatenate([getattr(part, name) + 8 * k for k, part in enumerate(parts)])
        for name in ("faces", "tets")
    )
    middle = corners[tets].mean(axis=1)
    volume = np.linalg.det(corners[tets][:, 1:] - corners[tets][:, :1])
    place = np.average(middle, axis=0, weights=volume)
    bent = Mesh("bent", corners, faces, tets, 1.0, place, (1, 0, 0, 0), False)
    cube = box((0.5,) * 3, (-0.2, 1.3, 0.0))
    apart = [part.detect_collision(cube)[0] for part in parts]
    isHit, depth = bent.detect_collision(cube)[:2]
    return {"depth": float(depth), "isHit": bool(isHit), "parts": sum(map(bool, apart))}
