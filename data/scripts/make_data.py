"""Write the project's own meshes and scenes: `python data/scripts/make_data.py [--out DIR]`.

All machines write the same bytes. A scene is a list of bodies, or such a list and a list of ties;
see `scenes`. Units: metres and kilograms. The y axis points up and the ground is the plane y = 0.
"""

import argparse
import itertools
import math
import random
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from meshes import COORDINATE_DECIMALS, MESHES, TRAY_BLOCKS, TRAY_PROFILE

# Orientations (w, x, y, z), normalised when a scene is loaded.
AS_MODELLED = (1.0, 0.0, 0.0, 0.0)
Z_TO_VERTICAL = (1.0, 1.0, 0.0, 0.0)  # 90° about x: a cylinder stands on its cap
QUARTER_YAW = (1.0, 0.0, 1.0, 0.0)  # 90° about y

# m, the height of a fixed post above the ground, too small to see. At 0, the post would touch the
# ground in every step.
POST_CLEARANCE = 0.1

# Settings with which structures and piles rest; see rbs/softstep/step.py.
RESTING = "solver soft-step friction 0.5 restitution 0"


class Body(NamedTuple):
    """One line of a scene file.

    A tie is one of a constraint file: (body1, vertex1, body2, vertex2, lower, upper). The bounds of
    the distance are multiples of that at the start. A rope has the lower bound 0.
    """

    meshFile: str
    density: float  # kg / m³
    position: tuple  # centre of mass (x, y, z), metres
    orientation: tuple = AS_MODELLED  # (w, x, y, z), of any length except zero
    isFixed: bool = False


def body(shape, density, position, orientation=AS_MODELLED, isFixed=False, decimals=6):
    """A Body of a mesh in MESHES; its position is rounded to these decimals."""
    place, turned = np.round(position, decimals), np.round(orientation, COORDINATE_DECIMALS)
    return Body(f"{shape}.mesh", density, tuple(place), tuple(turned), isFixed)


def random_orientation(generator):
    """A random quaternion (w, x, y, z). generator : random.Random, alike in all Python versions"""
    return tuple(round(generator.uniform(-1.0, 1.0), 3) for _ in range(4))


def turn(orientation, vector):
    """Turn a (3,) vector by a quaternion q = (w, u): q v q⁻¹ = v + 2 u × (u × v + w v) / |q|²."""
    w, u = orientation[0], np.array(orientation[1:])
    return vector + 2 * np.cross(u, np.cross(u, vector) + w * vector) / (w * w + u @ u)


def make_posts(places):
    """Return fixed upright cylinders at `places`, a list of (x, z) in metres."""
    y = 10.0 + POST_CLEARANCE  # half the cylinder's length
    return [body("cylinder", 4000.0, (x, y, z), Z_TO_VERTICAL, True) for x, z in places]


def tet():
    """A square of 5 × 5 tetrahedra, which land in turn and bounce into each other."""
    # Less than a tetrahedron's largest diameter, 12.2, so that they push each other sideways.
    spacing, generator, bodies = 9.0, random.Random(25), []
    for i, (row, column) in enumerate(itertools.product(range(-2, 3), repeat=2)):
        place = spacing * column, 12.0 + 2.0 * (7 * i % 25), spacing * row
        bodies.append(body("tetrahedron", 80.0, place, random_orientation(generator)))
    return bodies


def mixed():
    """One of each shape, and another box, fall onto each other in a tray.

    The wall is high enough for the default restitution. With 1, they bounce over it.
    """
    bodies = [
        body("long-octahedron", 60.0, (5.0, 33.0, 2.0), (1.0, 0.9, 0.0, 0.1)),
        body("cylinder", 60.0, (-6.0, 12.0, -7.0), (1.0, 0.2, 0.0, 0.0)),
        body("ellipsoid", 60.0, (-6.0, 35.0, -10.0), (1.0, 0.0, 1.0, 1.0)),
        body("box", 60.0, (3.0, 17.0, 10.0), (1.0, 0.3, 0.0, 0.2)),
        body("tetrahedron", 60.0, (-11.0, 38.0, 3.0), (1.0, 0.0, 0.5, 1.0)),
        body("octahedron", 60.0, (9.0, 16.0, -1.0), (1.0, 0.0, 0.4, 0.2)),
        body("box", 60.0, (-10.0, 25.0, 6.0), (1.0, 1.0, 0.0, 0.4)),
    ]
    rise = POST_CLEARANCE - TRAY_PROFILE[0][1]
    angles = [360.0 * (i + 0.5) / TRAY_BLOCKS for i in range(TRAY_BLOCKS)]
    tray = [make_block("tray_block", 4000.0, 1, angle, rise) for angle in angles]
    return bodies + [block._replace(isFixed=True) for block in tray]


def stress():
    """25 assorted bodies fall onto 4 × 4 fixed posts."""
    generator = random.Random(41)
    shapes = "box tetrahedron ellipsoid octahedron long-octahedron cylinder".split()
    bodies = make_posts(itertools.product((-63.0, -21.0, 21.0, 63.0), repeat=2))
    # A spacing of 28 puts 16 of the bodies about 7 m beside a post, and keeps the bodies apart.
    for i, (column, row) in enumerate(itertools.product(range(-2, 3), repeat=2)):
        x, z = (round(28.0 * step + generator.uniform(-3.0, 3.0), 2) for step in (column, row))
        place = x, round(generator.uniform(42.0, 66.0), 2), z
        bodies.append(body(shapes[i % 6], 300.0, place, random_orientation(generator)))
    return bodies


def cube():
    """Octahedra at the corners of a tilted cube, tied to each other, so that it is rigid."""
    edge, centre = 11.0, (0.0, 30.0, 0.0)
    tilt = (4.0, 1.0, 0.0, 1.0)
    corners = np.array(list(itertools.product((-edge / 2, edge / 2), repeat=3)))
    places = [centre + turn(tilt, corner) for corner in corners]
    bodies = [body("octahedron", 900.0, place, tilt, decimals=3) for place in places]
    return bodies, [(i, 0, k, 0, 1.0, 1.0) for i, k in itertools.combinations(range(8), 2)]


def tower_chain():
    """A leaning column on a fixed foot, each body tied to the one below, elastic by a tenth."""
    shapes = 3 * ["box"] + 3 * ["tetrahedron"] + 3 * ["octahedron"]
    densities = [2400.0, 1800.0, 1200.0, 1500.0, 1000.0, 700.0, 600.0, 900.0, 1400.0]
    lean, rise = 1.5, 14.0  # metres from one body to the next, along x and y
    bodies = [
        body(shape, density, (lean * i, 70.0 + rise * i, 0.0), isFixed=i == 0)
        for i, (shape, density) in enumerate(zip(shapes, densities, strict=True))
    ]
    return bodies, [(i, 0, i + 1, 0, 0.9, 1.1) for i in range(8)]


def two_chain():
    """Two chains above an alley of fixed posts; small bodies fall onto one of them.

    Nine boxes hang down from the first. Nine tetrahedra reach out sideways and swing into them.
    """
    height, links = 136.0, range(9)
    hanging = [body("box", 2000.0, (0.0, height - 13.5 * i, 0.0), isFixed=i == 0) for i in links]
    places = [(20.0 + 14.0 * i, height, 0.0) for i in links]
    swinging = [body("tetrahedron", 2500.0, place, isFixed=place[0] == 20.0) for place in places]
    posts = make_posts(itertools.product((-60.0, -20.0, 20.0, 60.0), (-18.0, 18.0)))
    falling = []
    for i, shape in enumerate(3 * ["octahedron", "ellipsoid"] + ["octahedron"]):
        place = 24.0 + 15.0 * i, height + 16.0 + 4.0 * i, 0.0
        falling.append(body(shape, 1000.0, place, (1.0, 0.3, 0.1, 0.2)))
    ties = [(i, 0, i + 1, 0, 0.9, 1.1) for i in (*range(8), *range(9, 17))]
    return hanging + swinging + posts + falling, ties


PLANKS = 13  # between the abutments


def bridge():
    """Planks between two fixed abutments sag, and catch bodies that fall onto them.

    The lower corners of each plank are tied to the facing corners of the next.
    """
    height, pitch = 40.0, 9.0
    # after a quarter turn, a plank is 8 m along the bridge and 12 m across it
    deck = []
    for i in range(PLANKS + 2):
        place = pitch * (i - (PLANKS + 1) / 2), height, 0.0
        deck.append(body("box", 500.0, place, QUARTER_YAW, i in (0, PLANKS + 1)))
    falling = [
        body("octahedron", 700.0, (-18.0, height + 18.0, 1.0), (1.0, 0.4, 0.0, 0.2)),
        body("ellipsoid", 700.0, (5.0, height + 30.0, -1.0), (1.0, 0.0, 0.3, 0.8)),
        body("box", 300.0, (24.0, height + 24.0, 0.0), (1.0, 0.2, 0.5, 0.1)),
    ]
    # The quarter turn takes z to x and x to -z. So corners with z > 0 face the next plank, and the
    # sign of x is the side of the bridge. A corner's index is 4 (x > 0) + 2 (y > 0) + (z > 0).
    ties = [(i, side + 1, i + 1, side, 0.0, 1.2) for i in range(PLANKS + 1) for side in (0, 4)]
    return deck + falling, ties


def net():
    """A net of octahedra hangs at its corners, and three light bodies fall into it.

    Each body's tips along x and z are tied to the facing tips of its neighbours.
    """
    side, height, pitch = 20, 90.0, 8.0
    bodies, ties, last = [], [], side - 1
    for i, k in itertools.product(range(side), repeat=2):
        place = pitch * (i - last / 2), height, pitch * (k - last / 2)
        bodies.append(body("octahedron", 200.0, place, isFixed={i, k} <= {0, last}))
        here = side * i + k
        if i < last:
            ties.append((here, 0, here + side, 2, 0.0, 1.1))
        if k < last:
            ties.append((here, 4, here + 1, 5, 0.0, 1.1))
    falling = [
        body("ball", 6.0, (-20.0, height + 20.0, 8.0), (1.0, 0.3, 0.2, 0.0)),
        body("cylinder", 5.0, (22.0, height + 26.0, -18.0), (1.0, 0.4, 0.3, 0.0)),
        body("box", 10.0, (10.0, height + 34.0, 26.0), (1.0, 0.2, 0.5, 0.1)),
    ]
    return bodies + falling, ties


def chimes():
    """Many short pendulums and a long chain, which needs many sweeps: a queue leaves them out."""
    pitch, links = 14.0, 20
    bodies, ties = [], []
    for i, k in itertools.product(range(14), range(16)):
        peg = np.array([pitch * (i - 6.5), 130.0, pitch * (k - 7.5)])
        angle = math.radians(20.0 + i + k)
        bob = peg + 12.0 * np.array([math.sin(angle), -math.cos(angle), 0.0])
        bodies.append(body("octahedron", 200.0, peg, isFixed=True))
        bodies.append(body("octahedron", 200.0, bob, decimals=3))
        ties.append((len(bodies) - 2, 3, len(bodies) - 1, 1, 0.0, 1.0))  # lowest and highest tip
    first = len(bodies)
    for i in range(links + 1):
        place = 9.0 * (i - links / 2), 105.0, pitch * 9.5
        bodies.append(body("octahedron", 200.0, place, isFixed=i == 0))
        if i:
            ties.append((first + i - 1, 0, first + i, 2, 0.0, 1.05))
    return bodies, ties


def make_chain_and_ball(anchor, orientation):
    """A chain on a fixed octahedron at `anchor`, with a ball at its end that is released.

    It swings towards +x, turned by the orientation. Returns (bodies, ties): each link's tip at -x
    is tied to the next one's at +x, and the last to the ball.
    """
    pitch, links = 9.0, 5  # between the anchor and the ball
    slope = math.radians(25.0)  # of the chain, below the horizontal
    along = turn(orientation, np.array([-math.cos(slope), -math.sin(slope), 0.0]))
    chain = []
    for i in range(links + 1):
        place = anchor + pitch * i * along
        chain.append(body("octahedron", 600.0, place, orientation, i == 0, decimals=3))
    reach = pitch * links + 11.0
    ball = body("ball", 2000.0, anchor + reach * along, orientation, decimals=3)
    ballTip = int(np.argmax(MESHES["ball"][0][:, 0]))
    tips = [0] * links + [ballTip]  # vertex 0 of an octahedron is its tip at +x
    return [*chain, ball], [(i, 2, i + 1, tip, 0.0, 1.05) for i, tip in enumerate(tips)]


def wrecking_ball():
    """A ball on a chain is released beside a stack of boxes and swings into it."""
    chain, ties = make_chain_and_ball(np.array([0.0, 70.0, 0.0]), AS_MODELLED)
    plinth = body("box", 1000.0, (14.0, 3.0, 0.0), QUARTER_YAW, True)
    # Just above one another, because boxes in contact would be resolved in the first step.
    places = [(14.0, 9.0 + 6.01 * i + 0.01, 0.0) for i in range(4)]
    boxes = [Body("box.mesh", 150.0, place, QUARTER_YAW) for place in places]
    return [*chain, plinth, *boxes], ties


# Slopes descend towards +x: (n, 0, 0, -1) turns by -2 atan(1/n) about z.
GENTLE = (8.0, 0.0, 0.0, -1.0)  # 14.3°, the friction angle of μ = 16/63 = 0.25
STEEP = (4.0, 0.0, 0.0, -1.0)  # 28.1°, the friction angle of μ = 8/15 = 0.53
# A slab set upright across the slopes, its x along z and its z along y, stops what rolls.
WALL = (1.0, -1.0, -1.0, -1.0)
# m, the initial height of a body above its slope, too small to see. Bodies in contact would be
# resolved before they have moved.
HAIR = 0.01
SLAB = np.ptp(MESHES["slab"][0], axis=0)  # its length, thickness and width


def slope_axes(tilt):
    """Return the unit vectors (3,) of a slope: downhill, and normal to it."""
    return (turn(tilt, axis) for axis in np.eye(3)[:2])


def make_slope(tilt, lane, shape, halfHeight, uphill):
    """A fixed slab with its lower end near the ground and its middle at z = lane, and a body on it.

    uphill : from the slab's middle to the body, metres. The body is turned like the slab.
    """
    downhill, normal = slope_axes(tilt)
    rise = POST_CLEARANCE - SLAB[0] / 2 * downhill[1] + SLAB[1] / 2 * normal[1]
    middle = np.array([0.0, rise, lane])
    place = middle - uphill * downhill + (SLAB[1] / 2 + halfHeight + HAIR) * normal
    return [body("slab", 1000.0, middle, tilt, True), body(shape, 60.0, place, tilt)]


def make_wall(x, z):
    """A fixed upright slab that stops what comes down a slope; x, z in metres."""
    return body("slab", 1000.0, (x, SLAB[2] / 2 + POST_CLEARANCE, z), WALL, True)


def slide():
    """Boxes slide down chutes from three heights. With μ = 0.2 they stop one behind the other."""
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
        across = (float(n), 1.0, float(n), -1.0)
        slabs.append(body("slab", 1000.0, middle - SLAB[1] / 2 * normal, across, True))
        if n in lanes:
            place = middle + (3.0 + HAIR) * normal + [0.0, 0.0, lanes[n]]
            boxes.append(body("box", 60.0, place, tilt))
    return [*slabs, make_wall(60.0, 0.0), *boxes]


def roll():
    """A cylinder, a ball and an ellipsoid slide down slopes, unless friction makes them roll."""
    return [
        *make_slope(STEEP, -20.0, "cylinder", 5.0, 17.0),
        *make_slope(STEEP, 0.0, "ball", 6.0, 17.0),
        *make_slope(STEEP, 16.0, "ellipsoid", 3.0, 17.0),
        make_wall(60.0, -2.0),
    ]


def tiles():
    """A box, a ball and a cylinder come down slopes and cross the seams of a floor of tiles."""
    length, height, width = 8.0, 6.0, 12.0  # of a tile, after a quarter turn
    level, step = height + POST_CLEARANCE, 0.2  # the slopes end a step above the floor
    rows = itertools.product(range(8), range(-2, 3))
    places = [(length * (i + 0.5), level - height / 2, width * k) for i, k in rows]
    floor = [body("box", 1000.0, place, QUARTER_YAW, True) for place in places]
    downhill, normal = slope_axes(GENTLE)
    slopes, movers = [], []
    lanes = ("box", 3.0, 19.0), ("ball", 6.0, 4.0), ("cylinder", 5.0, -14.0)
    for shape, halfHeight, lane in lanes:
        middle = np.array([-HAIR, level + step, lane]) - SLAB[0] / 2 * downhill  # of the upper side
        slopes.append(body("slab", 1000.0, middle - SLAB[1] / 2 * normal, GENTLE, True))
        place = middle - 10.0 * downhill + (halfHeight + HAIR) * normal
        movers.append(body(shape, 60.0, place, GENTLE))
    return [*floor, *slopes, *movers]


# m, the initial joints between the blocks of a structure.
JOINT = 0.001


def height_of(row):
    """The height of boxes in a row of a structure, counted from 0."""
    return 3.0 + JOINT + row * (6.0 + JOINT)


def boxes(places):
    """Boxes at `places`, a list of (x, row)."""
    return [body("box", 60.0, (x, height_of(row), 0.0)) for x, row in places]


def make_block(name, density, axis, degrees, rise=0.0, away=(0.0, 0.0, 0.0)):
    """A wedge, turned from its position in MESHES about the axis of its structure.

    axis : 1 (y) or 2 (z); rise : metres; away : (3,), shift before the rotation
    """
    half = math.radians(degrees) / 2
    orientation = np.zeros(4)
    orientation[[0, 1 + axis]] = np.round([math.cos(half), math.sin(half)], COORDINATE_DECIMALS)
    vertices, _, tets = MESHES[name]
    corners = vertices[tets]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1])
    centre = np.average(corners.mean(axis=1), axis=0, weights=volumes)  # of mass
    place = turn(orientation, centre + away) + [0.0, rise, 0.0]
    return body(name, density, place, orientation)


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
            bodies.append(body("card", 60.0, place, turned))
        floor += 2 * drop + JOINT
        for left, right in itertools.pairwise(middles):
            # outwards from the middle of the house, over the pairs at the ends
            outwards = np.sign(left + right) or 0.0
            x = (left + right) / 2 + outwards * (length - pitch) / 2 + outwards * JOINT
            bodies.append(body("card", 60.0, (x, floor + JOINT + thickness / 2, 0.0)))
        floor += thickness + JOINT
    return bodies


def wall():
    """A ball on a chain swings into a wall of bricks."""
    chain, ties = make_chain_and_ball(np.array([0.0, 80.0, 10.0]), QUARTER_YAW)
    rows = [(row, i) for row in range(8) for i in range(7 - row % 2)]
    bricks = boxes([((12.0 + JOINT) * (i - (6 - row % 2) / 2), row) for row, i in rows])
    return [*chain, *bricks], ties


def ramp():
    """Boxes on slopes of 26° and 28°. One stays, as μ = 0.5 has a friction angle of 26.6°."""
    bodies = []
    for angle, lane in ((26.0, -10.0), (28.0, 10.0)):
        tilt = (round(1 / math.tan(math.radians(angle / 2)), 6), 0.0, 0.0, -1.0)
        bodies += make_slope(tilt, lane, "box", 3.0, 12.0)
    return bodies


def cradle():
    """Newton's cradle: five balls side by side on two strings each. One of them is released.

    The strings tie the ends of a ball's axis along z to the inner tips of its hooks.
    """
    count, height, length, angle = 5, 70.0, 50.0, math.radians(40.0)
    # m between the balls. Those that meet within one step would move on together.
    gap = 0.4
    # a turn about z points two faces of each ball along ± x, squarely at its neighbours: of those
    # across z = 0 with y > 0, the one that is furthest along x
    middles = MESHES["ball"][0][np.array(MESHES["ball"][1])].mean(axis=1)
    isAcross = (np.abs(middles[:, 2]) < 1e-6) & (middles[:, 1] > 0.0)
    x, y, _ = max(middles[isAcross], key=lambda middle: middle[0])
    half = -math.atan2(y, x) / 2
    forward = (math.cos(half), 0.0, 0.0, math.sin(half))
    pitch = 2 * math.hypot(x, y) + gap
    z = MESHES["ball"][0][:, 2]
    ballEnds = int(z.argmin()), int(z.argmax())
    balls, hooks, ties = [], [], []
    for i in range(count):
        x = pitch * (i - (count - 1) / 2)
        swing = angle if i == 0 else 0.0
        place = x - length * math.sin(swing), height - length * math.cos(swing), 0.0
        balls.append(body("ball", 60.0, place, forward))
        hooks += [body("octahedron", 60.0, (x, height, z), isFixed=True) for z in (-20.0, 20.0)]
        for side, tip in enumerate((4, 5)):
            ties.append((i, ballEnds[side], count + 2 * i + side, tip, 0.0, 1.0))
    return balls + hooks, ties


def loaded_bridge():
    """Boxes and cylinders come to rest on the rope bridge."""
    bodies, ties = bridge()
    boxes = [body("box", 300.0, (-27.0 + 18.0 * i, 56.0, 0.0), QUARTER_YAW) for i in range(4)]
    places = [(-18.0 + 18.0 * i, 80.0, 0.0) for i in range(3)]
    cylinders = [body("cylinder", 60.0, place, Z_TO_VERTICAL) for place in places]
    return bodies[: PLANKS + 2] + boxes + cylinders, ties


def two_cylinder():
    """A lying cylinder bounces off the ground into a skew one above it; caps are tied to caps."""
    upper = body("cylinder", 120.0, (4.0, 38.0, -3.0), (1.0, 0.0, 0.2, 0.0))
    ties = [(0, vertex, 1, vertex, 0.8, 1.2) for vertex in (0, 39)]
    return [body("cylinder", 120.0, (0.0, 22.0, 0.0)), upper], ties


def tower():
    """A column of crosswise boxes, tetrahedra and octahedra collapses."""
    bodies = []
    for shape, densities, heights in (
        ("box", (2400.0, 1600.0, 800.0), (8.0, 20.0, 32.0)),
        ("tetrahedron", (300.0, 200.0, 100.0), (46.0, 60.0, 74.0)),
        ("octahedron", (400.0, 800.0, 1200.0), (88.0, 102.0, 116.0)),
    ):
        for k, (density, height) in enumerate(zip(densities, heights, strict=True)):
            isAcross = k == 1 and shape != "octahedron"
            turned = QUARTER_YAW if isAcross else AS_MODELLED
            bodies.append(body(shape, density, (0.0, height, 0.0), turned))
    return bodies


def dominoes():
    """Slabs on end in a row, the first one leaning. With friction, they fall in turn."""
    upright, leaning = (1.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.8)  # 90° and 77° about z
    places = [(-60.0 + 22.0 * i, 24.0 + JOINT, 0.0) for i in range(9)]
    standing = [body("slab", 60.0, place, upright) for place in places]
    return [body("slab", 60.0, (-90.0, 26.0, 0.0), leaning), *standing]


def arch():
    """Fifteen wedges, half a ring about the z axis, stand as an arch by their weight alone."""
    degrees = [180.0 * (7 - i) / 15 for i in range(15)]
    away = (0.0, 5 * JOINT, 0.0)
    return [make_block("voussoir", 60.0, 2, angle, JOINT, away) for angle in degrees]


def scenes():
    """Returns name → (scene, settings that its file recommends)."""
    tilted = (1.0, 0.3, 0.0, 0.5), (1.0, 0.2, 0.0, 0.3), (1.0, 0.6, 0.3, 0.0)
    pyramid = [(12.5 * (i - (14 - row) / 2), row) for row in range(15) for i in range(15 - row)]
    blow = body("ball", 2000.0, (20.0, 75.0, 0.0))  # onto the shoulder of the arch
    basic = two_cylinder, tet, mixed, tower, stress, cube, tower_chain, two_chain, bridge
    basic += (wrecking_ball,)
    resting = dominoes, arch, card_house, wall, ramp, loaded_bridge
    return {
        "singletet": ([body("tetrahedron", 60.0, (3.0, 28.0, -4.0), tilted[0])], ""),
        "singlebox": ([Body("box.off", 120.0, (0.0, 36.0, 0.0), tilted[1])], ""),
        "single_cylinder": ([body("cylinder", 120.0, (0.0, 80.0, 0.0), tilted[2])], ""),
        **{make.__name__: (make(), "") for make in basic},
        **{make.__name__: (make(), RESTING) for make in resting},
        "stack": (boxes([(0.0, row) for row in range(20)]), RESTING),
        "pyramid": (boxes(pyramid), RESTING),
        "arch_blow": ([*arch(), blow], RESTING),
        "slide": (slide(), "friction 0.2"),
        "roll": (roll(), "friction 0.4"),
        "tiles": (tiles(), "solver soft-step friction 0.1 restitution 0"),
        "net": (net(), "solver soft-step substeps 2"),
        "chimes": (chimes(), "scheduling queue broad-phase grid"),
        "cradle": (cradle(), "solver soft-step restitution 1"),
    }


def format_numbers(values):
    """Return the shortest text that reads back as the same doubles."""
    return " ".join(repr(float(value)) for value in values)


def write_lines(path, lines):
    """Write lines of text, with line feeds on every system, or end the program."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")
    except OSError as error:
        sys.exit(f"{path}: {error.strerror}")


def write_mesh(path, vertices, faces, tets):
    """Write a mesh as MEDIT text: one-based indices, and the reference number 1 after each row."""
    lines = ["MeshVersionFormatted 1", "Dimension 3", "Vertices", str(len(vertices))]
    lines += [f"{format_numbers(vertex)} 1" for vertex in vertices]
    for title, rows in (("Triangles", faces), ("Tetrahedra", tets)):
        lines += [
            title,
            str(len(rows)),
            *(" ".join(str(i + 1) for i in row) + " 1" for row in rows),
        ]
    write_lines(path, lines + ["End"])


def scene_lines(bodies, suggestion=""):
    """Return the lines of a scene: a count, then `mesh density isFixed x y z qw qx qy qz`.

    suggestion : settings that a comment recommends
    """
    lines = [f"# suggests {suggestion}"] * bool(suggestion) + [str(len(bodies))]
    for name, density, position, orientation, isFixed in bodies:
        numbers = f"{format_numbers(position):<23} {format_numbers(orientation)}"
        lines.append(f"{name:<22}{density:<8}{int(isFixed)}   {numbers}")
    return lines


def main():
    parser = argparse.ArgumentParser(description="Write the project's own meshes and scenes.")
    text, ours = "output folder (default: the folder above scripts/)", Path(__file__).parents[1]
    parser.add_argument("--out", type=Path, metavar="DIR", default=ours, help=text)
    folder = parser.parse_args().out
    for name, mesh in MESHES.items():
        write_mesh(folder / f"{name}.mesh", *mesh)
    vertices, faces, _ = MESHES["box"]
    lines = ["OFF", f"{len(vertices)} {len(faces)} 0", *map(format_numbers, vertices)]
    write_lines(folder / "box.off", lines + [f"3 {a} {b} {c}" for a, b, c in faces])
    for name, (scene, suggestion) in scenes().items():
        bodies, ties = scene if isinstance(scene, tuple) else (scene, [])
        write_lines(folder / f"{name}-scene.txt", scene_lines(bodies, suggestion))
        if ties:
            lines = [str(len(ties)), *(" ".join(map(str, tie)) for tie in ties)]
            write_lines(folder / f"{name}-constraints.txt", lines)


if __name__ == "__main__":
    main()
