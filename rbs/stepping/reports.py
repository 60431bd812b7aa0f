"""Per-step diagnostics: contacts, counters and timings."""

import itertools
import time
from contextlib import contextmanager
from typing import NamedTuple

from rbs.geometry.triples import ZERO, add, floats, number, sub

# Index of the ground as the second body of a contact.
GROUND = -1

# Phases of a step, in order, and their names in the window. The pair-by-pair step has no tables to
# read and write back. The soft step solves contacts and constraints together.
PHASES = {name: name for name in ("gather", "integrate", "collisions", "ground")}
PHASES |= {"contactSolver": "contact solver", "constraints": "constraints"}
PHASES["writeBack"] = "write back"


class Contact(NamedTuple):
    """One contact that a step resolved. Vectors are tuples of 3 in world axes.

    Zeros are unsigned, so that a contact has the same bits however it was found.
    """

    body1: int  # index of the mesh
    body2: int  # index of the mesh, or GROUND
    depth: float  # ≥ 0, before the correction
    normal: tuple  # unit, from body 1 to body 2
    point: tuple  # point of body 2 deepest inside body 1; on the ground, lowest point of body 1
    impulse: float  # mass · speed, on body 2, along the normal
    friction: tuple  # mass · speed, on body 2, perpendicular to the normal
    arm: tuple  # from the COM of body 1 to where the impulses act


class StepReport:
    """Diagnostics of one step, for display and benchmarks. The simulation never reads them.

    candidatePairs : number of pairs that the broad phase passed to the collision test
    constraintVisits : number of constraint visits
    seconds : dict, time spent in each of the PHASES
    isAsleep : (n,) bool, bodies that the soft step skips; None with the other solver
    """

    def __init__(self):
        self._contacts, self._found, self._columns, self._later = [], [], [], []
        self.candidatePairs = self.constraintVisits = 0
        self.seconds, self.isAsleep = {}, None

    def __repr__(self):
        milliseconds = 1e3 * sum(self.seconds.values())
        return (
            f"StepReport({self.contactCount} contacts, {self.candidatePairs} candidate pairs, "
            f"{self.constraintVisits} constraint visits, {milliseconds:.3g} ms)"
        )

    @property
    def contacts(self):
        """Contacts in the order i < j, the ground last: list of `Contact`."""
        self._add_late()
        self._contacts += itertools.starmap(_contact, self._found)
        rows = []
        for columns in self._columns:
            rows += zip(*((column.T + 0).tolist() for column in columns), strict=True)
        for _, i, j, depth, n, point, impulse, friction, arm in sorted(rows):
            vectors = tuple(n), tuple(point), impulse, tuple(friction), tuple(arm)
            self._contacts.append(Contact(i, j, depth, *vectors))
        self._found, self._columns = [], []
        return self._contacts

    @property
    def contactCount(self):
        """Number of contacts, without listing them."""
        self._add_late()
        waiting = sum(len(columns[0]) for columns in self._columns)
        return len(self._contacts) + len(self._found) + waiting

    @property
    def hasSleepers(self):
        """Whether any bodies sleep. Contacts between them are as when they fell asleep."""
        return self.isAsleep is not None and bool(self.isAsleep.any())

    def add_contact(self, i, j, depth, normal, point, impulses):
        """Adds a contact from the arguments of `resolve_collision` and its result, if any."""
        self._found.append((i, j, depth, normal, point, impulses))

    def add_columns(self, *columns):
        """Adds contacts given as arrays, which are converted to `Contact`s on demand.

        columns : rank (m,), position in the order i < j; then the fields of `Contact`, (m,) or
            (3, m)
        """
        self._columns.append(columns)

    def add_later(self, function):
        """Adds contacts by a function of this report, once somebody asks for them.

        A function that holds the report would keep both, and its arrays, until garbage collection.
        """
        self._later.append(function)

    def _add_late(self):
        while self._later:
            self._later.pop()(self)

    @contextmanager
    def phase(self, name):
        """Measures the time of the `with` block."""
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start


def _contact(i, j, depth, normal, point, impulses):
    """Returns the `Contact` of `StepReport.add_contact`.

    A negative depth, as on the ground, comes with a normal from body 2 to body 1.
    """
    depth, normal = number(depth), floats(normal, 3)
    if depth < 0.0 or j == GROUND:
        depth, normal = abs(depth), sub(ZERO, normal)
    impulse, *vectors = impulses or (0.0, ZERO, ZERO)
    # + 0.0 turns -0.0 into 0.0
    n, p, f, r = (add(floats(v, 3), ZERO) for v in (normal, point, *vectors))
    return Contact(i, j, depth, n, p, impulse + 0.0, f, r)
