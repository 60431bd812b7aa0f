"""What a step tells of itself: its contacts, counts and times, for the eye and for benchmarks."""

import time
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from rbs.geometry.triples import ZERO, floats, sub

# Stands for the ground where a contact names its second body.
GROUND = -1

# The phases that a step may have, in order, and their names in the window. The basic one has no
# tables to gather and write back. The soft-step solver solves contacts and constraints together.
PHASES = {
    "gather": "gather",
    "integrate": "integrate",
    "collisions": "collisions",
    "ground": "ground",
    "contactSolver": "contact solver",
    "constraints": "constraints",
    "writeBack": "write back",
}


class Contact(NamedTuple):
    """One contact that a step has resolved. Vectors are tuples of 3 in world axes.

    No zero has a sign, so that the same contact is told in the same bits however it was found.
    """

    body1: int  # index of the mesh
    body2: int  # likewise, or GROUND
    depth: float  # ≥ 0, before the correction
    normal: tuple  # unit, from body 1 to body 2
    point: tuple  # the point of body 2 that is deepest in body 1; body 1's lowest one on the ground
    impulse: float  # mass · speed, what body 2 receives along the normal
    friction: tuple  # mass · speed, what it receives across
    arm: tuple  # from the COM of body 1 to where the impulses act; it goes along with body 1


class StepReport:
    """What a step did: for the eye and for benchmarks, never read by the simulation.

    candidatePairs : number of pairs that the broad phase gave to the collision test
    constraintVisits : number of constraints looked at
    seconds : dict, the time spent in each phase, of PHASES
    isAsleep : (n,) bool, which bodies the soft-step solver leaves out; None of the other one
    """

    def __init__(self):
        self._contacts = []
        self._pending = []
        self.candidatePairs = 0
        self.constraintVisits = 0
        self.seconds = {}
        self.isAsleep = None

    def __repr__(self):
        milliseconds = 1e3 * sum(self.seconds.values())
        return (
            f"StepReport({self.contactCount} contacts, {self.candidatePairs} candidate pairs, "
            f"{self.constraintVisits} constraint visits, {milliseconds:.3g} ms)"
        )

    @property
    def contacts(self):
        """List of `Contact` in the order i < j, the ground last."""
        pending, self._pending = self._pending, []
        rows = []
        for *columns, impulse, friction, arm in pending:
            friction = np.broadcast_to(np.reshape(friction, (3, -1)), arm.shape)
            columns = (*columns, impulse, friction, arm)
            rows += zip(*((column.T + 0).tolist() for column in columns), strict=True)
        for _, i, j, depth, n, point, impulse, friction, arm in sorted(rows):
            vectors = tuple(n), tuple(point), impulse, tuple(friction), tuple(arm)
            self._contacts.append(Contact(i, j, depth, *vectors))
        return self._contacts

    @property
    def contactCount(self):
        """How many contacts there are; does not list them."""
        return len(self._contacts) + sum(len(columns[0]) for columns in self._pending)

    @property
    def hasSleepers(self):
        """Whether bodies sleep; contacts among them are not listed."""
        return self.isAsleep is not None and bool(self.isAsleep.any())

    def add_contact(self, i, j, depth, normal, point, impulses):
        """Notes what `resolve_collision` was given, and what it returned: ContactImpulses or None.

        A negative depth, as on the ground, comes with a normal that points from body 2 to body 1.
        """
        depth, normal = float(depth), floats(normal, 3)
        if depth < 0.0 or j == GROUND:
            depth, normal = abs(depth), sub(ZERO, normal)
        if impulses is None:
            impulses = (0.0, ZERO, ZERO)
        impulse, friction, arm = impulses
        self._contacts.append(
            Contact(
                i,
                j,
                depth,
                _unsigned(normal),
                _unsigned(point),
                impulse + 0.0,
                _unsigned(friction),
                _unsigned(arm),
            )
        )

    def add_columns(self, *columns):
        """Notes contacts that arrays describe; they become `Contact`s when they are asked for.

        columns : rank (m,), where they stand in the order i < j; then what a `Contact` holds: body1
            (m,), body2 (m,), depth (m,), normal (3, m), point (3, m), impulse (m,), friction (3, m)
            or a single vector for all, arm (3, m)
        """
        self._pending.append(columns)

    @contextmanager
    def phase(self, name):
        """Times what is done inside the `with` block."""
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start


def _unsigned(vector):
    """The vector as a tuple of 3 floats, with 0.0 in place of -0.0."""
    x, y, z = floats(vector, 3)
    return x + 0.0, y + 0.0, z + 0.0
