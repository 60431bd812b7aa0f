"""The results that submissions are compared with, by the formulas of `rbs.glass.model`.

Arrays and units are those of that room. From the top: integration; masses and tensors; two bodies;
collisions; constraints.
"""

from collections import namedtuple

import numpy as np

from rbs.glass.model import (
    UP,
    Pair,
    collide,
    is_slow,
    length_of,
    move,
    rotation_matrices,
    step,
    stop,
    unit,
    world_inverse_tensors,
)
from rbs.scenes.messages import InputError
from reference.graderData import RELEASED_2024, WIDTHS

DENSITY = 1.0
TIME_STEP = 0.1  # s
RESTITUTION = 0.5
GROUND_RESTITUTION = 0.3  # differs from RESTITUTION, so that 1 - e differs from e
# The bounds of a constraint, relative to the sample's reference value, and the tolerances.
BOUNDS = {"Upper": 1.2, "Lower": 0.8}
POSITION_TOLERANCE = 1e-6  # m
VELOCITY_TOLERANCE = 1e-5  # m/s
# Tolerances relative to a constraint's error, 10^x with x between these: the error is within those
# of the first kind, and beyond those of the second.
TOLERANCES = {"within": (0.1, 2.5), "beyond": (-2.5, -0.1)}


def steps_of(data):
    """The time steps (n,) that each sample makes one after the other, in s; 0 means none."""
    n = len(data["randomPositions"])
    usual = {"timeStep": np.full(n, TIME_STEP), "secondStep": np.zeros(n)}
    return {key: data.get(key, value) for key, value in usual.items()}


def start_of(data):
    """The random states: position, orientation, linear and angular velocity."""
    x, q, v, w = (data[f"random{name}"] for name in WIDTHS)
    return x, unit(q), v, w


def integration(data):
    state, mass = start_of(data), data["solids"][2].mass
    for count, h in enumerate(steps_of(data).values(), start=1):
        after = step(*state, h[:, None], count, mass)
        state = [np.where(h[:, None] != 0.0, b, a) for a, b in zip(state, after, strict=True)]
    return {f"result{name}": rows for name, rows in zip(WIDTHS, state, strict=True)}


def further_integration(data):
    """Results for a fixed mesh and for `currVertices`, which the data do not show.

    Gives the pose (n, 7) of a fixed mesh, which must stay, and the distance of a free mesh's
    `currVertices` from its vertices, which must be zero.
    """
    x, q, v, w = start_of(data)
    h, mass = steps_of(data)["timeStep"][:, None], data["solids"][2].mass
    newX, newQ, *_velocities = step(x, q, v, w, h, 1, mass)
    pose, drawn = (x, q), (newX, newQ)
    vertices = carried(data, *drawn) - carried(data, newX, newQ)
    return {"a fixed mesh's pose": np.hstack(pose), "currVertices": vertices}


def carried(data, positions, orientations):
    R, body = rotation_matrices(orientations), data["solids"][2]
    vertices = body.vertices @ np.swapaxes(R, 1, 2) + positions[:, None]
    return vertices.reshape(len(R), -1)


def mass_properties(vertices, tets):
    """Returns volume, centroid (3,), and inertia tensor (3, 3) about it for density 1.

    vertices (V, 3), anywhere; tets (T, 4), in any orientation. Over a tetrahedron with the corners
    x_i the integral of x xᵀ is V/20 (Σ x_i x_iᵀ + (Σ x_i)(Σ x_i)ᵀ) (F. Tonon, "Explicit exact
    formulas for the 3-D tetrahedron inertia tensor", J. Math. Stat. 1, 2005). With C the sum of
    these, the tensor is tr(C) 1 − C.
    """
    corners = np.asarray(vertices)[np.asarray(tets, dtype=np.int64)]
    a, b, c, d = np.moveaxis(corners, 1, 0)
    volumes = np.abs(np.sum((b - a) * np.cross(c - a, d - a), axis=1)) / 6
    centre = volumes @ corners.sum(axis=1) / (4 * volumes.sum())
    corners = corners - centre
    sums = corners.sum(axis=1)
    moments = np.swapaxes(corners, 1, 2) @ corners + sums[:, :, None] * sums[:, None]
    C = np.sum(volumes[:, None, None] * moments, axis=0) / 20
    return volumes.sum(), centre, np.trace(C) * np.eye(3) - C


# Mass properties of a body of density 1: its mass; its COM in the data's coordinates, (3,); its
# vertices relative to the COM, (V, 3); its inertia tensor about the COM, (3, 3).
Solid = namedtuple("Solid", "mass centre vertices tensor")


def solids_of(data):
    """Returns a dict from 1 and 2 to the mesh's Solid. Raises InputError if it has no volume."""
    solids = {}
    for k in (k for k in (1, 2) if f"tets{k}" in data):
        vertices = data[f"origVertices{k}"]
        volume, centre, tensor = mass_properties(vertices, data[f"tets{k}"])
        if not 0.0 < volume < np.inf:
            raise InputError(f"mesh {k} is not a body: its volume is {volume:g}")
        solids[k] = Solid(DENSITY * volume, centre, vertices - centre, DENSITY * tensor)
    return solids


def inertia_of(data):
    """Whether the graded class has the release's tensor, and turns it as the release does."""
    isReleased = data["convention"] == RELEASED_2024
    return data.get("inertia", (isReleased, isReleased))


def rotated_tensors(data):
    """World inverse inertia tensors of mesh 2, (n, 9), in units of `tensor_unit`."""
    tensors = world_inverse_tensors(data["solids"][2], start_of(data)[1], *inertia_of(data))
    return {"rotated inverse inertia": tensors.reshape(-1, 9) / tensor_unit(data)}


def tensor_unit(data):
    """The inverse of mesh 2's mean moment of inertia, 1 / (kg m²).

    In this unit the entries of its inverse tensor are of size 1, as the error bound requires.
    """
    return 3.0 / float(np.trace(data["solids"][2].tensor))


def pair_of(data, ends=(1, 2), fixed=()):
    """The Pair of two bodies in the states of all samples.

    ends : the two bodies, 1 or 2 of the data or 0 for the ground; fixed : those that are fixed
    """
    n, found = len(data["randomPositions"]), []
    rest = np.zeros((n, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), *np.zeros((2, n, 3))
    for k in ends:
        x, q, v, w = start_of(data) if k == 2 else rest
        isFree = k not in fixed
        v, w = (v, w) if k not in fixed else rest[2:]
        m = 1.0 / data["solids"][k].mass if k and isFree else 0.0
        T = np.zeros((n, 3, 3))
        if "ownTensors" in data:  # those that a student's functions had
            own = data["ownTensor2"] if k == 2 else data["ownTensors"][k, isFree]
            T = np.broadcast_to(own, (n, 3, 3))
        elif k and isFree:
            T = world_inverse_tensors(data["solids"][k], q, *inertia_of(data))
        found.append((x, q, v, w, m, T))
    return Pair(*map(list, zip(*found, strict=True)))


def contacts_of(data):
    """The data's depth (n,), normal and point (n, 3); zero where there is no collision."""
    hit = data["isCollision"]
    rows = data["depth"], data["intNormal"], data["intPosition"]
    return [np.where(hit if row.ndim == 1 else hit[:, None], row, 0.0) for row in rows]


def resolution(data):
    """Results of `resolve_collision`, (2, n, ...); where nothing collides, the states before."""
    pair = pair_of(data)
    states, _terms = collide(pair, *contacts_of(data), RESTITUTION)
    hit, (xs, vs, ws) = data["isCollision"][:, None], zip(*states, strict=True)
    x, v, w = (np.where(hit, *both) for both in ((xs, pair.x), (vs, pair.v), (ws, pair.w)))
    after = x, pair.q, v, w
    results = {f"result{name}": np.array(rows) for name, rows in zip(WIDTHS, after, strict=True)}
    return results


def further_resolution(data):
    """States (n, 13) of mesh 1 if it is fixed, and of mesh 2 on the ground; and how far the
    vertices are from where they are drawn.
    """
    depth, normal, point = contacts_of(data)
    onGround = -depth, np.repeat(UP, len(depth), axis=0), point, GROUND_RESTITUTION
    states = {}
    for name, ends, fixed, contact in (
        ("a fixed mesh's state", (1, 2), (1,), (depth, normal, point, RESTITUTION)),
        ("on the ground", (2, 0), (), onGround),
    ):
        pair = pair_of(data, ends, fixed)
        ((x, v, w), _other), _terms = collide(pair, *contact)
        drawn = x
        states[name] = np.hstack([x, pair.q[0], v, w])
    return states | {"currVertices": length_of(drawn - x)}


def constrained_points(data, pair):
    """World positions of rest vertex 0 of mesh 1, carried along by either body."""
    body = data["solids"][1]
    vertex = body.vertices[0]
    R = [rotation_matrices(q) for q in pair.q]
    return [R[0] @ vertex + pair.x[0], R[1] @ vertex + pair.x[1]]


def flag_of(wasValid):
    """What a function of constraints tells; mistakes are edits of this line."""
    return wasValid


def position_constraints(data):
    """Results of `resolve_position_constraint` for both bounds: flags and corrected positions.

    Flags (n,), positions (2, n, 3); and flags for the tolerances of `position_tolerances`.
    """
    results = {}
    for bound, factor in BOUNDS.items():
        pair, refValue = pair_of(data), factor * data["refValues"][:, 0]
        p1, p2 = constrained_points(data, pair)
        names = [key for key in (f"{place}{bound}" for place in TOLERANCES) if key in data]
        given = bound == "Upper", POSITION_TOLERANCE, [data[name] for name in names]
        (wasValid, *others), after, _terms = move(pair, p1, p2, refValue, *given)
        results[f"positionWasValid{bound}"] = flag_of(wasValid)
        results[f"correctedPositions{bound}"] = np.array(after)
        for name, isValid in zip(names, others, strict=True):
            text = f"C {name.removesuffix(bound)} the tolerance, {bound}"
            results[text] = flag_of(isValid)
    results["two fixed meshes"] = flag_of(np.full(len(refValue), True))
    return results


def drawn_tolerances(errors, data):
    """Tolerances (n,) that the errors are within, and beyond: a dict of the keys of TOLERANCES.

    Drawn by the seed of the fresh samples, so that a tolerance does not tell the error.
    """
    generator, n = np.random.Generator(np.random.PCG64(data.get("seed", 0))), len(errors)
    return {
        place: 10.0 ** (low + (high - low) * generator.random(n)) * np.abs(errors)
        for place, (low, high) in TOLERANCES.items()
    }


def position_tolerances(data):
    """Tolerances that C is within, and beyond, in each sample: "withinUpper" and so on."""
    pair, found = pair_of(data), {}
    length = length_of(np.subtract(*constrained_points(data, pair)))
    for bound, factor in BOUNDS.items():
        C = length - factor * data["refValues"][:, 0]
        for place, rows in drawn_tolerances(C, data).items():
            found[f"{place}{bound}"] = rows
    return found


def velocity_constraints(data):
    """Results of `resolve_velocity_constraint`: flags (n,) and corrected velocities (2, n, 3).

    Also flags for tolerances that |J v| is within, and beyond.
    """
    pair = pair_of(data)
    Jv, linear, angular, _terms = stop(pair, *constrained_points(data, pair))
    flags = {"velocityWasValid": is_slow(Jv, VELOCITY_TOLERANCE)}
    isKept = flags["velocityWasValid"][:, None]
    for place in filter(data.__contains__, TOLERANCES):
        flags[f"|J v| {place} the tolerance"] = is_slow(Jv, data[place])
    results = {name: flag_of(isValid) for name, isValid in flags.items()}
    results["correctedLinVelocities"] = np.where(isKept, pair.v, linear)
    return results | {"correctedAngVelocities": np.where(isKept, pair.w, angular)}


def distance_rates(data):
    """|J v| in each sample."""
    pair = pair_of(data)
    return np.abs(stop(pair, *constrained_points(data, pair))[0])
