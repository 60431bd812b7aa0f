"""Rigid-body formulas in plain NumPy, for all samples at once, with known mistakes.

Each function computes the results of one part of a grader from the inputs in the data. Given
`mistakes`, a set of names in `verdict/mistakes.md`, it computes the results of a program with these
mistakes; `hints` compares them with a submission's. Nothing is imported from the simulation.

Arrays have the sample first: vectors (n, 3), quaternions (n, 4), tensors (n, 3, 3). Units are m,
kg, s and rad. Numbers are doubles, or mpmath's in arrays of objects: `make_reference.py` computes
the results of collisions and constraints with 50 digits. From the top: algebra; integration; masses
and tensors; `Pair`, an impulse between two bodies; collisions; constraints.
"""

from collections import namedtuple

import numpy as np

from rbs.scenes.messages import InputError
from reference.graderData import RELEASED_2024, WIDTHS
from reference.physics2024 import (
    INERTIA_DIVISOR,
    in_world_axes,
    mass_properties,
    rotation_matrices,
)

UP = np.array([[0.0, 1.0, 0.0]])
GRAVITY = -9.8 * UP  # m/s²
DENSITY = 1.0
TIME_STEP = 0.1  # s
RESTITUTION = 0.5
GROUND_RESTITUTION = 0.3  # differs from RESTITUTION, so that 1 - e differs from e
# The bounds of a constraint, relative to the sample's reference value, and the tolerances.
BOUNDS = {"Upper": 1.2, "Lower": 0.8}
POSITION_TOLERANCE = 1e-6  # m
VELOCITY_TOLERANCE = 1e-5  # m/s
# Tolerances relative to a constraint's error: the error is within the first, beyond the second.
TOLERANCES = {"within": 2.0, "beyond": 0.5}
NONE = frozenset()


def unless(mistakes, right, names, *wrong):
    """Returns `right`, or the wrong value of the first of these mistakes that is made.

    names : names of mistakes, separated by "; "; wrong : a value for each
    """
    pairs = zip(names.split("; "), wrong, strict=True)
    return next((value for name, value in pairs if name in mistakes), right)


def dot(a, b):
    """Dot products of the rows, (n,)."""
    return np.sum(a * b, axis=1)


def unit(a):
    """The rows, each divided by its length."""
    return a / np.sqrt(dot(a, a))[:, None]


def inverse_of(tensor):
    """The inverse of a tensor (3, 3)."""
    a, b, c = tensor
    adjugate = np.array([np.cross(b, c), np.cross(c, a), np.cross(a, b)]).T
    return adjugate / (a @ adjugate[:, 0])


def scaled(factor, a):
    """The rows (n, w), each times its factor (n,)."""
    return factor[:, None] * a


def multiply(p, q):
    """Hamilton products of the rows: (s t − u·v, s v + t u + u × v)."""
    s, u, t, v = p[:, :1], p[:, 1:], q[:, :1], q[:, 1:]
    return np.hstack([s * t - dot(u, v)[:, None], s * v + t * u + np.cross(u, v)])


def exponential(q):
    """Exponentials of the rows (s, u): e^s (cos |u|, sin |u| u/|u|)."""
    angle = np.linalg.norm(q[:, 1:], axis=1, keepdims=True)
    return np.exp(q[:, :1]) * np.hstack([np.cos(angle), np.sinc(angle / np.pi) * q[:, 1:]])


def integration(data, mistakes=NONE):
    """Results of `Mesh.integrate_timestep`, by semi-implicit Euler."""
    x, q, v, w = (data[f"random{name}"] for name in WIDTHS)
    h, q = TIME_STEP, unit(q)
    names = "gravity upwards; gravity of 9.81; gravity along z; gravity times mass"
    wrong = -GRAVITY, -9.81 * UP, GRAVITY[:, [0, 2, 1]], data["solids"][2].mass * GRAVITY
    gravity = unless(mistakes, GRAVITY, names, *wrong)
    newV = v + gravity * unless(mistakes, h, "velocity left; velocity without h", 0.0, 1.0)
    names = "position left; position without h; explicit Euler; half acceleration; "
    wrong = 0.0, newV, h * v, h * v + h**2 / 2 * gravity, h * newV + h**2 / 2 * gravity
    shift = unless(mistakes, h * newV, names + "half acceleration too", *wrong)
    names = "orientation without h; whole angle; turned backwards"
    half = w * unless(mistakes, h / 2, names, 0.5, h, -h / 2)
    zero = np.zeros((len(q), 1))
    pure = np.hstack([half, zero] if "scalar last" in mistakes else [zero, half])
    first = pure + np.array([1.0, 0.0, 0.0, 0.0])
    names = "first order; first order, any length"
    turn = unless(mistakes, exponential(pure), names, first, first)
    product = multiply(q, turn) if "quaternion order" in mistakes else multiply(turn, q)
    newQ = unless(mistakes, product, "orientation left; first order", q, unit(product))
    results = dict(zip(WIDTHS, (x + shift, newQ, newV, w), strict=True))
    results = {f"result{name}": one for name, one in results.items()}
    return results | {"seen": {"new velocity": newV, "ω h/2": half, "exp(ω h/2)": turn}}


def further_integration(data, mistakes=NONE):
    """Results for a fixed mesh and for `currVertices`, which the data do not show.

    Gives the pose (n, 7) of a fixed mesh, which must stay, and the distance of a free mesh's
    `currVertices` from its vertices, which must be zero.
    """
    step, still = integration(data, mistakes), {}
    poses = data["randomPositions"], unit(data["randomOrientations"])
    now = carried(data, step["resultPositions"], step["resultOrientations"])
    late = carried(data, *poses) - now
    if "fixed is free" in mistakes:
        still = {f"random{name}": 0.0 * poses[0] for name in ("LinVelocities", "AngVelocities")}
        poses = list(integration(data | still, mistakes).values())[:2]
    vertices = unless(mistakes, 0.0 * late, "vertices left", late)
    return {"a fixed mesh's pose": np.hstack(poses), "currVertices": vertices}


def carried(data, positions, orientations):
    """The vertices of mesh 2 in these poses, (n, 3 V)."""
    R, body = rotation_matrices(orientations), data["solids"][2]
    vertices = body.vertices @ np.swapaxes(R, 1, 2) + positions[:, None]
    return vertices.reshape(len(R), -1)


def exponentials(data, mistakes=NONE):
    """`QExp` of each sample's turn: of a single row, and of that row between two others."""
    rows = [exponential(row) for row in turn_rows(data)]
    return {"QExp of one row": rows[1], "QExp of several rows": np.hstack(rows)}


def turn_rows(data):
    """Three arguments (n, 4) of QExp: zero, [0, ω h/2] and three times that."""
    pure = np.insert(0.5 * TIME_STEP * data["randomAngVelocities"], 0, 0.0, axis=1)
    return 0.0 * pure, pure, 3.0 * pure


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


def world_inverse_tensors(data, k, q, mistakes):
    """Inverse inertia tensors (n, 3, 3) of orientations q: R I⁻¹ Rᵀ, or the release's."""
    R = rotation_matrices(q[:, [3, 0, 1, 2]] if "tensor's scalar last" in mistakes else q)
    body, isReleased = data["solids"][k], data["convention"] == RELEASED_2024
    offset = body.centre @ body.centre * np.eye(3) - np.outer(body.centre, body.centre)
    tensor = body.tensor + ("tensor about the origin" in mistakes) * body.mass * offset  # Steiner
    tensor = tensor / (INERTIA_DIVISOR if isReleased else 1)
    inverse = tensor if "tensor not inverted" in mistakes else inverse_of(tensor)
    unturned = [np.broadcast_to(one, R.shape) for one in (np.eye(3), inverse)]
    names = "tensor is the identity; tensor not turned; tensor turned once; "
    others = *unturned, R @ inverse, in_world_axes(R, inverse, not isReleased)
    right = in_world_axes(R, inverse, isReleased)
    return unless(mistakes, right, names + "tensor turned the other way", *others)


def rotated_tensors(data, mistakes=NONE):
    """World inverse inertia tensors of mesh 2, (n, 9), in units of `tensor_unit`."""
    tensors = world_inverse_tensors(data, 2, unit(data["randomOrientations"]), mistakes)
    seen = {"R": rotation_matrices(data["randomOrientations"]), "R I⁻¹ Rᵀ": tensors}
    return {"rotated inverse inertia": tensors.reshape(-1, 9) / tensor_unit(data), "seen": seen}


def tensor_unit(data):
    """The inverse of mesh 2's mean moment of inertia, 1 / (kg m²).

    In this unit the entries of its inverse tensor are of size 1, as the error bound requires.
    """
    return 3.0 / float(np.trace(data["solids"][2].tensor))


class Pair:
    """Two bodies in the states of all samples; each quantity is a list of two arrays.

    ends : the two bodies, 1 or 2 of the data or 0 for the ground; fixed : those that are fixed
    """

    def __init__(self, data, mistakes, ends=(1, 2), fixed=()):
        n = len(data["randomPositions"])
        states = [data[f"random{name}"] for name in WIDTHS]
        rest = [np.zeros((n, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), *np.zeros((2, n, 3))]
        moving = [*states[:2], *rest[2:]] if 2 in fixed else states
        both = [moving if k == 2 else rest for k in ends]
        self.x, self.q, self.v, self.w = (list(column) for column in zip(*both, strict=True))
        self.q = [unit(q) for q in self.q]
        self.seen = {}  # intermediate values of `push`, for `--explain`
        self.R = [rotation_matrices(q) for q in self.q]
        self.invMass, T = [0.0, 0.0], [np.zeros((n, 3, 3))] * 2
        for end, k in enumerate(ends):
            if k and (k not in fixed or "fixed is free" in mistakes):
                self.invMass[end] = 1.0 / data["solids"][k].mass
                T[end] = world_inverse_tensors(data, k, self.q[end], mistakes)
        names = "tensor of mesh 1 for mesh 2; tensor of mesh 2 for mesh 1; tensors exchanged"
        self.invTensor = unless(mistakes, T, names, [T[0], T[0]], [T[1], T[1]], [T[1], T[0]])

    def move_apart(self, shift, mistakes):
        """Moves body 1 against the shifts (n, 3) and body 2 along them; returns body 2's weight.

        Each moves in proportion to its inverse mass.
        """
        right = [invMass / sum(self.invMass) for invMass in self.invMass]
        names = "equal weights; weights exchanged; whole correction for each"
        weights = unless(mistakes, right, names, (0.5, 0.5), right[::-1], (1.0, 1.0))
        self.x = [self.x[0] - weights[0] * shift, self.x[1] + weights[1] * shift]
        return weights[1]

    def arms(self, points, mistakes):
        """The vectors from the COMs to the points."""
        arms = [point - x for point, x in zip(points, self.x, strict=True)]
        names = "arms from the origin; arms exchanged; arms reversed"
        return unless(mistakes, arms, names, points, arms[::-1], [-arm for arm in arms])

    def closing_speed(self, arms, n, mistakes):
        """(v1 − v2)·n of the points at the arms."""
        sign = unless(mistakes, 1.0, "closing speed of the COMs; r × ω", 0.0, -1.0)
        signs = sign, -sign if "J's last block's sign" in mistakes else sign
        each = zip(self.v, self.w, arms, signs, strict=True)
        v1, v2 = (v + sign * np.cross(w, r) for v, w, r, sign in each)
        return dot(v1 - v2, n)

    def push(self, arms, n, factor, mistakes):
        """Changes the velocities by an impulse −j n on body 1 and j n on body 2, at the arms.

        j = factor (v1 − v2)·n / (m1⁻¹ + m2⁻¹ + Σ (r × n)ᵀ I⁻¹ (r × n))
        """
        crosses = [np.cross(arm, n) for arm in arms]
        both = list(zip(self.invTensor, crosses, strict=True))
        changes = [np.sum(T * c[:, None], axis=2) for T, c in both]
        turning = [dot(c, change) for c, change in zip(crosses, changes, strict=True)]
        closing = self.closing_speed(arms, n, mistakes)
        closing = unless(mistakes, closing, "closing only", np.maximum(closing, 0.0))
        names = "no rotational term; no rotational term of mesh 1; no rotational term of mesh 2"
        turning = unless(mistakes, sum(turning), names, 0.0, turning[1], turning[0])
        squares = 2.0 + sum(dot(c, c) for c in crosses)
        K = unless(mistakes, sum(self.invMass) + turning, "K without inverse mass", squares)
        j = factor * closing / K
        j = unless(mistakes, j, "impulse's sign; impulse left", -j, 0.0 * j)
        J = np.hstack([n, crosses[0], -n, -crosses[1]])
        self.seen = {"r1": arms[0], "r2": arms[1], "n": n, "J": J}
        self.seen |= {"u·n = J v": closing, "K": K, "j, λ": j}
        names = "angular velocities left; angular impulse's sign; "
        for k, sign in ((0, -1.0), (1, 1.0)):
            own = names + f"angular impulse {k + 1}'s sign; J's last block's sign"
            spin = unless(mistakes, 1.0, own, 0.0, -1.0, -1.0, -1.0 if k else 1.0)
            push = -sign if f"linear impulse {k + 1}'s sign" in mistakes else sign
            invMass = unless(mistakes, self.invMass[k], "impulse without inverse mass", 1.0)
            own = "spin without inertia; spin without arm"
            straight = np.sum(self.invTensor[k] * n[:, None], axis=2)
            change = unless(mistakes, changes[k], own, crosses[k], straight)
            if not {f"velocity {k + 1} lost", f"velocities {k + 1} lost"} & mistakes:
                self.v[k] = self.v[k] + push * invMass * scaled(j, n)
            if f"velocities {k + 1} lost" not in mistakes:
                self.w[k] = self.w[k] + spin * sign * scaled(j, change)

    def push_scrambled(self, arms, n, inJ):
        """A constraint's impulse if the velocities are in the order v1, v2, ω1, ω2.

        inJ : whether J is in this order instead, and the velocities and M⁻¹ are not
        """
        c1, c2 = (np.cross(arm, n) for arm in arms)
        (m1, m2), (T1, T2) = self.invMass, self.invTensor
        Jv = dot(n, self.v[0]) + dot(c1, self.v[1]) - dot(n, self.w[0]) - dot(c2, self.w[1])
        blocks = ((m1, n), (T1, c1), (m2, -n), (T2, -c2))
        if inJ:
            blocks = ((m1, n), (m2, c1), (T1, -n), (T2, -c2))
        changes = [np.sum(M * b[:, None], axis=2) if np.ndim(M) else M * b for M, b in blocks]
        K = sum(dot(b, change) for (_M, b), change in zip(blocks, changes, strict=True))
        moved = (old - scaled(Jv / K, d) for old, d in zip(self.v + self.w, changes, strict=True))
        self.v[0], self.v[1], self.w[0], self.w[1] = moved


def detection(data, mistakes=NONE):
    """isCollision (n,), depth (n,), intNormal and intPosition (n, 3): the data's own."""
    return {key: data[key] for key in ("isCollision", "depth", "intNormal", "intPosition")}


def contacts_of(data):
    """The data's depth (n,), normal and point (n, 3); zero where there is no collision."""
    hit = data["isCollision"]
    rows = data["depth"], data["intNormal"], data["intPosition"]
    return [np.where(hit if row.ndim == 1 else hit[:, None], row, 0.0) for row in rows]


def resolve(pair, depth, n, point, e, mistakes):
    """Changes a Pair as `resolve_collision` does."""
    if sum(pair.invMass) == 0.0:
        return
    names = "depth's absolute value; pushed together; positions left"
    depth = unless(mistakes, depth, names, np.abs(depth), -depth, 0.0 * depth)
    shift = scaled(depth, n)
    point = point + pair.move_apart(shift, mistakes) * shift
    names = "restitution twice; restitution squared; restitution left out; restitution alone; "
    wrong = 1.0 + 2.0 * e, (1.0 + e) ** 2, 1.0, e, 1.0 - e
    factor = unless(mistakes, 1.0 + e, names + "restitution subtracted", *wrong)
    pair.push(pair.arms([point, point], mistakes), n, factor, mistakes)


def resolution(data, mistakes=NONE):
    """Results of `resolve_collision`, (2, n, ...); where nothing collides, the states before."""
    pair = Pair(data, mistakes)
    resolve(pair, *contacts_of(data), RESTITUTION, mistakes)
    columns = (pair.x, pair.q, pair.v, pair.w)
    results = {f"result{name}": np.array(one) for name, one in zip(WIDTHS, columns, strict=True)}
    return results | {"seen": pair.seen}


def further_resolution(data, mistakes=NONE):
    """States (n, 13) of mesh 1 if it is fixed, and of mesh 2, free and fixed, on the ground."""
    depth, normal, point = contacts_of(data)
    onGround = -depth, np.repeat(UP, len(depth), axis=0), point, GROUND_RESTITUTION
    states = {}
    for name, ends, fixed, contact in (
        ("a fixed mesh's state", (1, 2), (1,), (depth, normal, point, RESTITUTION)),
        ("on the ground", (2, 0), (), onGround),
        ("fixed on the ground", (2, 0), (2,), onGround),
    ):
        pair = Pair(data, mistakes, ends, fixed)
        resolve(pair, *contact, mistakes)
        states[name] = np.hstack([pair.x[0], pair.q[0], pair.v[0], pair.w[0]])
    return states


def constrained_points(data, pair, mistakes):
    """World positions of rest vertex 0 of mesh 1, carried along by either body."""
    body = data["solids"][1]
    restPoint = body.vertices[0] + ("COM not subtracted" in mistakes) * body.centre
    return [R @ restPoint + x for R, x in zip(pair.R, pair.x, strict=True)]


def is_valid(C, isUpper, tolerance, refValue, mistakes):
    """Whether a bound is satisfied: C ≤ tolerance (upper) or C ≥ −tolerance (lower)."""
    tolerance = tolerance * (refValue if "tolerance times refValue" in mistakes else 1.0)
    upper = C <= unless(mistakes, tolerance, "no tolerance", 0.0)
    names = "no tolerance; lower tolerance's sign"
    lower = C >= unless(mistakes, -tolerance, names, 0.0, tolerance)
    wasValid = upper if isUpper != ("bounds exchanged" in mistakes) else lower
    always, never = np.full((2, len(C)), [[True], [False]])
    return unless(mistakes, wasValid, "always valid; never valid", always, never)


def flags(wasValid, mistakes):
    """The flags that are returned, (n,)."""
    names = "flag inverted; flag true; flag false"
    return unless(mistakes, wasValid, names, ~wasValid, wasValid | True, wasValid & False)


def position_constraints(data, mistakes=NONE):
    """Results of `resolve_position_constraint` for both bounds: flags and corrected positions.

    Flags (n,), positions (2, n, 3); and flags for tolerances that C is within, and beyond.
    """
    results = {"seen": {}}
    for bound, factor in BOUNDS.items():
        pair, isUpper = Pair(data, NONE), bound == "Upper"
        point1, point2 = constrained_points(data, pair, mistakes)
        gap = point1 - point2
        length = np.sqrt(dot(gap, gap))
        refValue = factor * data["refValues"][:, 0]
        C = length - refValue
        wasValid = is_valid(C, isUpper, POSITION_TOLERANCE, refValue, mistakes)
        shift = scaled(np.where(wasValid, 0.0, C), unit(gap))
        names = "correction left; correction's sign; direction of any length"
        shift = unless(mistakes, shift, names, 0.0 * shift, -shift, scaled(length, shift))
        pair.move_apart(shift, mistakes)
        results["seen"] |= {"p1": point1, "p2": point2, "n": unit(gap), f"C, {bound}": C}
        results[f"positionWasValid{bound}"] = flags(wasValid, mistakes)
        results[f"correctedPositions{bound}"] = np.array(pair.x)
        for place, unitsOfC in TOLERANCES.items():
            wasValid = is_valid(C, isUpper, unitsOfC * np.abs(C), refValue, mistakes)
            results[f"C {place} the tolerance, {bound}"] = flags(wasValid, mistakes)
    return results | {"two fixed meshes": flags(np.full(len(C), True), mistakes)}


def velocity_constraints(data, mistakes=NONE):
    """Results of `resolve_velocity_constraint`: flags (n,) and corrected velocities (2, n, 3).

    Also flags for tolerances that |J v| is within, and beyond. J v becomes zero by an impulse along
    n that stops the change of the distance, as in a collision without restitution.
    """
    pair = Pair(data, mistakes)
    points = constrained_points(data, pair, mistakes)
    n, arms = unit(points[0] - points[1]), pair.arms(points, mistakes)
    Jv = np.abs(pair.closing_speed(arms, n, mistakes))
    before = np.array([pair.v, pair.w])
    if {"J's blocks scrambled", "v's blocks scrambled"} & mistakes:
        pair.push_scrambled(arms, n, "J's blocks scrambled" in mistakes)
    else:
        pair.push(arms, n, 1.0, mistakes)

    def are_valid(tolerance):
        valid = Jv <= unless(mistakes, tolerance, "no tolerance", 0.0)
        return valid | ("always valid" in mistakes)

    wasValid = are_valid(VELOCITY_TOLERANCE)
    after = np.where(wasValid[:, None], before, [pair.v, pair.w])
    after = unless(mistakes, after, "linear and angular exchanged", after[::-1])
    results = {"correctedLinVelocities": after[0], "correctedAngVelocities": after[1]}
    results["seen"] = pair.seen
    rates = distance_rates(data) if mistakes else Jv
    for place, factor in TOLERANCES.items():
        results[f"|J v| {place} the tolerance"] = flags(are_valid(factor * rates), mistakes)
    return results | {"velocityWasValid": flags(wasValid, mistakes)}


def distance_rates(data):
    """|J v| of the constraint in each sample, (n,)."""
    pair = Pair(data, NONE)
    points = constrained_points(data, pair, NONE)
    arms, n = pair.arms(points, NONE), unit(points[0] - points[1])
    return np.abs(pair.closing_speed(arms, n, NONE))
