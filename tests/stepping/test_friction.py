"""Friction: single contacts by the thousand, and sliding, slopes and rolling against closed forms.

Boxes are 12 x 6 x 8 m, a step is 0.02 s, and a contact has one point. A box that lies is held at
one place after the other and rocks: at the end of a step it falls with 0.2 to 0.6 m/s and its
lower side swings to and fro with up to 0.4 m/s, whatever its size, for all of that is g h times a
number of the shape. Tests that allow for it say how.
"""

import itertools

import numpy as np
import pytest
from oracles import (
    body,
    box_body,
    ground,
    quaternion,
    random_quaternions,
    restore,
    rotation,
    state_of,
)

from RBSFunctions import Mesh, resolve_collision, run_timestep

G = 9.8
H = 0.02  # seconds
EPS = np.finfo(float).eps


def throw(mesh, linVelocity, angVelocity=(0, 0, 0)):
    mesh.linVelocity = np.array([linVelocity], dtype=float)
    mesh.angVelocity = np.array([angVelocity], dtype=float)
    return mesh


# --------------------------------------------------------------------------------------------------
# Single contacts
# --------------------------------------------------------------------------------------------------

CONTACTS = 3000


def random_meshes(rng, count):
    """Meshes of random shapes, sizes and densities; every fifth is fixed."""
    shapes = ("box", "tetrahedron", "octahedron", "cylinder")
    return [
        body(
            shapes[k % 4],
            density=10.0 ** rng.uniform(-2, 2),
            isFixed=k % 5 == 4,
            size=rng.uniform(0.2, 3.0, size=3),
        )
        for k in range(count)
    ]


def random_state(rng, mesh):
    """A row (13,) for `restore`: anywhere, turned anyhow, with a speed from 0.01 to 100.

    A fixed mesh has none. One with a speed would be a conveyor belt, whose friction does work.
    """
    velocities = rng.normal(size=6) * np.repeat(10.0 ** rng.uniform(-2, 2, size=2), 3)
    velocities *= not mesh.isFixed
    return np.concatenate((rng.uniform(-5, 5, 3), random_quaternions(rng, 1)[0], velocities))


def motion_at(state, point):
    """Velocities (n, 3) of the bodies' points at `point` (n, 3); state : (n, 13)."""
    return state[:, 7:10] + np.cross(state[:, 10:13], point - state[:, 0:3])


def across(vectors, normal):
    """The vectors (n, 3) without their parts along the unit normals."""
    return vectors - (vectors * normal).sum(axis=1, keepdims=True) * normal


def length(vectors):
    return np.sqrt((vectors**2).sum(axis=-1))


def turning(meshes, state, vectors):
    """The meshes' inertia tensors, in world axes, times the vectors (n, 3); zeros if fixed."""
    r = rotation(state[:, 3:7]).as_matrix()
    tensors = np.array([m.IT * (not m.isFixed) for m in meshes])
    return np.einsum("nij,njk,nlk,nl->ni", r, tensors, r, vectors)


def kinetic_energy(meshes, state):
    """(n,): ½ m v² + ½ ω · I ω; nothing for a fixed mesh."""
    mass = np.array([0.0 if m.isFixed else m.mass for m in meshes])
    v, w = state[:, 7:10], state[:, 10:13]
    return 0.5 * mass * (v * v).sum(axis=1) + 0.5 * (w * turning(meshes, state, w)).sum(axis=1)


@pytest.fixture(scope="module")
def contacts():
    """3000 contacts resolved without friction and with it, by `resolve_collision`.

    A dict of arrays with a row a contact: before, without, withIt : pairs of (n, 13) states;
    meshes : pair of lists; normal, point (n, 3); mu (n,).
    """
    rng = np.random.default_rng(5)
    pool = random_meshes(rng, 40)
    rows = []
    for k in range(CONTACTS):
        while True:
            pair = [pool[i] for i in rng.choice(len(pool), 2, replace=False)]
            if not (pair[0].isFixed and pair[1].isFixed):
                break
        restore(pair, [random_state(rng, mesh) for mesh in pair])
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        mu, e = 10.0 ** rng.uniform(-1.5, 1), rng.choice([0.0, 0.5, 1.0])
        depth, penPoint = rng.uniform(0, 0.3), rng.uniform(-6, 6, 3)
        before = state_of(pair)
        resolve_collision(*pair, depth, normal, penPoint, e, k % 2 == 1)
        without = state_of(pair)
        restore(pair, before)
        resolve_collision(*pair, depth, normal, penPoint, e, k % 2 == 1, mu=mu)
        # the point goes along with mesh 2, which moves by its share of the depth
        point = penPoint + without[1, :3] - before[1, :3]
        rows.append((before, without, state_of(pair), pair, normal, point, mu))
    before, without, withIt, pairs, normal, point, mu = zip(*rows, strict=True)
    return {
        "before": np.array(before).swapaxes(0, 1),
        "without": np.array(without).swapaxes(0, 1),
        "withIt": np.array(withIt).swapaxes(0, 1),
        "meshes": list(zip(*pairs, strict=True)),
        "normal": np.array(normal),
        "point": np.array(point),
        "mu": np.array(mu),
    }


def momentum(contacts, body, state):
    """Linear and angular momentum of a body, the latter about its COM: two (n, 3)."""
    meshes, rows = contacts["meshes"][body], contacts[state][body]
    mass = np.array([0.0 if m.isFixed else m.mass for m in meshes])
    return mass[:, None] * rows[:, 7:10], turning(meshes, rows, rows[:, 10:13])


def momentum_scale(contacts):
    """(n,): what the rounding of impulses is relative to, when they are told from the states."""
    return sum(
        length(part)
        for k, state in itertools.product(range(2), ("before", "without", "withIt"))
        for part in momentum(contacts, k, state)
    )


def momentum_gain(contacts, body, start, end):
    """What a body gains of both between two states."""
    old, new = momentum(contacts, body, start), momentum(contacts, body, end)
    return new[0] - old[0], new[1] - old[1]


def received(contacts, start, end):
    """The impulse (n, 3) that body 2 receives between two states, from what is not fixed."""
    gains = [momentum_gain(contacts, k, start, end)[0] for k in range(2)]
    isFixed = np.array([m.isFixed for m in contacts["meshes"][1]])
    return np.where(isFixed[:, None], -gains[0], gains[1])


def sliding_of(contacts, state):
    """Velocity (n, 3) across the normal of body 1 relative to body 2, at the contact."""
    relative = np.subtract(*(motion_at(contacts[state][k], contacts["point"]) for k in range(2)))
    return across(relative, contacts["normal"])


def speed_scale(contacts):
    """(n,): what the rounding of the contact's velocities is relative to."""
    scale = 0.0
    for k, state in itertools.product(range(2), ("before", "without", "withIt")):
        arms = contacts["point"] - contacts[state][k][:, :3]
        w = length(contacts[state][k][:, 10:13])
        scale = scale + length(contacts[state][k][:, 7:10]) + w * length(arms)
    return scale


def test_kinetic_energy_never_grows_through_friction(contacts):
    energies = [
        sum(kinetic_energy(contacts["meshes"][k], contacts[state][k]) for k in range(2))
        for state in ("without", "withIt")
    ]
    lost = energies[0] - energies[1]
    assert (lost >= -1e-13 * energies[0]).all()
    # and it does take some, in nearly all contacts that press
    pressed = (received(contacts, "before", "without") * contacts["normal"]).sum(axis=1) > 0
    assert (lost[pressed] > 1e-9 * energies[0][pressed]).mean() > 0.9


def test_friction_slows_or_stops_the_sliding_and_never_turns_it_round(contacts):
    old, new = sliding_of(contacts, "without"), sliding_of(contacts, "withIt")
    t = old / length(old)[:, None]
    speed, left = length(old), (new * t).sum(axis=1)
    rounding = 1e-13 * speed_scale(contacts)
    assert (left >= -rounding).all()
    assert (left <= speed + rounding).all()

    # Coulomb: what sticks needed no more than μ times the normal impulse, what slides got just that
    pressing = (received(contacts, "before", "without") * contacts["normal"]).sum(axis=1)
    friction = received(contacts, "without", "withIt")
    most = contacts["mu"] * np.maximum(pressing, 0.0)
    tolerance = 1e-13 * momentum_scale(contacts)
    assert (length(friction) <= most + (1 + contacts["mu"]) * tolerance).all()
    sticks = left <= np.maximum(1e-9 * speed, rounding)
    slides = ~sticks & (pressing > 0)
    missing = (most - length(friction)) / (1 + contacts["mu"])
    assert (missing <= tolerance)[slides].all()
    assert sticks.sum() > 400 and slides.sum() > 400

    # It lies in the plane of contact, and opposes the sliding: body 2 is dragged along by body 1.
    assert (np.abs((friction * contacts["normal"]).sum(axis=1)) <= tolerance).all()
    along = (friction * t).sum(axis=1)
    # the direction t is as good as the sliding is larger than its rounding
    t_error = np.minimum(2.0, rounding / speed)
    assert (length(friction - along[:, None] * t) <= tolerance + t_error * length(friction)).all()
    assert (along >= -tolerance).all()
    assert (along > tolerance)[sticks | slides].mean() > 0.99


def test_contacts_that_separate_get_no_friction(contacts):
    """A negative impulse, which the coursework's convention gives them, presses nothing."""
    pressing = (received(contacts, "before", "without") * contacts["normal"]).sum(axis=1)
    closingOnly = np.arange(CONTACTS) % 2 == 1
    for separating, some in (((pressing < 0), 400), ((pressing == 0) & closingOnly, 400)):
        assert separating.sum() > some
        for k in range(2):
            without, withIt = contacts["without"][k], contacts["withIt"][k]
            assert np.array_equal(without[separating], withIt[separating])


def test_friction_conserves_momentum(contacts):
    isFree = np.array([[not m.isFixed for m in contacts["meshes"][k]] for k in range(2)])
    linear, angular = zip(
        *(momentum_gain(contacts, k, "without", "withIt") for k in range(2)), strict=True
    )
    rounding = 1e-13 * momentum_scale(contacts)
    both = isFree.all(axis=0)
    assert both.sum() > 1500
    assert (length(linear[0] + linear[1]) <= rounding)[both].all()
    # About its COM each body gains r × what it receives; so about the origin nothing is gained.
    friction = received(contacts, "without", "withIt")
    for k, sign in ((0, -1.0), (1, 1.0)):
        arm = contacts["point"] - contacts["without"][k][:, :3]
        excess = length(angular[k] - sign * np.cross(arm, friction))
        assert (excess <= (1 + length(arm)) * rounding)[isFree[k]].all()
    # and that is not because there is none to speak of
    assert (length(friction) > 1e6 * rounding).sum() > 900
    # what is fixed stays as it is
    for k in range(2):
        assert np.array_equal(contacts["before"][k][~isFree[k]], contacts["withIt"][k][~isFree[k]])


# --------------------------------------------------------------------------------------------------
# Sliding on level ground
# --------------------------------------------------------------------------------------------------

# What a box slides on: the ground, or a fixed body, before or after it in the list.
FLOORS = ("ground", "body before", "body after")
FAST = 10.0  # m/s


def on_floor(mesh, floor):
    """`(meshes, groundMesh)` for a step of a mesh on something level at y = 0."""
    if floor == "ground":
        return [mesh], ground()
    slab = box_body(1000, 100, 1000, (0, -50, 0), isFixed=True)
    return ([slab, mesh] if floor == "body before" else [mesh, slab]), None


def slide(mu, e, floor="ground", h=H):
    """x and velocity after each step, (n,) and (n, 3), of a box with 10 m/s along x.

    It goes on for a tenth longer than the sliding should last.
    """
    mesh = throw(box_body(12, 6, 8, (0, 3, 0)), (FAST, 0, 0))
    meshes, groundMesh = on_floor(mesh, floor)
    x, v = [], []
    for _ in range(round(1.1 * FAST / (mu * G) / h)):
        run_timestep(meshes, groundMesh, h, e, mu=mu)
        x.append(mesh.position[0, 0])
        v.append(mesh.linVelocity[0].copy())
    return np.array(x), np.array(v)


@pytest.mark.parametrize(
    ("mu", "e", "floor"),
    [(0.1, 0.5, "ground"), (0.6, 0.0, "body before"), (0.6, 0.5, "body after")],
)
def test_sliding_box_stops_where_it_should(mu, e, floor):
    x, v = slide(mu, e, floor)
    distance, expected = x[-1], FAST**2 / (2 * mu * G)
    # From 51.0 m with μ = 0.1 to 8.5 m with μ = 0.6. The mean deceleration, v²/2 by the distance,
    # is off by as much the other way.
    assert FAST**2 / (2 * distance) == pytest.approx(mu * G, rel=0.1)
    assert abs(v[-1, 0]) < 2 * G * H  # what is left is the rocking

    # Where the residue comes from. While the box slides, a step's friction is μ times its normal
    # impulse J, and J goes into stopping the fall: v_y = ΣJ/m - g t. So
    #     v_x = v_0 - μ ΣJ/m = v_0 - μ (g t + v_y),
    # to the small angle between the contact's velocity and the box's.
    t = H * np.arange(1, len(x) + 1)
    isSliding = v[:, 0] > 0.1 * FAST
    byMomentum = FAST - mu * (G * t + v[:, 1])
    assert np.abs(v[:, 0] - byMomentum)[isSliding].max() < 0.06
    # The friction lags behind by the fall that one contact leaves, w = -v_y, 0.1 to 0.6 m/s, for
    # v_0/(μ g): v_0 w/g further. And a step moves before it slows: half a step with v_0 further.
    w = -v[isSliding, 1].mean()
    explained = expected + FAST * w / G + FAST * H / 2
    assert distance == pytest.approx(explained, rel=0.01)


def test_stopping_distance_converges_with_the_time_step():
    # both parts of the residue, and w with them, are proportional to g h
    errors = np.array([slide(0.6, 0.5, h=h)[0][-1] for h in (H, H / 2, H / 4)]) - FAST**2 / (
        1.2 * G
    )
    assert (errors > 0).all()
    assert errors[1:] / errors[:-1] == pytest.approx(0.5, abs=0.1)


def test_ground_and_bodies_rub_alike():
    """Boxes, balls and tetrahedra that land on one vertex, by a hair, thrown and spinning anyhow.

    By a hair: the ground's contact point stays as deep as the vertex was, that on a body goes along
    with the correction.
    """
    rng = np.random.default_rng(8)
    stuck = 0
    for k in range(30):
        name = ("box", "ball", "tetrahedron")[k % 3]
        turn = random_quaternions(rng, 1)[0]
        v, w = rng.normal(size=(2, 3)) * [[5.0], [1.0]]
        v[1] = -abs(v[1])
        results = []
        for floor in FLOORS:
            mesh = throw(body(name, (0, 0, 0), turn, density=2.0), v, w)
            mesh.integrate_timestep(H)
            low = mesh.currVertices[:, 1].min()
            start = (0, -low - 1e-9, 0)
            mesh = throw(body(name, start, turn, density=2.0), v, w)
            meshes, groundMesh = on_floor(mesh, floor)
            report = run_timestep(meshes, groundMesh, H, 0.5, mu=0.4)
            assert len(report.contacts) == 1
            results.append(np.concatenate((mesh.linVelocity[0], mesh.angVelocity[0])))
        contact = report.contacts[0]
        stuck += np.linalg.norm(contact.friction) < 0.4 * contact.impulse * (1 - 1e-9)
        assert np.abs(np.array(results) - results[0]).max() < 1e-6
    assert 2 < stuck < 28


INCLINE_MU = 0.4  # a friction angle of 21.8°
SLOPE_SECONDS = 5.0


def descend(degrees, e, order, h=H):
    """A box on a slope, let go: its way downhill after each step (n,) and its rocking speed.

    The rocking speed is the largest that its lower side swings with, 3 m below the COM.
    """
    tilt = quaternion((0, 0, 1), -degrees)
    downhill, normal, _ = rotation(tilt).as_matrix().T
    slab = box_body(400, 20, 200, -10 * normal, orientation=tilt, isFixed=True)
    mesh = box_body(12, 6, 8, 3 * normal, orientation=tilt)
    meshes = [slab, mesh] if order == "slab first" else [mesh, slab]
    start, way, rocking = mesh.position[0].copy(), [], 0.0
    for _ in range(round(SLOPE_SECONDS / h)):
        run_timestep(meshes, None, h, e, mu=INCLINE_MU)
        way.append((mesh.position[0] - start) @ downhill)
        rocking = max(rocking, 3.0 * np.linalg.norm(across(mesh.angVelocity, normal[None])))
        assert abs((mesh.position[0] - start) @ normal) < 0.1  # it stays down
    return np.array(way), rocking


@pytest.mark.parametrize(
    ("degrees", "e", "order"), [(10, 0.5, "slab first"), (20, 0.0, "box first")]
)
def test_box_creeps_no_faster_than_it_rocks_below_the_friction_angle(degrees, e, order):
    way, rocking = descend(degrees, e, order)
    # A box that rocks is held back only while its contact slides downhill. Once the box is faster
    # than its lower side swings, that is always, and friction, more than the pull, slows it down.
    # To this comes what a step moves before friction acts: g h sin θ.
    creep = rocking + G * H * np.sin(np.radians(degrees))
    assert 0 < way[-1] < creep * SLOPE_SECONDS
    # Hence 0.7 to 1.7 m in 5 s, in place of the 21 m at 10° and 42 m at 20° without friction.
    assert way[-1] < 0.05 * 0.5 * G * np.sin(np.radians(degrees)) * SLOPE_SECONDS**2
    # It does not get faster: as far in the second half as in the first, within the rocking.
    half = way[len(way) // 2 - 1]
    assert way[-1] - half < half + 0.6


@pytest.mark.parametrize(
    ("degrees", "e", "order"), [(25, 0.0, "slab first"), (40, 0.5, "box first")]
)
def test_box_slides_above_the_friction_angle(degrees, e, order):
    way, _ = descend(degrees, e, order)
    t = H * np.arange(1, len(way) + 1)
    slope = np.radians(degrees)
    expected = G * (np.sin(slope) - INCLINE_MU * np.cos(slope))  # 0.589 and 3.297 m/s²
    # By a parabola, whose other terms take up how the box begins.
    assert 2 * np.polyfit(t, way, 2)[0] == pytest.approx(expected, abs=0.005)
    # As on level ground, friction lags by μ times the fall that the contact leaves: up to
    # 0.4 · 0.6 m/s, with which the box is further, and half a step's pull.
    excess = way[-1] - 0.5 * expected * SLOPE_SECONDS**2
    assert 0 < excess < (INCLINE_MU * 0.6 + 0.5 * G * H * np.sin(slope)) * SLOPE_SECONDS


def icosphere(subdivisions):
    """A ball of radius 6 that touches the ground at y = 0, with 10 · 4ⁿ + 2 vertices."""
    ball = body("ball")
    vertices, faces = ball.origVertices / 6.0, [tuple(face) for face in ball.faces.tolist()]
    for _ in range(subdivisions - 1):  # data/ball.mesh is the first one
        middle, pieces, points = {}, [], [*vertices]
        for face in faces:
            corners = []
            for edge in itertools.pairwise((*face, face[0])):
                if frozenset(edge) not in middle:
                    point = vertices[edge[0]] + vertices[edge[1]]
                    middle[frozenset(edge)] = len(points)
                    points.append(point / np.linalg.norm(point))
                corners.append(middle[frozenset(edge)])
            (a, b, c), (ab, bc, ca) = face, corners
            pieces += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        vertices, faces = np.array(points), pieces
    # filled from an inner point
    tets = [(len(vertices), *face) for face in faces]
    vertices = 6.0 * np.concatenate([vertices, np.zeros((1, 3))])
    lowest = vertices[:, 1].min()
    shape = vertices, np.array(faces), np.array(tets)
    return Mesh("ball", *shape, 1.0, [[0, -lowest, 0]], [[1, 0, 0, 0]], False)


def bowl(ball, mu=0.5, e=0.5):
    """(v along x, ω r) of a ball thrown with 20 m/s and no spin, as means over a second.

    A solid ball slides until v = ω r. Friction F turns it, F r = ⅖ m r² dω/dt, and slows it,
    F = -m dv/dt, so that v + ⅖ ω r stays: 7/5 v = v_0 at the end, after 2/7 v_0/(μ g) = 1.2 s. The
    second begins half as much later.
    """
    throw(ball, (20.0, 0, 0))
    rows = []
    begin = round(1.5 * 2 / 7 * 20.0 / (mu * G) / H)
    for _ in range(begin + 50):
        run_timestep([ball], ground(), H, e, mu=mu)
        rows.append((ball.linVelocity[0, 0], -6.0 * ball.angVelocity[0, 2]))
    return np.mean(rows[begin:], axis=0)


def test_thrown_ball_begins_to_roll():
    # The balls are polyhedra of 42, 162 and 642 vertices. Rolling over a facet, they fall from
    # vertex to vertex and lose some speed at each, in proportion to the angle between them, which a
    # subdivision halves: 18 %, 8 % and 4 % are missing after a second and a half.
    missing = []
    for subdivisions, slip in ((1, 0.04), (2, 0.015), (3, 0.005)):
        v, rim = bowl(icosphere(subdivisions))
        assert rim == pytest.approx(v, rel=slip)
        missing.append(1 - v / (5 / 7 * 20.0))
    assert 0.01 < missing[2] < 0.06
    assert np.divide(missing[1:], missing[:-1]) == pytest.approx(0.5, abs=0.12)
