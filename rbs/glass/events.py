"""The events of a step, in order, as `run_timestep(..., observer=...)` reports them.

An event holds the arguments of a call, and the states of its bodies before and after. The functions
of RBSFunctions.py therefore know nothing of events, and a student's can take their place.
"""

from collections import namedtuple
from itertools import count
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from Quaternion import rotation_matrices
from rbs.geometry.triples import ZERO
from rbs.stepping.bodies import STATE_WIDTHS
from rbs.stepping.reports import GROUND


class Kind:
    """Names of the kinds of events.

    A contact is followed by its position correction, its impulse, and its friction if there is any.
    A step on arrays reports each contact point once, with its total impulses.
    """

    FLIGHT, BOXES, CONTACT = "free flight", "bounding-box overlap", "contact"
    CORRECTION, IMPULSE, FRICTION = "position correction", "impulse", "friction"
    CONSTRAINT, POINT = "constraint", "contact point"


# What follows a contact.
CONTACT_PARTS = (Kind.CORRECTION, Kind.IMPULSE, Kind.FRICTION)


# What an event holds of each body: attributes of a mesh, with their shapes. invIT is in body axes.
SHAPES = STATE_WIDTHS | {"invMass": (), "invIT": (3, 3)}
BodyState = namedtuple("BodyState", SHAPES)


class Event(NamedTuple):
    """One event of a step.

    kind : of `Kind`
    bodies : indices of the meshes, or GROUND as the second one
    before, after : lists of the `BodyState` of each body
    given : dict of the call's arguments, by the coursework's names. Of a contact: its number in the
        step, from 1, depth ≥ 0, normal (3,) from body 1 to body 2, points (its point (3,), twice),
        CRCoeff, closingOnly and mu; of friction, also the normal impulse. Of a constraint: its
        index, points, refValue, upper, tolerance, and isValid. Of a contact point of a step on
        arrays: its number, depth, normal, points, impulse, friction (3,), mu and timeStep
    """

    kind: str
    bodies: tuple
    before: list
    after: list
    given: dict


class Watch:
    """Makes the events of one step, and calls the observer with each.

    observer : function of an `Event`; meshes, groundMesh, step : of `run_timestep`
    """

    def __init__(self, observer, meshes, groundMesh, step):
        self._observer, self._meshes, self._step = observer, meshes, step
        self._index = {id(mesh): b for b, mesh in enumerate(meshes)} | {id(groundMesh): GROUND}
        self._start = states_of(meshes)

    def _tell(self, kind, meshes, before, after, **given):
        bodies = tuple(self._index[id(mesh)] for mesh in meshes)
        self._observer(Event(kind, bodies, before, after, given))

    def tell_flights(self):
        """Tells the observer of each free flight, once all bodies have been integrated."""
        h, gravity = self._step.timeStep, np.array(self._step.gravity)
        ends = zip(self._meshes, self._start, states_of(self._meshes), strict=True)
        for mesh, before, after in ends:
            if not mesh.isFixed or (before.position != after.position).any():
                force = np.array((getattr(mesh, "load", None) or [ZERO])[0])
                g = gravity + before.invMass * force
                self._tell(Kind.FLIGHT, [mesh], [before], [after], timeStep=h, gravity=g)

    def pairs(self, pairs):
        """Yields the pairs, and reports those whose bounding boxes overlap when it is their turn.

        The pair collides if a contact follows.
        """
        for i, j in pairs:
            m1, m2 = self._meshes[i], self._meshes[j]
            if (m1.invMass or m2.invMass) and m1.bounding_box_collision(m2):
                states = states_of((m1, m2))
                self._tell(Kind.BOXES, (m1, m2), states, states)
            yield i, j

    def watched(self, taught):
        """Returns the functions of `run_timestep` with a `resolve_collision` that also reports the
        contact and what the call did.

        The part of the velocity change along the normal is the normal impulse, the rest friction.
        """
        options = {name: getattr(self._step, name) for name in ("CRCoeff", "closingOnly", "mu")}
        numbers = count(1)

        def resolve_collision(m1, m2, *arguments):
            pair, before = (m1, m2), states_of((m1, m2))
            d, n, p = (np.array(one, dtype=np.float64).ravel() for one in arguments[:3])
            if self._index[id(m2)] == GROUND or d[0] < 0.0:  # the normal points into body 1
                n = -n
            given = {"contact": next(numbers), "depth": abs(float(d[0])), "normal": n} | options
            self._tell(Kind.CONTACT, pair, before, before, points=(p, p), **given)
            impulses = taught.resolve_collision(m1, m2, *arguments)
            after = states_of(pair)
            moved = [b._replace(position=a.position) for a, b in zip(after, before, strict=True)]
            given["points"] = (p + after[1].position - before[1].position,) * 2
            j = float(applied_impulse(moved, after) @ n)
            pushed = pushed_apart(moved, j * n, given["points"][0]) if options["mu"] else after
            self._tell(Kind.CORRECTION, pair, before, moved, **given)
            self._tell(Kind.IMPULSE, pair, moved, pushed, **given)
            if options["mu"]:
                self._tell(Kind.FRICTION, pair, pushed, after, impulse=j, **given)
            return impulses

        return SimpleNamespace(**vars(taught) | {"resolve_collision": resolve_collision})

    def visits(self, visit, ties):
        """Returns the function `visit` of a constraint, such that each visit is reported.

        ties : of `ConstraintRows`
        """

        def watched(c):
            b1, b2, arm1, arm2, refValue, upper, *_ = ties[c]
            m1, m2 = self._meshes[b1], self._meshes[b2]
            before = states_of((m1, m2))
            arms = zip(before, (arm1, arm2), strict=True)
            points = tuple(one.position + np.ravel(arm) for one, arm in arms)
            given = {"constraint": c, "points": points, "refValue": refValue, "upper": bool(upper)}
            isCorrected = visit(c)
            given |= {"tolerance": self._step.tolerance, "isValid": not isCorrected}
            self._tell(Kind.CONSTRAINT, (m1, m2), before, states_of((m1, m2)), **given)
            return isCorrected

        return watched

    def tell_points(self, report):
        """Reports each contact of the soft step, which solves all of them together, with the states
        after the step. The impulses are sums over the step.
        """
        states = states_of([*self._meshes, None])  # the ground is the last one
        for number, c in enumerate(report.contacts, 1):
            pair = [states[c.body1], states[c.body2]]
            given = {"contact": number, "depth": c.depth, "normal": np.array(c.normal)}
            given |= {"points": (pair[0].position + c.arm,) * 2, "friction": np.array(c.friction)}
            given |= {"impulse": c.impulse, "mu": self._step.mu, "timeStep": self._step.timeStep}
            self._observer(Event(Kind.POINT, (c.body1, c.body2), pair, pair, given))


def states_of(meshes):
    """Returns the `BodyState` of each mesh, ours or a student's; None stands for the ground."""
    states = []
    for mesh in meshes:
        rows = ((getattr(mesh, name, np.zeros(shape)), shape) for name, shape in SHAPES.items())
        rows = (np.array(row, dtype=np.float64).reshape(shape)[()] for row, shape in rows)
        states.append(BodyState(*rows))
    return states


def world_inertia(state):
    """Returns R I⁻¹ Rᵀ (3, 3) of a `BodyState`."""
    R = np.reshape(rotation_matrices(state.orientation), (3, 3))
    return R @ state.invIT @ R.T


def applied_impulse(before, after):
    """Returns the impulse (3,) on body 2, by the change of its linear velocity.

    If body 2 cannot move, it is minus the impulse on body 1. before, after : `BodyState` of both
    """
    (a1, a2), (b1, b2) = before, after
    if a2.invMass:
        return (b2.linVelocity - a2.linVelocity) / a2.invMass
    return (a1.linVelocity - b1.linVelocity) / (a1.invMass or 1.0)


def pushed_apart(before, impulse, point):
    """Returns the states (2) after -impulse on body 1 and +impulse on body 2, (3,), at a point."""
    states = []
    for sign, state in zip((-1.0, 1.0), before, strict=True):
        lin = state.linVelocity + sign * state.invMass * impulse
        turn = world_inertia(state) @ np.cross(point - state.position, impulse)
        states.append(state._replace(linVelocity=lin, angVelocity=state.angVelocity + sign * turn))
    return states
