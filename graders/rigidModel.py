"""The graders' own rigid-body formulas in plain NumPy, all samples at once, with known mistakes.

Each function computes what a part of a grader is to give, from the inputs in the data; and what a
program would give whose author had made certain mistakes, which `mistakes.md` lists by the names
that are looked for here. `hints` compares. Nothing is imported from the simulation or a student.

Arrays of samples have the sample first: vectors (n, 3), quaternions (n, 4), tensors (n, 3, 3).
Units: m, kg, s, rad. `mistakes` is a set of names.
"""

from dataclasses import dataclass

import numpy as np
from gradingTools import RELEASED_2024, WIDTHS, GraderDataError
from released.physics2024 import (
    INERTIA_FACTOR,
    in_world_axes,
    inertia_tensor,
    rotation_matrices,
)

from rbs.submissions import our_module

GRAVITY = 9.8  # m/s²
DENSITY = 1.0
TIME_STEP = 0.1  # s
RESTITUTION = 0.5
GROUND_RESTITUTION = 0.3  # another one, that 1 - e may be told from e
UP = np.array([[0.0, 1.0, 0.0]])
# The bounds of a constraint, in units of the sample's reference value, and the tolerances.
BOUNDS = {"Upper": 1.2, "Lower": 0.8}
POSITION_TOLERANCE = 1e-6  # m
VELOCITY_TOLERANCE = 1e-5  # m/s
# Tolerances within which, and beyond which, a constraint is violated, in units of its violation.
TOLERANCES = {"within": 2.0, "beyond": 0.5}


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


def turned(matrices, v):
    """Matrix times vector, row by row."""
    return np.einsum("nij,nj->ni", matrices, v)


# ---- Integration --------------------------------------------------------------------------------


def integration(data, mistakes=frozenset()):
    """What `Mesh.integrate_timestep` makes of each state: semi-implicit Euler."""
    x, v, w = (data[f"random{name}"] for name in ("Positions", "LinVelocities", "AngVelocities"))
    q = unit(data["randomOrientations"])
    gravity = GRAVITY * np.array([0.0, 0.0, -1.0] if "gravity along z" in mistakes else -UP[0])
    if "gravity upwards" in mistakes:
        gravity = -gravity
    if "gravity of 9.81" in mistakes:
        gravity = 9.81 / GRAVITY * gravity
    if "gravity times mass" in mistakes:
        gravity = solid(data, 2).mass * gravity
    newV = v + (1.0 if "velocity without h" in mistakes else TIME_STEP) * gravity
    if "velocity left" in mistakes:
        newV = v
    old = {"explicit Euler", "half acceleration"} & mistakes
    shift = (1.0 if "position without h" in mistakes else TIME_STEP) * (v if old else newV)
    if {"half acceleration", "half acceleration too"} & mistakes:
        shift = shift + 0.5 * TIME_STEP**2 * gravity
    return {
        "resultPositions": x if "position left" in mistakes else x + shift,
        "resultOrientations": _new_orientation(q, w, mistakes),
        "resultLinVelocities": newV,
        "resultAngVelocities": w,
    }


def _new_orientation(q, w, mistakes):
    """exp([0, ω h/2]) ∘ q, with mistakes."""
    if "orientation left" in mistakes:
        return q
    half = 0.5 * (1.0 if "orientation without h" in mistakes else TIME_STEP) * w
    half = (2.0 if "whole angle" in mistakes else 1.0) * half
    half = -half if "turned backwards" in mistakes else half
    zero = np.zeros((len(q), 1))
    pure = np.hstack([half, zero] if "scalar last" in mistakes else [zero, half])
    turn = exponential(pure)
    if {"first order", "first order, any length"} & mistakes:
        turn = pure + np.array([1.0, 0.0, 0.0, 0.0])
    product = multiply(q, turn) if "quaternion order" in mistakes else multiply(turn, q)
    return unit(product) if "first order" in mistakes else product


def unmoved(data, mistakes=frozenset()):
    """A fixed mesh's pose (n, 7) after `integrate_timestep`, and how far `currVertices` are from
    where a free mesh then is: nowhere."""
    n = len(data["randomPositions"])
    poses = data["randomPositions"], unit(data["randomOrientations"])
    if "fixed is free" in mistakes:
        rest = {f"random{name}": np.zeros((n, 3)) for name in ("LinVelocities", "AngVelocities")}
        moved = integration(data | rest, mistakes)
        poses = moved["resultPositions"], moved["resultOrientations"]
    step = integration(data, mistakes)
    after = carried(data, step["resultPositions"], step["resultOrientations"])
    before = carried(data, data["randomPositions"], data["randomOrientations"])
    difference = before - after if "vertices left" in mistakes else 0.0 * after
    return {"a fixed mesh's pose": np.hstack(poses), "currVertices": difference}


def carried(data, positions, orientations):
    """The vertices of mesh 2 in these poses, (n, 3 V)."""
    body = solid(data, 2)
    R = rotation_matrices(orientations)
    vertices = np.einsum("nij,vj->nvi", R, body.vertices - body.centre) + positions[:, None]
    return vertices.reshape(len(positions), -1)


def exponentials(data, mistakes=frozenset()):
    """`QExp` of each sample's turn as a single row, and of that row between two others."""
    rows = turn_rows(data)
    one = exponential(rows[1])
    return {
        "QExp of one row": one,
        "QExp of several rows": np.hstack([exponential(part) for part in rows]),
    }


def turn_rows(data):
    """Three (n, 4): rows without a turn, [0, ω h/2], and a turn by more than that."""
    pure = np.insert(0.5 * TIME_STEP * data["randomAngVelocities"], 0, 0.0, axis=1)
    return 0.0 * pure, pure, 3.0 * pure


# ---- Masses and tensors -------------------------------------------------------------------------


@dataclass(frozen=True)
class Solid:
    """Mass properties of a body of density 1.

    mass : kg; centre (3,) : the COM in the data's coordinates
    vertices (V, 3) : the data's; tensor (3, 3) : about the COM
    """

    mass: float
    centre: np.ndarray
    vertices: np.ndarray
    tensor: np.ndarray


def solid(data, k):
    """The Solid of mesh k of the data, 1 or 2; raises ValueError where it has no volume."""
    vertices, tets = data[f"origVertices{k}"], data[f"tets{k}"]
    corners = vertices[tets]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    mass = DENSITY * float(volumes.sum())
    if not 0.0 < mass < np.inf:
        raise ValueError(f"density {DENSITY:g} times volume {volumes.sum():g} gives no mass")
    centre = np.average(corners.mean(axis=1), axis=0, weights=volumes)
    return Solid(mass, centre, vertices, inertia_tensor(vertices, tets, DENSITY))


def check_bodies(data):
    """Raises GraderDataError unless both meshes of the data are bodies."""
    for k in (1, 2):
        if f"tets{k}" in data:
            try:
                solid(data, k)
            except (ValueError, np.linalg.LinAlgError) as problem:
                raise GraderDataError(f"mesh {k} is not a body: {problem}") from None


def world_inverse_tensors(data, k, R, mistakes):
    """(n, 3, 3) inverse inertia tensors in world axes: R I⁻¹ Rᵀ, or what the release has."""
    body, isReleased = solid(data, k), data["convention"] == RELEASED_2024
    tensor = body.tensor
    if "tensor about the origin" in mistakes:  # Steiner's theorem
        offset = body.centre @ body.centre * np.eye(3) - np.outer(body.centre, body.centre)
        tensor = tensor + body.mass * offset
    if isReleased:
        tensor = INERTIA_FACTOR * tensor
    inverse = tensor if "tensor not inverted" in mistakes else np.linalg.inv(tensor)
    if "tensor is the identity" in mistakes:
        return np.broadcast_to(np.eye(3), R.shape)
    if "tensor not turned" in mistakes:
        return np.broadcast_to(inverse, R.shape)
    return in_world_axes(R, inverse, isReleased != ("tensor turned the other way" in mistakes))


def rotated_tensors(data, mistakes=frozenset()):
    """World inverse inertia tensors of mesh 2, (n, 9), in units of `tensor_unit`."""
    R = rotation_matrices(data["randomOrientations"])
    tensors = world_inverse_tensors(data, 2, R, mistakes)
    return {"rotated inverse inertia": tensors.reshape(len(R), 9) / tensor_unit(data)}


def tensor_unit(data):
    """1 / (kg m²), of mesh 2: the inverse of its mean moment of inertia.

    In it, the entries of its inverse tensor are of size 1, as the error bound wants them.
    """
    return 3.0 / float(np.trace(solid(data, 2).tensor))


class Pair:
    """Two bodies in the states of all samples: a list of two of each quantity.

    ends : which bodies, 1 or 2 of the data or 0 for the ground; fixed : which of them are fixed
    """

    def __init__(self, data, mistakes, ends=(1, 2), fixed=()):
        n = len(data["randomPositions"])
        states = [data[f"random{name}"] for name in WIDTHS]
        rest = [np.zeros((n, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), *np.zeros((2, n, 3))]
        self.x, self.q, self.v, self.w = (
            [state if k == 2 else still for k in ends]
            for state, still in zip(states, rest, strict=True)
        )
        self.q = [unit(q) for q in self.q]
        self.R = [rotation_matrices(q) for q in self.q]
        self.invMass, self.invTensor = [0.0, 0.0], [np.zeros((n, 3, 3))] * 2
        for end, k in enumerate(ends):
            isFree = k not in fixed or "fixed is free" in mistakes
            if k in fixed:
                self.v[end], self.w[end] = rest[2:]
            if k and isFree:
                self.invMass[end] = 1.0 / solid(data, k).mass
                self.invTensor[end] = world_inverse_tensors(data, k, self.R[end], mistakes)
        first, second = self.invTensor
        if {"tensor of mesh 1 for mesh 2", "tensors exchanged"} & mistakes:
            self.invTensor[1] = first
        if {"tensor of mesh 2 for mesh 1", "tensors exchanged"} & mistakes:
            self.invTensor[0] = second

    def weights(self, mistakes):
        """How much of a correction each body takes: in proportion to its inverse mass."""
        invMass = self.invMass[::-1] if "weights exchanged" in mistakes else self.invMass
        if "equal weights" in mistakes:
            return 0.5, 0.5
        if "whole correction for each" in mistakes:
            return 1.0, 1.0
        return invMass[0] / sum(invMass), invMass[1] / sum(invMass)

    def arms(self, points, mistakes):
        """From the COMs to the points."""
        origins = [0.0 * x for x in self.x] if "arms from the origin" in mistakes else self.x
        arms = [point - x for point, x in zip(points, origins, strict=True)]
        if "arms exchanged" in mistakes:
            arms = arms[::-1]
        return [-arm for arm in arms] if "arms reversed" in mistakes else arms

    def closing_speed(self, arms, n, mistakes):
        """(v1 − v2)·n of the points at the arms."""
        spins = [np.cross(w, arm) for w, arm in zip(self.w, arms, strict=True)]
        if "closing speed of the COMs" in mistakes:
            spins = [0.0, 0.0]
        if "r × ω" in mistakes:
            spins = [-spin for spin in spins]
        speeds = [dot(v + spin, n) for v, spin in zip(self.v, spins, strict=True)]
        return speeds[0] - speeds[1]

    def push(self, arms, n, factor, mistakes):
        """Changes the velocities by an impulse −j n on body 1 and j n on body 2, at the arms.

        j = factor (v1 − v2)·n / (m1⁻¹ + m2⁻¹ + Σ (r × n)ᵀ I⁻¹ (r × n))
        """
        if "impulse left" in mistakes:
            return
        crosses = [np.cross(arm, n) for arm in arms]
        changes = [turned(T, c) for T, c in zip(self.invTensor, crosses, strict=True)]
        denominator = np.full(len(n), sum(self.invMass))
        if "no rotational term" not in mistakes:
            denominator = denominator + dot(crosses[0], changes[0]) + dot(crosses[1], changes[1])
        closing = self.closing_speed(arms, n, mistakes)
        j = factor * (np.maximum(closing, 0.0) if "closing only" in mistakes else closing)
        j = (-j if "impulse's sign" in mistakes else j) / denominator
        for k, sign in ((0, -1.0), (1, 1.0)):
            invMass = 1.0 if "impulse without inverse mass" in mistakes else self.invMass[k]
            change = crosses[k] if "spin without inertia" in mistakes else changes[k]
            spin = -sign if "angular impulse's sign" in mistakes else sign
            if not {f"velocity {k + 1} lost", f"velocities {k + 1} lost"} & mistakes:
                self.v[k] = self.v[k] + sign * invMass * scaled(j, n)
            if not {"angular velocities left", f"velocities {k + 1} lost"} & mistakes:
                self.w[k] = self.w[k] + spin * scaled(j, change)

    def states(self):
        """The state (n, 13) of either body: position, orientation and velocities."""
        columns = zip(self.x, self.q, self.v, self.w, strict=True)
        return [np.hstack(column) for column in columns]


# ---- Collisions ---------------------------------------------------------------------------------


def detection(data, mistakes=frozenset()):
    """isCollision (n,), depth (n,), intNormal and intPosition (n, 3), out of the data's contacts.

    Where the COM is not subtracted the meshes lie elsewhere, and collisions are looked for again by
    the project's own test, which is graded against the data itself.
    """
    keys = ("isCollision", "depth", "intNormal", "intPosition")
    isCollision, depth, normal, point = (data[key] for key in keys)
    if "COM not subtracted" in mistakes:
        hull1, hull2 = data["origVertices1"], data["origVertices2"]
        R = rotation_matrices(data["randomOrientations"])
        contacts = [
            our_module("GJK").is_collide(hull1, hull2 @ turn.T + x)
            for turn, x in zip(R, data["randomPositions"], strict=True)
        ]
        isCollision, depth, normal, point = (
            np.array([np.squeeze(value) for value in column])
            for column in zip(*contacts, strict=True)
        )
    if "point of mesh 1" in mistakes:
        point = point + scaled(depth, normal)
    depth = -depth if "depth's sign" in mistakes else depth
    normal = -normal if "normal's sign" in mistakes else normal
    if "normal and point exchanged" in mistakes:
        normal, point = point, normal
    return dict(zip(keys, (isCollision, depth, normal, point), strict=True))


def contact_of(data):
    """The data's depth (n,), normal and point (n, 3); zero where there is no collision."""
    hit = data["isCollision"]
    rows = (data["depth"], data["intNormal"], data["intPosition"])
    return [np.where(hit if row.ndim == 1 else hit[:, None], row, 0.0) for row in rows]


def resolve(pair, depth, n, point, e, mistakes):
    """Changes a Pair as `resolve_collision` does."""
    if sum(pair.invMass) == 0.0:
        return
    weights = pair.weights(mistakes)
    depth = np.abs(depth) if "depth's absolute value" in mistakes else depth
    depth = -depth if "pushed together" in mistakes else depth
    shift = (0.0 if "positions left" in mistakes else 1.0) * scaled(depth, n)
    pair.x = [pair.x[0] - weights[0] * shift, pair.x[1] + weights[1] * shift]
    point = point + weights[1] * shift
    factor = 1.0 + e
    for name, wrong in (
        ("restitution twice", 1.0 + 2.0 * e),
        ("restitution squared", (1.0 + e) ** 2),
        ("restitution left out", 1.0),
        ("restitution alone", e),
        ("restitution subtracted", 1.0 - e),
    ):
        factor = wrong if name in mistakes else factor
    pair.push(pair.arms([point, point], mistakes), n, factor, mistakes)


def resolution(data, mistakes=frozenset()):
    """Both bodies, (2, n, ...), after `resolve_collision`; without a collision they stay."""
    pair = Pair(data, mistakes)
    resolve(pair, *contact_of(data), RESTITUTION, mistakes)
    columns = (pair.x, pair.q, pair.v, pair.w)
    return {f"result{name}": np.array(one) for name, one in zip(WIDTHS, columns, strict=True)}


def fixed_resolution(data, mistakes=frozenset()):
    """The state of mesh 1, were it fixed, after `resolve_collision`: that from before."""
    pair = Pair(data, mistakes, fixed=(1,))
    resolve(pair, *contact_of(data), RESTITUTION, mistakes)
    return {"a fixed mesh's state": pair.states()[0]}


def ground_resolution(data, mistakes=frozenset()):
    """The states of mesh 2, free and fixed, after `resolve_collision` with the ground."""
    states = []
    for fixed in ((), (2,)):
        pair = Pair(data, mistakes, ends=(2, 0), fixed=fixed)
        depth, _normal, point = contact_of(data)
        resolve(pair, -depth, np.repeat(UP, len(depth), axis=0), point, GROUND_RESTITUTION, mistakes)
        states.append(pair.states()[0])
    return dict(zip(("on the ground", "fixed on the ground"), states, strict=True))


# ---- Constraints --------------------------------------------------------------------------------


def constrained_points(data, pair, mistakes):
    """World positions of rest vertex 0 of mesh 1, carried along by either body."""
    body = solid(data, 1)
    restPoint = body.vertices[0]
    if "COM not subtracted" not in mistakes:
        restPoint = restPoint - body.centre
    return [R @ restPoint + x for R, x in zip(pair.R, pair.x, strict=True)]


def is_valid(C, isUpper, tolerance, mistakes):
    """Whether a bound is satisfied: C ≤ tolerance for an upper one, C ≥ −tolerance for a lower."""
    tolerance = 0.0 * tolerance if "no tolerance" in mistakes else tolerance
    if "always valid" in mistakes or "never valid" in mistakes:
        return np.full(len(C), "always valid" in mistakes)
    if isUpper != ("bounds exchanged" in mistakes):
        return C <= tolerance
    return C >= (tolerance if "lower tolerance's sign" in mistakes else -tolerance)


def distance_errors(data, pair, mistakes):
    """(vectors p1 − p2 (n, 3), dict from bound to C (n,))"""
    points = constrained_points(data, pair, mistakes)
    gap = points[0] - points[1]
    length = np.linalg.norm(gap, axis=1)
    return gap, {key: length - factor * data["refValues"][:, 0] for key, factor in BOUNDS.items()}


def position_constraints(data, mistakes=frozenset()):
    """`resolve_position_constraint` on both bounds: flags (n,), corrected positions (2, n, 3)."""
    pair = Pair(data, frozenset())
    weights = pair.weights(mistakes)
    gap, errors = distance_errors(data, pair, mistakes)
    direction = gap if "direction of any length" in mistakes else unit(gap)
    results = {}
    for bound, C in errors.items():
        wasValid = is_valid(C, bound == "Upper", POSITION_TOLERANCE, mistakes)
        shift = scaled(np.where(wasValid, 0.0, C), direction)
        shift = (0.0 if "correction left" in mistakes else 1.0) * shift
        shift = -shift if "correction's sign" in mistakes else shift
        results[f"positionWasValid{bound}"] = wasValid != ("flag inverted" in mistakes)
        results[f"correctedPositions{bound}"] = np.array(
            [pair.x[0] - weights[0] * shift, pair.x[1] + weights[1] * shift]
        )
    return results


def position_tolerances(data, mistakes=frozenset()):
    """Flags (n,) of both bounds with tolerances within and beyond which C lies."""
    _gap, errors = distance_errors(data, Pair(data, frozenset()), mistakes)
    isInverted = "flag inverted" in mistakes
    flags = {
        f"{bound.lower()} bound, C {place} the tolerance": isInverted
        != is_valid(C, bound == "Upper", factor * np.abs(C), mistakes)
        for bound, C in errors.items()
        for place, factor in TOLERANCES.items()
    }
    return flags | {"two fixed meshes": np.full(len(_gap), not isInverted)}


def velocity_constraints(data, mistakes=frozenset()):
    """`resolve_velocity_constraint`: velocityWasValid (n,), and (2, n, 3) corrected velocities.

    J v = 0 afterwards is an impulse along n that stops the change of the distance: a collision's
    without restitution.
    """
    pair, arms, n = _velocity_constraint(data, mistakes)
    Jv = pair.closing_speed(arms, n, mistakes)
    wasValid = (np.abs(Jv) <= VELOCITY_TOLERANCE) | ("always valid" in mistakes)
    before = pair.v, pair.w
    pair.v, pair.w = list(pair.v), list(pair.w)
    pair.push(arms, n, 1.0, mistakes)
    v, w = (
        np.where(wasValid[:, None], old, new)
        for old, new in zip(before, (pair.v, pair.w), strict=True)
    )
    if "linear and angular exchanged" in mistakes:
        v, w = w, v
    return {
        "velocityWasValid": wasValid != ("flag inverted" in mistakes),
        "correctedLinVelocities": v,
        "correctedAngVelocities": w,
    }


def distance_rates(data, mistakes=frozenset()):
    """|J v| (n,)"""
    pair, arms, n = _velocity_constraint(data, mistakes)
    return np.abs(pair.closing_speed(arms, n, mistakes))


def velocity_tolerances(data, mistakes=frozenset()):
    """Flags (n,) with tolerances within and beyond which |J v| lies."""
    flags = {}
    for place, factor in TOLERANCES.items():
        tolerance = ("no tolerance" not in mistakes) * factor * distance_rates(data)
        wasValid = (distance_rates(data, mistakes) <= tolerance) | ("always valid" in mistakes)
        flags[f"|J v| {place} the tolerance"] = wasValid != ("flag inverted" in mistakes)
    return flags


def _velocity_constraint(data, mistakes):
    """(pair, arms, n)"""
    pair = Pair(data, mistakes)
    points = constrained_points(data, pair, mistakes)
    n = unit(points[0] - points[1])
    arms = pair.arms(points, mistakes)
    return pair, arms, n
