"""Write the project's grader data: random states, and the results of exact physics.

    python graders/make_reference.py [--out DIR] [--convention exact|released-2024]

Needs mpmath (pip install mpmath). The three files have the keys and shapes of the coursework's own
(contract, section 3). The random states are doubles, taken as exact numbers; the results come from
`reference.referencePhysics`, in 50 digits, and are rounded to doubles at the end. `--convention
released-2024` reproduces the quirks of the released data. Two runs write the same bytes.
"""

import argparse
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
from reference import referencePhysics as physics
from reference.graderData import CONVENTIONS, DATA_DIRECTORY, EXACT, RELEASED_2024, WIDTHS
from reference.referencePhysics import exact, unit

SAMPLE_COUNT = 100

# The doubles that the graders pass to functions.
TIME_STEP = exact(0.1)  # s
RESTITUTION = exact(0.5)
UPPER_FACTOR = 1.2
LOWER_FACTOR = 0.8
POSITION_TOLERANCE = exact(1e-6)  # m
VELOCITY_TOLERANCE = exact(1e-5)  # m/s

LARGEST_SPEED = 10.0  # per component, in m/s and in rad/s
REST_INTERVAL = 10  # the last of every ten samples is at rest, so its velocities are valid

# Largest distance of the centres of mass, in m. Larger, fewer poses collide: here about half, as
# the box extends 3 to 8 m from its centre, the octahedron 2 to 8 m.
COLLISION_RADIUS = 11.5
POSITION_RADIUS = 20.0  # m, where collisions do not matter
REFERENCE_LENGTHS = (5.0, 30.0)  # m, range of a constraint's reference value

# Vertices in m, and tetrahedra, of two meshes whose centres of mass are not at the origin.
MESHES = (
    # A box of 12 × 6 × 8 m: six tetrahedra around its long diagonal, from corner 0 to corner 7.
    (
        [(x, y, z) for z in (3.0, 11.0) for y in (-2.0, 4.0) for x in (1.0, 13.0)],
        [(0, 1, 3, 7), (0, 5, 1, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 4, 5, 7), (0, 6, 4, 7)],
    ),
    # An octahedron with six different arms, its principal axes oblique: four around its z axis.
    (
        [(0, -3, 1), (10, -3, 1), (2, -10, 1), (2, 0, 1), (2, -3, -2), (2, -3, 7)],
        [(4, 5, 1, 3), (4, 5, 3, 0), (4, 5, 0, 2), (4, 5, 2, 1)],
    ),
)

# From the data's keys to the attributes of a Body.
ATTRIBUTES = ("position", "orientation", "linVelocity", "angVelocity")
STATE = dict(zip(WIDTHS, ATTRIBUTES, strict=True))


def boundary_triangles(tets):
    """The outward triangles that only one of the tetrahedra has."""
    triangles = {}
    for a, b, c, d in tets:
        for triangle in ((a, c, b), (a, b, d), (a, d, c), (b, c, d)):
            triangles.setdefault(frozenset(triangle), []).append(triangle)
    return [found[0] for found in triangles.values() if len(found) == 1]


def make_meshes(convention):
    """Returns (entries of the data file, [body of mesh 1, body of mesh 2])."""
    entries, bodies = {}, []
    for k, (vertices, tets) in enumerate(MESHES, start=1):
        faces = np.array(boundary_triangles(tets), np.int64)
        vertices, tets = np.array(vertices, np.float64), np.array(tets, np.int64)
        entries |= {f"origVertices{k}": vertices, f"faces{k}": faces, f"tets{k}": tets}
        bodies.append(physics.make_body(exact(vertices), faces, tets, convention))
    return entries, bodies


def draw_numbers(generator, low, high, count):
    """Doubles (count,) as exact numbers, uniform between low and high."""
    # Python's arithmetic, because NumPy may fuse multiplication and addition on some processors.
    return exact([low + (high - low) * u for u in generator.random(count).tolist()])


def draw_state(generator, sample, radius, body):
    """The body in a random state of doubles, with its position in a ball about the origin."""
    position = draw_numbers(generator, -radius, radius, 3)
    while position @ position > radius * radius:
        position = draw_numbers(generator, -radius, radius, 3)
    orientation = exact(unit(draw_numbers(generator, -1.0, 1.0, 4)).astype(float))
    speed = 0.0 if sample % REST_INTERVAL == REST_INTERVAL - 1 else LARGEST_SPEED
    velocities = (draw_numbers(generator, -speed, speed, 3) for _ in range(2))
    state = (position, orientation, *velocities)
    return replace(body, **dict(zip(ATTRIBUTES, state, strict=True)))


def normalised(body):
    """The body with its rounded orientation normalised again, as Mesh does."""
    return replace(body, orientation=unit(body.orientation))


def to_array(bodies, attribute):
    """An attribute of n bodies (n, width), rounded to doubles."""
    return np.array([getattr(body, attribute) for body in bodies]).astype(float)


def to_pair(bodyPairs, attribute):
    """An attribute of n pairs of bodies: arrays (n, width) for mesh 1 and mesh 2."""
    return [to_array(bodies, attribute) for bodies in zip(*bodyPairs, strict=True)]


def state_entries(prefix, bodies):
    return {prefix + key: to_array(bodies, attribute) for key, attribute in STATE.items()}


def make_integration_data(convention):
    """Returns the contents of integration.data."""
    generator = np.random.Generator(np.random.PCG64(1))
    body = make_meshes(convention)[1][0]  # the results do not depend on its shape
    drawn = [draw_state(generator, k, POSITION_RADIUS, body) for k in range(SAMPLE_COUNT)]
    integrated = [physics.integrate(normalised(body), TIME_STEP) for body in drawn]
    results = state_entries("result", integrated)
    if convention == RELEASED_2024:
        # Quirk 3 of the contract: only sample 0 has a result.
        for array in results.values():
            array[1:] = 0.0
    return state_entries("random", drawn) | results


def make_collision_data(convention):
    """Returns the contents of collision-resolution.data.

    The contact is rounded to doubles first and resolved as rounded, because the grader passes these
    numbers to resolve_collision. Its entries are zero if the bodies do not collide.
    """
    generator = np.random.Generator(np.random.PCG64(2))
    meshEntries, (body1, body2) = make_meshes(convention)
    contacts = np.zeros((SAMPLE_COUNT, 7))
    drawn, resolved = [], []
    for sample in range(SAMPLE_COUNT):
        drawn.append(draw_state(generator, sample, COLLISION_RADIUS, body2))
        bodies = body1, normalised(drawn[-1])
        contact = physics.detect_collision(*bodies)
        if contact is not None:
            contacts[sample] = contact
            bodies = physics.resolve_collision(bodies, exact(contacts[sample]), RESTITUTION)
        resolved.append(bodies)
    return {
        **meshEntries,
        **state_entries("random", drawn),
        "isCollision": contacts[:, 0] > 0.0,
        "depth": contacts[:, 0].copy(),
        "intNormal": contacts[:, 1:4].copy(),
        "intPosition": contacts[:, 4:].copy(),
        **{f"result{key}": to_pair(resolved, attribute) for key, attribute in STATE.items()},
    }


def make_constraint_data(convention):
    """Returns the contents of constraint-resolution.data.

    Both ends of the constraint are rest vertex 0 of mesh 1, carried along by either body. A bound
    is the product of its factor and the reference value in double precision, because the grader
    passes that product to resolve_position_constraint.
    """
    generator = np.random.Generator(np.random.PCG64(3))
    meshEntries, (body1, body2) = make_meshes(convention)
    drawn, refValues, results = [], [], []
    for sample in range(SAMPLE_COUNT):
        drawn.append(draw_state(generator, sample, POSITION_RADIUS, body2))
        refValues.append(draw_numbers(generator, *REFERENCE_LENGTHS, 1).astype(float))
        bodies = body1, normalised(drawn[-1])
        points = [body.carry(body1.vertices[0]) for body in bodies]
        upper, lower = (exact(factor * refValues[-1][0]) for factor in (UPPER_FACTOR, LOWER_FACTOR))
        given, tolerance = (bodies, points), POSITION_TOLERANCE
        results.append(
            (
                *physics.resolve_position_constraint(*given, upper, True, tolerance),
                *physics.resolve_position_constraint(*given, lower, False, tolerance),
                *physics.resolve_velocity_constraint(*given, VELOCITY_TOLERANCE),
            )
        )
    upperValid, uppers, lowerValid, lowers, velocityValid, pairs = zip(*results, strict=True)
    return {
        **meshEntries,
        **state_entries("random", drawn),
        "refValues": np.array(refValues),
        "positionWasValidUpper": np.array(upperValid),
        "correctedPositionsUpper": to_pair(uppers, "position"),
        "positionWasValidLower": np.array(lowerValid),
        "correctedPositionsLower": to_pair(lowers, "position"),
        "velocityWasValid": np.array(velocityValid),
        "correctedLinVelocities": to_pair(pairs, "linVelocity"),
        "correctedAngVelocities": to_pair(pairs, "angVelocity"),
    }


def make_reference(directory, convention=EXACT):
    """Writes the three files into a folder, which is made if it is missing.

    They are pickles that NumPy 1 and 2 both read, the same bytes from either. For the function that
    rebuilds an array, NumPy 2 writes a module name that NumPy before 1.26 does not know; the old
    name serves all. Protocol 3 stores names as lines without lengths, so one can be replaced.
    """
    directory.mkdir(parents=True, exist_ok=True)
    makers = make_integration_data, make_collision_data, make_constraint_data
    names = "integration", "collision-resolution", "constraint-resolution"
    for name, make in zip(names, makers, strict=True):
        payload = pickle.dumps(make(convention), protocol=3)
        payload = payload.replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n")
        (directory / f"{name}.data").write_bytes(payload)


def main():
    """Writes the files that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    text = "folder to write to (default: the project's data)"
    parser.add_argument("--out", metavar="DIR", type=Path, default=DATA_DIRECTORY, help=text)
    text = "physics behind the data (default: %(default)s)"
    parser.add_argument("--convention", choices=CONVENTIONS, default=EXACT, help=text)
    arguments = parser.parse_args()
    try:
        make_reference(arguments.out, arguments.convention)
    except OSError as problem:
        parser.exit(2, f"{parser.prog}: {arguments.out}: {problem.strerror}\n")
    print(f"wrote three files to {arguments.out}")


if __name__ == "__main__":
    main()
