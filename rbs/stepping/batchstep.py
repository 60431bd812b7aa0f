"""A step with its contacts in batches, on arrays, bitwise identical to the loop over all pairs.

The impulses follow when all positions are corrected, because no position depends on a velocity.
"""

import itertools

import numpy as np

from rbs.geometry.arrays import take
from rbs.geometry.hulls import FEATURE_TOLERANCE
from rbs.geometry.patches import contact_points
from rbs.geometry.vectors import cross
from rbs.stepping.batches import find_contacts, in_batches
from rbs.stepping.bodies import Bodies, check_numbers
from rbs.stepping.kernels import collide, inverse_effective_mass, position_corrections
from rbs.stepping.reports import GROUND


def batch_step(meshes, groundMesh, step, report):
    """The part of `run_timestep` before the constraints; step : from `step_arguments`."""
    if len(meshes) == 0:
        return
    with report.phase("gather"):
        bodies = Bodies(meshes, step.gravity)
    with report.phase("integrate"):
        bodies.integrate(step.timeStep, step.gyroscopic)
        check_numbers(bodies.columns(), meshes, "free flight")
    with report.phase("collisions"):
        contacts, report.candidatePairs = find_contacts(bodies)
        apply_impulses(bodies, contacts, step, report)
    with report.phase("ground"):
        if groundMesh is not None:
            _resolve_ground(bodies, groundMesh, step, report)
    with report.phase("writeBack"):
        check_numbers(bodies.columns(), meshes, "contacts")
        bodies.write_back()


def apply_impulses(bodies, contacts, step, report):
    """Applies the impulses by batch; whatever ignores velocities is computed for all at once."""
    if len(contacts.rank) == 0:
        return
    order, starts = in_batches(*contacts.bodies, bodies.isFixed)
    rank, ends, depth, n, before, after = contacts.of(order)
    radius = take(bodies.hulls.radius, ends)
    t, tolerance = before[:, 1] - before[:, 0], FEATURE_TOLERANCE * (radius[0] + radius[1])
    penPoint = contact_points(bodies.hulls, *ends, t, n, tolerance) + before[:, 1]
    invMasses, invInertias = take(bodies.invMass, ends), take(bodies.invInertia, ends, axis=1)
    arms = (penPoint + position_corrections(invMasses, depth)[1] * n)[:, None] - after
    K, response = inverse_effective_mass(invMasses, invInertias, cross(arms, n[:, None]))
    impulses, frictions = [], []
    for some in itertools.starmap(slice, itertools.pairwise(starts.tolist())):
        velocity = take(bodies.velocity, ends[:, some], axis=1)
        contact = (table[..., some] for table in (invMasses, invInertias, arms, n, K, response))
        impulse, friction = collide(velocity, *contact, step)
        bodies.velocity[:, ends[:, some]] = velocity
        impulses.append(impulse)
        frictions.append(friction)
    impulse, friction = np.concatenate(impulses), np.concatenate(frictions, axis=1)
    report.add_columns(rank, *ends, depth, n, penPoint, impulse, friction, arms[:, 0])


def _resolve_ground(bodies, groundMesh, step, report):
    """Applies `resolve_collision` to each body that reaches the ground, which is body 2."""
    b, penPoint = bodies.lowest_points()
    if len(b) == 0:
        return
    still = groundMesh.body_state()
    still = np.reshape(still.position + still.linVelocity + still.angVelocity, (9, 1))
    motion = np.stack((take(bodies.motion, b, axis=1), still.repeat(len(b), axis=1)), axis=1)
    invMasses, invInertias = np.zeros((2, len(b))), np.zeros((9, 2, len(b)))
    invMasses[0], invInertias[:, 0] = bodies.invMass[b], bodies.invInertia[:, b]
    depth, n = -penPoint[1], -np.tile([[0.0], [1.0], [0.0]], len(b))  # zeros are -0.0
    correction = position_corrections(invMasses, depth)
    motion[:3] += correction * n[:, None]
    arms = (penPoint + correction[1] * n)[:, None] - motion[:3]
    K, response = inverse_effective_mass(invMasses, invInertias, cross(arms, n[:, None]))
    impulse, friction = collide(motion[3:], invMasses, invInertias, arms, n, K, response, step)
    bodies.motion[:, b] = motion[:, 0]
    rank, second = np.full(len(b), np.iinfo(np.intp).max), np.full(len(b), GROUND)  # last
    report.add_columns(rank, b, second, depth, n, penPoint, impulse, friction, arms[:, 0])
