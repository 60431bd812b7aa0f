"""Grade collision detection and resolution against collision-resolution.data.

    python graders/ResolveCollisionsGrading.py [--data DIR]
    python graders/ResolveCollisionsGrading.py --modules DIR    a student's modules

Detection, `Mesh.detect_collision`, is not graded on the released data, because the release's is
approximate (quirk 6 in graders/README.md). Resolution, `resolve_collision`, is graded on the depth,
normal and point in the data, so it does not depend on detection.
"""

import sys

import numpy as np
from classwork.graderProgram import run_grader
from reference import rigidModel as model
from reference.graderData import COLLISION_LAYOUT, EXACT, WIDTHS
from verdict.parts import FEW, Grader, Part, WrongResult, numbers, results_of, returned, state_of

CONTACT = {"isCollision": 1, "depth": 1, "intNormal": 3, "intPosition": 3}
TENSOR = "rotated inverse inertia"  # in units of the mean one


def detect(bodies, data, sample):
    name = "Mesh.detect_collision"
    values = returned(bodies.resting().detect_collision(bodies.moving(sample)), name, CONTACT)
    yield "isCollision", values[0]
    if numbers(values[0], bool, "isCollision"):
        for key, value in list(zip(CONTACT, values, strict=True))[1:]:
            yield key, value, f"{name}'s {key}"


def rotate_tensor(bodies, data, sample):
    tensor = bodies.moving(sample).get_rotated_inv_IT()
    yield TENSOR, numbers(tensor, 9, TENSOR) / model.tensor_unit(data)


def resolve(bodies, data, sample):
    """Leaves the meshes as they are in samples without a collision."""
    meshes = bodies.resting(), bodies.moving(sample)
    if data["isCollision"][sample]:
        bodies.function("resolve_collision")(*meshes, *contact_of(data, sample), model.RESTITUTION)
    for k, mesh in enumerate(meshes, start=1):
        yield from results_of(mesh, f", mesh {k}")


def contact_of(data, sample):
    """Copies of the data's depth, normal and point."""
    return [data[key][sample].copy() for key in list(CONTACT)[1:]]


def resolve_further(bodies, data, sample):
    """Resolves with a fixed mesh, and with the ground, where the depth is negative."""
    meshes = bodies.resting(isFixed=True), bodies.moving(sample)
    bodies.function("resolve_collision")(*meshes, *contact_of(data, sample), model.RESTITUTION)
    yield "a fixed mesh's state", state_of(meshes[0])
    yield "on the ground", on_ground(bodies, data, sample, False)


def resolve_fixed(bodies, data, sample):
    """Resolves a fixed mesh on the ground, which the released `run_timestep` asks for, too."""
    state = on_ground(bodies, data, sample, True)
    yield "fixed on the ground", WrongResult("0 / 0") if np.isnan(state).any() else state


def on_ground(bodies, data, sample, isFixed):
    mesh = bodies.moving(sample, isFixed)
    depth, _normal, point = contact_of(data, sample)
    contact = -depth, model.UP.copy(), point, model.GROUND_RESTITUTION
    bodies.function("resolve_collision")(mesh, bodies.ground(), *contact)
    return state_of(mesh)


def colliding_samples(data):
    return np.flatnonzero(data["isCollision"])[:FEW]


FOUND = CONTACT | {"isCollision": bool}
EXACT_ONLY = {"conditional": tuple(CONTACT)[1:], "conventions": (EXACT,)}
STATES = {f"result{name}, mesh {k}": width for name, width in WIDTHS.items() for k in (1, 2)}
FURTHER = "resolve_collision with fixed meshes and the ground"
UNSEEN = {"a fixed mesh's state": 13, "on the ground": 13}
FIXED = {"fixed on the ground": 13}
GUARD = (
    ": begin resolve_collision with `if m1.invMass + m2.invMass == 0: return`. A scene with a "
    "fixed body on the ground needs that, such as wrecking_ball"
)
ALONE = "resolve_collision of a fixed mesh on the ground"
EXTRA = {"samples": colliding_samples, "isExtra": True}
GRADER = Grader(
    "ResolveCollisionsGrading",
    "Collision detection and resolution",
    "collision-resolution.data",
    COLLISION_LAYOUT,
    (
        Part("detect_collision", FOUND, detect, model.detection, **EXACT_ONLY),
        Part("get_rotated_inv_IT", {TENSOR: 9}, rotate_tensor, model.rotated_tensors, isExtra=True),
        Part("resolve_collision", STATES, resolve, model.resolution),
        Part(FURTHER, UNSEEN, resolve_further, model.further_resolution, **EXTRA),
        Part(ALONE, FIXED, resolve_fixed, model.further_resolution, **EXTRA, advice=GUARD),
    ),
)

if __name__ == "__main__":
    sys.exit(run_grader(__doc__, GRADER))
