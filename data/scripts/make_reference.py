"""Write the project's grader data: random states, and the results of exact physics.

    python data/scripts/make_reference.py [--out DIR] [--convention exact|released-2024]

The three files have the keys and shapes of the coursework's own (see `reference.graderData`). The
random states are doubles, taken as exact numbers. The results have 50 digits and are rounded to
doubles at the end. More than thirty of the digits are beyond a double's, so a result is the double
nearest to the formula's true value, however its terms cancel. `--convention released-2024`
reproduces the quirks of the released data. Two runs write the same bytes.

Nothing is imported from RBSFunctions, GJK or Quaternion, so none of their errors is repeated here.
Vectors are NumPy arrays of mpmath's numbers, in world axes, in m, s and radians.
"""

import argparse
import pickle
import sys
from pathlib import Path

import numpy as np

try:
    from mpmath import mp
except ModuleNotFoundError:
    sys.exit("make_reference.py needs mpmath: pip install mpmath")

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "graders"))

from reference import rigidModel as model
from reference.graderData import (
    COLLISION_LAYOUT,
    CONSTRAINT_LAYOUT,
    CONVENTIONS,
    DATA_DIRECTORY,
    EXACT,
    INTEGRATION_LAYOUT,
    RELEASED_2024,
    WIDTHS,
)

from rbs.glass.model import multiply, unit

mp.dps = 50
# Converts numbers to 50 digits, doubles exactly.
exact = np.frompyfunc(mp.mpf, 1, 1)
cos, sinc = (np.frompyfunc(function, 1, 1) for function in (mp.cos, mp.sinc))
GRAVITY = exact(["0", "-9.8", "0"])
# Difference, in m, below which lengths are equal; their rounding errors are near 1e-48.
TIE = exact("1e-30")
# Least distance of a random sample, in m, from every decision (whether bodies collide, which
# direction is the shallowest), so that double precision decides alike. If an assertion fails,
# another seed is needed.
MARGIN = exact("1e-6")
SAMPLE_COUNT = 100

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


def integrate(position, orientation, linVelocity, angVelocity, timeStep):
    """Returns n states, arrays (n, w), after one step of semi-implicit Euler: velocity first.

    The angular velocity turns the body by |ω| h about ω: with v = ω h / 2, by the quaternion
    exp([0, v]) = [cos |v|, v sin |v| / |v|], from the left as ω is in world axes.
    """
    linVelocity = linVelocity + timeStep * GRAVITY
    v = timeStep / 2 * angVelocity
    angle = np.sqrt(np.sum(v * v, axis=1, keepdims=True))
    turned = multiply(np.hstack([cos(angle), sinc(angle) * v]), unit(orientation))
    return position + timeStep * linVelocity, turned, linVelocity, angVelocity


def detect_collision(hull1, faces1, hull2, faces2):
    """Returns the contact (7,) of two convex bodies, [depth, *normal, *point], or zeros.

    hull : (V, 3), world vertices of a body; faces : (F, 3), anticlockwise seen from outside
    depth > 0 is the distance that body 2 must move along the unit normal to separate; the point is
    that of body 2 deepest inside body 1, and point + depth normal is on body 1's surface.

    Moved by t along a unit direction d, body 2 clears body 1 once t reaches their overlap along d,
    max over 1 of a·d − min over 2 of b·d. Bodies are apart when some overlap is negative, and the
    penetration depth is the least overlap of all directions. That overlap is the distance from the
    origin to a supporting plane of the Minkowski difference, so the least one belongs to a face of
    the difference; and those faces come from faces of body 1, faces of body 2, or a pair of edges.
    """
    (normals1, edges1), (normals2, edges2) = _features(hull1, faces1), _features(hull2, faces2)
    crossed = np.cross(edges1[:, None], edges2).reshape(-1, 3)
    axes = unit(np.vstack([normals1, normals2, crossed]))
    heights1, heights2 = axes @ hull1.T, axes @ hull2.T
    along = heights1.max(axis=1) - heights2.min(axis=1)
    against = heights2.max(axis=1) - heights1.min(axis=1)
    directions, overlaps = np.vstack([axes, -axes]), np.concatenate([along, against])

    depth, normal = overlaps.min(), directions[overlaps.argmin()]
    assert abs(depth) > MARGIN, "the bodies only just touch"
    if depth < 0:
        return np.zeros(7)
    others = overlaps[directions @ normal < 1 - TIE]
    assert others.min() > depth + MARGIN, "two directions are equally shallow"
    return np.hstack([depth, normal, _deepest_point(hull1, hull2, depth, normal)])


def _features(hull, faces):
    """Outward face normals and edge vectors of a body, of any length.

    Of the two triangles at an edge, one runs along it towards the larger index. Diagonals of flat
    quadrilaterals count as edges, which does no harm: no direction's overlap is below the depth.
    """
    a, b, c = hull[faces.T]
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    edges = hull[end[start < end]] - hull[start[start < end]]
    return np.cross(b - a, c - a), edges


def _support_feature(hull, direction):
    """The vertices farthest along the direction: one, the ends of an edge, or those of a face."""
    heights = hull @ direction
    isFarthest = heights > heights.max() - TIE
    assert all(isFarthest | (heights < heights.max() - MARGIN)), "a vertex almost touches"
    return hull[isFarthest]


def _deepest_point(hull1, hull2, depth, normal):
    """The point of hull 2 that is deepest in hull 1, by the features that touch once apart.

    A vertex b of hull 2 against a face: b. A vertex a of hull 1 against a face: the point of that
    face which comes to lie on a, a − depth n. Two edges, a + s u and b + t w: the point of the
    second that comes to lie on the first, where a + s u = b' + t w with b' = b + depth n. The cross
    product with u leaves (b' − a) × u = t (u × w).
    """
    top, bottom = _support_feature(hull1, normal), _support_feature(hull2, -normal)
    if len(bottom) == 1:
        return bottom[0]
    if len(top) == 1:
        return top[0] - depth * normal
    (a, aEnd), (b, bEnd) = top, bottom
    u, w = aEnd - a, bEnd - b
    common = np.cross(u, w)
    t = np.cross(b + depth * normal - a, u) @ common / (common @ common)
    return b + t * w


def make_meshes():
    """Returns the entries of the data file for both meshes."""
    entries = {}
    for k, (vertices, tets) in enumerate(MESHES, start=1):
        triangles = {}  # by their corners, outwards
        for a, b, c, d in tets:
            for triangle in ((a, c, b), (a, b, d), (a, d, c), (b, c, d)):
                triangles.setdefault(frozenset(triangle), []).append(triangle)
        faces = [found[0] for found in triangles.values() if len(found) == 1]
        entries[f"origVertices{k}"] = np.array(vertices, np.float64)
        entries[f"faces{k}"] = np.array(faces, np.int64)
        entries[f"tets{k}"] = np.array(tets, np.int64)
    return entries


def draw_numbers(generator, low, high, count):
    """Doubles (count,) as exact numbers, uniform between low and high."""
    # Python's arithmetic, because NumPy may fuse multiplication and addition on some processors.
    return exact([low + (high - low) * u for u in generator.random(count).tolist()])


def draw_state(generator, sample, radius):
    """A random state of doubles, with the position in a ball about the origin."""
    position = draw_numbers(generator, -radius, radius, 3)
    while position @ position > radius * radius:
        position = draw_numbers(generator, -radius, radius, 3)
    (orientation,) = unit(draw_numbers(generator, -1.0, 1.0, 4)[None]).astype(float)
    speed = 0.0 if sample % REST_INTERVAL == REST_INTERVAL - 1 else LARGEST_SPEED
    velocities = (draw_numbers(generator, -speed, speed, 3) for _ in range(2))
    return position, exact(orientation), *velocities


def inputs_of(states, convention):
    """The data that `rigidModel` needs: random states, in exact numbers, and the solids."""
    columns = map(np.array, zip(*states, strict=True))
    data = {f"random{key}": column for key, column in zip(WIDTHS, columns, strict=True)}
    meshes = {key: exact(a) if a.dtype == float else a for key, a in make_meshes().items()}
    return data | {"solids": model.solids_of(meshes), "convention": convention}


def doubles(data, layout):
    """The entries of a file in doubles, except the meshes; results for two meshes are pairs."""
    entries = {}
    for key, (kind, *axes) in layout.items():
        if key in data:
            array = np.ascontiguousarray(data[key], dtype=bool if kind is bool else float)
            entries[key] = list(array) if axes[0] == 2 else array
    return entries


def make_integration_data(convention):
    """Returns the contents of integration.data."""
    generator = np.random.Generator(np.random.PCG64(1))
    states = [draw_state(generator, k, POSITION_RADIUS) for k in range(SAMPLE_COUNT)]
    data = inputs_of(states, convention)
    results = integrate(*(data[f"random{key}"] for key in WIDTHS), exact(model.TIME_STEP))
    for key, array in zip(WIDTHS, results, strict=True):
        data[f"result{key}"] = array.copy()
        if convention == RELEASED_2024:  # quirk 3: only sample 0 has a result
            data[f"result{key}"][1:] = 0.0
    return doubles(data, INTEGRATION_LAYOUT)


def make_collision_data(convention):
    """Returns the contents of collision-resolution.data.

    The contact is rounded to doubles first and resolved as rounded, because the grader passes these
    numbers to resolve_collision. Its entries are zero if the bodies do not collide.
    """
    generator = np.random.Generator(np.random.PCG64(2))
    states = [draw_state(generator, k, COLLISION_RADIUS) for k in range(SAMPLE_COUNT)]
    meshes, data = make_meshes(), inputs_of(states, convention)
    hulls = model.carried(data, data["randomPositions"], data["randomOrientations"])
    resting = data["solids"][1].vertices, meshes["faces1"]
    found = [detect_collision(*resting, hull.reshape(-1, 3), meshes["faces2"]) for hull in hulls]
    contacts = exact(np.array(found).astype(float))
    data |= {"isCollision": contacts[:, 0] > 0, "depth": contacts[:, 0]}
    data |= {"intNormal": contacts[:, 1:4], "intPosition": contacts[:, 4:]}
    return meshes | doubles(data | model.resolution(data), COLLISION_LAYOUT)


def make_constraint_data(convention):
    """Returns the contents of constraint-resolution.data.

    Both ends of the constraint are rest vertex 0 of mesh 1, carried along by either body. A bound
    is the product of its factor and the reference value in double precision, because the grader
    passes that product to resolve_position_constraint.
    """
    generator = np.random.Generator(np.random.PCG64(3))
    states, refValues = [], []
    for sample in range(SAMPLE_COUNT):
        states.append(draw_state(generator, sample, POSITION_RADIUS))
        refValues.append(draw_numbers(generator, *REFERENCE_LENGTHS, 1).astype(float))
    data = inputs_of(states, convention) | {"refValues": np.array(refValues)}
    data |= model.position_constraints(data) | model.velocity_constraints(data)
    return make_meshes() | doubles(data, CONSTRAINT_LAYOUT)


def make_reference(directory, convention=EXACT):
    """Writes the three files into a folder, which is made if it is missing.

    NumPy 2 writes a module name that NumPy before 1.26 does not know; the old name serves all.
    Protocol 3 stores names as lines without lengths, so one can be replaced.
    """
    directory.mkdir(parents=True, exist_ok=True)
    makers = make_integration_data, make_collision_data, make_constraint_data
    names = "integration", "collision-resolution", "constraint-resolution"
    for name, make in zip(names, makers, strict=True):
        payload = pickle.dumps(make(convention), protocol=3)
        payload = payload.replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n")
        (directory / f"{name}.data").write_bytes(payload)


def main():
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
