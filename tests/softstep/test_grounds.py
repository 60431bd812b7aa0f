"""The soft step on grounds of many bodies, with loads and blows, and when supports are removed.

Cases of each kind are made up, and compared with one long slab or with closed forms.
"""

import itertools

import experiments
import numpy as np
import pytest
from engines import throw
from experiments import MOVERS, above, box, in_lanes, roller, tiles
from oracles import box_body, ground, minkowski_depth, penetrations, quaternion, rotation, state_of

from rbs.softstep.step import SolverState
from RBSFunctions import run_timestep
from RigidBodySimulation import shapes

G, H = 9.8, 0.02


def run(meshes, seconds, **settings):
    """The solver's state after steps, without ground and friction unless they are given."""
    settings = {"mu": 0.0, "hasGround": False} | settings
    return experiments.run("soft step", meshes, seconds, **settings)[0].settings["solverState"]


def prism(sides, radius, height):
    """A flat prism that lies on y = 0."""
    turn = quaternion((0, 1, 0), 6)
    return above(shapes.cylinder(radius, height, 1.0, sides=sides, orientation=turn))


def triangles(side=1.4, rows=4, count=10):
    """Fixed prisms of height 0.7 below y = 0 from x = -2 on."""
    depth, meshes = side * np.sqrt(0.75), []
    for k, r in itertools.product(range(count), range(rows)):
        x, z = -2 + (k + r % 2) * side / 2, (r - rows / 2) * depth
        near, far = (z, z + depth) if k % 2 == 0 else (z + depth, z)
        corners = (x, near), (x + side, near), (x + side / 2, far)
        points = np.array([(a, y, b) for a, b in corners for y in (-0.7, 0)])
        meshes.append(shapes.convex_hull(points, 1.0, isFixed=True))
    return meshes


def moving_tiles(velocity, spin):
    """Tiles that move together, and turn about the origin."""
    turn = np.array([0.0, spin, 0.0])
    return [throw(one, velocity + np.cross(turn, one.position[0]), turn) for one in tiles()]


def slab(depth=100):
    return [box_body(100, 1, depth, (0, -0.5, 0), isFixed=True)]


def free_row(width=1.0, height=1.0, depth=2.0):
    places = [(-2 + width * k, -0.5 * height, 0) for k in range(round(9 / width))]
    return [box_body(width, height, depth, place) for place in places]


def spun(spin, x=0.0, y=0.2, z=0.0):
    """A flat box that spins about its vertical axis."""
    return throw(box_body(1.2, 0.4, 0.9, (x, y, z)), spin=(0.0, spin, 0.0))


def slide(lanes, seconds=1.2, **settings):
    """`(way, speed, lift)` (lanes,) of movers over floors: parts of the velocity, and metres.

    lanes : (mover, floor, velocity); the floors stand on the ground
    """
    worlds = []
    for mover, floor, velocity in lanes:
        rise = -min(mesh.currVertices[:, 1].min() for mesh in floor)
        worlds.append([mover, *floor])
        for mesh in worlds[-1]:
            mesh.position = mesh.position + (0, rise, 0)
        mover.linVelocity = np.array([velocity], dtype=float)
    meshes, movers = in_lanes(*worlds), [lane[0] for lane in lanes]
    start, heights = np.array([mesh.position[0] for mesh in movers]), []
    settings |= {"hasGround": True}
    settings["watch"] = lambda: heights.append([mesh.position[0, 1] for mesh in movers])
    run(meshes, seconds, **settings)
    velocity = np.array([lane[2] for lane in lanes], dtype=float)
    square = (velocity**2).sum(axis=1)
    moved = np.array([mesh.position[0] for mesh in movers]) - start
    way = (moved * velocity).sum(axis=1) / square / seconds
    speed = (np.array([mesh.linVelocity[0] for mesh in movers]) * velocity).sum(axis=1) / square
    return way, speed, np.max(heights, axis=0) - start[:, 1]


SEAMS = {
    "slowly": (lambda: box(0.3), tiles, (0.4, 0, 0)),
    "fast": (box, tiles, (11, 0, 0)),
    "turned tiles": (box, lambda: tiles(turn=20), (3, 0, -1)),
    "narrow tiles": (box, lambda: tiles(0.1, rows=1, count=70), (3, 0, 0)),
    "uneven by 0.1 mm": (box, lambda: tiles(uneven=1e-4), (3, 0, 1)),
    "a flat triangle": (lambda: prism(3, 0.6, 0.2), lambda: tiles(turn=33), (8, 0, -4)),
    "a flat pentagon": (lambda: prism(5, 0.6, 0.2), lambda: tiles(turn=33), (8, 0, -4)),
    "a thin hexagon": (lambda: prism(6, 0.6, 0.02), tiles, (3, 0, 1)),
    "a ball": (MOVERS["ball"], tiles, (8, 0, 0)),
    "free row": (box, free_row, (3, 0, 0)),
    "free row, narrow": (box, lambda: free_row(0.4), (3, 0, 0)),
    "heavy rider": (lambda: box(density=8.0), lambda: free_row(2.0, 0.2, 3.0), (3, 0, 0.1)),
    "landing": (lambda: box(-0.52, 0.8), tiles, (5, 0, 0)),
    "landing on triangles": (lambda: above(prism(6, 0.6, 0.5), 0.5), triangles, (3, 0, 0.2)),
    "free row, spinning": (lambda: spun(12, 0, 0.2), lambda: free_row(1.04, 0.5, 3), (0.6, 0, 0)),
    "tiles that move": (box, lambda: moving_tiles((1, 0, 0), 0.0), (3, 0, 0)),
    "tiles that turn": (box, lambda: moving_tiles((0, 0, 0), 0.3), (3, 0, 0)),
    "spinning": (lambda: spun(6, 0, 0.2, 0), lambda: tiles(0.9, 0.9, 5), (2, 0, 0)),
    "spinning fast": (lambda: spun(25, 0.1, 0.2, 0.2), lambda: tiles(0.9, 0.9, 5), (2, 0, 0)),
}


def test_what_slides_over_seams_does_not_feel_them():
    made = [(make(), floor(), velocity) for make, floor, velocity in SEAMS.values()]
    way, speed, lift = slide(made)
    isFelt = (abs(way - 1) > 0.02) | (abs(speed - 1) > 0.02) | (lift > 5e-3)
    assert not list(itertools.compress(SEAMS, isFelt))


def test_what_rolls_over_seams_does_not_feel_them():
    """Within 5 %, as much as time steps of 0.02 and 0.005 s differ. If bodies touched beyond edges,
    the prisms would come 0.55 to 0.9 of their way, and rise by 0.1 m.
    """
    lanes = []
    for k, make in enumerate((MOVERS["ball"], lambda: roller(16), lambda: roller(32))):
        speed, width = (1, 3, 3)[k], (1.1, 0.5, 1.1)[k]
        for floor in (slab(20), tiles(width, width, count=round(12 / width))):
            mover = throw(make(), spin=(0.0, 0.0, -2.0 * speed))
            lanes.append((mover, floor, (speed, 0, 0)))
    way, _, lift = slide(lanes, 1.5, mu=0.5)
    assert way[::2].min() > 0.6 and way[1::2] == pytest.approx(way[::2], rel=0.05)
    assert (lift[1::2] < lift[::2] + 5e-3).all()


def test_thin_plates_lie_on_each_other():
    """Dropped, by up to 0.6; they sink in by 0.012 if they lie straight. All points count that
    overlap, or will: otherwise, a plate that lands on one corner gets through the one below it.
    That happens in a few of the heaps, which differ in their random numbers only.
    """
    lanes, thickness = [], np.array([0.06, *[0.03] * 41])
    for seed, thin in enumerate(thickness):
        rng, meshes = np.random.default_rng(seed), []
        for k in range(8):
            axis = (0.03 * rng.normal(), 1, 0.03 * rng.normal())
            height = thin * (k + 0.5) + 0.05 + 0.08 * k
            place = rng.uniform(-0.1, 0.1), height, rng.uniform(-0.1, 0.1)
            turn = quaternion(axis, rng.uniform(-40, 40))
            meshes.append(box_body(0.9, thin, 0.7, place, orientation=turn))
        assert len(penetrations(meshes)) == 0
        lanes.append(meshes)
    run(in_lanes(*lanes), 1.2, hasGround=True, mu=0.5)
    heights = np.array([[mesh.position[0, 1] for mesh in meshes] for meshes in lanes])
    off = np.abs(heights - np.outer(thickness, np.arange(8) + 0.5)).max(axis=1)
    assert off[:2].max() < 0.02 and np.count_nonzero(off > 0.02) <= 6
    assert min(mesh.currVertices[:, 1].min() for meshes in lanes for mesh in meshes) > -0.006


def test_what_stands_out_of_the_floor_stops_a_box_and_a_step_down_does_not():
    """Steps up, and an edge of 2 cm; the body below it reaches beyond the plane of the floor only
    with this edge. With time steps down to 0.00125 s, the box rests on it after 0.78 to 0.87 m.
    """
    q, half, lanes = quaternion((0, 0, 1), 45), 0.15 * np.sqrt(2), []
    edge = box_body(0.3, 0.3, 0.3, (1.2, 0.02 - half, 0), orientation=q, isFixed=True)
    for height in (0.05, 0.2, -0.01):
        floor = [box_body(4, 1, 4, (-1, -0.5, 0), isFixed=True)]
        floor.append(box_body(20, 1, 4, (11, height - 0.5, 0), isFixed=True))
        lanes.append((box(), floor, (1, 0, 0)))
    way, speed, _ = slide([*lanes, (box(), [edge, *slab(4)], (1, 0, 0))], 2.0)
    assert way[:2].max() < 0.3 and speed[[0, 1, 3]].max() < 0.05
    assert speed[2] == pytest.approx(1.0, abs=0.05) and 0.75 < 2.0 * way[3] < 0.9


def test_what_slides_down_a_slope_goes_on_where_it_meets_the_floor():
    """At the speed along the floor: neither slope nor floor pushes back. MuJoCo has it, too."""
    lanes, due = [], []
    for degrees, width, way, speed in (
        *((3, 60, 2, 5), (8, 2, 2, 5), (14.3, 2, 2, 5), (30, 60, 2, 5), (5, 60, 3.13, 0)),
        *((10, 60, 10, 0), (14.3, 60, 3.37, 0), (20, 60, 3, 0), (25, 2, 3.29, 0)),
    ):
        q = quaternion((0, 0, 1), -degrees)
        turn = rotation(q)
        mover = box(*turn.apply((-way, 0.5, 0)), orientation=q)
        throw(mover, turn.apply((speed, 0, 0)))
        slope = box_body(40, 1, 4, turn.apply((-20, -0.5, 0)), orientation=q, isFixed=True)
        places = [((k + 0.5) * width, -0.5, 0) for k in range(3)]
        lanes.append([mover, slope, *(box_body(width, 1, 4, p, isFixed=True) for p in places)])
        end = np.sqrt(speed**2 + 2 * G * (way - 0.5) * np.sin(np.radians(degrees)))
        due.append(end * np.cos(np.radians(degrees)))
    found, movers = np.full(len(due), np.nan), [lane[0] for lane in lanes]

    def watch():
        for k, mesh in enumerate(movers):
            if np.isnan(found[k]) and mesh.position[0, 0] > 2.0:
                found[k] = mesh.linVelocity[0, 0]

    run(in_lanes(*lanes), 4.0, watch=watch)
    assert (found > 0.95 * np.array(due)).all()


def log_on_plank(kind, rng):
    """`(bodies, changes)`: a log that lies on a plank, and a block at its next side.

    changes : (body, shift, orientation or None), after a step. The block gets 1 to 2 cm into the
        log: after the plank or the log has turned, so that an end of the plank is 0.1 above the
        place where they touch; or it was flush with the plank, and rises, or both others sink
    """
    sides = int(rng.integers(12, 25))
    turn, half = 2 * np.pi / sides, 1.5 * np.sin(np.pi / sides)
    log = above(shapes.convex_hull(roller(sides).origVertices * (3.0, 3.0, 5.0), 1.0))
    if kind in ("plank turns", "log turns"):
        outward, middle = np.array([np.sin(turn), -np.cos(turn), 0.0]), log.position[0, 1]
        away, q = 1000 * outward, quaternion((0, 0, 1), np.degrees(turn))
        place = (0, middle, 0) + (middle + 0.24) * outward + away
        block = box_body(1.6 * half, 0.5, 0.9, place, orientation=q)
        plank = box_body(4, 2, 24, (0.9 * half - 2, -0.999, 0))
        turned = plank if kind == "plank turns" else log
        q = quaternion((1, 0, 0), rng.choice((-0.46, 0.46)))
        shift = rotation(q).apply(turned.position[0]) - turned.position[0]
        changes = [(block, -away, None), (turned, shift, q)]
    else:
        ahead = rng.uniform(0.003, 0.006)
        corners = ((0, 0), (-1, -4), (1, -4))
        ridge = [(x, y, z) for x, y in corners for z in (0.05, 1.65)]
        block = shapes.convex_hull(np.array(ridge) + (half + ahead, ahead * np.tan(turn), 0), 1.0)
        plank = box_body(4, 2, 4, (0, -0.9995, -2.05))
        if kind == "block rises":
            changes = [(block, (0, 0.018, 0), None)]
        else:
            changes = [(mesh, (0, -0.018, 0), None) for mesh in (log, plank)]
    bodies = log, plank, block
    return [bodies[k] for k in rng.permutation(3)], bodies, changes


def test_contacts_show_how_deep_bodies_are_in_each_other():
    """Otherwise, nothing pushes them apart."""
    rng, made = np.random.default_rng(1), []
    kinds = "plank turns", "log turns", "block rises", "log sinks"
    for kind in kinds:
        made += [log_on_plank(kind, rng) for _ in range(12)]
    meshes = in_lanes(*(lane for lane, *_ in made))
    number = {id(mesh): k for k, mesh in enumerate(meshes)}
    settings = {"gravity": (0.0, 0.0, 0.0), "mu": 0.0, "hasGround": False}
    settings["solverState"] = run(meshes, H, **settings)
    for mesh, shift, orientation in itertools.chain(*(changes for *_, changes in made)):
        mesh.position = mesh.position + np.array([shift])
        if orientation is not None:
            mesh.orientation = np.array([orientation])
    pairs = [(log, block) for _, (log, _, block), _ in made]
    deep = [minkowski_depth(a.currVertices, b.currVertices) for a, b in pairs]
    report, shown = experiments.run("soft step", meshes, H, **settings)[0].report, {}
    for c in report.contacts:
        shown[c.body1, c.body2] = max(c.depth, shown.get((c.body1, c.body2), 0.0))
    found = [shown.get(tuple(sorted((number[id(a)], number[id(b)]))), 0.0) for a, b in pairs]
    hidden = (np.array(deep) - found).reshape(len(kinds), -1).max(axis=1)
    assert min(deep) > 9e-3 and not list(itertools.compress(kinds, hidden > 3e-3))


# Blows, energy, loads


def test_a_blow_on_tiles_is_not_repeated():
    """If it were, a wall would throw a box back at a tenth of its speed."""
    lanes, due = [], []
    for isFixed, speed in (True, 2.0), (True, 5.0), (False, 2.0), (False, 3.0):
        mover = throw(box(), (speed, 0.0, 0.3 * speed * isFixed))
        other = box_body(1, 1, 1 + 9 * isFixed, (2.2, 0.5, 0), isFixed=isFixed)
        lanes.append([mover, other, *tiles(1.1, 1.1, rows=8)])
        ends = ((0, 0, 0.3), (0, 0, 0)) if isFixed else ((0.5, 0, 0), (0.5, 0, 0))
        due.append(speed * np.array(ends))
    run(in_lanes(*lanes), 1.7)
    ends = np.array([[mesh.linVelocity[0] for mesh in lane[:2]] for lane in lanes])
    assert ends[:2] == pytest.approx(np.array(due[:2]), abs=0.07)
    assert ends[2:] == pytest.approx(np.array(due[2:]), abs=0.02)


def test_what_starts_deep_in_the_ground_and_below_another_comes_out():
    """Being pushed out, they have no velocity, but do not sleep. A load may stay, and sag."""
    lanes, ratios = [], (1, 1, 10, 100)
    for ratio, x, degrees in zip(ratios, (0, -0.4, 0, -0.4), (0, 10, 0, 10), strict=True):
        low = box(x, -0.4, orientation=quaternion((0, 1, 0.3), degrees))
        lanes.append([low, box(0.1, orientation=quaternion((0, 1, 0), 20), density=ratio)])
    run(in_lanes(*lanes), 4.0, hasGround=True, mu=0.5)
    for ratio, meshes in zip(ratios, lanes, strict=True):
        assert min(mesh.currVertices[:, 1].min() for mesh in meshes) > -1e-3 - 2.5e-4 * ratio


# Sleep, and supports that are removed


def test_contacts_of_sleepers_balance_gravity():
    """A stack, a box on two others, and a plank that leans against a wall."""
    meshes = [box(0.1 * (k % 2), 0.5 + k) for k in range(6)]
    meshes += [box(4.0, 0.5), box(5.2, 0.5), box(4.5, 1.5)]
    meshes.append(box_body(0.2, 2, 1, (9, 0.95, 0), orientation=quaternion((0, 0, 1), -20)))
    meshes.append(box_body(0.2, 4, 4, (9.8, 2, 0), isFixed=True))
    state = run(meshes, 10.0, hasGround=True, mu=0.6)
    for isWhole in (True, False):
        if not isWhole:  # wakes, with the box below
            meshes[5].angVelocity = np.array([[0.0, 1e-4, 0.0]])
        given = {"contactSolver": "soft-step", "mu": 0.6, "solverState": state}
        report, net = run_timestep(meshes, ground(), H, 0.0, **given), np.zeros((11, 6))
        sleepers = [k for k in range(10) if isWhole or k not in (4, 5)]
        assert np.flatnonzero(report.isAsleep).tolist() == sleepers
        for c in report.contacts:
            force = np.multiply(c.normal, c.impulse) + c.friction
            for k, sign in ((c.body1, -1), (c.body2, 1)):
                if k >= 0:
                    lever = meshes[c.body1].position[0] + c.arm - meshes[k].position[0]
                    net[k] += sign * np.concatenate((force, np.cross(lever, force)))
        weight = np.array([G * H * mesh.mass for mesh in meshes])
        net[:, 1] -= weight
        assert np.abs(net[sleepers] / weight[sleepers, None]).max() < 0.05


def test_what_others_hold_stays_where_it_is_if_one_support_is_removed():
    """A plank with five cubes on two of three legs, and a pyramid without a stone. If the loads
    above a body that is held ended, too, the topmost cube would sink by 5 mm.
    """
    legs = [box_body(0.4, 1, 1, (x, 0.5, 0)) for x in (0, -2, 2)]
    plank = [*legs, box_body(5, 0.5, 1, (0, 1.25, 0)), *(box(0, 2.0 + k) for k in range(5))]
    stones = [box(1.1 * (c - (3 - r) / 2), 0.5 + r) for r in range(4) for c in range(4 - r)]
    meshes = in_lanes(plank, stones)
    state = run(meshes, 2.0, hasGround=True, mu=0.5)
    for gone in (9 + 5, 0):  # from the last
        state.remove(gone)
        del meshes[gone]
    start = state_of(meshes)[:, :3]
    run(meshes, 0.6, hasGround=True, mu=0.5, solverState=state)
    assert 1e-4 < np.abs(state_of(meshes)[:, :3] - start).max() < G * H**2 / 2


# Grounds that move, and bodies that are linked


@pytest.mark.parametrize("size", [1.0, 4e-4])
@pytest.mark.parametrize("velocity, spin", [((1, 0, -0.5), 0.0), ((0, 0, 0), 0.5)])
def test_a_ground_that_starts_to_move_wakes_and_carries_what_rests_on_it(velocity, spin, size):
    """However slowly."""
    velocity, spin = size * np.array(velocity), size * spin
    isGround, options = spin == 0.0, {"mu": 1.0, "contactSolver": "soft-step"}
    floor, mesh, state = ground() if isGround else slab()[0], box(1.0), SolverState()

    def step(seconds):
        for _ in range(round(seconds / H)):
            meshes = [mesh] if isGround else [mesh, floor]
            plane = floor if isGround else None
            run_timestep(meshes, plane, H, 0.0, solverState=state, **options)

    step(2.0)
    assert state.sleep.isAsleep[0]
    floor.linVelocity, floor.angVelocity = np.array([velocity]), np.array([[0.0, spin, 0.0]])
    step(1.0)
    due = velocity + np.cross([0, spin, 0], mesh.position[0])
    assert mesh.linVelocity[0] == pytest.approx(due, abs=0.01 * size)
    assert mesh.angVelocity[0] == pytest.approx([0, spin, 0], abs=0.01 * size)
    floor.linVelocity, floor.angVelocity = np.zeros((2, 1, 3))
    step(2.0)
    assert state.sleep.isAsleep[0] and not mesh.linVelocity.any()


def test_a_sleeping_stack_moves_like_one_that_never_sleeps():
    """Its support begins to move, however slowly: along, up, down, about its axis."""
    ends = []
    for sleeping in (True, False):
        lanes = [[*slab(40), *(box(0.0, 0.5 + k) for k in range(3))] for _ in range(4)]
        meshes, state = in_lanes(*lanes, width=60.0), SolverState()
        along, up, down, turned = (lane[0] for lane in lanes)
        for k in range(200):
            if k == 100:
                along.linVelocity = np.array([[0.03, 0.0, 0.0]])
                assert state.sleep.isAsleep.sum() == 12 * sleeping
            if k >= 100:
                up.position = up.position + (0, 5e-4, 0)
                down.position = down.position - (0, 5e-4, 0)
                turned.orientation = quaternion((0, 1, 0), 0.02 * (k - 99))[None]
            run(meshes, H, mu=0.5, sleeping=sleeping, solverState=state)
        ends.append(state_of(meshes)[:, :7])
    assert np.allclose(*ends, atol=2e-3)
    tops = ends[0][3::4] - [(0, 2.5, 60 * k, 1, 0, 0, 0) for k in range(4)]
    moved = tops[[0, 1, 2, 3], [0, 1, 1, 5]]
    assert moved == pytest.approx([0.06, 0.05, -0.05, 0.0174], abs=0.005)


@pytest.mark.parametrize("mu, gravity, way", [(0.5, (0, 5, 0), 2.5), (0.0, (1, -G, 0), 0.5)])
def test_a_sleeping_stack_moves_when_gravity_turns_or_friction_ends(mu, gravity, way):
    meshes = [box(0.0, 0.5 + k) for k in range(3)]
    state = run(meshes, 2.0, hasGround=True, mu=0.5)
    assert state.sleep.isAsleep.all()
    start = state_of(meshes)[:, :2]
    run(meshes, 1.0, hasGround=True, mu=mu, solverState=state, gravity=gravity)
    assert (state_of(meshes)[:, :2] - start).max(axis=1) == pytest.approx(way, abs=0.03)


def test_linked_bodies_pass_through_each_other_if_they_may():
    """A row of cubes, each tied to the next along their common upper edge, folds."""
    ends = {}
    kinds = {"broadPhase": "grid"}, {"contactScheduling": "batches"}, {"contactSolver": "soft-step"}
    for collide in (True, False):
        for k, options in enumerate(({}, *kinds)):
            meshes = [box(1.0 * i, 20, isFixed=i == 0) for i in range(3)] + [box(9.0, 20)]
            state = SolverState() if k == 3 else None
            a, b = (m.currVertices for m in meshes[:2])
            shared = np.argwhere(np.linalg.norm(a[:, None] - b, axis=2) < 1e-9).tolist()
            upper = [(i, j) for i, j in shared if a[i, 1] > 20]
            links = [[1, j, 0, i, 0.0, True] for i, j in upper]  # in either order
            links += [[1, i, 2, j, 0.0, True] for i, j in upper]
            options = options | {"constraints": links, "linkedBodiesCollide": collide}
            for _ in range(10):
                run_timestep(meshes, None, H, 0.0, solverState=state, **options)
            depth = max(m.detect_collision(n)[1] for m, n in itertools.pairwise(meshes[:3]))
            assert (depth < 0.1) == collide
            ends[k, collide] = state_of(meshes)
        assert all(np.array_equal(ends[0, collide], ends[k, collide]) for k in (1, 2))
    assert not np.array_equal(ends[0, True], ends[0, False])
