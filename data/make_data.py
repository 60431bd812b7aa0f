"""Write the project's own meshes and scenes: `python data/make_data.py [--out DIR]`.

Every file is written beside this script, or into DIR. The numbers depend only on this file, so all
machines write the same bytes.

Units: metres and kilograms. The y axis points up and the ground is the plane y = 0.
"""

import argparse
import itertools
import math
import random
from pathlib import Path
from typing import NamedTuple

import numpy as np

# Decimals of coordinates in metres. More would let the last bits of a C library's sines reach the
# files; fewer would move vertices noticeably towards the planes of other faces.
COORDINATE_DECIMALS = 9

# The reference number that MEDIT gives every vertex, triangle and tetrahedron, such as a material.
REFERENCE = 1


# ---------------------------------------------------------------------------------------------
# Meshes. A mesh is a tuple (vertices, faces, tets): (V, 3) float coordinates in metres, and lists
# of (a, b, c) and (a, b, c, d) zero-based vertex indices. Faces are counter-clockwise seen from
# outside; tetrahedra have det(b - a, c - a, d - a) > 0.
# ---------------------------------------------------------------------------------------------


def fill_convex(vertices, polygons):
    """Make a mesh of a convex polyhedron, without adding a vertex to it.

    Every polygon is cut into a fan from its vertex of lowest index. Then vertex 0 belongs to every
    triangle of the faces around it, and lies strictly behind the planes of all other triangles.
    Joining these to vertex 0 fills the body with tetrahedra of positive volume. Every vertex is a
    corner, which a contact or a constraint can use; an inner vertex would be useless.

    vertices : (V, 3), metres
    polygons : lists of vertex indices, counter-clockwise seen from outside
    Returns (vertices, faces, tets).
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

    Its faces are congruent, and its principal moments of inertia differ. Unlike the other meshes it
    is not centred on the origin, so that scenes with it need the shift to the centre of mass.
    """
    vertices = [[width, height, depth], [0, height, 0], [width, 0, 0], [0, 0, depth]]
    return fill_convex(vertices, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def make_hexahedron(corners):
    """Eight corners with six flat faces, in the order of a box: 4 (x > 0) + 2 (y > 0) + (z > 0)."""
    return fill_convex(
        corners,
        [
            [0, 1, 3, 2],
            [4, 6, 7, 5],  # -x, +x
            [0, 4, 5, 1],
            [2, 3, 7, 6],  # -y, +y
            [0, 2, 6, 4],
            [1, 5, 7, 3],
        ],
    )  # -z, +z


def make_box(width, height, depth):
    """A box centred on the origin; sizes along x, y, z in metres."""
    corners = np.array(list(itertools.product([-0.5, 0.5], repeat=3))) * [width, height, depth]
    return make_hexahedron(corners)


def make_voussoir(count, inner, outer, width):
    """One of `count` equal wedges of an arch, at the position of the keystone.

    The arch is half a ring about the z axis, with radii inner and outer; sizes in metres.
    """
    half = math.pi / (2 * count)
    return make_hexahedron(
        [
            (side * radius * math.sin(half), radius * math.cos(half), z)
            for side in (-1, 1)
            for radius in (inner, outer)
            for z in (-width / 2, width / 2)
        ]
    )


# One of eleven equal sectors about the y axis reaches to z = ± x tan(π/11) = ± 0.29363 x. A little
# less, 27/92 = 0.29348, leaves joints of at most 1 cm. Corners are multiples of 1/2⁹ (x of 92, z of
# 27 times that), which nine decimals represent exactly, so the sides are exactly flat.
DOME_SECTORS, DOME_GRID = 11, 1 / 2**9
DOME_INNER, DOME_OUTER = 30.0, 37.0  # radii, in metres
DOME_JOINTS = (0.0, 20.0, 40.0, 58.0, 74.0)  # degrees, between the rings


def make_dome_block(ring):
    """A block of a dome about the y axis, positioned on the x axis, between two joints."""
    corners = []
    for radius, joint in itertools.product((DOME_INNER, DOME_OUTER), DOME_JOINTS[ring : ring + 2]):
        angle = math.radians(joint)
        column = round(radius * math.cos(angle) / (92 * DOME_GRID))
        y = round(radius * math.sin(angle) / DOME_GRID)
        corners += [(92 * column, y, side * 27 * column) for side in (-1, 1)]
    return make_hexahedron(DOME_GRID * np.array(corners))


def make_ring_block(count, inner, outer, height):
    """One of `count` equal blocks of a low ring about the y axis, positioned on the x axis.

    inner, outer : distances of the middles of its sides from the axis, in metres
    """
    slope = math.tan(math.pi / count)
    return make_hexahedron(
        [
            (x, y, side * slope * x)
            for x in (inner, outer)
            for y in (-height / 2, height / 2)
            for side in (-1, 1)
        ]
    )


# The blocks of a tray are eighths of a ring. Half of one reaches to z = ± x tan(π/8) = ± 0.41421 x.
# 53/128 = 0.41406 leaves joints of at most 1 cm, and corners that nine decimals represent exactly.
TRAY_BLOCKS, TRAY_SLOPE, TRAY_HEIGHT = 8, 53 / 128, 6.0


def make_tray_block(foot, brim, outer, height):
    """A block of a low wall about the y axis, positioned on the x axis.

    foot, brim, outer : distances from the axis of its inner side at the bottom and at the top, and
        of its outer side, in metres
    """
    profile = [(foot, -height / 2), (brim, height / 2), (outer, -height / 2), (outer, height / 2)]
    return make_hexahedron([(x, y, side * TRAY_SLOPE * x) for x, y in profile for side in (-1, 1)])


def make_octahedron(a, b, c):
    """An octahedron with its tips on the axes, at ±a, ±b and ±c metres."""
    vertices = [[a, 0, 0], [0, b, 0], [-a, 0, 0], [0, -b, 0], [0, 0, c], [0, 0, -c]]
    equator = list(itertools.pairwise([0, 1, 2, 3, 0]))
    return fill_convex(vertices, [[i, j, 4] for i, j in equator] + [[j, i, 5] for i, j in equator])


def make_cylinder(radius, length, sides):
    """A right prism along z on a regular polygon of `sides` corners; sizes in metres.

    The corners are half a step away from the x axis. If the number of sides is a multiple of four,
    one side faces straight down, and an unrotated cylinder lies flat on the ground.
    """
    angles = [2 * math.pi * (i + 0.5) / sides for i in range(sides)]
    vertices = [
        [radius * math.cos(angle), radius * math.sin(angle), z]
        for z in (-length / 2, length / 2)
        for angle in angles
    ]
    bottom, top = list(range(sides)), list(range(sides, 2 * sides))
    walls = [[i, j, j + sides, i + sides] for i, j in itertools.pairwise(bottom + [0])]
    return fill_convex(vertices, [bottom[::-1], top] + walls)


def make_icosahedron():
    """The regular icosahedron on the unit sphere: points (12, 3) and 20 outward triangles."""
    golden = (1 + math.sqrt(5)) / 2
    # The cyclic permutations of (0, ±1, ±golden) have edges of length 2.
    points = np.array(
        [
            np.roll([0.0, y, z], shift)
            for shift in range(3)
            for y in (-1, 1)
            for z in (-golden, golden)
        ]
    )
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
    edges = sorted(
        {tuple(sorted(edge)) for i, j, k in triangles for edge in ((i, j), (j, k), (k, i))}
    )
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


# The sizes are near those of the coursework's meshes, so that scenes can be adapted.
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
    "ring_block": make_ring_block(6, 5.0, 11.0, 6.0),
    "tray_block": make_tray_block(foot=22.0, brim=23.0, outer=26.0, height=TRAY_HEIGHT),
    **{f"dome_block_{ring + 1}": make_dome_block(ring) for ring in range(4)},
}


# ---------------------------------------------------------------------------------------------
# Scenes. A scene is a list of bodies.
# ---------------------------------------------------------------------------------------------

# Orientations (w, x, y, z), normalised when a scene is loaded.
AS_MODELLED = (1.0, 0.0, 0.0, 0.0)
Z_TO_VERTICAL = (1.0, 1.0, 0.0, 0.0)  # 90° about x: a cylinder stands on its cap
QUARTER_YAW = (1.0, 0.0, 1.0, 0.0)  # 90° about y

# m, the height of a fixed post above the ground, too small to see. At 0, the post would touch the
# ground in every step.
POST_CLEARANCE = 0.1


class Body(NamedTuple):
    """One line of a scene file."""

    meshFile: str
    density: float  # kg / m³
    position: tuple  # centre of mass (x, y, z), metres
    orientation: tuple = AS_MODELLED  # (w, x, y, z), of any length except zero
    isFixed: bool = False


class Tie(NamedTuple):
    """One line of a constraint file: bounds of the distance between vertices of two bodies.

    The bounds are multiples of the distance at the start. A rope has the lower bound 0.
    """

    body1: int
    vertex1: int
    body2: int
    vertex2: int
    lower: float
    upper: float


def random_orientation(generator):
    """A random quaternion (w, x, y, z). `generator`: random.Random, equal on all versions."""
    return tuple(round(generator.uniform(-1.0, 1.0), 3) for _ in range(4))


def turn(orientation, vector):
    """Turn a (3,) vector by a quaternion q = (w, u): q v q⁻¹ = v + 2 u × (u × v + w v) / |q|²."""
    w, u = orientation[0], np.array(orientation[1:])
    return vector + 2 * np.cross(u, np.cross(u, vector) + w * vector) / (w * w + u @ u)


def make_posts(places):
    """Return fixed upright cylinders at `places`, a list of (x, z) in metres."""
    y = 10.0 + POST_CLEARANCE  # half the cylinder's length
    return [
        Body("cylinder.mesh", 4000.0, (x, y, z), Z_TO_VERTICAL, isFixed=True) for x, z in places
    ]


def single_tet():
    """A tilted tetrahedron falls, and starts to spin when it lands."""
    return [Body("tetrahedron.mesh", 60.0, (3.0, 28.0, -4.0), (1.0, 0.3, 0.0, 0.5))]


def single_box():
    """A box, read from a surface without tetrahedra, falls on a corner."""
    return [Body("box.off", 120.0, (0.0, 36.0, 0.0), (1.0, 0.2, 0.0, 0.3))]


def single_cylinder():
    """A cylinder falls far, onto the rim of a cap."""
    return [Body("cylinder.mesh", 120.0, (0.0, 80.0, 0.0), (1.0, 0.6, 0.3, 0.0))]


def two_cylinders():
    """A lying cylinder bounces off the ground into a skew one above it."""
    return [
        Body("cylinder.mesh", 120.0, (0.0, 22.0, 0.0)),
        Body("cylinder.mesh", 120.0, (4.0, 38.0, -3.0), (1.0, 0.0, 0.2, 0.0)),
    ]


def two_cylinders_ties():
    """Tie a corner of each cap to the same corner of the other cylinder, elastic by a fifth."""
    return [Tie(0, vertex, 1, vertex, 0.8, 1.2) for vertex in (0, 39)]


def tet_rain():
    """A square of 5 × 5 tetrahedra, which land in turn and bounce into each other."""
    generator = random.Random(25)
    # Less than a tetrahedron's largest diameter, 12.2, so that they push each other sideways.
    # Neighbours start at least 14 m apart in height; some diagonal ones only 6 m, but these are
    # 12.7 m apart along the ground.
    spacing = 9.0
    bodies = []
    for i, (row, column) in enumerate(itertools.product(range(-2, 3), repeat=2)):
        height = 12.0 + 2.0 * (7 * i % 25)
        bodies.append(
            Body(
                "tetrahedron.mesh",
                80.0,
                (spacing * column, height, spacing * row),
                random_orientation(generator),
            )
        )
    return bodies


def mixed_shapes():
    """One of each shape, and another box, fall onto each other in a tray and stay in it.

    The wall is low, but high enough for the default restitution. With restitution 1, they bounce
    over it.
    """
    bodies = [
        Body("long-octahedron.mesh", 60.0, (5.0, 33.0, 2.0), (1.0, 0.9, 0.0, 0.1)),
        Body("cylinder.mesh", 60.0, (-6.0, 12.0, -7.0), (1.0, 0.2, 0.0, 0.0)),
        Body("ellipsoid.mesh", 60.0, (-6.0, 35.0, -10.0), (1.0, 0.0, 1.0, 1.0)),
        Body("box.mesh", 60.0, (3.0, 17.0, 10.0), (1.0, 0.3, 0.0, 0.2)),
        Body("tetrahedron.mesh", 60.0, (-11.0, 38.0, 3.0), (1.0, 0.0, 0.5, 1.0)),
        Body("octahedron.mesh", 60.0, (9.0, 16.0, -1.0), (1.0, 0.0, 0.4, 0.2)),
        Body("box.mesh", 60.0, (-10.0, 25.0, 6.0), (1.0, 1.0, 0.0, 0.4)),
    ]
    rise = TRAY_HEIGHT / 2 + POST_CLEARANCE
    tray = [
        make_block("tray_block", 4000.0, 1, 360.0 * (i + 0.5) / TRAY_BLOCKS, rise)
        for i in range(TRAY_BLOCKS)
    ]
    return bodies + [block._replace(isFixed=True) for block in tray]


def tower():
    """A column of crosswise boxes, tetrahedra and octahedra collapses."""
    return [
        Body("box.mesh", 2400.0, (0.0, 8.0, 0.0)),
        Body("box.mesh", 1600.0, (0.0, 20.0, 0.0), QUARTER_YAW),
        Body("box.mesh", 800.0, (0.0, 32.0, 0.0)),
        Body("tetrahedron.mesh", 300.0, (0.0, 46.0, 0.0)),
        Body("tetrahedron.mesh", 200.0, (0.0, 60.0, 0.0), QUARTER_YAW),
        Body("tetrahedron.mesh", 100.0, (0.0, 74.0, 0.0)),
        Body("octahedron.mesh", 400.0, (0.0, 88.0, 0.0)),
        Body("octahedron.mesh", 800.0, (0.0, 102.0, 0.0)),
        Body("octahedron.mesh", 1200.0, (0.0, 116.0, 0.0)),
    ]


def stress():
    """25 assorted bodies fall onto 4 × 4 fixed posts."""
    generator = random.Random(41)
    shapes = [
        "box.mesh",
        "tetrahedron.mesh",
        "ellipsoid.mesh",
        "octahedron.mesh",
        "long-octahedron.mesh",
        "cylinder.mesh",
    ]
    bodies = make_posts(itertools.product((-63.0, -21.0, 21.0, 63.0), repeat=2))
    # A spacing of 28 puts 16 of the bodies about 7 m beside a post along x and z, so that most
    # graze it. It also keeps the bodies apart, as two radii add up to at most 22 m.
    for i, (column, row) in enumerate(itertools.product(range(-2, 3), repeat=2)):
        x, z = (round(28.0 * step + generator.uniform(-3.0, 3.0), 2) for step in (column, row))
        y = round(generator.uniform(42.0, 66.0), 2)
        bodies.append(
            Body(shapes[i % len(shapes)], 300.0, (x, y, z), random_orientation(generator))
        )
    return bodies


def cube():
    """Octahedra at the corners of a tilted cube, tied to each other."""
    edge, centre = 11.0, (0.0, 30.0, 0.0)
    tilt = (4.0, 1.0, 0.0, 1.0)
    bodies = []
    for corner in itertools.product((-edge / 2, edge / 2), repeat=3):
        position = np.round(centre + turn(tilt, np.array(corner)), 3)
        bodies.append(Body("octahedron.mesh", 900.0, tuple(position), tilt))
    return bodies


def cube_ties():
    """Tie every body to every other at its initial distance, so that the cube is rigid."""
    return [Tie(i, 0, k, 0, 1.0, 1.0) for i, k in itertools.combinations(range(8), 2)]


def tower_chain():
    """A leaning column on a fixed foot, each body tied to the one below.

    It buckles, falls past its foot and hangs from it, with its end on the ground.
    """
    shapes = 3 * ["box.mesh"] + 3 * ["tetrahedron.mesh"] + 3 * ["octahedron.mesh"]
    densities = [2400.0, 1800.0, 1200.0, 1500.0, 1000.0, 700.0, 600.0, 900.0, 1400.0]
    lean, rise = 1.5, 14.0  # metres from one body to the next, along x and y
    return [
        Body(shape, density, (lean * i, 70.0 + rise * i, 0.0), isFixed=i == 0)
        for i, (shape, density) in enumerate(zip(shapes, densities, strict=True))
    ]


def tower_chain_ties():
    """Tie each body to the next, elastic by a tenth."""
    return [Tie(i, 0, i + 1, 0, 0.9, 1.1) for i in range(8)]


def two_chains():
    """Two chains above an alley of fixed posts; small bodies fall onto one of them.

    Nine boxes hang straight down from the first; nine tetrahedra reach out sideways from the
    first, and swing down into the boxes. Neighbours are tied to each other.
    """
    height = 136.0
    hanging = [
        Body("box.mesh", 2000.0, (0.0, height - 13.5 * i, 0.0), isFixed=i == 0) for i in range(9)
    ]
    swinging = [
        Body("tetrahedron.mesh", 2500.0, (20.0 + 14.0 * i, height, 0.0), isFixed=i == 0)
        for i in range(9)
    ]
    posts = make_posts(itertools.product((-60.0, -20.0, 20.0, 60.0), (-18.0, 18.0)))
    shapes = 3 * ["octahedron.mesh", "ellipsoid.mesh"] + ["octahedron.mesh"]
    falling = [
        Body(shape, 1000.0, (24.0 + 15.0 * i, height + 16.0 + 4.0 * i, 0.0), (1.0, 0.3, 0.1, 0.2))
        for i, shape in enumerate(shapes)
    ]
    return hanging + swinging + posts + falling


def two_chains_ties():
    """Tie each body of a chain to the next, elastic by a tenth."""
    return [Tie(i, 0, i + 1, 0, 0.9, 1.1) for first in (0, 9) for i in range(first, first + 8)]


def rope_bridge():
    """Planks between two fixed abutments sag, and catch bodies that fall onto them."""
    height, pitch, planks = 40.0, 9.0, 13
    # after a quarter turn, a plank is 8 m along the bridge and 12 m across it
    deck = [
        Body(
            "box.mesh",
            500.0,
            (pitch * (i - (planks + 1) / 2), height, 0.0),
            QUARTER_YAW,
            isFixed=i in (0, planks + 1),
        )
        for i in range(planks + 2)
    ]
    falling = [
        Body("octahedron.mesh", 700.0, (-18.0, height + 18.0, 1.0), (1.0, 0.4, 0.0, 0.2)),
        Body("ellipsoid.mesh", 700.0, (5.0, height + 30.0, -1.0), (1.0, 0.0, 0.3, 0.8)),
        Body("box.mesh", 300.0, (24.0, height + 24.0, 0.0), (1.0, 0.2, 0.5, 0.1)),
    ]
    return deck + falling


def rope_bridge_ties():
    """Tie the lower corners of each plank to the facing corners of the next."""
    # The quarter turn takes z to x and x to -z. So corners with z > 0 face the next plank, and the
    # sign of x is the side of the bridge. A corner's index is 4 (x > 0) + 2 (y > 0) + (z > 0).
    return [Tie(i, side + 1, i + 1, side, 0.0, 1.2) for i in range(14) for side in (0, 4)]


NET_SIDE = 20  # bodies along each side of the net


def hanging_net():
    """A net of octahedra hangs at its corners, and three light bodies fall into it."""
    height, pitch = 90.0, 8.0
    places = list(itertools.product(range(NET_SIDE), repeat=2))
    corners = set(itertools.product((0, NET_SIDE - 1), repeat=2))
    middle = (NET_SIDE - 1) / 2
    net = [
        Body(
            "octahedron.mesh",
            200.0,
            (pitch * (i - middle), height, pitch * (k - middle)),
            isFixed=(i, k) in corners,
        )
        for i, k in places
    ]
    falling = [
        Body("ball.mesh", 6.0, (-20.0, height + 20.0, 8.0), (1.0, 0.3, 0.2, 0.0)),
        Body("cylinder.mesh", 5.0, (22.0, height + 26.0, -18.0), (1.0, 0.4, 0.3, 0.0)),
        Body("box.mesh", 10.0, (10.0, height + 34.0, 26.0), (1.0, 0.2, 0.5, 0.1)),
    ]
    return net + falling


def hanging_net_ties():
    """Tie each body's tips along x and z to the facing tips of its neighbours."""
    ties = []
    for i, k in itertools.product(range(NET_SIDE), repeat=2):
        here = NET_SIDE * i + k
        if i + 1 < NET_SIDE:
            ties.append(Tie(here, 0, here + NET_SIDE, 2, 0.0, 1.1))
        if k + 1 < NET_SIDE:
            ties.append(Tie(here, 4, here + 1, 5, 0.0, 1.1))
    return ties


CHAIN_LINKS = 5  # octahedra between the anchor and the ball


def make_chain_and_ball(anchor, orientation):
    """A chain on a fixed octahedron at `anchor`, with a ball at its end that is released.

    It swings towards +x, turned by the orientation.
    """
    pitch = 9.0
    slope = math.radians(25.0)  # of the chain, below the horizontal
    along = turn(orientation, np.array([-math.cos(slope), -math.sin(slope), 0.0]))
    chain = [
        Body(
            "octahedron.mesh",
            600.0,
            tuple(np.round(anchor + pitch * i * along, 3)),
            orientation,
            isFixed=i == 0,
        )
        for i in range(CHAIN_LINKS + 1)
    ]
    reach = pitch * CHAIN_LINKS + 11.0
    return [
        *chain,
        Body("ball.mesh", 2000.0, tuple(np.round(anchor + reach * along, 3)), orientation),
    ]


def wrecking_ball():
    """A ball on a chain is released beside a stack of boxes and swings into it."""
    plinth = Body("box.mesh", 1000.0, (14.0, 3.0, 0.0), QUARTER_YAW, isFixed=True)
    # Just above one another, because boxes in contact would be resolved in the first step.
    stack = [
        Body("box.mesh", 150.0, (14.0, 9.0 + 6.01 * i + 0.01, 0.0), QUARTER_YAW) for i in range(4)
    ]
    return [*make_chain_and_ball(np.array([0.0, 70.0, 0.0]), AS_MODELLED), plinth, *stack]


def wrecking_ball_ties():
    """Tie each link's tip at -x to the next one's at +x, and the last to the ball."""
    ballTip = int(np.argmax(MESHES["ball"][0][:, 0]))
    tips = [0] * CHAIN_LINKS + [ballTip]  # vertex 0 of an octahedron is its tip at +x
    return [Tie(i, 2, i + 1, tip, 0.0, 1.05) for i, tip in enumerate(tips)]


# Slopes descend towards +x: (n, 0, 0, -1) turns by -2 atan(1/n) about z.
GENTLE = (8.0, 0.0, 0.0, -1.0)  # 14.3°, the friction angle of μ = 16/63 = 0.25
STEEP = (4.0, 0.0, 0.0, -1.0)  # 28.1°, the friction angle of μ = 8/15 = 0.53
# A slab set upright across the slopes, its x along z and its z along y.
WALL = (1.0, -1.0, -1.0, -1.0)
# m, the initial height of a body above its slope, too small to see. Bodies in contact would be
# resolved before they have moved.
HAIR = 0.01
SLAB = np.ptp(MESHES["slab"][0], axis=0)  # its length, thickness and width


def slope_axes(tilt):
    """Return the unit vectors (3,) of a slope: downhill, and normal to it."""
    return (turn(tilt, axis) for axis in np.eye(3)[:2])


def make_slope(tilt, lane, meshFile, halfHeight, uphill):
    """A fixed slab with its lower end near the ground and its middle at z = lane, and a body on it.

    uphill : from the slab's middle to the body, metres. The body is turned like the slab.
    """
    downhill, normal = slope_axes(tilt)
    rise = POST_CLEARANCE - SLAB[0] / 2 * downhill[1] + SLAB[1] / 2 * normal[1]
    middle = np.array([0.0, rise, lane])
    place = middle - uphill * downhill + (SLAB[1] / 2 + halfHeight + HAIR) * normal
    return [
        Body("slab.mesh", 1000.0, tuple(np.round(middle, 6)), tilt, isFixed=True),
        Body(meshFile, 60.0, tuple(np.round(place, 6)), tilt),
    ]


def make_wall(x, z):
    """A fixed slab across the way, so that bodies stay in the picture."""
    return Body("slab.mesh", 1000.0, (x, SLAB[2] / 2 + POST_CLEARANCE, z), WALL, isFixed=True)


def incline():
    """Boxes on slopes of 14° and 28°. One stays, because μ = 0.4 has a friction angle of 22°."""
    return [
        *make_slope(STEEP, -10.0, "box.mesh", 3.0, 17.0),
        *make_slope(GENTLE, 10.0, "box.mesh", 3.0, 17.0),
    ]


def slide():
    """Boxes slide down chutes from three heights, and reach the ground at three speeds.

    With μ = 0.2 they stop one behind the other. With more friction they stop on the chute; with
    less they reach the wall.
    """
    slabs, boxes = [], []
    lanes = {2: -15.0, 3: 0.0, 5: 15.0}  # slope of a box's first slab -> its z, in metres
    edge = None  # the edge between the upper sides of two slabs
    for n in (10, 5, 3, 2):  # from below: 11°, 23°, 37° and 53°
        tilt = (float(n), 0.0, 0.0, -1.0)
        downhill, normal = slope_axes(tilt)
        if edge is None:
            edge = np.array([0.0, POST_CLEARANCE + SLAB[1] * normal[1], 0.0])
        middle = edge - (HAIR + SLAB[2] / 2) * downhill
        edge = middle - SLAB[2] / 2 * downhill
        # A quarter turn about y lays the slab across, and then the tilt follows: (n, 1, n, -1).
        slabs.append(
            Body(
                "slab.mesh",
                1000.0,
                tuple(np.round(middle - SLAB[1] / 2 * normal, 6)),
                (float(n), 1.0, float(n), -1.0),
                isFixed=True,
            )
        )
        if n in lanes:
            place = middle + (3.0 + HAIR) * normal + [0.0, 0.0, lanes[n]]
            boxes.append(Body("box.mesh", 60.0, tuple(np.round(place, 6)), tilt))
    return [*slabs, make_wall(60.0, 0.0), *boxes]


def roll():
    """A cylinder, a ball and an ellipsoid slide down slopes, unless friction makes them roll."""
    return [
        *make_slope(STEEP, -20.0, "cylinder.mesh", 5.0, 17.0),
        *make_slope(STEEP, 0.0, "ball.mesh", 6.0, 17.0),
        *make_slope(STEEP, 16.0, "ellipsoid.mesh", 3.0, 17.0),
        make_wall(60.0, -2.0),
    ]


def settle():
    """Boxes that land on a corner or on a post's rim start to spin, and come to rest."""
    return [
        *make_posts([(0.0, 0.0)]),
        Body("box.mesh", 60.0, (3.0, 32.0, -4.0)),
        Body("box.mesh", 120.0, (-26.0, 18.0, 4.0), (1.0, 0.3, 0.1, 0.4)),
        Body("box.mesh", 240.0, (24.0, 18.0, 4.0), (1.0, -0.2, 0.5, 0.3)),
    ]


# m, the initial joints between the blocks of a structure.
JOINT = 0.001


def stack():
    """Twenty boxes on top of each other. They only stand with the soft-step solver."""
    return [
        Body("box.mesh", 60.0, (0.0, round(3.0 + JOINT + i * (6.0 + JOINT), 6), 0.0))
        for i in range(20)
    ]


def pyramid():
    """Boxes in fifteen rows, each standing on two of the row below."""
    return [
        Body(
            "box.mesh",
            60.0,
            (12.5 * (column - (14 - row) / 2), round(3.0 + JOINT + row * (6.0 + JOINT), 6), 0.0),
        )
        for row in range(15)
        for column in range(15 - row)
    ]


def dominoes():
    """Slabs on end in a row, the first one leaning. With friction, they fall in turn."""
    upright = (1.0, 0.0, 0.0, 1.0)  # 90° about z
    leaning = (1.0, 0.0, 0.0, 0.8)  # 77°
    return [
        Body("slab.mesh", 60.0, (-90.0, 26.0, 0.0), leaning),
        *(
            Body("slab.mesh", 60.0, (-60.0 + 22.0 * i, round(24.0 + JOINT, 6), 0.0), upright)
            for i in range(9)
        ),
    ]


def centre_of_mass(mesh):
    """Return the centre of mass (3,) of a mesh, a tuple as in MESHES."""
    vertices, _, tets = mesh
    corners = vertices[tets]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1])
    return np.average(corners.mean(axis=1), axis=0, weights=volumes)


# Wedges are modelled at one position about the axis of their structure, and are turned about it to
# the others.


def make_block(name, density, axis, degrees, rise=0.0, away=(0.0, 0.0, 0.0)):
    """A body with a mesh of MESHES, turned about an axis through the origin.

    axis : 1 (y) or 2 (z); rise : metres; away : (3,), shift before the rotation
    """
    half = math.radians(degrees) / 2
    orientation = [round(math.cos(half), COORDINATE_DECIMALS), 0.0, 0.0, 0.0]
    orientation[1 + axis] = round(math.sin(half), COORDINATE_DECIMALS)
    place = turn(orientation, centre_of_mass(MESHES[name]) + away) + [0.0, rise, 0.0]
    return Body(f"{name}.mesh", density, tuple(np.round(place, 6)), tuple(orientation))


def make_arch(name, count):
    """Half a ring of `count` wedges about the z axis, its ends on the ground."""
    degrees = [180.0 * ((count - 1) / 2 - i) / count for i in range(count)]
    return [make_block(name, 60.0, 2, angle, JOINT, (0.0, 5 * JOINT, 0.0)) for angle in degrees]


def arch():
    """Fifteen wedges stand as an arch, held up only by their weight."""
    return make_arch("voussoir", 15)


def arch_blow():
    """A heavy ball falls onto the shoulder of an arch."""
    return [*make_arch("voussoir", 15), Body("ball.mesh", 2000.0, (20.0, 75.0, 0.0))]


def dome():
    """Four rings of eleven wedges hold each other around an open eye."""
    return [
        make_block(f"dome_block_{ring + 1}", 60.0, 1, 360.0 * i / DOME_SECTORS, (ring + 1) * JOINT)
        for ring in range(4)
        for i in range(DOME_SECTORS)
    ]


def round_tower():
    """Eleven rings of six blocks, each across the joints of the ring below, and a ball on top."""
    blocks = [
        make_block(
            "ring_block",
            60.0,
            1,
            60.0 * i + 30.0 * (row % 2),
            3.0 + JOINT + row * (6.0 + JOINT),
            (JOINT, 0.0, 0.0),
        )
        for row in range(11)
        for i in range(6)
    ]
    return [*blocks, Body("ball.mesh", 20.0, (0.0, 70.5, 0.0))]


CARD = np.ptp(MESHES["card"][0], axis=0)  # its length, thickness and width
CARD_TILT = 68.0  # degrees from the ground


def card_house():
    """Pairs of leaning cards in three storeys: three pairs, two, and one."""
    length, thickness, _ = CARD
    half = math.radians(CARD_TILT) / 2
    angle = 2 * half
    # offsets of a leaning card's lowest corner from its middle, down and across
    drop = length / 2 * math.sin(angle) + thickness / 2 * math.cos(angle)
    reach = length / 2 * math.cos(angle) + thickness / 2 * math.sin(angle)
    pitch = 12.0  # from pair to pair
    bodies, floor = [], 0.0
    for pairs in (3, 2, 1):
        middles = [pitch * (i - (pairs - 1) / 2) for i in range(pairs)]
        for middle, side in itertools.product(middles, (-1, 1)):
            place = middle + side * (reach + JOINT / 2), floor + drop + JOINT, 0.0
            turned = (math.cos(half), 0.0, 0.0, -side * math.sin(half))
            bodies.append(
                Body(
                    "card.mesh",
                    60.0,
                    tuple(np.round(place, 6)),
                    tuple(np.round(turned, COORDINATE_DECIMALS)),
                )
            )
        floor += 2 * drop + JOINT
        for left, right in itertools.pairwise(middles):
            # outwards from the middle of the house, over the pairs at the ends
            outwards = np.sign(left + right) or 0.0
            place = (left + right) / 2 + outwards * (length - pitch) / 2
            place += outwards * JOINT
            bodies.append(
                Body(
                    "card.mesh",
                    60.0,
                    tuple(np.round((place, floor + JOINT + thickness / 2, 0.0), 6)),
                )
            )
        floor += thickness + JOINT
    return bodies


def wall():
    """A ball on a chain swings into a wall of bricks."""
    bricks = [
        Body(
            "box.mesh",
            60.0,
            (
                round((12.0 + JOINT) * (i - (6 - row % 2) / 2), 6),
                round(3.0 + JOINT + row * (6.0 + JOINT), 6),
                0.0,
            ),
        )
        for row in range(8)
        for i in range(7 - row % 2)
    ]
    return [*make_chain_and_ball(np.array([0.0, 80.0, 10.0]), QUARTER_YAW), *bricks]


def ramp():
    """Boxes on slopes of 26° and 28°. One stays, as μ = 0.5 has a friction angle of 26.6°."""
    tilts = [
        (round(1 / math.tan(math.radians(angle / 2)), 6), 0.0, 0.0, -1.0) for angle in (26.0, 28.0)
    ]
    return [
        *make_slope(tilts[0], -10.0, "box.mesh", 3.0, 12.0),
        *make_slope(tilts[1], 10.0, "box.mesh", 3.0, 12.0),
    ]


CRADLE_BALLS = 5
# m between the balls. They must hit one after the other, because balls that meet within one step
# move on together.
CRADLE_GAP = 0.4


def middle_of_a_face(mesh):
    """Return the middle (3,) of the face across z = 0 with y > 0 that is furthest along x."""
    vertices, faces, _ = mesh
    middles = vertices[np.array(faces)].mean(axis=1)
    isFlat = (np.abs(middles[:, 2]) < 1e-6) & (middles[:, 1] > 0.0)
    return max(middles[isFlat], key=lambda middle: middle[0])


def cradle():
    """Newton's cradle: five balls side by side on two strings each. One of them is released.

    The strings hold the ends of a ball's axis along z, and no force turns it about this axis.
    """
    height, length, angle = 70.0, 50.0, math.radians(40.0)
    # a turn about z points two faces of each ball along ± x, squarely at its neighbours
    x, y, _ = middle_of_a_face(MESHES["ball"])
    half = -math.atan2(y, x) / 2
    forward = tuple(np.round((math.cos(half), 0.0, 0.0, math.sin(half)), COORDINATE_DECIMALS))
    pitch = 2 * math.hypot(x, y) + CRADLE_GAP
    balls, hooks = [], []
    for i in range(CRADLE_BALLS):
        x = pitch * (i - (CRADLE_BALLS - 1) / 2)
        swing = angle if i == 0 else 0.0
        place = x - length * math.sin(swing), height - length * math.cos(swing), 0.0
        balls.append(Body("ball.mesh", 60.0, tuple(np.round(place, 6)), forward))
        hooks += [
            Body("octahedron.mesh", 60.0, (round(x, 6), height, z), isFixed=True)
            for z in (-20.0, 20.0)
        ]
    return balls + hooks


def cradle_ties():
    """Tie the ends of each ball's axis along z to the inner tips of its hooks."""
    z = MESHES["ball"][0][:, 2]
    return [
        Tie(i, int(ballEnd), CRADLE_BALLS + 2 * i + side, tip, 0.0, 1.0)
        for i in range(CRADLE_BALLS)
        for side, (ballEnd, tip) in enumerate([(z.argmin(), 4), (z.argmax(), 5)])
    ]


def loaded_bridge():
    """Boxes and cylinders come to rest on the rope bridge."""
    deck = rope_bridge()[:15]
    loads = [Body("box.mesh", 300.0, (-27.0 + 18.0 * i, 56.0, 0.0), QUARTER_YAW) for i in range(4)]
    loads += [
        Body("cylinder.mesh", 60.0, (-18.0 + 18.0 * i, 80.0, 0.0), Z_TO_VERTICAL) for i in range(3)
    ]
    return deck + loads


def loaded_net():
    """Eighteen bodies, too large for its mesh, fall into the net."""
    generator = random.Random(17)
    net = hanging_net()[: NET_SIDE**2]
    shapes = ["box.mesh", "ball.mesh", "cylinder.mesh"]
    heap = [
        Body(
            shapes[(row + column + layer) % 3],
            10.0,
            (24.0 * column, 108.0 + 24.0 * layer, 24.0 * row),
            random_orientation(generator),
        )
        for layer in range(2)
        for row in (-1, 0, 1)
        for column in (-1, 0, 1)
    ]
    return net + heap


SCENES = {
    "singletet": single_tet,
    "singlebox": single_box,
    "single_cylinder": single_cylinder,
    "two_cylinder": two_cylinders,
    "tet": tet_rain,
    "mixed": mixed_shapes,
    "tower": tower,
    "stress": stress,
    "cube": cube,
    "tower_chain": tower_chain,
    "two_chain": two_chains,
    "bridge": rope_bridge,
    "net": hanging_net,
    "wrecking_ball": wrecking_ball,
    "incline": incline,
    "slide": slide,
    "roll": roll,
    "settle": settle,
    "stack": stack,
    "pyramid": pyramid,
    "dominoes": dominoes,
    "arch": arch,
    "arch_blow": arch_blow,
    "dome": dome,
    "round_tower": round_tower,
    "card_house": card_house,
    "wall": wall,
    "ramp": ramp,
    "cradle": cradle,
    "loaded_bridge": loaded_bridge,
    "loaded_net": loaded_net,
}

# Settings with which structures and piles rest; see rbs/softstep/step.py.
RESTING = "solver soft-step friction 0.5 restitution 0"
# Recommended settings, by scene, written as a comment in its file.
SUGGESTIONS = {
    "incline": "friction 0.4",
    "slide": "friction 0.2",
    "roll": "friction 0.4",
    "settle": "friction 0.4",
    **dict.fromkeys(
        [
            "stack",
            "pyramid",
            "dominoes",
            "arch",
            "arch_blow",
            "dome",
            "round_tower",
            "card_house",
            "wall",
            "ramp",
            "loaded_bridge",
            "loaded_net",
        ],
        RESTING,
    ),
    "cradle": "solver soft-step restitution 1",
}

# Functions that return the constraints, by scene.
TIES = {
    "two_cylinder": two_cylinders_ties,
    "cube": cube_ties,
    "tower_chain": tower_chain_ties,
    "two_chain": two_chains_ties,
    "bridge": rope_bridge_ties,
    "net": hanging_net_ties,
    "wrecking_ball": wrecking_ball_ties,
    "wall": wrecking_ball_ties,
    "cradle": cradle_ties,
    "loaded_bridge": rope_bridge_ties,
    "loaded_net": hanging_net_ties,
}


# ---------------------------------------------------------------------------------------------
# Files
# ---------------------------------------------------------------------------------------------


def format_numbers(values):
    """Return the shortest text that reads back as the same doubles."""
    return " ".join(repr(float(value)) for value in values)


def write_lines(path, lines):
    """Write lines of text, with line feeds on every system."""
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


def write_mesh(path, vertices, faces, tets):
    """Write a mesh as MEDIT text: one-based indices, a reference number after each row."""
    lines = ["MeshVersionFormatted 1", "Dimension 3", "Vertices", str(len(vertices))]
    lines += [f"{format_numbers(vertex)} {REFERENCE}" for vertex in vertices]
    for title, simplices in (("Triangles", faces), ("Tetrahedra", tets)):
        lines += [title, str(len(simplices))]
        lines += [" ".join(str(i + 1) for i in simplex) + f" {REFERENCE}" for simplex in simplices]
    write_lines(path, lines + ["End"])


def write_off(path, vertices, faces):
    """Write the surface of a mesh as OFF: zero-based indices, after each face's count."""
    lines = ["OFF", f"{len(vertices)} {len(faces)} 0"]
    lines += [format_numbers(vertex) for vertex in vertices]
    lines += [" ".join(str(i) for i in (len(face), *face)) for face in faces]
    write_lines(path, lines)


def suggestion_line(words):
    """Return the comment that recommends settings."""
    return f"# suggests {words}"


def scene_lines(bodies):
    """Return the lines of a scene: a count, then `mesh density isFixed x y z qw qx qy qz`."""
    lines = [str(len(bodies))]
    for body in bodies:
        lines.append(
            f"{body.meshFile:<22}{body.density:<8}{int(body.isFixed)}   "
            f"{format_numbers(body.position):<23} {format_numbers(body.orientation)}"
        )
    return lines


def write_ties(path, ties):
    """Write a constraint file: a count, then `m1 v1 m2 v2 lower upper` per line."""
    write_lines(path, [str(len(ties))] + [" ".join(map(str, tie)) for tie in ties])


def main():
    parser = argparse.ArgumentParser(description="Write the project's own meshes and scenes.")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        default=Path(__file__).parent,
        help="output folder (default: beside this script)",
    )
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)

    for name, mesh in MESHES.items():
        write_mesh(folder / f"{name}.mesh", *mesh)
    boxVertices, boxFaces, _ = MESHES["box"]
    write_off(folder / "box.off", boxVertices, boxFaces)
    for name, makeBodies in SCENES.items():
        suggestion = [suggestion_line(SUGGESTIONS[name])] if name in SUGGESTIONS else []
        write_lines(folder / f"{name}-scene.txt", suggestion + scene_lines(makeBodies()))
    for name, makeTies in TIES.items():
        write_ties(folder / f"{name}-constraints.txt", makeTies())


if __name__ == "__main__":
    main()
