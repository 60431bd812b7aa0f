"""The events of a step, in order, as `run_timestep(..., observer=...)` reports them.

An event follows from the arguments of a call, and its bodies before and after. The functions of
RBSFunctions.py know nothing of events, so that a student's can take their place.
"""

from collections import namedtuple
from typing import NamedTuple

import numpy as np

from Quaternion import rotation_matrices
from rbs.geometry.triples import ZERO
from rbs.stepping.meshes import STATE_WIDTHS
from rbs.stepping.reports import GROUND, contact_of


class Kind:
    """Names of the kinds of events.

    A contact is followed by its position correction, its impulse, and its friction if there is any.
    A step on arrays reports each contact point once, with its total impulses.
    """

    FLIGHT, CONTACT = "free flight", "contact"
    CORRECTION, IMPULSE, FRICTION = "position correction", "impulse", "friction"
    CONSTRAINT, POINT = "constraint", "contact point"


# What follows a contact.
CONTACT_PARTS = (Kind.CORRECTION, Kind.IMPULSE, Kind.FRICTION)
# What an event holds of each body: attributes of a mesh, with their shapes. Tensors are in body
# axes; isTurnedBack tells whether the mesh turns them to world axes as the release does. No step
# changes those of KEPT.
SHAPES = STATE_WIDTHS | {"invMass": (), "IT": (3, 3), "invIT": (3, 3), "isTurnedBack": ()}
KEPT = "isFixed", "invMass", "IT", "invIT"


class BodyState(namedtuple("BodyState", SHAPES)):
    """What an event holds of a body: see SHAPES."""

    isFixed = property(lambda self: bool(self.invMass == 0.0))


class Event(NamedTuple):
    """One event of a step.

    kind : of `Kind`
    bodies : indices of the meshes, or GROUND as the second one
    before, after : lists of the `BodyState` of each body
    given : dict of the call's arguments, by the coursework's names. Of a contact: its number in the
        step, from 1, depth ≥ 0, normal (3,) from body 1 to body 2, points (its point (3,), twice),
        CRCoeff and mu; of friction, also the normal impulse. Of a constraint: its
        index, points, refValue, upper, tolerance, and isValid. Of a contact point of a step on
        arrays: its number, depth, normal, points, impulse, friction (3,), mu and timeStep
    """

    kind: str
    bodies: tuple
    before: list
    after: list
    given: dict


class Watch:
    """Makes the events of one `Step`, and calls the observer with each."""

    def __init__(self, observer, step):
        self._observer, self._step, self._contacts = observer, step, 0
        self._kept = [{name: getattr(mesh, name) for name in KEPT[1:]} for mesh in step.meshes]

    def _report(self, kind, bodies, before, after, **given):
        self._observer(Event(kind, bodies, before, after, given))

    def states(self, *bodies):
        """Returns the present `BodyState`s of bodies, by index or GROUND."""
        states = []
        for b in bodies:
            mesh = self._step.groundMesh if b == GROUND else self._step.meshes[b]
            rows = ((getattr(mesh, name, np.zeros(shape)), shape) for name, shape in SHAPES.items())
            rows = (np.array(value, dtype=np.float64).reshape(shape)[()] for value, shape in rows)
            found = BodyState(*rows)
            states.append(found if found.invMass else found._replace(invIT=np.zeros((3, 3))))
        return states

    def report_flights(self):
        """Reports each free flight, once all bodies have been integrated."""
        h, gravity = self._step.timeStep, np.array(self._step.gravity)
        for b, mesh in enumerate(self._step.meshes):
            (after,) = self.states(b)
            start = {name: table[:, b] for name, table in self._step.start.items()}
            before = after._replace(**start, **self._kept[b])
            pose = zip(before[:2], after[:2], strict=True)
            if not before.isFixed or any((one != other).any() for one, other in pose):
                force = np.array((getattr(mesh, "load", None) or [ZERO])[0])
                g = gravity + before.invMass * force
                self._report(Kind.FLIGHT, (b,), [before], [after], timeStep=h, gravity=g)

    def report_contact(self, i, j, depth, normal, point):
        """Reports a contact to be resolved. Returns the arguments of `report_response` to it."""
        self._contacts += 1
        found = contact_of(i, j, depth, normal, point)
        given = {"contact": self._contacts, "depth": found.depth, "normal": np.array(found.normal)}
        given |= {"CRCoeff": self._step.CRCoeff, "mu": self._step.mu}
        before, p = self.states(i, j), np.array(found.point)
        self._report(Kind.CONTACT, (i, j), before, before, points=(p, p), **given)
        return (i, j), p, before, given

    def report_response(self, pair, p, before, given):
        """Reports what `resolve_collision` did with a contact.

        The part of the velocity change along the normal is the normal impulse, the rest friction.
        """
        after = self.states(*pair)
        moved = [b._replace(position=a.position) for a, b in zip(after, before, strict=True)]
        given["points"] = (p + after[1].position - before[1].position,) * 2
        self._report(Kind.CORRECTION, pair, before, moved, **given)
        if not given["mu"]:
            return self._report(Kind.IMPULSE, pair, moved, after, **given)
        n = given["normal"]
        impulse = float(applied_impulse(moved, after) @ n)
        pushed = pushed_apart(moved, impulse * n, given["points"][0])
        self._report(Kind.IMPULSE, pair, moved, pushed, **given)
        self._report(Kind.FRICTION, pair, pushed, after, impulse=impulse, **given)

    def report_visit(self, link, bound, before, isValid):
        """Reports the visit of a bound of a `Link`. before : `states` of both bodies"""
        arms = zip(before, (link.arm1, link.arm2), strict=True)
        given = dict(zip(("constraint", "refValue", "upper"), bound, strict=True))
        given["points"] = tuple(one.position + np.ravel(arm) for one, arm in arms)
        given |= {"tolerance": self._step.tolerance, "isValid": isValid}
        after = self.states(link.body1, link.body2)
        self._report(Kind.CONSTRAINT, (link.body1, link.body2), before, after, **given)

    def report_points(self):
        """Reports each contact of the soft step, with the states after it and total impulses."""
        step = self._step
        for number, c in enumerate(step.report.contacts, 1):
            pair = self.states(c.body1, c.body2)
            given = {"contact": number, "depth": c.depth, "normal": np.array(c.normal)}
            given |= {"points": (pair[0].position + c.arm,) * 2, "friction": np.array(c.friction)}
            given |= {"impulse": c.impulse, "mu": step.mu, "timeStep": step.timeStep}
            self._report(Kind.POINT, (c.body1, c.body2), pair, pair, **given)


def world_inertia(state):
    """Returns R I⁻¹ Rᵀ (3, 3) of a `BodyState`, or Rᵀ I⁻¹ R if it is turned back."""
    R = np.reshape(rotation_matrices(state.orientation), (3, 3))
    R = R.T if state.isTurnedBack else R
    return R @ state.invIT @ R.T


def applied_impulse(before, after):
    """Returns the impulse (3,) on body 2, from the change of its linear velocity, or of that of
    body 1 if body 2 is immovable.

    before, after : `BodyState` of both
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
