"""The soft-step contact solver, with which piles come to rest.

A step is divided into substeps, each with one pass over all contacts (Macklin et al.: Small Steps
in Physics Simulation. SCA 2019). Contacts are implicitly integrated springs and dampers; Solver2D
and Box2D v3 call this method soft step:

    contacts of near pairs, kept and new                             detection
    lost supports, bodies that wake, and sleepers on trial           sleeping
    each substep of length h:
        gravity, and the impulses of the last substep                contacts
        all constraints solved together, and a pseudo-velocity       softconstraints
            that pushes distances to their bounds
        a sweep over all contacts, which pushes bodies apart
        x += h v
        both again without the pushes, which are dropped
    blows, plastic and elastic                                       contacts
    a bound on the energy that all this gives                        energies
    bodies on trial that stay where they were, and that fall asleep  sleeping

The first sweep goes on while a point would sink far, or on a linked body, faster than gravity makes
it in a step. Both go on until they converge where masses are uneven, and in a step whose substeps
are longer or shorter than the last one's.
"""

import numpy as np

from rbs.geometry.vectors import indices, take
from rbs.softstep.contacts import SoftContacts, StillContacts
from rbs.softstep.detection import Frames, detect
from rbs.softstep.manifolds import NO_MANIFOLDS, Manifolds
from rbs.softstep.rows import inverted
from rbs.softstep.sleeping import Sleep, beside, connected, unloaded, wake
from rbs.softstep.softconstraints import SoftConstraints, carried, constraint_keys
from rbs.stepping.flight import turned


def soft_step(step):
    """Makes a `Step` with the soft-step solver."""
    report, state, bodies = step.report, step.solverState, step.bodies
    if len(step.meshes) == 0 or step.timeStep == 0.0:
        return
    with report.phase("gather"):
        state = SolverState() if state is None else state
        lastGravity, isBereft = state.surroundings[:3], state.renumber(bodies)
        h = step.timeStep / step.substeps
        constraints = constraint_keys(step.constraints, bodies)
        tied = constraints[0:4:2].astype(np.intp)
        isDisturbed, ratio = state.disturbed(step, constraints, tied, h)
        bodies.start_moved(state.sleep.state[:3], state.sleep.state[9:], step.timeStep)
        isMoving = isDisturbed | isBereft | bodies.isKinematic
        if step.sleeping and not (isMoving | (state.sleep.isAsleep == bodies.isFixed)).any():
            report.isAsleep = state.sleep.isAsleep
            report.add_later(StillContacts(step, state.manifolds))
            return
        bodies.update_rotations()
        drift = None
        if step.gyroscopic:  # bodies turn by the mean angular velocities of free flight
            mean = bodies.tumbling_velocities(step.timeStep)[0]
            drift = mean - bodies.angVelocity
            bodies.angVelocity[:] = mean
    with report.phase("collisions"):
        isStill = state.sleep.isAsleep | (bodies.isFixed & ~bodies.isKinematic)
        frames = Frames(step, isStill & ~isDisturbed, tied)
        found = detect(step, frames, state, tied)
        given = step, frames, state, lastGravity, found
        manifolds, isBereft, lost = unloaded(*given, isDisturbed, isBereft)
        sleep, isTried = wake(step, frames, state, manifolds, tied, lost, isDisturbed, isBereft)
    with report.phase("contactSolver"):
        motion = Motion(frames, sleep.isAsleep, drift)
        distances = SoftConstraints(constraints, state.constraintImpulse, frames, motion, h, ratio)
        contacts = SoftContacts(manifolds, frames, motion, step.mu, h, ratio)
        for _ in range(step.substeps):
            _make_substep(motion, contacts, distances, h)
        contacts.apply(motion)
        contacts.impact(motion, step.CRCoeff, distances)
    with report.phase("writeBack"):
        motion.store(bodies)
        state.sleep = sleep.settled(step, frames, motion, isTried)
        isStill = ((sleep.isAsleep | isTried) & state.sleep.isAsleep) | bodies.isFixed
        state.manifolds = contacts.store(manifolds, np.append(isStill, True))
        bodies.check("contacts and constraints")
        state.constraintImpulse = distances.impulse
        bodies.write_back()
    report.isAsleep, report.candidatePairs = state.sleep.isAsleep, len(state.pairKey)
    report.constraintVisits = distances.visits
    report.add_columns(contacts.reported(contacts.total))
    if len(contacts.others):
        report.add_later(StillContacts(step, state.manifolds.rows(contacts.others)))


def _make_substep(motion, contacts, distances, h):
    """Gravity, warm starting, constraints and the soft sweep, motion, and both without the push."""
    motion.velocity += motion.acceleration * h
    contacts.warm_start()
    if distances.count:
        contacts.apply(motion)
        pushed = distances.pull(motion)
    contacts.soft_sweep(motion)
    if distances.count:
        distances.relax(motion, pushed)
        contacts.weigh(motion)
        contacts.measure(motion)
    else:
        motion.displacement += h * motion.rates()
    contacts.relax(motion)


class Motion:
    """Velocities of the m bodies that move, and displacements in the step.

    Bodies move that are neither asleep nor fixed, and kinematic ones and a ground that moves, whose
    velocity no impulse changes. The last of m + 1 columns stands for all that is still.

    moving : (m,), these bodies; the ground is body n; bodies : without it
    column : (n + 1,), of each body and of the ground
    velocity, begin : (6, m + 1), linear and angular, and at the start
    shift, turn : (3, m + 1), sums of v h and of ω h, so that orientations become exp(turn/2) ∘ q,
        see also `SoftConstraints`; displacement : (6, m + 1), both
    invMass : (m + 1,); invInertia : (9, m + 1); inverse : (10, m + 1), both
    mass, inertia : (m,) and (9, m), 0 if no impulse changes the velocity; those at the start, to
        which constraints add none, see `SoftConstraints`
    gravity, spinUp : (3, m + 1), linear and angular acceleration, also by forces and torques
    drift : (3, m + 1), mean angular velocities of free flight less those at its start, or None.
        Bodies turn by the former, while impulses change the latter, and angular momenta last
    """

    def __init__(self, frames, isAsleep, drift):
        bodies, self.timeStep = frames.bodies, frames.timeStep
        self.fallRate = bodies.fallRate
        isMoving = ~(isAsleep | bodies.isFixed) | bodies.isKinematic
        self.moving = indices(np.concatenate((isMoving, [frames.isGroundMoving])))
        self.bodies, count = self.moving[self.moving < frames.count], len(self.moving)
        self.column = np.full(frames.count + 1, count)
        self.column[self.moving] = np.arange(count)
        table, some = np.zeros((22, count + 1)), slice(len(self.bodies))
        self.velocity, self.inverse, self.acceleration = table[:6], table[6:16], table[16:]
        self.invMass, self.invInertia = self.inverse[0], self.inverse[1:]
        self.gravity, self.spinUp = self.acceleration[:3], self.acceleration[3:]
        self.velocity[:, :-1] = take(frames.velocity, self.moving, axis=1)
        self.invMass[:-1] = take(bodies.invMass, self.moving)
        self.invInertia[:, :-1] = take(bodies.invInertia, self.moving, axis=1)
        self.acceleration[:, some] = (~bodies.isFixed * bodies.acceleration)[:, self.bodies]
        isMovable = self.invMass[:-1] > 0.0
        self.mass = 1.0 / np.where(isMovable, self.invMass[:-1], np.inf)
        self.inertia = inverted(self.invInertia[:, :-1].reshape(3, 3, count)).reshape(9, count)
        self.drift = drift
        if drift is not None:
            self.drift = np.zeros((3, count + 1))
            self.drift[:, some] = take(drift, self.bodies, axis=1)
            self.velocity[3:] -= self.drift
        self.begin = self.velocity.copy()
        self.displacement = np.zeros((6, count + 1))
        self.shift, self.turn = self.displacement[:3], self.displacement[3:]

    def rates(self):
        """Velocities (6, m + 1) with which bodies move and turn, with the drift."""
        if self.drift is None:
            return self.velocity
        return np.concatenate((self.velocity[:3], self.velocity[3:] + self.drift))

    def store(self, bodies):
        """Moves `Bodies` to the end of the step."""
        some, own = slice(len(self.bodies)), self.bodies
        orientation = turned(take(bodies.orientation, own, axis=1), self.turn[:, some])
        bodies.state = bodies.state.copy()
        bodies.position[:, own] += self.shift[:, some]
        bodies.velocity[:, own] = self.velocity[:, some]
        if self.drift is None:
            bodies.orientation[:, own] = orientation
        else:
            bodies.turn_freely(own, orientation)
        bodies.end_moved()


class SolverState:
    """State of the soft-step solver, carried from one step to the next as `solverState`.

    A step without it starts cold: it detects every contact anew and starts with no impulses. A
    simulation that is saved and restored with it continues bit for bit. It belongs to one list of
    bodies, which may grow or shrink at its end; call `remove` before others are removed from it.
    Its arrays are never modified.

    count : number of bodies; None before the first step
    manifolds : `Manifolds`; sleep : `Sleep`
    pairKey, pairAxis : (P,), i · (count + 1) + j of the pairs i < j with nearby boxes that were not
        both still, and (3, P), their axes of separation or penetration; 0 if unknown
    surroundings : (12,), gravity in m/s², friction, whether linked bodies collide, whether there is
        ground, and its velocity; empty before the first step. A change wakes all bodies
    substep : length of a substep in s, 0 before the first step. A change wakes all bodies
    removed : indices of bodies that have been removed since the last step, in this order
    constraint : (6, R), keys of the distance constraints, see `SoftConstraints`
    constraintImpulse : (4, R), see `SoftConstraints`
    """

    def __init__(self):
        self.count, self.manifolds, self.sleep = None, NO_MANIFOLDS, None
        self.pairKey, self.pairAxis = np.zeros(0, dtype=np.int64), np.zeros((3, 0))
        self.constraint, self.surroundings = np.zeros((6, 0)), np.zeros(0)
        self.constraintImpulse = np.zeros((4, 0))
        self.substep, self.removed = 0.0, ()

    def renumber(self, bodies):
        """Takes up the bodies of a step. Returns which (n,) touched a removed one, were tied to it,
        or were fixed, but are no longer; they wake.

        Added bodies are awake and have no contacts. Without `removed`, bodies are taken to be
        removed from the end of the list.
        """
        count = len(bodies.meshes)
        isBereft = np.zeros(count, dtype=bool)
        if self.count is None:
            self.sleep = Sleep.none(bodies)
        elif self.count != count or self.removed:
            old = list(range(self.count))
            for body in self.removed:  # each index counts without those before
                del old[body : body + 1]  # bodies that have been added are beyond the end
            # new indices, ascending; -1 if removed
            number = np.full(self.count + 1, -1)
            number[old[:count]], number[-1] = np.arange(len(old[:count])), count
            self.pairKey, self.pairAxis = self.pairKey[:0], self.pairAxis[:, :0]
            self.manifolds, touched = self.manifolds.renumbered(number)
            self.sleep = self.sleep.renumbered(bodies, number)
            ends = number[self.constraint[0:4:2].astype(np.intp)]
            isKept = (ends >= 0).all(axis=0)
            left = ends[:, ~isKept]
            isBereft[touched] = isBereft[left[left >= 0]] = True
            self.constraint = self.constraint[:, isKept]
            self.constraint[0:4:2] = ends[:, isKept]
            self.constraintImpulse = self.constraintImpulse[:, isKept]
        self.count, self.removed = count, ()
        return isBereft | (np.isinf(self.sleep.timer) & ~bodies.isFixed)

    def disturbed(self, step, constraint, tied, h):
        """`(isDisturbed (n,), ratio)`: which bodies wake because they were changed, or are driven,
        from outside, and how many times as long substeps are as in the last step.

        constraint, tied : (6, R), (2, R), of this step, and the bodies that they join; h : s
        """
        bodies, ratio, last = step.bodies, h / (self.substep or h), self.surroundings
        ground = step.groundMesh is not None, *bodies.state[3:9, -1]
        scene = *step.gravity, step.mu, step.linkedBodiesCollide, *ground
        self.surroundings, self.substep = np.array(scene), h
        isOther = not np.array_equal(self.surroundings, last) or ratio != 1.0
        isChanged = (bodies.state[:, :-1] != self.sleep.state).any(axis=0)
        isStirred = isChanged | bodies.isDriven | isOther
        given = constraint, self.constraint, self.constraintImpulse
        self.constraintImpulse, retied = carried(*given)
        self.constraint, isStirred[retied] = constraint, True
        isFree = ~bodies.isFixed
        if tied.size:  # what is tied to such a body wakes with it
            isStirred |= connected((isStirred | beside(isStirred, tied)) & isFree, isFree, tied)
        return (isStirred & isFree) | isChanged, ratio

    def remove(self, body):
        """Notes that a body is removed before the next step."""
        if self.count is not None:
            self.removed = (*self.removed, body)

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
        """Returns the `SolverState` from which `arrays` were made."""
        state = cls()
        if arrays:
            vars(state).update({name: arrays[name] for name in vars(state) if name in arrays})
            state.sleep = Sleep(**{name: arrays[f"sleep.{name}"] for name in Sleep.COLUMNS})
            names = vars(NO_MANIFOLDS)
            state.manifolds = Manifolds(**{name: arrays[f"manifolds.{name}"] for name in names})
            state.count, state.removed = len(state.sleep.timer), tuple(state.removed.tolist())
            shape = len(cls().constraintImpulse), len(state.constraint[0])
            state.constraintImpulse = state.constraintImpulse.reshape(shape)
        return state
