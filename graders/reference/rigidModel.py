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
FIXED_STEPS = (0.1, 0.02, 0.01, 0.05, 0.03)  # s, that students use in place of timeStep
# The bounds of a constraint, relative to the sample's reference value, and the tolerances.
BOUNDS = {"Upper": 1.2, "Lower": 0.8}
POSITION_TOLERANCE = 1e-6  # m
VELOCITY_TOLERANCE = 1e-5  # m/s
# Tolerances relative to a constraint's error, 10^x with x between these: the error is within those
# of the first kind, and beyond those of the second.
TOLERANCES = {"within": (0.1, 2.5), "beyond": (-2.5, -0.1)}
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


def steps_of(data):
    """The time steps (n,) that each sample makes one after the other, in s; 0 means none."""
    n = len(data["randomPositions"])
    usual = {"timeStep": np.full(n, TIME_STEP), "secondStep": np.zeros(n)}
    return {key: data.get(key, value) for key, value in usual.items()}


def integration(data, mistakes=NONE):
    """Results of `Mesh.integrate_timestep`, by semi-implicit Euler."""
    state = [data[f"random{name}"] for name in WIDTHS]
    state[1] = unit(state[1])
    first, second = steps_of(data).values()
    fixed = [h for h in FIXED_STEPS if f"step of {h}" in mistakes]
    state = integrated(data, *state, first * 0.0 + fixed[0] if fixed else first, mistakes, 1.0)
    again = second * 0.0 + fixed[0] if fixed else second
    later = integrated(data, *state, again, mistakes, 2.0)
    isAgain = (second != 0.0)[:, None]
    pairs = zip(WIDTHS, state, later, strict=True)
    return {f"result{name}": np.where(isAgain, b, a) for name, a, b in pairs}


def integrated(data, x, q, v, w, h, mistakes, count):
    """The state after a time step h (n,); count : how many steps have been made with this one"""
    names = "gravity upwards; gravity of 9.81; gravity of 10; gravity along z; gravity times mass; "
    wrong = -GRAVITY, -9.81 * UP, -10.0 * UP, GRAVITY[:, [0, 2, 1]]
    wrong += data["solids"][2].mass * GRAVITY, count * GRAVITY
    gravity = unless(mistakes, GRAVITY, names + "gravity accumulates", *wrong)
    h = h[:, None]
    newV = v + gravity * unless(mistakes, h, "velocity left; velocity without h", 0.0 * h, 1.0)
    names = "position left; position without h; explicit Euler; half acceleration; "
    wrong = 0.0 * newV, newV, h * v, h * v + h**2 / 2 * gravity, h * newV + h**2 / 2 * gravity
    shift = unless(mistakes, h * newV, names + "half acceleration too", *wrong)
    names = "orientation without h; whole angle; turned backwards; to radians; to degrees"
    wrong = 0.5, h, -h / 2, h / 2 * np.pi / 180.0, h / 2 * 180.0 / np.pi
    half = w * unless(mistakes, h / 2, names, *wrong)
    zero = np.zeros((len(q), 1))
    pure = np.hstack([half, zero] if "scalar last" in mistakes else [zero, half])
    first = pure + np.array([1.0, 0.0, 0.0, 0.0])
    names = "first order; first order, any length"
    turn = unless(mistakes, exponential(pure), names, first, first)
    product = multiply(q, turn) if "quaternion order" in mistakes else multiply(turn, q)
    if "conjugated" in mistakes:
        product = multiply(product, turn * np.array([1.0, -1.0, -1.0, -1.0]))
    newQ = unless(mistakes, product, "orientation left; first order", q, unit(product))
    return x + shift, newQ, newV, w


def further_integration(data, mistakes=NONE):
    """Results for a fixed mesh and for `currVertices`, which the data do not show.

    Gives the pose (n, 7) of a fixed mesh, which must stay, and the distance of a free mesh's
    `currVertices` from its vertices, which must be zero.
    """
    once = {key: value for key, value in data.items() if key != "secondStep"}
    step, still = integration(once, mistakes), {}
    poses = data["randomPositions"], unit(data["randomOrientations"])
    new = step["resultPositions"], step["resultOrientations"]
    now = carried(data, *new)
    if "fixed is free" in mistakes:
        still = {f"random{name}": 0.0 * poses[0] for name in ("LinVelocities", "AngVelocities")}
    late = [carried(data, *one) - now for one in (poses, (new[0], poses[1]), (poses[0], new[1]))]
    names = "vertices left; vertices of the old orientation; vertices of the old position"
    vertices = unless(mistakes, 0.0 * late[0], names, *late)
    if still:
        poses = list(integration(once | still, mistakes).values())[:2]
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
    body, (isSmall, isReleased) = data["solids"][k], inertia_of(data)
    offset = body.centre @ body.centre * np.eye(3) - np.outer(body.centre, body.centre)
    tensor = body.tensor + ("tensor about the origin" in mistakes) * body.mass * offset  # Steiner
    tensor = tensor / (INERTIA_DIVISOR if isSmall else 1)
    inverse = tensor if "tensor not inverted" in mistakes else inverse_of(tensor)
    unturned = [np.broadcast_to(one, R.shape) for one in (np.eye(3), inverse)]
    names = "tensor is the identity; tensor not turned; tensor turned once; tensor elementwise; "
    others = *unturned, R @ inverse, R * inverse * np.swapaxes(R, -1, -2)
    others += (in_world_axes(R, inverse, not isReleased),)
    right = in_world_axes(R, inverse, isReleased)
    return unless(mistakes, right, names + "tensor turned the other way", *others)


def inertia_of(data):
    """Whether the graded class has the release's tensor, and turns it as the release does."""
    isReleased = data["convention"] == RELEASED_2024
    return data.get("inertia", (isReleased, isReleased))


def rotated_tensors(data, mistakes=NONE):
    """World inverse inertia tensors of mesh 2, (n, 9), in units of `tensor_unit`."""
    tensors = world_inverse_tensors(data, 2, unit(data["randomOrientations"]), mistakes)
    return {"rotated inverse inertia": tensors.reshape(-1, 9) / tensor_unit(data)}


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
        self.R = [rotation_matrices(q) for q in self.q]
        self.invMass, T = [0.0, 0.0], [np.zeros((n, 3, 3))] * 2
        for end, k in enumerate(ends):
            isFree = k not in fixed or "fixed is free" in mistakes
            if k and isFree:
                self.invMass[end] = 1.0 / data["solids"][k].mass
            if k and (isFree or "fixed turns" in mistakes):
                T[end] = world_inverse_tensors(data, k, self.q[end], mistakes)
        names = "tensor of mesh 1 for mesh 2; tensor of mesh 2 for mesh 1; tensors exchanged"
        self.invTensor = unless(mistakes, T, names, [T[0], T[0]], [T[1], T[1]], [T[1], T[0]])

    def move_apart(self, shift, mistakes):
        """Moves body 1 against the shifts (n, 3) and body 2 along them; returns body 2's weight.

        Each moves in proportion to its inverse mass.
        """
        right = [invMass / sum(self.invMass) for invMass in self.invMass]
        names = "equal weights; weights exchanged; whole correction for each; half correction"
        wrong = (0.5, 0.5), right[::-1], (1.0, 1.0), [0.5 * one for one in right]
        weights = unless(mistakes, right, names, *wrong)
        self.x = [self.x[0] - weights[0] * shift, self.x[1] + weights[1] * shift]
        return weights[1]

    def arms(self, points, mistakes):
        """The vectors from the COMs to the points."""
        arms = [point - x for point, x in zip(points, self.x, strict=True)]
        names = "arms from the origin; arms exchanged; arms reversed"
        for name, whole in (("integer arms", np.trunc), ("rounded arms", np.round)):
            arms = [whole(arm) for arm in arms] if name in mistakes else arms
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
        if "J of integers" in mistakes:
            n, crosses = np.trunc(n), [np.trunc(one) for one in crosses]
        tensors, masses = self.invTensor, self.invMass
        if "M for its inverse" in mistakes:
            tensors = [np.linalg.inv(one.astype(float)) for one in tensors]
            masses = [1.0 / one for one in masses]
        both = list(zip(tensors, crosses, strict=True))
        changes = [np.sum(T * c[:, None], axis=2) for T, c in both]
        if "tensor before the arm" in mistakes:
            pairs = zip(tensors, arms, strict=True)
            changes = [np.cross(np.sum(T * r[:, None], axis=2), n) for T, r in pairs]
        turning = [dot(c, change) for c, change in zip(crosses, changes, strict=True)]
        closing = self.closing_speed(arms, n, mistakes)
        if "J of integers" in mistakes:
            closing = dot(n, self.v[0] - self.v[1])
            closing = closing + dot(crosses[0], self.w[0]) - dot(crosses[1], self.w[1])
        names = "closing only; closing's absolute value"
        closing = unless(mistakes, closing, names, np.maximum(closing, 0.0), np.abs(closing))
        names = "no rotational term; no rotational term of mesh 1; no rotational term of mesh 2; "
        names += "rotational term 1 subtracted; rotational term 2 subtracted"
        wrong = 0.0, turning[1], turning[0], turning[1] - turning[0], turning[0] - turning[1]
        turning = unless(mistakes, sum(turning), names, *wrong)
        squares = 2.0 + sum(dot(c, c) for c in crosses)
        heavy = sum(1.0 / one if one else 0.0 for one in masses) + turning
        names = "K without inverse mass; masses in K"
        linear = sum(masses) * (dot(n, n) if "J of integers" in mistakes else 1.0)
        K = unless(mistakes, linear + turning, names, squares, heavy)
        j = factor * closing / K
        j = unless(
            mistakes, j, "impulse's sign; impulse left; j of 1.5; j of 2", -j, 0 * j, 1.5 * j, 2 * j
        )
        names = "angular velocities left; angular impulse's sign; "
        for k, sign in ((0, -1.0), (1, 1.0)):
            if k and "impulse 2 after body 1 has changed" in mistakes:
                j = factor * self.closing_speed(arms, n, mistakes) / K
            own = names + f"angular impulse {k + 1}'s sign; J's last block's sign"
            spin = unless(mistakes, 1.0, own, 0.0, -1.0, -1.0, -1.0 if k else 1.0)
            push = -sign if f"linear impulse {k + 1}'s sign" in mistakes else sign
            invMass = unless(mistakes, masses[k], "impulse without inverse mass", 1.0)
            own = "spin without inertia; spin without arm"
            straight = np.sum(tensors[k] * n[:, None], axis=2)
            change = unless(mistakes, changes[k], own, crosses[k], straight)
            if not {f"velocity {k + 1} lost", f"velocities {k + 1} lost"} & mistakes:
                self.v[k] = self.v[k] + push * invMass * scaled(j, n)
            if not {f"spin {k + 1} lost", f"velocities {k + 1} lost"} & mistakes:
                self.w[k] = self.w[k] + spin * sign * scaled(j, change)

    def push_scrambled(self, arms, n, what):
        """A constraint's impulse if the blocks of one factor are in the order v1, v2, ω1, ω2.

        what : the factor, J, v or M
        """
        c1, c2 = (np.cross(arm, n) for arm in arms)
        (m1, m2), (T1, T2) = self.invMass, self.invTensor
        v, J, M = (*self.v, *self.w), (n, c1, -n, -c2), (m1, T1, m2, T2)
        if what == "J":
            J = n, -n, c1, -c2
        v = v if what == "v" else (v[0], v[2], v[1], v[3])
        M = (m1, m2, T1, T2) if what == "M" else M
        changes = [
            np.sum(own * b[:, None], axis=2) if np.ndim(own) else own * b
            for own, b in zip(M, J, strict=True)
        ]
        Jv, K = (sum(map(dot, J, rows)) for rows in (v, changes))
        moved = [old - scaled(Jv / K, d) for old, d in zip(v, changes, strict=True)]
        if what != "v":
            moved = moved[0], moved[2], moved[1], moved[3]
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
    return results


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
    names = "always valid; never valid; always upper; always lower; both bounds"
    return unless(mistakes, wasValid, names, always, never, upper, lower, upper & lower)


def flags(wasValid, mistakes):
    """The flags that are returned, (n,)."""
    names = "flag inverted; flag true; flag false"
    return unless(mistakes, wasValid, names, ~wasValid, wasValid | True, wasValid & False)


def position_constraints(data, mistakes=NONE):
    """Results of `resolve_position_constraint` for both bounds: flags and corrected positions.

    Flags (n,), positions (2, n, 3); and flags for tolerances that C is within, and beyond.
    """
    results = {}
    for bound, factor in BOUNDS.items():
        pair, isUpper = Pair(data, NONE), bound == "Upper"
        points = constrained_points(data, pair, mistakes)
        gap, apart = points[0] - points[1], pair.x[0] - pair.x[1]
        length = np.sqrt(dot(gap, gap))
        refValue = factor * data["refValues"][:, 0]
        C = unless(mistakes, length - refValue, "squared distances", length**2 - refValue**2)
        wasValid = is_valid(C, isUpper, POSITION_TOLERANCE, refValue, mistakes)
        if "to the tolerance" in mistakes:
            C = C - POSITION_TOLERANCE * (1.0 if isUpper else -1.0)
        shift = scaled(np.where(wasValid, 0.0, C), unit(gap))
        names = "correction left; correction's sign; direction of any length; axis of the COMs"
        wrong = 0.0 * shift, -shift, scaled(length, shift)
        across = scaled(np.where(wasValid, 0.0, C), unit(apart))
        shift = unless(mistakes, shift, names, *wrong, across)
        if "points for COMs" in mistakes:
            isMoved = ~wasValid[:, None]
            pair.x = [np.where(isMoved, p, x) for p, x in zip(points, pair.x, strict=True)]
        pair.move_apart(shift, mistakes)
        results[f"positionWasValid{bound}"] = flags(wasValid, mistakes)
        results[f"correctedPositions{bound}"] = np.array(pair.x)
        for place, tolerance in tolerances(distance_errors(data)[bound], data).items():
            wasValid = is_valid(C, isUpper, tolerance, refValue, mistakes)
            results[f"C {place} the tolerance, {bound}"] = flags(wasValid, mistakes)
    return results | {"two fixed meshes": flags(np.full(len(data["refValues"]), True), mistakes)}


def tolerances(errors, data):
    """Tolerances (n,) that the errors are within, and beyond: a dict of the keys of TOLERANCES.

    Drawn by the seed of the fresh samples, so that a tolerance does not tell the error.
    """
    generator, n = np.random.Generator(np.random.PCG64(data.get("seed", 0))), len(errors)
    return {
        place: 10.0 ** (low + (high - low) * generator.random(n)) * np.abs(errors)
        for place, (low, high) in TOLERANCES.items()
    }


def distance_errors(data):
    """C of the upper and the lower bound in each sample: a dict from bound to array (n,)."""
    gap = np.subtract(*constrained_points(data, Pair(data, NONE), NONE))
    length = np.sqrt(dot(gap, gap))
    return {bound: length - factor * data["refValues"][:, 0] for bound, factor in BOUNDS.items()}


def velocity_constraints(data, mistakes=NONE):
    """Results of `resolve_velocity_constraint`: flags (n,) and corrected velocities (2, n, 3).

    Also flags for tolerances that |J v| is within, and beyond. J v becomes zero by an impulse along
    n that stops the change of the distance, as in a collision without restitution.
    """
    pair = Pair(data, mistakes)
    points = constrained_points(data, pair, mistakes)
    gap = points[0] - points[1]
    n, arms = unit(gap), pair.arms(points, mistakes)
    if "axis of the COMs" in mistakes:
        n = unit(pair.x[0] - pair.x[1])
    Jv = pair.closing_speed(arms, n, mistakes)
    if "J of integers" in mistakes:
        c1, c2 = (np.trunc(np.cross(arm, n)) for arm in arms)
        Jv = dot(np.trunc(n), pair.v[0] - pair.v[1]) + dot(c1, pair.w[0]) - dot(c2, pair.w[1])
    signed, Jv = Jv, np.abs(Jv)
    if "J of any length" in mistakes:
        Jv = Jv * np.sqrt(dot(gap, gap))
    if "no absolute value" in mistakes:
        Jv = signed
    before = np.array([pair.v, pair.w])
    scrambled = [what for what in "JvM" if f"{what}'s blocks scrambled" in mistakes]
    if scrambled:
        pair.push_scrambled(arms, n, scrambled[0])
    else:
        pair.push(arms, n, 1.0, mistakes)

    def are_valid(tolerance):
        valid = Jv <= unless(mistakes, tolerance, "no tolerance", 0.0)
        return valid | ("always valid" in mistakes)

    wasValid = are_valid(VELOCITY_TOLERANCE)
    after = np.array([pair.v, pair.w])
    after = unless(mistakes, after, "changes for velocities", after - before)
    after = np.where(wasValid[:, None], before, after)
    after = unless(mistakes, after, "linear and angular exchanged", after[::-1])
    results = {"correctedLinVelocities": after[0], "correctedAngVelocities": after[1]}
    for place, tolerance in tolerances(distance_rates(data), data).items():
        results[f"|J v| {place} the tolerance"] = flags(are_valid(tolerance), mistakes)
    return results | {"velocityWasValid": flags(wasValid, mistakes)}


def distance_rates(data):
    """|J v| of the constraint in each sample, (n,)."""
    pair = Pair(data, NONE)
    points = constrained_points(data, pair, NONE)
    arms, n = pair.arms(points, NONE), unit(points[0] - points[1])
    return np.abs(pair.closing_speed(arms, n, NONE))
