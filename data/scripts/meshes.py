"""The project's own meshes: convex polyhedra, filled with tetrahedra.

Units: metres. Lengths are near those of the coursework's meshes, so that scenes can be adapted.
"""

import itertools
import math

import numpy as np

# Decimals of coordinates in metres. More would let the last bits of a C library's sines reach the
# files; fewer would move vertices noticeably towards the planes of other faces.
COORDINATE_DECIMALS = 9

# A mesh is a tuple (vertices, faces, tets): (V, 3) float coordinates in metres, and lists
# of (a, b, c) and (a, b, c, d) zero-based vertex indices. Faces are counter-clockwise seen from
# outside; tetrahedra have det(b - a, c - a, d - a) > 0.


def fill_convex(vertices, polygons):
    """Make a mesh of a convex polyhedron, without adding a vertex.

    Every polygon is cut into a fan from its vertex of lowest index. So vertex 0 lies behind all
    triangles without it, and tetrahedra join these to vertex 0.
    vertices : (V, 3), metres; polygons : lists of indices, counter-clockwise seen from outside
    """
    faces = []
    for polygon in polygons:
        start = polygon.index(min(polygon))
        apex, *rim = polygon[start:] + polygon[:start]
        faces += [(apex, a, b) for a, b in itertools.pairwise(rim)]
    tets = [(0, *face) for face in faces if 0 not in face]
    # Adding 0.0 turns -0.0 into 0.0.
    return np.round(vertices, COORDINATE_DECIMALS) + 0.0, faces, tets


def make_tetrahedron(width, height, depth):
    """Four alternate corners of a box with one corner at the origin; sizes in metres.

    Unlike the other meshes, it needs to be shifted to its centre of mass.
    """
    vertices = [[width, height, depth], [0, height, 0], [width, 0, 0], [0, 0, depth]]
    return fill_convex(vertices, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


# The sides of a hexahedron: -x, +x, -y, +y, -z and +z.
SIDES = [[*map(int, side)] for side in "0132 4675 0451 2376 0264 1573".split()]


def make_hexahedron(corners):
    """Eight corners with six flat faces, in the order of a box: 4 (x > 0) + 2 (y > 0) + (z > 0)."""
    return fill_convex(corners, SIDES)


def make_box(width, height, depth):
    """A box centred on the origin; sizes along x, y, z in metres."""
    corners = np.array(list(itertools.product([-0.5, 0.5], repeat=3))) * [width, height, depth]
    return make_hexahedron(corners)


def make_voussoir(count, inner, outer, width):
    """One of `count` equal wedges of an arch, at the position of the keystone.

    The arch is half a ring about the z axis, with radii inner and outer; sizes in metres.
    """
    half = math.pi / (2 * count)
    corners = itertools.product((-1, 1), (inner, outer), (-width / 2, width / 2))
    return make_hexahedron(
        [(side * r * math.sin(half), r * math.cos(half), z) for side, r, z in corners]
    )


def make_wedge(profile, slope):
    """A block of a ring about the y axis, positioned on the x axis.

    profile : four corners (x, y), inner ones first, metres; its sides are at z = ± slope x
    """
    return make_hexahedron([(x, y, side * slope * x) for x, y in profile for side in (-1, 1)])


# The blocks of a tray are eighths of a ring. Half of one reaches to z = ± x tan(π/8) = ± 0.41421 x.
# 53/128 = 0.41406 leaves joints of at most 1 cm, and corners that nine decimals represent exactly.
TRAY_BLOCKS, TRAY_SLOPE = 8, 53 / 128
# The lower and the upper corner of its inner side, and of its outer side.
TRAY_PROFILE = ((22.0, -3.0), (23.0, 3.0), (26.0, -3.0), (26.0, 3.0))


def make_octahedron(a, b, c):
    """An octahedron with its tips on the axes, at ±a, ±b and ±c metres."""
    vertices = [[a, 0, 0], [0, b, 0], [-a, 0, 0], [0, -b, 0], [0, 0, c], [0, 0, -c]]
    equator = list(itertools.pairwise([0, 1, 2, 3, 0]))
    return fill_convex(vertices, [[i, j, 4] for i, j in equator] + [[j, i, 5] for i, j in equator])


def make_cylinder(radius, length, sides):
    """A right prism along z on a regular polygon of `sides` corners; sizes in metres.

    If the number of sides is a multiple of four, one side faces straight down.
    """
    angles = [2 * math.pi * (i + 0.5) / sides for i in range(sides)]
    corners = [(radius * math.cos(angle), radius * math.sin(angle)) for angle in angles]
    vertices = [[x, y, z] for z in (-length / 2, length / 2) for x, y in corners]
    bottom, top = list(range(sides)), list(range(sides, 2 * sides))
    walls = [[i, j, j + sides, i + sides] for i, j in itertools.pairwise(bottom + [0])]
    return fill_convex(vertices, [bottom[::-1], top] + walls)


def make_icosahedron():
    """The regular icosahedron on the unit sphere: points (12, 3) and 20 outward triangles."""
    golden = (1 + math.sqrt(5)) / 2
    # The cyclic permutations of (0, ±1, ±golden) have edges of length 2.
    signs = list(itertools.product((-1, 1), (-golden, golden)))
    points = np.array([np.roll([0.0, y, z], shift) for shift in range(3) for y, z in signs])
    triangles = []
    for i, j, k in itertools.combinations(range(12), 3):
        edges = points[[i, j, k]] - points[[j, k, i]]
        if np.allclose(np.linalg.norm(edges, axis=1), 2):
            isOutward = np.linalg.det(points[[i, j, k]]) > 0
            triangles.append((i, j, k) if isOutward else (i, k, j))
    return points / math.hypot(1, golden), triangles


def subdivide(points, triangles):
    """Cut each triangle into four, with the midpoints of its edges lifted onto the unit sphere.

    points : (P, 3); triangles : list of (i, j, k). Returns both for the finer surface.
    """
    sides = [side for i, j, k in triangles for side in ((i, j), (j, k), (k, i))]
    edges = sorted({tuple(sorted(side)) for side in sides})
    middle = {}  # (i, j) and (j, i) -> index of the edge's midpoint
    for index, (i, j) in enumerate(edges, start=len(points)):
        middle[i, j] = middle[j, i] = index
    lifted = points[[i for i, _ in edges]] + points[[j for _, j in edges]]
    lifted /= np.linalg.norm(lifted, axis=1, keepdims=True)

    pieces = []
    for i, j, k in triangles:
        ij, jk, ki = middle[i, j], middle[j, k], middle[k, i]
        pieces += [(i, ij, ki), (j, jk, ij), (k, ki, jk), (ij, jk, ki)]
    return np.concatenate([points, lifted]), pieces


def make_ellipsoid(a, b, c, subdivisions):
    """An ellipsoid of 10 · 4ⁿ + 2 vertices with half-axes a, b, c in metres, n subdivisions."""
    points, triangles = make_icosahedron()
    for _ in range(subdivisions):
        points, triangles = subdivide(points, triangles)
    return fill_convex(points * [a, b, c], triangles)


# By name.
MESHES = {
    "tetrahedron": make_tetrahedron(8.0, 7.0, 6.0),
    "box": make_box(12.0, 6.0, 8.0),
    "octahedron": make_octahedron(3.4, 3.4, 3.4),
    "long-octahedron": make_octahedron(10.4, 10.4, 1.4),
    "cylinder": make_cylinder(radius=5.0, length=20.0, sides=20),
    "ellipsoid": make_ellipsoid(2.0, 3.0, 5.0, subdivisions=2),
    "ball": make_ellipsoid(6.0, 6.0, 6.0, subdivisions=1),
    "slab": make_box(48.0, 2.0, 14.0),
    "card": make_box(14.0, 0.4, 10.0),
    "voussoir": make_voussoir(15, 34.0, 42.0, 14.0),
    "tray_block": make_wedge(TRAY_PROFILE, TRAY_SLOPE),
}
