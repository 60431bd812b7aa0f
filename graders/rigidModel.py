"""The graders' own rigid-body formulas in plain NumPy, all samples at once, with known mistakes.

Each function computes what a part of a grader is to give, from the inputs in the data; and what a
program would give whose author had made certain mistakes: `mistakes` is a set of the names that are
listed in `mistakes.md`. `hints` compares. Nothing is imported from the simulation or a student.

Arrays of samples have the sample first: vectors (n, 3), quaternions (n, 4), tensors (n, 3, 3).
Units: m, kg, s, rad.
"""

from collections import namedtuple

import numpy as np
from gradingTools import RELEASED_2024, WIDTHS, GraderDataError
from released.physics2024 import (
    INERTIA_FACTOR,
    in_world_axes,
    inertia_tensor,
    rotation_matrices,
)

UP = np.array([[0.0, 1.0, 0.0]])
GRAVITY = -9.8 * UP  # m/s²
DENSITY = 1.0
TIME_STEP = 0.1  # s
RESTITUTION = 0.5
GROUND_RESTITUTION = 0.3  # another one, which tells 1 - e from e
# The bounds of a constraint, in units of the sample's reference value, and the tolerances.
BOUNDS = {"Upper": 1.2, "Lower": 0.8}
POSITION_TOLERANCE = 1e-6  # m
VELOCITY_TOLERANCE = 1e-5  # m/s
# Tolerances, in units of a constraint's error, that the error is within, and beyond.
TOLERANCES = {"within": 2.0, "beyond": 0.5}
NONE = frozenset()


def unless(mistakes, right, wrong):
    """What is right, unless a mistake is made. wrong : dict from its name to what comes of it"""
    return next((value for name, value in wrong.items() if name in mistakes), right)


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


# ---- Integration --------------------------------------------------------------------------------


def integration(data, mistakes=NONE):
    """What `Mesh.integrate_timestep` makes of each state: semi-implicit Euler."""
    x, q, v, w = (data[f"random{name}"] for name in WIDTHS)
    h, q = TIME_STEP, unit(q)
    gravity = unless(
        mistakes,
        GRAVITY,
        {
            "gravity upwards": -GRAVITY,
            "gravity of 9.81": -9.81 * UP,
            "gravity along z": GRAVITY[:, [0, 2, 1]],
            "gravity times mass": data["solids"][2].mass * GRAVITY,
        },
    )
    newV = v + gravity * unless(mistakes, h, {"velocity left": 0.0, "velocity without h": 1.0})
    shift = unless(
        mistakes,
        h * newV,
        {
            "position left": 0.0,
            "position without h": newV,
            "explicit Euler": h * v,
            "half acceleration": h * v + h**2 / 2 * gravity,
            "half acceleration too": h * newV + h**2 / 2 * gravity,
        },
    )
    half = w * unless(
        mistakes,
        h / 2,
        {"orientation without h": 0.5, "whole angle": h, "turned backwards": -h / 2},
    )
    zero = np.zeros((len(q), 1))
    pure = np.hstack([half, zero] if "scalar last" in mistakes else [zero, half])
    first = pure + np.array([1.0, 0.0, 0.0, 0.0])
    names = "first order", "first order, any length"
    turn = unless(mistakes, exponential(pure), dict.fromkeys(names, first))
    product = multiply(q, turn) if "quaternion order" in mistakes else multiply(turn, q)
    return {
        "resultPositions": x + shift,
        "resultOrientations": unless(
            mistakes, product, {"orientation left": q, "first order": unit(product)}
        ),
        "resultLinVelocities": newV,
        "resultAngVelocities": w,
    }


def further_integration(data, mistakes=NONE):
    """The pose (n, 7) of a mesh that is fixed, which stays; and of a free one how far
    `currVertices` are from where its vertices are, which is nowhere."""
    step, still = integration(data, mistakes), {}
    poses = data["randomPositions"], unit(data["randomOrientations"])
    now = carried(data, step["resultPositions"], step["resultOrientations"])
    late = carried(data, *poses) - now
    if "fixed is free" in mistakes:
        still = {f"random{name}": 0.0 * poses[0] for name in ("LinVelocities", "AngVelocities")}
        poses = list(integration(data | still, mistakes).values())[:2]
    return {
        "a fixed mesh's pose": np.hstack(poses),
        "currVertices": unless(mistakes, 0.0 * late, {"vertices left": late}),
    }


def carried(data, positions, orientations):
    """The vertices of mesh 2 in these poses, (n, 3 V)."""
    R, body = rotation_matrices(orientations), data["solids"][2]
    vertices = np.einsum("nij,vj->nvi", R, body.vertices) + positions[:, None]
    return vertices.reshape(len(R), -1)


def exponentials(data, mistakes=NONE):
    """`QExp` of each sample's turn as a single row, and of that row between two others."""
    rows = [exponential(row) for row in turn_rows(data)]
    return {"QExp of one row": rows[1], "QExp of several rows": np.hstack(rows)}


def turn_rows(data):
    """Three (n, 4): rows without a turn, [0, ω h/2], and rows that turn further."""
    pure = np.insert(0.5 * TIME_STEP * data["randomAngVelocities"], 0, 0.0, axis=1)
    return 0.0 * pure, pure, 3.0 * pure


# ---- Masses and tensors -------------------------------------------------------------------------


# Mass properties of a body of density 1: its mass, kg; its COM in the data's coordinates, (3,); its
# vertices with the COM as origin, (V, 3); its inertia tensor about the COM, (3, 3).
Solid = namedtuple("Solid", "mass centre vertices tensor")


def solids_of(data):
    """Dict from 1 and 2 to the Solid of that mesh; raises GraderDataError for what is no body."""
    solids = {}
    for k in (k for k in (1, 2) if f"tets{k}" in data):
        vertices, tets = data[f"origVertices{k}"], data[f"tets{k}"]
        corners = vertices[tets]
        volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
        mass = DENSITY * float(volumes.sum())
        if not 0.0 < mass < np.inf:
            raise GraderDataError(f"mesh {k} is not a body: its volume is {volumes.sum():g}")
        centre = np.average(corners.mean(axis=1), axis=0, weights=volumes)
        tensor = inertia_tensor(vertices, tets, DENSITY)
        solids[k] = Solid(mass, centre, vertices - centre, tensor)
    return solids


def world_inverse_tensors(data, k, R, mistakes):
    """(n, 3, 3) inverse inertia tensors in world axes: R I⁻¹ Rᵀ, or what the release has."""
    body, isReleased = data["solids"][k], data["convention"] == RELEASED_2024
    offset = body.centre @ body.centre * np.eye(3) - np.outer(body.centre, body.centre)
    tensor = body.tensor + ("tensor about the origin" in mistakes) * body.mass * offset  # Steiner
    tensor = (INERTIA_FACTOR if isReleased else 1.0) * tensor
    inverse = tensor if "tensor not inverted" in mistakes else np.linalg.inv(tensor)
    return unless(
        mistakes,
        in_world_axes(R, inverse, isReleased),
        {
            "tensor is the identity": np.broadcast_to(np.eye(3), R.shape),
            "tensor not turned": np.broadcast_to(inverse, R.shape),
            "tensor turned the other way": in_world_axes(R, inverse, not isReleased),
        },
    )


def rotated_tensors(data, mistakes=NONE):
    """World inverse inertia tensors of mesh 2, (n, 9), in units of `tensor_unit`."""
    tensors = world_inverse_tensors(
        data, 2, rotation_matrices(data["randomOrientations"]), mistakes
    )
    return {"rotated inverse inertia": tensors.reshape(-1, 9) / tensor_unit(data)}


def tensor_unit(data):
    """1 / (kg m²), of mesh 2: the inverse of its mean moment of inertia.

    In it, the entries of its inverse tensor are of size 1, as the error bound wants them.
    """
    return 3.0 / float(np.trace(data["solids"][2].tensor))


class Pair:
    """Two bodies in the states of all samples: a list of two of each quantity.

    ends : which bodies, 1 or 2 of the data or 0 for the ground; fixed : which of them are fixed
    """

    def __init__(self, data, mistakes, ends=(1, 2), fixed=()):
        n = len(data["randomPositions"])
        states = [data[f"random{name}"] for name in WIDTHS]
        rest = [np.zeros((n, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), *np.zeros((2, n, 3))]
        moving = [*states[:2], *rest[2:]] if 2 in fixed else states
        both = [moving if k == 2 else rest for k in ends]
        self.x, self.q, self.v, self.w = (list(column) for column in zip(*both, strict=True))
        self.q = [unit(q) for q in self.q]
        self.R = [rotation_matrices(q) for q in self.q]
        self.invMass, T = [0.0, 0.0], [np.zeros((n, 3, 3))] * 2
        for end, k in enumerate(ends):
            if k and (k not in fixed or "fixed is free" in mistakes):
                self.invMass[end] = 1.0 / data["solids"][k].mass
                T[end] = world_inverse_tensors(data, k, self.R[end], mistakes)
        self.invTensor = unless(
            mistakes,
            T,
            {
                "tensor of mesh 1 for mesh 2": [T[0], T[0]],
                "tensor of mesh 2 for mesh 1": [T[1], T[1]],
                "tensors exchanged": [T[1], T[0]],
            },
        )

    def move_apart(self, shift, mistakes):
        """Moves body 1 against the shifts (n, 3) and body 2 along them; returns body 2's weight.

        Each moves in proportion to its inverse mass.
        """
        right = [invMass / sum(self.invMass) for invMass in self.invMass]
        weights = unless(
            mistakes,
            right,
            {
                "equal weights": (0.5, 0.5),
                "weights exchanged": right[::-1],
                "whole correction for each": (1.0, 1.0),
            },
        )
        self.x = [self.x[0] - weights[0] * shift, self.x[1] + weights[1] * shift]
        return weights[1]

    def arms(self, points, mistakes):
        """From the COMs to the points."""
        arms = [point - x for point, x in zip(points, self.x, strict=True)]
        return unless(
            mistakes,
            arms,
            {
                "arms from the origin": points,
                "arms exchanged": arms[::-1],
                "arms reversed": [-arm for arm in arms],
            },
        )

    def closing_speed(self, arms, n, mistakes):
        """(v1 − v2)·n of the points at the arms."""
        sign = unless(mistakes, 1.0, {"closing speed of the COMs": 0.0, "r × ω": -1.0})
        v1, v2 = (v + sign * np.cross(w, r) for v, w, r in zip(self.v, self.w, arms, strict=True))
        return dot(v1 - v2, n)

    def push(self, arms, n, factor, mistakes):
        """Changes the velocities by an impulse −j n on body 1 and j n on body 2, at the arms.

        j = factor (v1 − v2)·n / (m1⁻¹ + m2⁻¹ + Σ (r × n)ᵀ I⁻¹ (r × n))
        """
        crosses = [np.cross(arm, n) for arm in arms]
        changes = [
            np.einsum("nij,nj->ni", T, c) for T, c in zip(self.invTensor, crosses, strict=True)
        ]
        turning = sum(dot(c, change) for c, change in zip(crosses, changes, strict=True))
        closing = self.closing_speed(arms, n, mistakes)
        closing = unless(mistakes, closing, {"closing only": np.maximum(closing, 0.0)})
        j = (
            factor
            * closing
            / (sum(self.invMass) + ("no rotational term" not in mistakes) * turning)
        )
        j = unless(mistakes, j, {"impulse's sign": -j, "impulse left": 0.0 * j})
        spin = unless(
            mistakes, 1.0, {"angular velocities left": 0.0, "angular impulse's sign": -1.0}
        )
        for k, sign in ((0, -1.0), (1, 1.0)):
            invMass = unless(mistakes, self.invMass[k], {"impulse without inverse mass": 1.0})
            change = unless(mistakes, changes[k], {"spin without inertia": crosses[k]})
            if not {f"velocity {k + 1} lost", f"velocities {k + 1} lost"} & mistakes:
                self.v[k] = self.v[k] + sign * invMass * scaled(j, n)
            if f"velocities {k + 1} lost" not in mistakes:
                self.w[k] = self.w[k] + spin * sign * scaled(j, change)


# ---- Collisions ---------------------------------------------------------------------------------


def detection(data, mistakes=NONE):
    """isCollision (n,), depth (n,), intNormal and intPosition (n, 3): the data's own."""
    keys = "isCollision", "depth", "intNormal", "intPosition"
    isCollision, depth, normal, point = (data[key] for key in keys)
    depth = unless(mistakes, depth, {"depth's sign": -depth})
    point = unless(mistakes, point, {"point of mesh 1": point + scaled(depth, normal)})
    normal = unless(mistakes, normal, {"normal's sign": -normal})
    if "normal and point exchanged" in mistakes:
        normal, point = point, normal
    return dict(zip(keys, (isCollision, depth, normal, point), strict=True))


def contacts_of(data):
    """The data's depth (n,), normal and point (n, 3); zero where there is no collision."""
    hit = data["isCollision"]
    rows = data["depth"], data["intNormal"], data["intPosition"]
    return [np.where(hit if row.ndim == 1 else hit[:, None], row, 0.0) for row in rows]


def resolve(pair, depth, n, point, e, mistakes):
    """Changes a Pair as `resolve_collision` does."""
    if sum(pair.invMass) == 0.0:
        return
    depth = unless(
        mistakes,
        depth,
        {
            "depth's absolute value": np.abs(depth),
            "pushed together": -depth,
            "positions left": 0.0 * depth,
        },
    )
    shift = scaled(depth, n)
    point = point + pair.move_apart(shift, mistakes) * shift
    factor = unless(
        mistakes,
        1.0 + e,
        {
            "restitution twice": 1.0 + 2.0 * e,
            "restitution squared": (1.0 + e) ** 2,
            "restitution left out": 1.0,
            "restitution alone": e,
            "restitution subtracted": 1.0 - e,
        },
    )
    pair.push(pair.arms([point, point], mistakes), n, factor, mistakes)


def resolution(data, mistakes=NONE):
    """Both bodies, (2, n, ...), after `resolve_collision`; without a collision they stay."""
    pair = Pair(data, mistakes)
    resolve(pair, *contacts_of(data), RESTITUTION, mistakes)
    columns = (pair.x, pair.q, pair.v, pair.w)
    return {f"result{name}": np.array(one) for name, one in zip(WIDTHS, columns, strict=True)}


def further_resolution(data, mistakes=NONE):
    """States (n, 13): of mesh 1, were it fixed; and of mesh 2, free and fixed, on the ground."""
    depth, normal, point = contacts_of(data)
    up = np.repeat(UP, len(depth), axis=0)
    states = {}
    for name, ends, fixed, contact in (
        ("a fixed mesh's state", (1, 2), (1,), (depth, normal, point, RESTITUTION)),
        ("on the ground", (2, 0), (), (-depth, up, point, GROUND_RESTITUTION)),
        ("fixed on the ground", (2, 0), (2,), (-depth, up, point, GROUND_RESTITUTION)),
    ):
        pair = Pair(data, mistakes, ends, fixed)
        resolve(pair, *contact, mistakes)
        states[name] = np.hstack([pair.x[0], pair.q[0], pair.v[0], pair.w[0]])
    return states


# ---- Constraints --------------------------------------------------------------------------------


def constrained_points(data, pair, mistakes):
    """World positions of rest vertex 0 of mesh 1, carried along by either body."""
    body = data["solids"][1]
    restPoint = body.vertices[0] + ("COM not subtracted" in mistakes) * body.centre
    return [R @ restPoint + x for R, x in zip(pair.R, pair.x, strict=True)]


def is_valid(C, isUpper, tolerance, mistakes):
    """Whether a bound is satisfied: C ≤ tolerance for an upper one, C ≥ −tolerance for a lower."""
    upper = C <= unless(mistakes, tolerance, {"no tolerance": 0.0})
    lower = C >= unless(
        mistakes, -tolerance, {"no tolerance": 0.0, "lower tolerance's sign": tolerance}
    )
    wasValid = upper if isUpper != ("bounds exchanged" in mistakes) else lower
    always, never = np.full((2, len(C)), [[True], [False]])
    return unless(mistakes, wasValid, {"always valid": always, "never valid": never})


def position_constraints(data, mistakes=NONE):
    """`resolve_position_constraint` on both bounds: flags (n,), corrected positions (2, n, 3); and
    flags with tolerances that C is within, and beyond."""
    results = {}
    isInverted = "flag inverted" in mistakes
    for bound, factor in BOUNDS.items():
        pair, isUpper = Pair(data, NONE), bound == "Upper"
        point1, point2 = constrained_points(data, pair, mistakes)
        gap = point1 - point2
        C = np.linalg.norm(gap, axis=1) - factor * data["refValues"][:, 0]
        wasValid = is_valid(C, isUpper, POSITION_TOLERANCE, mistakes)
        shift = scaled(np.where(wasValid, 0.0, C), unit(gap))
        pair.move_apart(
            unless(
                mistakes,
                shift,
                {
                    "correction left": 0.0 * shift,
                    "correction's sign": -shift,
                    "direction of any length": scaled(np.linalg.norm(gap, axis=1), shift),
                },
            ),
            mistakes,
        )
        results[f"positionWasValid{bound}"] = wasValid != isInverted
        results[f"correctedPositions{bound}"] = np.array(pair.x)
        for place, unitsOfC in TOLERANCES.items():
            wasValid = is_valid(C, isUpper, unitsOfC * np.abs(C), mistakes)
            results[f"C {place} the tolerance, {bound}"] = wasValid != isInverted
    return results | {"two fixed meshes": np.full(len(C), not isInverted)}


def velocity_constraints(data, mistakes=NONE):
    """`resolve_velocity_constraint`: velocityWasValid (n,), and (2, n, 3) corrected velocities; and
    flags with tolerances that |J v| is within, and beyond.

    J v = 0 afterwards is an impulse along n that stops the change of the distance: a collision's
    without restitution.
    """
    pair = Pair(data, mistakes)
    points = constrained_points(data, pair, mistakes)
    n, arms = unit(points[0] - points[1]), pair.arms(points, mistakes)
    Jv = np.abs(pair.closing_speed(arms, n, mistakes))
    before = np.array([pair.v, pair.w])
    pair.push(arms, n, 1.0, mistakes)

    def are_valid(tolerance):
        valid = Jv <= unless(mistakes, tolerance, {"no tolerance": 0.0})
        return valid | ("always valid" in mistakes)

    wasValid = are_valid(VELOCITY_TOLERANCE)
    after = np.where(wasValid[:, None], before, [pair.v, pair.w])
    after = unless(mistakes, after, {"linear and angular exchanged": after[::-1]})
    rates = distance_rates(data) if mistakes else Jv
    isInverted = "flag inverted" in mistakes
    return {
        "velocityWasValid": wasValid != isInverted,
        "correctedLinVelocities": after[0],
        "correctedAngVelocities": after[1],
        **{
            f"|J v| {place} the tolerance": are_valid(factor * rates) != isInverted
            for place, factor in TOLERANCES.items()
        },
    }


def distance_rates(data):
    """|J v| (n,)"""
    pair = Pair(data, NONE)
    points = constrained_points(data, pair, NONE)
    arms, n = pair.arms(points, NONE), unit(points[0] - points[1])
    return np.abs(pair.closing_speed(arms, n, NONE))
