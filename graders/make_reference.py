"""Write the project's grader data: random states, and what exact physics makes of them.

    python graders/make_reference.py [--out DIR] [--convention exact|released-2024]

The three files have the keys and shapes of the coursework's own (contract, section 3). The results
come from `referencePhysics`, in fifty digits, and are rounded to double at the end. With
`--convention released-2024` they have the quirks of the released data instead, so that the graders
can be tried on data of that kind.

The random inputs are doubles, taken as exact numbers. Running twice writes the same bytes.
"""

import itertools
import pickle
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np
from decimalMath import ONE, ZERO, exact, extended_precision, normalised
from gradingTools import (
    BAD_DATA,
    DATA_DIRECTORY,
    EXACT,
    RELEASED_2024,
    OneLineParser,
    add_convention_argument,
)
from referencePhysics import (
    Body,
    Contact,
    NotGeneric,
    demand,
    detect_collision,
    integrate,
    make_solid,
    resolve_collision,
    resolve_position_constraint,
    resolve_velocity_constraint,
)

SAMPLE_COUNT = 100
SEEDS = {"integration": 1, "collision": 2, "constraint": 3}

TIME_STEP = Decimal(0.1)  # s; as the double 0.1 that the graders pass
RESTITUTION = Decimal(0.5)
UPPER_FACTOR = 1.2
LOWER_FACTOR = 0.8
POSITION_TOLERANCE = Decimal(1e-6)  # m
VELOCITY_TOLERANCE = Decimal(1e-5)  # m/s

LARGEST_SPEED = 10.0  # per component, in m/s and in rad/s
REST_INTERVAL = 10  # the last of every ten samples is at rest: no rotation, velocities valid

# The centres of mass of colliding bodies are drawn within this distance, in m, at which about half
# of the poses collide: the box reaches 3 to 8 m from its centre, the octahedron 2 to 8 m.
COLLISION_RADIUS = 11.5
POSITION_RADIUS = 20.0  # m, where only the state matters
REFERENCE_LENGTHS = (5.0, 30.0)  # m, between which a constraint's reference value is drawn

# A full set must exercise every branch: least and largest number of samples that take it.
COLLISION_COUNTS = (40, 70)
VIOLATION_COUNTS = (20, 80)

# Neither mesh has its centre of mass at the origin of its coordinates, nor a symmetry too many: a
# box of 12 × 6 × 8 m, and an octahedron with six different arms, in m, whose principal axes are
# oblique.
BOX_CORNERS = ((1.0, -2.0, 3.0), (13.0, 4.0, 11.0))
OCTAHEDRON_CENTRE = (2.0, -3.0, 1.0)
OCTAHEDRON_ARMS = ((2.0, 8.0), (7.0, 3.0), (3.0, 6.0))  # towards −x, +x; −y, +y; −z, +z


# ---- Meshes -------------------------------------------------------------------------------------


def make_box():
    """(vertices, tets) of the box: six tetrahedra around its long diagonal.

    Corner k lies at the upper end along x, y, z where bits 0, 1, 2 of k are set. Every path from
    corner 0 to corner 7 along three edges spans a tetrahedron; paths that take the axes in an odd
    order span it inside out, so two of its corners change places.
    """
    vertices = [tuple(BOX_CORNERS[k >> axis & 1][axis] for axis in range(3)) for k in range(8)]
    tets = []
    for x, y, z in itertools.permutations((1, 2, 4)):
        isOdd = (x, y, z) in ((2, 1, 4), (1, 4, 2), (4, 2, 1))
        middle = (x + y, x) if isOdd else (x, x + y)
        tets.append((0, *middle, 7))
    return vertices, tets


def make_octahedron():
    """(vertices, tets) of the octahedron: four tetrahedra around its z axis.

    Vertices 2 k and 2 k + 1 end the negative and the positive arm of axis k.
    """
    vertices = []
    for axis, (back, forth) in enumerate(OCTAHEDRON_ARMS):
        for offset in (-back, forth):
            vertex = list(OCTAHEDRON_CENTRE)
            vertex[axis] += offset
            vertices.append(tuple(vertex))
    waist = (1, 3, 0, 2)
    tets = [(4, 5, waist[k], waist[(k + 1) % 4]) for k in range(4)]
    return vertices, tets


def boundary_triangles(tets):
    """The outward triangles of tetrahedra that no other tetrahedron shares."""
    triangles = {}
    for a, b, c, d in tets:
        for triangle in ((a, c, b), (a, b, d), (a, d, c), (b, c, d)):
            triangles.setdefault(frozenset(triangle), []).append(triangle)
    return [found[0] for found in triangles.values() if len(found) == 1]


def make_meshes(convention):
    """(entries for the data file, [solid of mesh 1, solid of mesh 2])."""
    entries, solids = {}, []
    for k, (vertices, tets) in ((1, make_box()), (2, make_octahedron())):
        faces = boundary_triangles(tets)
        entries[f"origVertices{k}"] = np.array(vertices, dtype=np.float64)
        entries[f"faces{k}"] = np.array(faces, dtype=np.int64)
        entries[f"tets{k}"] = np.array(tets, dtype=np.int64)
        solids.append(make_solid([exact(vertex) for vertex in vertices], faces, tets, convention))
    return entries, solids


# ---- Random states ------------------------------------------------------------------------------


@dataclass(frozen=True)
class State:
    """A random state, as tuples of doubles: position, unit quaternion, velocities."""

    position: tuple
    orientation: tuple
    linVelocity: tuple
    angVelocity: tuple


def make_generator(name):
    """A generator whose stream is named in full, not left to NumPy's choice of a default."""
    return np.random.Generator(np.random.PCG64(SEEDS[name]))


def draw_numbers(generator, low, high, count):
    """A tuple of doubles, uniform between low and high.

    The arithmetic is Python's: NumPy's may fuse the multiplication and the addition, or not,
    depending on the processor.
    """
    return tuple(low + (high - low) * u for u in generator.random(count).tolist())


def draw_state(generator, index, radius):
    """A State whose position is uniform in a ball about the origin; sample `index` of its set."""
    position = draw_numbers(generator, -radius, radius, 3)
    while sum(x * x for x in position) > radius * radius:
        position = draw_numbers(generator, -radius, radius, 3)
    orientation = normalised(exact(draw_numbers(generator, -1.0, 1.0, 4)))
    speed = 0.0 if index % REST_INTERVAL == REST_INTERVAL - 1 else LARGEST_SPEED
    return State(
        position,
        tuple(float(x) for x in orientation),
        draw_numbers(generator, -speed, speed, 3),
        draw_numbers(generator, -speed, speed, 3),
    )


def state_entries(states):
    return {
        "randomPositions": to_array([state.position for state in states]),
        "randomOrientations": to_array([state.orientation for state in states]),
        "randomLinVelocities": to_array([state.linVelocity for state in states]),
        "randomAngVelocities": to_array([state.angVelocity for state in states]),
    }


def body_in(state, solid):
    """The body of a State; the rounded orientation is made a unit quaternion again, as by Mesh."""
    return Body(
        solid,
        exact(state.position),
        normalised(exact(state.orientation)),
        exact(state.linVelocity),
        exact(state.angVelocity),
    )


def resting_body(solid):
    return Body(solid, (ZERO, ZERO, ZERO), (ONE, ZERO, ZERO, ZERO))


def to_array(rows):
    """Rows of Decimals or doubles, each rounded to the nearest double: (n, width).

    Adding zero makes −0 into 0: the sign of a normal's zero depends on which of two equal
    directions was met first, and means nothing.
    """
    return np.array([[float(x) + 0.0 for x in row] for row in rows], dtype=np.float64)


def to_pair(bodyPairs, attribute):
    """[mesh 1, mesh 2] of arrays (n, width): an attribute of n pairs of bodies."""
    return [to_array([getattr(pair[k], attribute) for pair in bodyPairs]) for k in (0, 1)]


# ---- The three data sets ------------------------------------------------------------------------


def make_integration_data(sampleCount=SAMPLE_COUNT, convention=EXACT):
    """The contents of integration.data; the first samples do not depend on how many there are."""
    generator = make_generator("integration")
    solid = make_meshes(convention)[1][0]  # its shape is of no account here
    states = [draw_state(generator, index, POSITION_RADIUS) for index in range(sampleCount)]
    bodies = [integrate(body_in(state, solid), TIME_STEP) for state in states]
    results = {
        "resultPositions": to_array([body.position for body in bodies]),
        "resultOrientations": to_array([body.orientation for body in bodies]),
        "resultLinVelocities": to_array([body.linVelocity for body in bodies]),
        "resultAngVelocities": to_array([body.angVelocity for body in bodies]),
    }
    if convention == RELEASED_2024:
        # Quirk 3 of the contract: only sample 0 has a result.
        for array in results.values():
            array[1:] = 0.0
    return state_entries(states) | results


def make_collision_data(sampleCount=SAMPLE_COUNT, convention=EXACT):
    """The contents of collision-resolution.data.

    The contact is rounded to doubles first, and resolved as rounded: those are the numbers that
    the grader hands to resolve_collision. Where there is no collision, its entries are zero.
    """
    generator = make_generator("collision")
    meshEntries, solids = make_meshes(convention)
    states, contactRows, resolved = [], [], []
    for index in range(sampleCount):
        states.append(draw_state(generator, index, COLLISION_RADIUS))
        bodies = resting_body(solids[0]), body_in(states[-1], solids[1])
        contact = detect_collision(*bodies)
        contactRow = (0.0,) * 7
        if contact is not None:
            numbers = (contact.depth, *contact.normal, *contact.point)
            contactRow = tuple(float(number) for number in numbers)
            depth, *vectors = exact(contactRow)
            rounded = Contact(depth, tuple(vectors[:3]), tuple(vectors[3:]))
            bodies = resolve_collision(*bodies, rounded, RESTITUTION)
        contactRows.append(contactRow)
        resolved.append(bodies)

    contacts = to_array(contactRows)
    return {
        **meshEntries,
        **state_entries(states),
        "isCollision": contacts[:, 0] > 0.0,
        "depth": contacts[:, 0].copy(),
        "intNormal": contacts[:, 1:4].copy(),
        "intPosition": contacts[:, 4:].copy(),
        "resultPositions": to_pair(resolved, "position"),
        "resultOrientations": to_pair(resolved, "orientation"),
        "resultLinVelocities": to_pair(resolved, "linVelocity"),
        "resultAngVelocities": to_pair(resolved, "angVelocity"),
    }


def make_constraint_data(sampleCount=SAMPLE_COUNT, convention=EXACT):
    """The contents of constraint-resolution.data.

    Both ends of the constraint are rest vertex 0 of mesh 1, carried along by either body. A bound
    is the product, in double precision, of its factor and the reference value: that product is what
    the grader hands to resolve_position_constraint.
    """
    generator = make_generator("constraint")
    meshEntries, solids = make_meshes(convention)
    states, refValues, uppers, lowers, velocities = [], [], [], [], []
    for index in range(sampleCount):
        states.append(draw_state(generator, index, POSITION_RADIUS))
        (refValue,) = draw_numbers(generator, *REFERENCE_LENGTHS, 1)
        refValues.append((refValue,))
        bodies = resting_body(solids[0]), body_in(states[-1], solids[1])
        points = tuple(body.carry(solids[0].vertices[0]) for body in bodies)
        for factor, isUpper, found in (
            (UPPER_FACTOR, True, uppers),
            (LOWER_FACTOR, False, lowers),
        ):
            bound = Decimal(factor * refValue)
            found.append(
                resolve_position_constraint(bodies, points, bound, isUpper, POSITION_TOLERANCE)
            )
        velocities.append(resolve_velocity_constraint(bodies, points, VELOCITY_TOLERANCE))

    (upperValid, upperPairs), (lowerValid, lowerPairs), (velocityValid, velocityPairs) = (
        zip(*found, strict=True) for found in (uppers, lowers, velocities)
    )
    return {
        **meshEntries,
        **state_entries(states),
        "refValues": to_array(refValues),
        "positionWasValidUpper": np.array(upperValid, dtype=np.bool_),
        "correctedPositionsUpper": to_pair(upperPairs, "position"),
        "positionWasValidLower": np.array(lowerValid, dtype=np.bool_),
        "correctedPositionsLower": to_pair(lowerPairs, "position"),
        "velocityWasValid": np.array(velocityValid, dtype=np.bool_),
        "correctedLinVelocities": to_pair(velocityPairs, "linVelocity"),
        "correctedAngVelocities": to_pair(velocityPairs, "angVelocity"),
    }


def checked_counts(collisionData, constraintData):
    """How many samples take each branch, as a line of text; NotGeneric where too few or many do."""
    counts = (
        ("collisions", collisionData["isCollision"], COLLISION_COUNTS),
        ("upper bounds violated", ~constraintData["positionWasValidUpper"], VIOLATION_COUNTS),
        ("lower bounds violated", ~constraintData["positionWasValidLower"], VIOLATION_COUNTS),
    )
    for name, flags, (least, largest) in counts:
        demand(least <= flags.sum() <= largest, f"{flags.sum()} {name}")
    return ", ".join(f"{flags.sum()} {name}" for name, flags, _ in counts)


# ---- Writing ------------------------------------------------------------------------------------


def write_pickle(path, data):
    """Write data as a pickle that NumPy 1 and 2 both read, the same bytes from either.

    NumPy 2 notes the function that rebuilds an array as numpy._core.multiarray._reconstruct, which
    NumPy before 1.26 does not have; its old name, numpy.core.multiarray._reconstruct, is kept by
    all. Protocol 3 stores names as lines without a length or a frame around them, so that the new
    name can be replaced by the old one in the finished pickle.
    """
    payload = pickle.dumps(data, protocol=3)
    payload = payload.replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n")
    path.write_bytes(payload)


def make_reference(directory, convention=EXACT):
    """Write the three files into a folder, made if need be; returns the line of counts."""
    with extended_precision():
        integrationData = make_integration_data(convention=convention)
        collisionData = make_collision_data(convention=convention)
        constraintData = make_constraint_data(convention=convention)
    counts = checked_counts(collisionData, constraintData)
    directory.mkdir(parents=True, exist_ok=True)
    write_pickle(directory / "integration.data", integrationData)
    write_pickle(directory / "collision-resolution.data", collisionData)
    write_pickle(directory / "constraint-resolution.data", constraintData)
    return counts


def main():
    parser = OneLineParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        default=DATA_DIRECTORY,
        help="the folder to write to (default: the project's data)",
    )
    add_convention_argument(parser)
    arguments = parser.parse_args()
    try:
        counts = make_reference(arguments.out, arguments.convention)
    except NotGeneric as problem:
        parser.exit(1, f"{parser.prog}: {problem}; another seed is needed\n")
    except OSError as problem:
        parser.exit(BAD_DATA, f"{parser.prog}: {arguments.out}: {problem.strerror}\n")
    print(f"wrote three files to {arguments.out}: {counts} of {SAMPLE_COUNT} samples each")


if __name__ == "__main__":
    main()
