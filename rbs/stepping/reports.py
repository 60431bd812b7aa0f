"""`Step`, the context of a step, and its report: contacts, counters and timings."""

import itertools
import time
from collections import namedtuple
from contextlib import contextmanager
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from rbs.geometry.triples import ZERO, add, floats, number, shown_value, sub, vector
from rbs.stepping.meshes import Snapshot, check_distinct

# Index of the ground as the second body of a contact.
GROUND = -1
# Types of lists of meshes, and of constraints.
LISTS = list, tuple, np.ndarray

# Phases of a step, in order. The pair-by-pair step has no tables to gather and write back. The soft
# step solves contacts and constraints together.
PHASES = "gather integrate collisions ground contactSolver constraints writeBack".split()


class Contact(NamedTuple):
    """One contact that a step resolved. Vectors are tuples of 3 in world axes.

    No zero is -0.0, so that a contact has the same bits however it was found.
    """

    body1: int  # index of the mesh
    body2: int  # index of the mesh, or GROUND
    depth: float  # ≥ 0, before the correction
    normal: tuple  # unit, from body 1 to body 2
    point: tuple  # point of body 2 deepest inside body 1; on the ground, lowest point of body 1
    impulse: float  # mass · speed, on body 2, along the normal
    friction: tuple  # mass · speed, on body 2, perpendicular to the normal
    arm: tuple  # from the COM of body 1 to where the impulses act


# m contacts: rank (m,), position in the order i < j, and the fields of `Contact`, (m,) or (3, m).
ContactColumns = namedtuple("ContactColumns", ("rank", *Contact._fields))


class StepReport:
    """Diagnostics of one step. The simulation never reads them.

    candidatePairs : number of pairs that the broad phase passed to the collision test
    constraintVisits : number of constraints that were checked, and corrected if violated. Those
        that no motion can violate or correct, such as a lower bound of 0, are not. In the soft
        step, each solution counts the active ones for whose impulses it solves
    seconds : dict, time spent in each of the PHASES
    isAsleep : (n,) bool, bodies that the soft step skips; None with the other solver
    found : contacts that are not listed yet: the arguments and the result of `resolve_collision`
    """

    def __init__(self):
        self._contacts, self.found, self._later = [], [], []
        self.candidatePairs = self.constraintVisits = 0
        self.seconds, self.isAsleep = {}, None

    def __repr__(self):
        asleep = f"{int(self.isAsleep.sum())} bodies asleep, " if self.hasSleepers else ""
        about = f"{self.contactCount} contacts, deepest {self.deepest:.3g}, {self.candidatePairs} "
        about += f"candidate pairs, {self.constraintVisits} visits, {asleep}"
        return f"StepReport({about}{1e3 * sum(self.seconds.values()):.3g} ms)"

    @property
    def contacts(self):
        """Contacts in the order i < j, the ground last: list of `Contact`."""
        self._contacts += itertools.starmap(contact_of, self.found)
        rows = []
        for late in self._later:
            rows += zip(*((column.T + 0).tolist() for column in late.columns), strict=True)
        for _, *fields in sorted(rows):
            values = (tuple(one) if isinstance(one, list) else one for one in fields)
            self._contacts.append(Contact(*values))
        self.found, self._later = [], []
        return self._contacts

    @property
    def contactCount(self):
        """Number of contacts, without listing them."""
        return len(self._contacts) + len(self.found) + sum(len(x.columns.rank) for x in self._later)

    @property
    def deepest(self):
        """Largest depth of a contact, or 0, without listing them."""
        depths = [contact.depth for contact in self._contacts]
        depths += [abs(number(found[2])) for found in self.found]
        depths += [late.columns.depth.max(initial=0.0) for late in self._later]
        return float(max(depths, default=0.0))

    @property
    def hasSleepers(self):
        """Whether any bodies sleep. The impulses between them balance gravity."""
        return self.isAsleep is not None and bool(self.isAsleep.any())

    def add_columns(self, columns):
        """Adds contacts given as `ContactColumns`."""
        self.add_later(SimpleNamespace(columns=columns))

    def add_later(self, contacts):
        """Adds contacts that are listed once somebody asks for their `columns`."""
        self._later.append(contacts)

    def phase(self, name):
        """Returns a context that measures the time of its `with` block."""
        return Phase(self.seconds, name)


class Phase:
    """A context that adds its time to the seconds of a phase; much faster than a generator."""

    def __init__(self, seconds, name):
        self._seconds, self._name = seconds, name

    def __enter__(self):
        self._begin = time.perf_counter()

    def __exit__(self, *error):
        now = time.perf_counter()
        self._seconds[self._name] = self._seconds.get(self._name, 0.0) + now - self._begin


def contact_of(i, j, depth, normal, point, impulses=None):
    """Returns the Contact of a call of `resolve_collision`; impulses : what it returned"""
    depth, normal = number(depth), floats(normal, 3)
    if depth < 0.0 or j == GROUND:  # the normal points from body 2 to body 1
        depth, normal = abs(depth), sub(ZERO, normal)
    impulse, *vectors = impulses or (0.0, ZERO, ZERO)
    # + 0.0 turns -0.0 into 0.0
    n, p, f, r = (add(floats(v, 3), ZERO) for v in (normal, point, *vectors))
    return Contact(i, j, depth, n, p, impulse + 0.0, f, r)


def check_arguments(meshes, groundMesh, constraints, functions, solverState, observer):
    """Raises TypeError, which names an argument of `run_timestep`, if it is of another kind."""
    areOurs = functions is None or hasattr(functions, "resolve_collision")
    isGround = groundMesh is None or hasattr(groundMesh, "invMass")
    isState = solverState is None or hasattr(solverState, "__dict__")
    for name, value, isFine, kind in (
        ("meshes", meshes, isinstance(meshes, LISTS), "a list of Meshes"),
        ("groundMesh", groundMesh, isGround, "a Mesh or None"),
        ("constraints", constraints, isinstance(constraints, LISTS), "a list of rows"),
        ("functions", functions, areOurs, "a module with resolve_collision, or None"),
        ("solverState", solverState, isState, "a SolverState or None"),
        ("observer", observer, observer is None or callable(observer), "a function or None"),
    ):
        if not isFine:
            raise TypeError(f"{name} must be {kind}, not {shown_value(value)}")


class Step:
    """The context of one time step, made by `run_timestep` from its arguments.

    It has all parameters of `run_timestep` as attributes; constraints is () if not enforced.

    contactSettings : CRCoeff and, unless it is 0, mu
    report : `StepReport`
    watch : `Watch`, which reports to the observer what the step did, or None
    isOnArrays : whether contacts are solved on arrays
    tensor : function, from the index of a body to its inverse inertia tensor in world axes; while
        constraints are visited, which change no orientation
    bodies : `Bodies` of a step on arrays, or None; start : `Snapshot` of the meshes before the step
    """

    def __init__(self, meshes, groundMesh, constraints, values, functions, solverState, isObserved):
        """values : dict of settings, from `step_arguments`"""
        vars(self).update(values)
        groundMesh = groundMesh if self.ground else None
        if groundMesh is not None:
            if groundMesh.invMass != 0.0:
                raise ValueError("groundMesh must be fixed")
            (_, y, _), (x, _, z) = vector(groundMesh.linVelocity), vector(groundMesh.angVelocity)
            if x or y or z:
                raise ValueError("groundMesh may only slide along its plane and turn about y")
        self.meshes, self.groundMesh, self.functions = meshes, groundMesh, functions
        self.constraints = constraints if self.enforceConstraints else ()
        self.solverState, self.report = solverState, StepReport()
        isInBatches = self.contactScheduling == "batches" and not isObserved
        self.isOnArrays = self.contactSolver == "soft-step" or isInBatches
        self.watch = self.bodies = self.start = None
        self.contactSettings = (self.CRCoeff, self.mu) if self.mu else (self.CRCoeff,)

    @contextmanager
    def undone_on_error(self):
        """Takes the state of the meshes, restores it after an error, and names an invalid mesh."""
        isSoft = self.solverState is not None and self.contactSolver == "soft-step"
        solver = dict(vars(self.solverState)) if isSoft else {}
        try:
            if self.isOnArrays and len(self.meshes):
                from rbs.stepping.bodies import bodies_of

                with self.report.phase("gather"):
                    self.bodies = bodies_of(self.meshes, self.gravity, self.groundMesh)
                self.start = self.bodies.start
            else:
                check_distinct(self.meshes)
                self.start = Snapshot.of(self.meshes)
            yield
        except BaseException as error:
            if self.start is not None:
                self.start.restore(self.meshes)
            if solver:
                vars(self.solverState).update(solver)  # its arrays are never modified
            if isinstance(error, ArithmeticError | AttributeError | TypeError | ValueError):
                for b, mesh in enumerate(self.meshes):
                    if not hasattr(mesh, "position"):
                        told = f"meshes[{b}] must be a Mesh, not {shown_value(mesh)}"
                        raise TypeError(told) from None
                Snapshot.of(self.meshes).check_start(self.meshes)
            raise

    def begin_contact(self, i, j, contact):
        """Tells the observer of a contact, (depth, normal, point), that is about to be resolved."""
        return self.watch and self.watch.report_contact(i, j, *contact)

    def end_contact(self, i, j, contact, impulses, begun):
        """Reports a resolved contact: what `resolve_collision` and `begin_contact` returned."""
        self.report.found.append((i, j, *contact, impulses))
        if self.watch is not None:
            self.watch.report_response(*begun)
