"""The graders' own rigid-body formulas in plain NumPy, all samples at once, with known mistakes.

Each function computes what a grader's data hold, from the inputs in the data; and what a student's
program would compute who had made certain mistakes. `hints` compares. Nothing is imported from the
simulation or from a student.

Arrays of samples have the sample first: vectors (n, 3), quaternions (n, 4), tensors (n, 3, 3).
Units: m, kg, s, rad. `mistakes` is a set of the names that the functions look for.
"""

from dataclasses import dataclass

import numpy as np
from gradingTools import RELEASED_2024, GraderDataError
from released.physics2024 import INERTIA_FACTOR, inertia_tensor

from rbs.submissions import our_module

GRAVITY = np.array([0.0, -9.8, 0.0])
DENSITY = 1.0
TIME_STEP = 0.1  # s
RESTITUTION = 0.5
# The bounds of a constraint, in units of the sample's reference value, and the tolerances.
UPPER_FACTOR = 1.2
LOWER_FACTOR = 0.8
POSITION_TOLERANCE = 1e-6  # m
VELOCITY_TOLERANCE = 1e-5  # m/s


# ---- Algebra ------------------------------------------------------------------------------------


def dot(a, b):
    """(n,) products of the rows."""
    return np.einsum("ni,ni->n", a, b)


def unit(a):
    """The rows at length 1."""
    return a / np.linalg.norm(a, axis=1, keepdims=True)


def scaled(factor, a):
    """The rows (n, w), each times its factor (n,)."""
    return factor[:, None] * a


def multiply(p, q):
    """Hamilton products of the rows: (s t − u·v, s v + t u + u × v)."""
    s, u, t, v = p[:, :1], p[:, 1:], q[:, :1], q[:, 1:]
    return np.hstack([s * t - dot(u, v)[:, None], s * v + t * u + np.cross(u, v)])


def exponential(q):
    """e^s (cos |u|, sin |u| u/|u|) of the rows (s, u)."""
    angle = np.linalg.norm(q[:, 1:], axis=1, keepdims=True)
    return np.exp(q[:, :1]) * np.hstack([np.cos(angle), np.sinc(angle / np.pi) * q[:, 1:]])


def rotations(q):
    """Rotation matrices (n, 3, 3) of quaternions of any length but zero."""
    w, x, y, z = unit(q).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def turned(matrices, v):
    """Matrix times vector, row by row."""
    return np.einsum("nij,nj->ni", matrices, v)


# ---- Integration --------------------------------------------------------------------------------


def integration(data, mistakes=frozenset()):
    """What `Mesh.integrate_timestep` makes of each state: semi-implicit Euler.

    Returns a dict with resultPositions, resultOrientations, resultLinVelocities and
    resultAngVelocities.
    """
    x, v, w = (data[f"random{name}"] for name in ("Positions", "LinVelocities", "AngVelocities"))
    q = unit(data["randomOrientations"])
    gravity = GRAVITY
    if "gravity upwards" in mistakes:
        gravity = -GRAVITY
    newV = v if "velocity left" in mistakes else v + TIME_STEP * gravity
    mover = v if "explicit Euler" in mistakes else newV
    newX = x if "position left" in mistakes else x + TIME_STEP * mover
    return {
        "resultPositions": newX,
        "resultOrientations": _new_orientation(q, w, mistakes),
        "resultLinVelocities": newV,
        "resultAngVelocities": w,
    }


def fixed_integration(data, mistakes=frozenset()):
    """The pose (n, 7), position and orientation, of a fixed mesh after `integrate_timestep`."""
    poses = data["randomPositions"], unit(data["randomOrientations"])
    if "fixed is free" in mistakes:
        atRest = data | {
            key: np.zeros_like(data[key]) for key in ("randomLinVelocities", "randomAngVelocities")
        }
        moved = integration(atRest, mistakes)
        poses = moved["resultPositions"], moved["resultOrientations"]
    return np.hstack(poses)


def _new_orientation(q, w, mistakes):
    """exp([0, ω h/2]) ∘ q, with mistakes."""
    if "orientation left" in mistakes:
        return q
    half = 0.5 * TIME_STEP * w
    if "whole angle" in mistakes:
        half = 2.0 * half
    if "turned backwards" in mistakes:
        half = -half
    zero = np.zeros((len(q), 1))
    pure = np.hstack([half, zero] if "scalar last" in mistakes else [zero, half])
    turn = exponential(pure)
    if {"first order", "first order, any length"} & mistakes:
        turn = pure + np.array([1.0, 0.0, 0.0, 0.0])
    product = multiply(q, turn) if "quaternion order" in mistakes else multiply(turn, q)
    return unit(product) if "first order" in mistakes else product


# ---- Masses and tensors -------------------------------------------------------------------------


@dataclass(frozen=True)
class Solid:
    """Mass properties of a body of density 1.

    mass : kg; centre (3,) : the COM in the data's coordinates
    vertices (V, 3) : the data's; tensor (3, 3) : about the COM
    tensorAtOrigin (3, 3) : about the origin of the data's coordinates
    """

    mass: float
    centre: np.ndarray
    vertices: np.ndarray
    tensor: np.ndarray
    tensorAtOrigin: np.ndarray


def solid(data, k):
    """The Solid of mesh k of the data, 1 or 2; raises ValueError where it has no volume."""
    vertices, tets = data[f"origVertices{k}"], data[f"tets{k}"]
    corners = vertices[tets]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    mass = DENSITY * float(volumes.sum())
    if not 0.0 < mass < np.inf:
        raise ValueError(f"density {DENSITY:g} times volume {volumes.sum():g} gives no mass")
    centre = np.average(corners.mean(axis=1), axis=0, weights=volumes)
    tensor = inertia_tensor(vertices, tets, DENSITY)
    # Steiner's theorem
    atOrigin = tensor + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return Solid(mass, centre, vertices, tensor, atOrigin)


def check_bodies(data):
    """Raises GraderDataError unless both meshes of the data are bodies."""
    for k in (1, 2):
        if f"tets{k}" in data:
            try:
                solid(data, k)
            except (ValueError, np.linalg.LinAlgError) as problem:
                raise GraderDataError(f"mesh {k} is not a body: {problem}") from None


def world_inverse_tensors(body, R, convention, mistakes):
    """(n, 3, 3) inverse inertia tensors in world axes, R I⁻¹ Rᵀ; of the release, Rᵀ (I/6)⁻¹ R."""
    isReleased = convention == RELEASED_2024
    tensor = body.tensorAtOrigin if "tensor about the origin" in mistakes else body.tensor
    if isReleased != ("tensor six times" in mistakes):
        tensor = INERTIA_FACTOR * tensor
    if "tensor not inverted" in mistakes:
        inverse = tensor
    else:
        inverse = np.linalg.inv(tensor)
    if "tensor is the identity" in mistakes:
        return np.broadcast_to(np.eye(3), R.shape)
    if "tensor not turned" in mistakes:
        return np.broadcast_to(inverse, R.shape)
    if isReleased != ("tensor turned the other way" in mistakes):
        R = R.transpose(0, 2, 1)
    return R @ inverse @ R.transpose(0, 2, 1)


def rotated_tensors(data, mistakes=frozenset()):
    """World inverse inertia tensors of mesh 2, (n, 9), in units of `tensor_unit`."""
    R = rotations(data["randomOrientations"])
    tensors = world_inverse_tensors(solid(data, 2), R, data["convention"], mistakes)
    return tensors.reshape(len(R), 9) / tensor_unit(data)


def tensor_unit(data):
    """1 / (kg m²), of mesh 2: the inverse of its mean moment of inertia.

    In it, the entries of its inverse tensor are of size 1, as the error bound wants them.
    """
    return 3.0 / float(np.trace(solid(data, 2).tensor))


@dataclass
class _Pair:
    """Both bodies in the states of all samples, and what is taken from each."""

    invMass: list
    R: list
    invTensor: list
    x: list
    v: list
    w: list


def _pair(data, mistakes):
    bodies = solid(data, 1), solid(data, 2)
    n = len(data["randomPositions"])
    zero = np.zeros((n, 3))
    R = [np.broadcast_to(np.eye(3), (n, 3, 3)), rotations(data["randomOrientations"])]
    return _Pair(
        invMass=[1.0 / body.mass for body in bodies],
        R=R,
        invTensor=[
            world_inverse_tensors(body, turn, data["convention"], mistakes)
            for body, turn in zip(bodies, R, strict=True)
        ],
        x=[zero, data["randomPositions"]],
        v=[zero, data["randomLinVelocities"]],
        w=[zero, data["randomAngVelocities"]],
    )


def _weights(invMass, mistakes):
    """How much of a correction each body takes: in proportion to its inverse mass."""
    if "equal weights" in mistakes:
        return 0.5, 0.5
    if "weights exchanged" in mistakes:
        invMass = invMass[::-1]
    return invMass[0] / sum(invMass), invMass[1] / sum(invMass)


# ---- Collisions ---------------------------------------------------------------------------------


def detection(data, mistakes=frozenset()):
    """isCollision (n,), depth (n,), intNormal and intPosition (n, 3), out of the data's contacts.

    Where the COM is not subtracted the meshes lie elsewhere, and collisions are looked for again by
    the project's own test, which is graded against the data itself.
    """
    contacts = data
    if "COM not subtracted" in mistakes:
        contacts = _contacts_of_shifted_meshes(data)
    isCollision, depth, normal, point = (
        contacts[key] for key in ("isCollision", "depth", "intNormal", "intPosition")
    )
    if "point of mesh 1" in mistakes:
        point = point + scaled(depth, normal)
    return {
        "isCollision": isCollision,
        "depth": -depth if "depth's sign" in mistakes else depth,
        "intNormal": -normal if "normal's sign" in mistakes else normal,
        "intPosition": point,
    }


def _contacts_of_shifted_meshes(data):
    hulls = [data[f"origVertices{k}"] for k in (1, 2)]
    contacts = [
        our_module("GJK").is_collide(hulls[0], hulls[1] @ R.T + x)
        for R, x in zip(rotations(data["randomOrientations"]), data["randomPositions"], strict=True)
    ]
    keys = ("isCollision", "depth", "intNormal", "intPosition")
    columns = zip(*contacts, strict=True)
    return {
        key: np.array([np.squeeze(value) for value in column])
        for key, column in zip(keys, columns, strict=True)
    }


def resolution(data, mistakes=frozenset()):
    """Both bodies after `resolve_collision` with the data's depth, normal and point.

    Returns a dict of (2, n, ...) arrays: resultPositions, resultOrientations, resultLinVelocities,
    resultAngVelocities. Samples without a collision stay as they are.
    """
    pair = _pair(data, mistakes)
    hit = data["isCollision"]
    n = np.where(hit[:, None], data["intNormal"], 0.0)
    depth = np.where(hit, data["depth"], 0.0)
    point = np.where(hit[:, None], data["intPosition"], 0.0)
    weights = _weights(pair.invMass, mistakes)
    shift = scaled(depth, n)
    if "positions left" in mistakes:
        shift = 0.0 * shift
    sign = -1.0 if "pushed together" in mistakes else 1.0
    x = [pair.x[0] - sign * weights[0] * shift, pair.x[1] + sign * weights[1] * shift]
    point = point + weights[1] * shift
    arms = [point - origin for origin in x]
    v, w = _impulses(pair, arms, n, 1.0 + RESTITUTION, mistakes)
    q = unit(data["randomOrientations"])
    return {
        "resultPositions": np.array(x),
        "resultOrientations": np.array([np.tile([1.0, 0.0, 0.0, 0.0], (len(q), 1)), q]),
        "resultLinVelocities": np.array(v),
        "resultAngVelocities": np.array(w),
    }


def fixed_resolution(data, mistakes=frozenset()):
    """The state (n, 13) of mesh 1, were it fixed, after `resolve_collision`: that from before."""
    if "fixed is free" in mistakes:
        return np.hstack([pair[0] for pair in resolution(data, mistakes).values()])
    state = np.zeros((len(data["depth"]), 13))
    state[:, 3] = 1.0  # at the origin, unturned, at rest
    return state


def _impulses(pair, arms, n, factor, mistakes):
    """(velocities, angular velocities), two arrays each, after an impulse −j n, +j n at the arms.

    j = factor ((v1 − v2)·n) / (m1⁻¹ + m2⁻¹ + Σ (r × n)ᵀ I⁻¹ (r × n))
    """
    if "impulse left" in mistakes:
        return pair.v, pair.w
    crosses = [np.cross(arm, n) for arm in arms]
    changes = [turned(T, c) for T, c in zip(pair.invTensor, crosses, strict=True)]
    denominator = np.full(len(n), sum(pair.invMass))
    if "no rotational term" not in mistakes:
        denominator = denominator + dot(crosses[0], changes[0]) + dot(crosses[1], changes[1])
    speeds = []
    for v, w, arm in zip(pair.v, pair.w, arms, strict=True):
        pointVelocity = v if "closing speed of the COMs" in mistakes else v + np.cross(w, arm)
        speeds.append(dot(pointVelocity, n))
    closing = speeds[0] - speeds[1]
    if "closing only" in mistakes:
        closing = np.maximum(closing, 0.0)
    for name, wrong in (
        ("restitution twice", 1.0 + 2.0 * RESTITUTION),
        ("restitution squared", (1.0 + RESTITUTION) ** 2),
        ("restitution left out", 1.0),
        ("restitution alone", RESTITUTION),
    ):
        factor = wrong if name in mistakes else factor
    j = factor * closing / denominator
    if "impulse's sign" in mistakes:
        j = -j
    v, w = list(pair.v), list(pair.w)
    for k, sign in ((0, -1.0), (1, 1.0)):
        if not {f"velocity {k + 1} lost", f"velocities {k + 1} lost"} & mistakes:
            v[k] = v[k] + sign * pair.invMass[k] * scaled(j, n)
        if not {"angular velocities left", f"velocities {k + 1} lost"} & mistakes:
            spin = -sign if "angular impulse's sign" in mistakes else sign
            w[k] = w[k] + spin * scaled(j, changes[k])
    return v, w


# ---- Constraints --------------------------------------------------------------------------------


def _constrained_points(data, pair, mistakes):
    """World positions of rest vertex 0 of mesh 1, carried along by either body."""
    body = solid(data, 1)
    restPoint = body.vertices[0]
    if "COM not subtracted" not in mistakes:
        restPoint = restPoint - body.centre
    return [R @ restPoint + x for R, x in zip(pair.R, pair.x, strict=True)]


def position_constraints(data, mistakes=frozenset()):
    """`resolve_position_constraint` on both bounds.

    Returns a dict with positionWasValidUpper (n,), correctedPositionsUpper (2, n, 3), and the same
    of the lower bound.
    """
    pair = _pair(data, frozenset())
    points = _constrained_points(data, pair, mistakes)
    weights = _weights(pair.invMass, mistakes)
    gap = points[0] - points[1]
    direction = unit(gap)
    results = {}
    for bound, factor in (("Upper", UPPER_FACTOR), ("Lower", LOWER_FACTOR)):
        C = np.linalg.norm(gap, axis=1) - factor * data["refValues"][:, 0]
        isUpper = (bound == "Upper") != ("bounds exchanged" in mistakes)
        wasValid = C <= POSITION_TOLERANCE if isUpper else C >= -POSITION_TOLERANCE
        if "always valid" in mistakes:
            wasValid = np.ones_like(wasValid)
        if "never valid" in mistakes:
            wasValid = np.zeros_like(wasValid)
        shift = scaled(np.where(wasValid, 0.0, C), direction)
        if "correction left" in mistakes:
            shift = 0.0 * shift
        if "correction's sign" in mistakes:
            shift = -shift
        results[f"positionWasValid{bound}"] = wasValid != ("flag inverted" in mistakes)
        results[f"correctedPositions{bound}"] = np.array(
            [pair.x[0] - weights[0] * shift, pair.x[1] + weights[1] * shift]
        )
    return results


def velocity_constraints(data, mistakes=frozenset()):
    """`resolve_velocity_constraint`: velocityWasValid (n,), and (2, n, 3) corrected velocities.

    J v = 0 afterwards is an impulse along n that stops the change of the distance: a collision's
    without restitution.
    """
    pair = _pair(data, mistakes)
    points = _constrained_points(data, pair, mistakes)
    n = unit(points[0] - points[1])
    arms = [point - x for point, x in zip(points, pair.x, strict=True)]
    rates = [dot(v + np.cross(w, arm), n) for v, w, arm in zip(pair.v, pair.w, arms, strict=True)]
    wasValid = np.abs(rates[0] - rates[1]) <= VELOCITY_TOLERANCE
    if "always valid" in mistakes:
        wasValid = np.ones_like(wasValid)
    v, w = _impulses(pair, arms, n, 1.0, mistakes)
    keep = wasValid[:, None]
    return {
        "velocityWasValid": wasValid != ("flag inverted" in mistakes),
        "correctedLinVelocities": np.where(keep, pair.v, v),
        "correctedAngVelocities": np.where(keep, pair.w, w),
    }
