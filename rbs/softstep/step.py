"""The soft-step contact solver: piles that rest.

A step is cut into substeps of length h, and each makes one pass over all contacts: Macklin et al.:
Small Steps in Physics Simulation. SCA 2019. Contacts are springs and dampers that are integrated
implicitly, see rbs/softstep/springs.py; Solver2D and Box2D v3 call it soft step. Within a substep:
gravity; the impulses of the substep before, as a start; one sweep in which penetration pushes out;
the move; one relaxing sweep without the push, which takes its speed out again. Restitution comes
after the last substep.

Nothing here has a unit of its own: times are counted in substeps, speeds in √(g r).

From the top: the step; who sleeps; `Motion`; and `SolverState`, all that one step leaves to the
next, beside the bodies.
"""

import numpy as np

from rbs.geometry.arrays import find_sorted, indices
from rbs.geometry.vectors import mat_vec
from rbs.softstep.contacts import SoftContacts
from rbs.softstep.detection import detect
from rbs.softstep.manifolds import COLUMNS, Manifolds
from rbs.softstep.sleeping import Sleep
from rbs.softstep.softconstraints import SoftConstraints
from rbs.stepping.bodies import EARTH, Bodies, check_numbers, turned
from rbs.stepping.reports import StepReport


def soft_step(
    meshes,
    groundMesh,
    timeStep,
    CRCoeff,
    closingOnly,
    mu,
    isGyroscopic,
    gravity,
    constraints,
    substeps,
    sleeping,
    state,
):
    """`run_timestep` with the soft-step solver; see there. Returns a `StepReport`.

    state : `SolverState` or None; it changes at the end, when nothing can go wrong any more
    """
    report = StepReport()
    if len(meshes) == 0 or timeStep == 0.0:
        return report
    with report.phase("gather"):
        bodies = Bodies(meshes, gravity)
        bodies.follow_orientations()
        state = SolverState() if state is None else state
        kept = state.begun(bodies)
        isDisturbed = kept.sleep.disturbed(bodies) | (kept.gravity != gravity).any()
        kept.gravity = np.array(gravity)
        if isGyroscopic:
            bodies.turn_gyroscopically(timeStep)
        check_numbers(bodies.columns(), meshes, "the last step")
    with report.phase("collisions"):
        isStill = (kept.sleep.isAsleep | bodies.isFixed) & ~isDisturbed
        manifolds, frames = detect(bodies, groundMesh is not None, isStill, kept, timeStep)
        distances = SoftConstraints(constraints, bodies, kept)
        if sleeping:
            isAsleep = _still_asleep(kept, bodies, isDisturbed, manifolds, distances)
        else:
            isAsleep = np.zeros(kept.count, dtype=bool)
    with report.phase("contactSolver"):
        h = timeStep / substeps
        motion = Motion(bodies, isAsleep)
        contacts = SoftContacts(manifolds, frames, motion, mu, timeStep, h)
        distances.begin(motion, frames, h)
        closing = contacts.impact_speeds(motion) if CRCoeff else None
        _make_substeps(motion, contacts, distances, substeps, h)
        manifolds = contacts.store(manifolds)
        if CRCoeff:
            contacts.restitute(motion, CRCoeff, closing, bodies, distances.ends)
    with report.phase("writeBack"):
        bodies.motion, bodies.orientation = motion.result(bodies)
        check_numbers(bodies.columns(), meshes, "contacts and constraints")
        kept.manifolds = manifolds
        if sleeping:
            kept.sleep = _settled(kept, bodies, isAsleep, distances, timeStep)
        else:
            kept.sleep = Sleep.none(bodies)
        distances.store(kept)
        bodies.write_back()
        state.replace(kept)
    report.isAsleep, report.candidatePairs = kept.sleep.isAsleep, len(kept.pairKey)
    report.constraintVisits = distances.visits
    contacts.tell(report)
    return report


def _make_substeps(motion, contacts, distances, substeps, h):
    """The substeps: gravity, warm start, soft sweep, move, relaxing sweep."""
    for _ in range(substeps):
        motion.fall(h)
        contacts.warm_start()
        if distances.batches:
            contacts.apply(motion)
            distances.warm_start(motion)
            distances.sweep(motion, isSoft=True)
        contacts.measure(motion)
        contacts.soft_sweep()
        contacts.measure(motion)
        if contacts.are_hit():
            contacts.soft_sweep()
            contacts.measure(motion)
        motion.move(h)
        contacts.move()
        if distances.batches:
            distances.sweep(motion, isSoft=False)
            contacts.measure(motion)
        contacts.relaxing_sweep()
    contacts.apply(motion)


def _still_asleep(kept, bodies, isDisturbed, manifolds, distances):
    """Which bodies (n,) sleep through this step; see rbs/softstep/sleeping.py."""
    links = np.concatenate((manifolds.bodies(kept.count), distances.ends), axis=1)
    lost = kept.manifolds.key[find_sorted(kept.manifolds.key, manifolds.key) < 0]
    lost = np.concatenate(np.divmod(lost, kept.count + 1))
    return kept.sleep.woken(bodies, isDisturbed, links, lost)


def _settled(kept, bodies, isAsleep, distances, timeStep):
    """The `Sleep` at the end of the step; what falls asleep stands still."""
    touching = kept.manifolds.bodies(kept.count)[:, (kept.manifolds.impulse > 0.0).any(axis=0)]
    links = np.concatenate((touching, distances.ends), axis=1)
    isAsleep, timer = kept.sleep.settled(bodies, isAsleep, links, timeStep)
    bodies.motion[3:9] = np.where(isAsleep, 0.0, bodies.motion[3:9])
    return Sleep.of(bodies, isAsleep, timer)


class Motion:
    """The velocities of the n bodies and of the ground, and how far they have come in the step.

    velocity : (n + 1, 6), linear and angular; shift, turn : (n, 3), sums of v h and of ω h: the
        orientation is exp(turn/2) ∘ q
    isStill : (n + 1,) bool, what is fixed or asleep, and the ground; for these, invMass : (n + 1,),
        invInertia : (9, n + 1) and gravity : (n + 1, 3) are 0
    fallRate : the magnitude of gravity, m/s²
    """

    def __init__(self, bodies, isAsleep):
        count = len(isAsleep) + 1
        isStill = self.isStill = np.append(isAsleep | bodies.isFixed, True)
        self.velocity = np.zeros((count, 6))
        self.velocity[:-1] = bodies.velocity.T
        self.invMass = np.where(isStill, 0.0, np.append(bodies.invMass, 0.0))
        self.invInertia = np.zeros((9, count))
        self.invInertia[:, :-1] = np.where(isStill[:-1], 0.0, bodies.invInertia)
        self.fallRate = bodies.fallRate
        self.gravity = np.where(isStill[:, None], 0.0, bodies.gravity)
        self.shift, self.turn = np.zeros((count - 1, 3)), np.zeros((count - 1, 3))

    def fall(self, h):
        self.velocity[:, :3] += self.gravity * h

    def push(self, impulses):
        """Changes the velocities by impulses (n + 1, 6) on the bodies, linear and angular."""
        self.velocity[:, :3] += self.invMass[:, None] * impulses[:, :3]
        self.velocity[:, 3:] += mat_vec(self.invInertia, impulses[:, 3:].T).T

    def move(self, h):
        self.shift += h * self.velocity[:-1, :3]
        self.turn += h * self.velocity[:-1, 3:]

    def result(self, bodies):
        """`(motion (9, n), orientation (4, n))` at the end of the step; see `Bodies`."""
        orientation = turned(bodies.orientation, np.ascontiguousarray(self.turn.T))
        moved = np.concatenate((bodies.position + self.shift.T, self.velocity[:-1].T))
        isStill = self.isStill[:-1]
        return (
            np.where(isStill, bodies.motion, moved),
            np.where(isStill, bodies.orientation, orientation),
        )


class SolverState:
    """What `run_timestep` takes as solverState, reads, and puts its successor's content into.

    Without it a step starts cold: it finds every contact anew and begins with no impulses. With it,
    a simulation that is saved with its bodies and restored goes on with the same bits. It belongs
    to a list of bodies, to the end of which others may be added, or from it be removed.

    count : number of bodies; None before the first step
    manifolds : `Manifolds`; sleep : `Sleep`
    pairKey : (P,), i · (count + 1) + j of the pairs i < j whose boxes were near each other
    pairAxis : (3, P), along which they were found apart, or penetrating; 0 where it is unknown
    constraint : (6, R), what distance constraints there were, see `SoftConstraints`
    gravity : (3,), of the last step; another one wakes all bodies
    constraintImpulse : (R,), of these in the last substep; constraintOffset and constraintSubstep
        (R,), as offset and substep of `Manifolds`
    """

    COLUMNS = (
        "pairKey",
        "pairAxis",
        "constraint",
        "constraintImpulse",
        "constraintOffset",
        "constraintSubstep",
        "gravity",
    )

    def __init__(self):
        self.clear()

    def clear(self):
        """Forgets everything: the next step starts cold."""
        self.count = self.manifolds = self.sleep = None
        self.pairKey, self.pairAxis = np.zeros(0, dtype=np.int64), np.zeros((3, 0))
        self.constraint, self.gravity = np.zeros((6, 0)), np.array(EARTH)
        self.constraintImpulse = self.constraintOffset = self.constraintSubstep = np.zeros(0)

    def begun(self, bodies):
        """The state that a step of these bodies begins with: another one, this stays as it is.

        Bodies that have been added are awake, without contacts; what has touched bodies that have
        been removed is awake, too.
        """
        count = len(bodies.invMass)
        state = SolverState()
        state.replace(self)
        if self.count is None:
            state.manifolds, state.sleep = Manifolds.none(), Sleep.none(bodies)
        elif self.count != count:
            first, second = np.divmod(self.pairKey, self.count + 1)
            left = indices(second < count)
            state.pairKey = first[left] * (count + 1) + second[left]
            state.pairAxis = self.pairAxis[:, left]
            state.manifolds, touched = self.manifolds.resized(self.count, count)
            state.sleep = self.sleep.resized(bodies, touched)
        state.count = count
        return state

    def replace(self, other):
        """Takes over the content of another state. Nobody writes into the arrays of a state."""
        self.__dict__.update(other.__dict__)

    def arrays(self):
        """The content as arrays: dict, {} before the first step. `from_arrays` takes it back."""
        if self.count is None:
            return {}
        found = {name: getattr(self, name) for name in self.COLUMNS}
        found |= {f"sleep.{name}": getattr(self.sleep, name) for name in Sleep.COLUMNS}
        found |= {f"manifolds.{n}": getattr(self.manifolds, n) for n in ("key", *COLUMNS)}
        return {name: np.array(value) for name, value in found.items()}

    @classmethod
    def from_arrays(cls, arrays):
        """The `SolverState` that `arrays` was made from."""
        state = cls()
        if arrays:
            arrays = {name: np.array(value) for name, value in arrays.items()}
            for name in cls.COLUMNS:  # older recordings have no gravity
                setattr(state, name, arrays.get(name, getattr(state, name)))
            state.sleep = Sleep(**{name: arrays[f"sleep.{name}"] for name in Sleep.COLUMNS})
            state.manifolds = Manifolds(**{n: arrays[f"manifolds.{n}"] for n in ("key", *COLUMNS)})
            state.count = len(state.sleep.timer)
        return state
