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

from rbs.geometry.broadphase import islands
from rbs.geometry.vectors import find_sorted, indices, take
from rbs.softstep.contacts import FREQUENCY, SoftContacts
from rbs.softstep.detection import Frames, detect
from rbs.softstep.manifolds import NO_MANIFOLDS, Manifolds
from rbs.softstep.placed import PlacedManifolds
from rbs.softstep.sleeping import Sleep, fallen
from rbs.softstep.softconstraints import SoftConstraints, bounds, changed_ends
from rbs.stepping.flight import turned
from rbs.stepping.meshes import check_numbers

# Speed of a blow that wakes all sleepers in its way, in multiples of the speed that gravity adds
# per step. With less, bodies that roll keep heaps with restitution awake: with 3, at restitution
# 0.2, 63 % of a heap of 200 sleep after 1000 steps, not 82 %.
BLOW_STEPS = 10.0


def soft_step(step):
    """Makes a `Step` with the soft-step solver."""
    meshes, groundMesh, constraints = step.meshes, step.groundMesh, step.constraints
    report, state, bodies = step.report, step.solverState, step.bodies
    if len(meshes) == 0 or step.timeStep == 0.0:
        return
    with report.phase("gather"):
        state = SolverState() if state is None else state
        kept, bereft = state.begun(bodies)
        h = step.timeStep / step.substeps
        ratio = h / (kept.substep or h)
        surroundings = np.array([*step.gravity, step.mu, groundMesh is not None])
        key = bounds(constraints, bodies)
        isDisturbed = kept.disturbed(bodies, surroundings, key, ratio)
        kept.surroundings, kept.substep = surroundings, h
        bodies.start_moved(kept.sleep.position, kept.sleep.orientation, step.timeStep)
        # if every body is either fixed or asleep, and undisturbed, there is nothing to do
        isBusy = isDisturbed | bodies.isKinematic | (kept.sleep.isAsleep == bodies.isFixed)
        if step.sleeping and not isBusy.any():
            state.replace(kept)
            report.isAsleep = kept.sleep.isAsleep
            rest = bodies.copied(), kept.manifolds, step.substeps
            report.add_later(lambda r: _report_resting(r, *rest))
            return
        bodies.update_rotations()
        momenta = None
        if step.gyroscopic:
            momenta = bodies.angular_momenta()
            bodies.motion[6:9] = bodies.tumbling_velocities(step.timeStep)[0]
            momenta -= bodies.angular_momenta()
    with report.phase("collisions"):
        isStill = kept.sleep.isAsleep | (bodies.isFixed & ~bodies.isKinematic)
        isStill &= ~isDisturbed
        distances, hasGround = SoftConstraints(key, bodies, kept), groundMesh is not None
        give = bodies.fallRate * (h / (2.0 * np.pi * FREQUENCY)) ** 2
        manifolds, frames = detect(
            bodies, hasGround, isStill, kept, step.timeStep, distances.ends, give
        )
        isLost = find_sorted(kept.manifolds.key, manifolds.key) < 0
        bereft[kept.sleep.bereft(bodies, kept.manifolds.rows(indices(isLost)), hasGround)] = True
        if bereft.any():
            manifolds, isFalling = fallen(manifolds, frames, bereft, step.gravity)
            kept.sleep.isAsleep[isFalling] = False
        if not step.sleeping:
            sleep = Sleep.none(bodies)
        else:
            links = np.concatenate((manifolds.bodies(kept.count), distances.ends), axis=1)
            lost = kept.manifolds.bodies(kept.count)[:, isLost].ravel()
            blow = BLOW_STEPS * bodies.fallRate * step.timeStep if step.CRCoeff else np.inf
            sleep = kept.sleep.woken(bodies, isDisturbed, links, lost, blow)
    with report.phase("contactSolver"):
        motion = Motion(bodies, sleep.isAsleep, step.timeStep)
        contacts = SoftContacts(manifolds, frames, motion, step.mu, step.timeStep, h, ratio)
        distances.begin(motion, frames, h, ratio)
        closing = contacts.impact_speeds(motion)
        _make_substeps(motion, contacts, distances, step.substeps, h)
        manifolds = contacts.store(manifolds)
        contacts.impact(motion, step.CRCoeff, closing, distances.ends, momenta)
    with report.phase("writeBack"):
        bodies.motion, orientation = motion.result(bodies)
        if step.gyroscopic:
            momenta += bodies.angular_momenta()  # with all impulses
        bodies.orientation = orientation
        if step.gyroscopic:
            bodies.set_angular_momenta(momenta)
        bodies.end_moved()
        check_numbers(bodies.columns(), meshes, "contacts and constraints")
        kept.manifolds = manifolds
        if step.sleeping:
            touching = manifolds.bodies(kept.count)[:, (manifolds.impulse > 0.0).any(axis=0)]
            links = np.concatenate((touching, distances.ends), axis=1)
            kept.sleep = sleep.settled(bodies, links, step.timeStep)
        else:
            kept.sleep = Sleep.none(bodies)
        distances.store(kept)
        bodies.write_back()
        state.replace(kept)
    report.isAsleep, report.candidatePairs = kept.sleep.isAsleep, len(kept.pairKey)
    report.constraintVisits = distances.visits
    contacts.add_to_report(report, contacts.total)
    if sleep.isAsleep.any():
        others, rest = contacts.others, (step.substeps, frames)
        report.add_later(lambda r: _report_resting(r, bodies, manifolds.taken(others), *rest))


def _report_resting(report, bodies, manifolds, substeps, frames=None):
    """Reports contacts of bodies at rest, with the impulses of their last substep."""
    if frames is None:
        bodies.update_rotations()
        frames = Frames(bodies, 0.0)
    placed = PlacedManifolds(manifolds, frames, indices(manifolds.impulse.any(axis=0)))
    total = np.concatenate((manifolds.impulse, manifolds.friction))[:, placed.rows]
    placed.add_to_report(report, substeps * total)


def _make_substeps(motion, contacts, distances, substeps, h):
    """Runs the substeps: gravity, warm starting, soft sweep, motion, relaxing sweep."""
    for _ in range(substeps):
        motion.accelerate(h)
        contacts.warm_start()
        if distances.batches:
            contacts.apply(motion)
            distances.warm_start(motion)
            distances.sweep(motion, isSoft=True)
        contacts.soft_sweep(motion)
        motion.integrate(h)
        if distances.batches:
            distances.sweep(motion, isSoft=False)
            contacts.measure(motion)
        contacts.relax()
    contacts.apply(motion)


class Motion:
    """Velocities of the m bodies that move, and displacements in the step.

    Bodies move that are neither asleep nor fixed, and kinematic ones, whose velocity no impulse
    changes. The last of m + 1 columns stands for the other bodies and the ground.

    moving : (m,), these bodies; column : (n + 1,), of each body and of the ground
    velocity : (6, m + 1), linear and angular; shift, turn : (3, m + 1), sums of v h and of ω h, so
        that the orientation becomes exp(turn/2) ∘ q
    invMass : (m + 1,); invInertia : (9, m + 1)
    gravity, spinUp : (3, m + 1), linear and angular acceleration, also by forces and torques
    begin, fall : velocity at the start, and the linear one that is added in the step
    """

    def __init__(self, bodies, isAsleep, timeStep):
        self.moving = indices(~(isAsleep | bodies.isFixed) | bodies.isKinematic)
        count = len(self.moving)
        self.column = np.full(len(isAsleep) + 1, count)
        self.column[self.moving] = np.arange(count)
        table = np.zeros((22, count + 1))
        self.velocity, self.invMass, self.invInertia = table[:6], table[6], table[7:16]
        self.gravity, self.spinUp = table[16:19], table[19:]
        self.isDriven = bodies.isDriven.any()
        self.velocity[:, :-1] = take(bodies.velocity, self.moving, axis=1)
        self.invMass[:-1] = bodies.invMass[self.moving]
        self.invInertia[:, :-1] = take(bodies.invInertia, self.moving, axis=1)
        isFree = ~bodies.isFixed[self.moving]
        acceleration = np.broadcast_to(bodies.acceleration, (6, len(isAsleep)))
        table[16:, :-1] = isFree * take(acceleration, self.moving, axis=1)
        self.fallRate, self.begin = bodies.fallRate, self.velocity.copy()
        self.fall = timeStep * self.gravity
        self.displacement = np.zeros((6, count + 1))
        self.shift, self.turn = self.displacement[:3], self.displacement[3:]

    def accelerate(self, h):
        self.velocity[:3] += self.gravity * h
        if self.isDriven:
            self.velocity[3:] += self.spinUp * h

    def integrate(self, h):
        self.displacement += h * self.velocity

    def orientations(self, bodies):
        """Orientations (4, m) of the moving ones of `Bodies` at the end of the step."""
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
    bodies, which may grow or shrink at its end; call `remove` before others are removed from it.
    Its arrays are never modified.

    count : number of bodies; None before the first step
    manifolds : `Manifolds`; sleep : `Sleep`
    pairKey, pairAxis : (P,), i · (count + 1) + j of the pairs i < j with nearby boxes that were not
        both still, and (3, P), their axes of separation or penetration; 0 if unknown
    surroundings : (5,), gravity in m/s², friction, and whether there is ground; NaN before the
        first step. A change wakes all bodies
    substep : length of a substep in s, 0 before the first step. A change wakes all bodies
    removed : indices of bodies that have been removed since the last step, in this order
    constraint : (6, R), keys of the distance constraints, see `SoftConstraints`
    constraintImpulse, constraintOffset : (R,), as in `Manifolds`
    """

    def __init__(self):
        self.clear()

    def clear(self):
        """Forgets everything, so that the next step starts cold."""
        self.count, self.manifolds, self.sleep = None, NO_MANIFOLDS, None
        self.pairKey, self.pairAxis = np.zeros(0, dtype=np.int64), np.zeros((3, 0))
        self.constraint, self.surroundings = np.zeros((6, 0)), np.full(5, np.nan)
        self.constraintImpulse = self.constraintOffset = np.zeros(0)
        self.substep, self.removed = 0.0, ()

    def begun(self, bodies):
        """`(state, bereft)`: a new state in which a step of these bodies begins, and whether each
        body (n,) touched a removed one. This state does not change.

        Added bodies are awake and have no contacts. Bodies that touched a removed one wake. Without
        `removed`, bodies are taken to be removed from the end of the list.
        """
        count = len(bodies.invMass)
        bereft = np.zeros(count, dtype=bool)
        state = SolverState()
        state.replace(self)
        state.removed = ()
        if self.count is None:
            state.sleep = Sleep.none(bodies)
        elif self.count != count or self.removed:
            number = self._numbers(count)
            first, second = (number[b] for b in np.divmod(self.pairKey, self.count + 1))
            left = indices((first >= 0) & (second >= 0))
            state.pairKey = first[left] * (count + 1) + second[left]
            state.pairAxis = self.pairAxis[:, left]
            state.manifolds, touched = self.manifolds.renumbered(number)
            state.sleep = self.sleep.renumbered(bodies, number, touched)
            bereft[touched] = True
        state.count = count
        return state, bereft

    def disturbed(self, bodies, surroundings, key, ratio):
        """Returns which bodies (n,) wake because they were changed, or are driven, from outside.

        surroundings, key : `surroundings` and `constraint` of this step
        ratio : of the length of its substeps to that of the last step's
        """
        isOther = (np.abs(surroundings - self.surroundings) > 0.0).any() | (ratio != 1)
        isStirred = bodies.isDriven | isOther
        ends = changed_ends(key, self.constraint)
        isStirred[ends[ends < self.count]] = True
        isStirred |= self.sleep.disturbed(bodies)
        # what is tied to such a body wakes with it
        tied = key[0:4:2].astype(np.intp)
        island = islands(tied, ~bodies.isFixed)
        first, second = tied[:, isStirred[tied].any(axis=0)]
        isStirred |= np.isin(island, island[np.concatenate((first, second))]) & ~bodies.isFixed
        return (isStirred & ~bodies.isFixed) | self.sleep.disturbed(bodies)

    def _numbers(self, count):
        """Returns the new index of each body and of the ground, ascending; -1 if removed."""
        old = list(range(self.count))
        for body in self.removed:  # each index counts without those before; new bodies are beyond
            del old[body : body + 1]
        number = np.full(self.count + 1, -1)
        number[old[:count]] = np.arange(len(old[:count]))
        number[-1] = count
        return number

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
        found["removed"] = np.array(self.removed, dtype=np.int64)
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
        return state
