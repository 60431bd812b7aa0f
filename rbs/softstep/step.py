"""The soft-step contact solver, with which piles come to rest.

A step is divided into substeps of length h, each with one pass over all contacts (Macklin et al.:
Small Steps in Physics Simulation. SCA 2019). Contacts are implicitly integrated springs and
dampers, see rbs/softstep/springs.py; Solver2D and Box2D v3 call this method soft step. A substep
applies gravity and the impulses of the last substep (warm starting), makes one sweep that pushes
penetration out, moves the bodies, and makes one relaxing sweep without the push, which removes the
velocity that the push has added. Restitution follows after the last substep.

Constants are relative: times are in substeps, speeds in √(g r).
"""

import numpy as np

from rbs.geometry.arrays import find_sorted, indices, take
from rbs.softstep.contacts import SoftContacts
from rbs.softstep.detection import detect
from rbs.softstep.manifolds import NO_MANIFOLDS, Manifolds
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

    state : `SolverState` or None; changed only at the end, when nothing can fail any more
    """
    report = StepReport()
    if len(meshes) == 0 or timeStep == 0.0:
        return report
    with report.phase("gather"):
        bodies = Bodies(meshes, gravity)
        state = SolverState() if state is None else state
        kept = state.begun(bodies)
        h = timeStep / substeps
        ratio = h / (kept.substep or h)
        isDisturbed = kept.sleep.disturbed(bodies) | (kept.gravity != gravity).any() | (ratio != 1)
        kept.gravity, kept.substep = np.array(gravity), h
        # if every body is either fixed or asleep, and undisturbed, there is nothing to do
        if sleeping and ((kept.sleep.isAsleep != bodies.isFixed) & ~isDisturbed).all():
            state.replace(kept)
            report.isAsleep = kept.sleep.isAsleep
            return report
        bodies.follow_orientations()
        if isGyroscopic:
            momenta = bodies.angular_momenta()
            bodies.motion[6:9] = bodies.tumbling_velocities(timeStep)[0]
            momenta -= bodies.angular_momenta()
        check_numbers(bodies.columns(), meshes, "the last step")
    with report.phase("collisions"):
        isStill = (kept.sleep.isAsleep | bodies.isFixed) & ~isDisturbed
        manifolds, frames = detect(bodies, groundMesh is not None, isStill, kept, timeStep)
        distances = SoftConstraints(constraints, bodies, kept)
        isAsleep = np.zeros(kept.count, dtype=bool)
        if sleeping:
            links = np.concatenate((manifolds.bodies(kept.count), distances.ends), axis=1)
            isLost = find_sorted(kept.manifolds.key, manifolds.key) < 0
            lost = kept.manifolds.bodies(kept.count)[:, isLost].ravel()
            isAsleep = kept.sleep.woken(bodies, isDisturbed, links, lost)
    with report.phase("contactSolver"):
        motion = Motion(bodies, isAsleep)
        contacts = SoftContacts(manifolds, frames, motion, mu, timeStep, h, ratio)
        distances.begin(motion, frames, h, ratio)
        closing = contacts.impact_speeds(motion) if CRCoeff else None
        _make_substeps(motion, contacts, distances, substeps, h)
        manifolds = contacts.store(manifolds)
        if CRCoeff:
            contacts.restitute(motion, CRCoeff, closing, bodies, distances.ends)
    with report.phase("writeBack"):
        bodies.motion, orientation = motion.result(bodies)
        if isGyroscopic:
            momenta += bodies.angular_momenta()  # with all impulses
        bodies.orientation = orientation
        if isGyroscopic:
            bodies.set_angular_momenta(momenta)
        check_numbers(bodies.columns(), meshes, "contacts and constraints")
        kept.manifolds = manifolds
        if sleeping:
            touching = manifolds.bodies(kept.count)[:, (manifolds.impulse > 0.0).any(axis=0)]
            links = np.concatenate((touching, distances.ends), axis=1)
            kept.sleep = kept.sleep.settled(bodies, isAsleep, links, timeStep)
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
    """Runs the substeps: gravity, warm starting, soft sweep, motion, relaxing sweep."""
    for _ in range(substeps):
        motion.fall(h)
        contacts.warm_start()
        if distances.batches:
            contacts.apply(motion)
            distances.warm_start(motion)
            distances.sweep(motion, isSoft=True)
        contacts.soft_sweep(motion)
        motion.move(h)
        if distances.batches:
            distances.sweep(motion, isSoft=False)
            contacts.measure(motion)
        contacts.relaxing_sweep()
    contacts.apply(motion)


class Motion:
    """Velocities of the m bodies that are neither fixed nor asleep, and displacements in the step.

    The last of m + 1 columns stands for everything that is still: the other bodies and the ground.

    moving : (m,), these bodies; column : (n + 1,), of each body and of the ground
    velocity : (6, m + 1), linear and angular; shift, turn : (3, m + 1), sums of v h and of ω h, so
        that the orientation becomes exp(turn/2) ∘ q
    invMass : (m + 1,); invInertia : (9, m + 1); gravity : (3, m + 1)
    """

    def __init__(self, bodies, isAsleep):
        self.moving = indices(~(isAsleep | bodies.isFixed))
        count = len(self.moving)
        self.column = np.full(len(isAsleep) + 1, count)
        self.column[self.moving] = np.arange(count)
        table = np.zeros((19, count + 1))
        self.velocity, self.invMass, self.invInertia = table[:6], table[6], table[7:16]
        self.gravity = table[16:]
        self.velocity[:, :-1] = take(bodies.velocity, self.moving, axis=1)
        self.invMass[:-1] = bodies.invMass[self.moving]
        self.invInertia[:, :-1] = take(bodies.invInertia, self.moving, axis=1)
        self.gravity[:, :-1] = np.reshape(bodies.gravity, (3, 1))
        self.fallRate = bodies.fallRate
        self.way = np.zeros((6, count + 1))
        self.shift, self.turn = self.way[:3], self.way[3:]

    def fall(self, h):
        self.velocity[:3] += self.gravity * h

    def move(self, h):
        self.way += h * self.velocity

    def orientations(self, bodies):
        """Orientations (4, m) of the moving bodies at the end of the step."""
        return turned(take(bodies.orientation, self.moving, axis=1), self.turn[:, :-1])

    def result(self, bodies):
        """`(motion (9, n), orientation (4, n))` at the end of the step; see `Bodies`."""
        motion, orientation = bodies.motion.copy(), bodies.orientation.copy()
        motion[:3, self.moving] += self.shift[:, :-1]
        motion[3:, self.moving] = self.velocity[:, :-1]
        orientation[:, self.moving] = self.orientations(bodies)
        return motion, orientation


class SolverState:
    """State of the soft-step solver, carried from one step to the next as `solverState`.

    A step without it starts cold: it detects every contact anew and starts with no impulses. A
    simulation that is saved and restored with it continues bit for bit. It belongs to one list of
    bodies, which may only grow or shrink at its end. Its arrays are never modified.

    count : number of bodies; None before the first step
    manifolds : `Manifolds`; sleep : `Sleep`
    pairKey, pairAxis : (P,), i · (count + 1) + j of the pairs i < j with nearby boxes that were not
        both still, and (3, P), their axes of separation or penetration; 0 if unknown
    gravity : (3,), m/s²; substep : s, of the last step, or 0. Another of either wakes all bodies
    constraint : (6, R), keys of the distance constraints, see `SoftConstraints`
    constraintImpulse, constraintOffset : (R,), as in `Manifolds`
    """

    def __init__(self):
        self.clear()

    def clear(self):
        """Forgets everything, so that the next step starts cold."""
        self.count, self.manifolds, self.sleep = None, NO_MANIFOLDS, None
        self.pairKey, self.pairAxis = np.zeros(0, dtype=np.int64), np.zeros((3, 0))
        self.constraint, self.gravity = np.zeros((6, 0)), np.array(EARTH)
        self.constraintImpulse = self.constraintOffset = np.zeros(0)
        self.substep = 0.0

    def begun(self, bodies):
        """Returns a new state in which a step of these bodies begins; this one does not change.

        Added bodies are awake and have no contacts. Bodies that touched a removed one wake.
        """
        count = len(bodies.invMass)
        state = SolverState()
        state.replace(self)
        if self.count is None:
            state.sleep = Sleep.none(bodies)
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
        """Takes over the content of another state."""
        vars(self).update(vars(other))

    def arrays(self):
        """Returns the content as a dict of arrays for `from_arrays`; {} before the first step."""
        if self.count is None:
            return {}
        found = dict(vars(self))
        del found["count"]
        for table in ("sleep", "manifolds"):
            found |= {f"{table}.{name}": column for name, column in vars(found.pop(table)).items()}
        return {name: np.array(value) for name, value in found.items()}

    @classmethod
    def from_arrays(cls, arrays):
        """Returns the `SolverState` from which `arrays` were made, also by older versions."""
        state = cls()
        if arrays:
            vars(state).update({name: arrays[name] for name in vars(state) if name in arrays})
            state.sleep = Sleep(**{name: arrays[f"sleep.{name}"] for name in Sleep.COLUMNS})
            names = vars(NO_MANIFOLDS)
            state.manifolds = Manifolds(**{name: arrays[f"manifolds.{name}"] for name in names})
            state.count = len(state.sleep.timer)
        return state
