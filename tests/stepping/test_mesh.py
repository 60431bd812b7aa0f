"""Mesh: mass properties by quadrature, and what a caller may pass, assign and keep."""

import copy
import gc
import math
import pickle
import warnings
import weakref

import numpy as np
import oracles
import pytest
from oracles import IDENTITY, SHAPES, body, box_body, ground, random_quaternions, shape, turned

from rbs.softstep.step import SolverState
from rbs.stepping.meshes import StateError
from rbs.stepping.settings import GRAVITY
from RBSFunctions import Mesh, refresh_vertices, resolve_collision, run_timestep
from RigidBodySimulation import shapes

# Sums over some hundred tetrahedra in double precision.
ROUNDING = 1e-12


def by_quadrature(vertices, tets):
    """Volume, COM, and inertia tensor about it for density 1.

    By the four-point Gauss rule in each tetrahedron, exact for the squares in S = ∫ x xᵀ. The
    tensor is tr(C) 1 - C with C = S - V c cᵀ.
    """
    far, near = (5 + 3 * math.sqrt(5)) / 20, (5 - math.sqrt(5)) / 20
    corners = vertices[tets]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    points = ((near + (far - near) * np.eye(4)) @ corners).reshape(-1, 3)
    w = np.repeat(volumes / 4, 4)
    volume, centre = w.sum(), w @ points / w.sum()
    C = (w[:, None] * points).T @ points - volume * np.outer(centre, centre)
    return volume, centre, np.trace(C) * np.eye(3) - C


# No factor of these hides in another: a missing density, a volume for a determinant, or a second
# power of the scale where the fifth belongs shows in every one.
@pytest.mark.parametrize(("density", "scale"), [(0.37, 0.013), (1.9, 311.0)])
@pytest.mark.parametrize("name", SHAPES)
def test_mass_properties_by_quadrature(name, density, scale):
    """Turned shapes, with full tensors, away from the origin; tetrahedra in any orientation."""
    vertices, faces, tets = shape(name)
    rng = np.random.default_rng(SHAPES.index(name))
    tets = rng.permuted(tets, axis=1)
    vertices = scale * (turned(vertices, random_quaternions(rng, 1)[0]) + [9, -7, 5])
    volume, centre, tensor = by_quadrature(vertices, tets)
    mesh = Mesh(name, vertices, faces, tets, density, np.zeros(3), IDENTITY, False)
    assert mesh.volume == pytest.approx(volume, rel=ROUNDING)
    assert [mesh.mass, 1 / mesh.invMass] == pytest.approx(2 * [density * volume], rel=ROUNDING)
    assert np.abs(vertices - centre - mesh.origVertices).max() < ROUNDING * np.ptp(vertices)
    assert np.abs(mesh.IT / density - tensor).max() < ROUNDING * np.abs(tensor).max()
    assert np.abs(mesh.invIT @ (density * tensor) - np.eye(3)).max() < 10 * ROUNDING


def test_the_callers_arrays_are_not_modified_and_not_kept():
    given = [array.copy() for array in shape("tetrahedron")]
    given += [np.array([[1.0, 2.0, 3.0]]), np.array([[2.0, 0.0, 0.0, 2.0]])]
    before = [array.copy() for array in given]
    mesh, other = Mesh("", *given[:3], 1.0, *given[3:], False), body("box", (2, 2, 3))
    resolve_collision(mesh, other, 0.1, [1, 0, 0], [2, 2, 3], 0.5)
    run_timestep([mesh, other], ground(), 0.1, 0.5)
    assert mesh.position[0, 0] != 1  # something did happen
    assert all(np.array_equal(a, b) for a, b in zip(given, before, strict=True))
    # and what the caller does to the arrays later is no business of the mesh
    names = "origVertices", "faces", "tets", "position", "orientation"
    kept = [getattr(mesh, name).copy() for name in names]
    for array in given:
        array[:] = 1
    assert all(np.array_equal(getattr(mesh, n), x) for n, x in zip(names, kept, strict=True))


def stepped(meshes, **options):
    run_timestep(meshes, ground(), 0.02, 0.5, **options)


def boxes(count):
    return [box_body(1.0, 2.0, 1.5, (3.0 * k, 50.0, 0.0)) for k in range(count)]


@pytest.mark.parametrize("way", [{}, {"contactScheduling": "batches"}])
def test_what_a_caller_writes_counts_and_what_a_caller_keeps_stays(way):
    meshes = boxes(2)
    meshes[0].linVelocity[0, 1] = 10.0
    for part in (lambda row: row, lambda row: row[0], lambda row: row.T):
        kept = part(meshes[1].position)
        before = kept.copy()
        stepped(meshes, **way)
        assert np.array_equal(kept, before)
        assert not np.array_equal(part(meshes[1].position), before)
    assert meshes[0].linVelocity[0, 1] == pytest.approx(10.0 + 3 * GRAVITY * 0.02)
    for vertices in (boxes(1)[0].currVertices, refresh_vertices(boxes(2))):
        with pytest.raises(ValueError, match="read-only"):
            vertices[0] = 7.0


def test_states_in_tables_are_those_of_a_loop_whatever_a_caller_does():
    """To the meshes, to the list and its order, and to the vertices."""
    rng = np.random.default_rng(11)
    ones, many = boxes(6), boxes(6)

    def assign(mesh, name, value):
        setattr(mesh, name, value * (1.0 / np.linalg.norm(value)))

    def add(mesh, name, value):
        if name != "orientation":
            getattr(mesh, name)[:] += value

    def fix(mesh, name, value):
        mesh.isFixed = not mesh.isFixed

    def halve(mesh, name, value):
        mesh.invIT[:] *= 0.5

    def grow(mesh, name, value):
        mesh.vertex_at(0.01 * value[0, :3])

    def drive(mesh, name, value):
        mesh.set_force(value[0, :3], -value[0, :3])

    done = set()
    for _ in range(120):
        change, name = rng.choice((assign, add, fix, halve, grow, drive)), rng.choice(oracles.STATE)
        value, k = rng.normal(size=(1, 4 if name == "orientation" else 3)), rng.integers(6)
        copies = [copy.copy(many[k]), copy.deepcopy(many[k]), pickle.loads(pickle.dumps(many[k]))]
        before, order = many[k].position.copy(), rng.permutation(6)[: rng.choice((0, 0, 3, 6))]
        for meshes, options in ((ones, {}), (many, {"contactScheduling": "batches"})):
            change(meshes[k], name, value)
            stepped([meshes[b] for b in order], **options)
            stepped(meshes, **options)
        done.add((change, name))
        for one, other in zip(ones, many, strict=True):
            for attribute in rng.permutation((*oracles.STATE, "currVertices"))[: rng.integers(6)]:
                assert np.array_equal(getattr(one, attribute), getattr(other, attribute))
        assert all(np.array_equal(mesh.position, before) for mesh in copies) or change is add
    assert len(done) > 20


WAYS = {
    "default": {},
    "queue": {"broadPhase": "grid", "constraintScheduling": "queue"},
    "batches": {"contactScheduling": "batches", "constraintScheduling": "batches"},
    "soft": {"contactSolver": "soft-step"},
}
ways = pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)


def pair(**settings):
    """A turned box above another; a rope between them is violated."""
    turn = oracles.quaternion([1, 2, 3], 40)
    lower = box_body(2, 3, 4, (0.0, 50.0, 0.0), orientation=turn, **settings)
    return [lower, box_body(1, 2, 2, (0.5, 53.5, 0.3), orientation=turn)]


@ways
@pytest.mark.parametrize("how", ["isFixed", "invMass", "invIT"])
def test_what_is_fixed_by_hand_is_as_what_was_fixed_at_the_start(way, how):
    """Whatever becomes of invIT: in contacts, constraints, pushes and torques."""
    runs = []
    for isByHand in (False, True):
        meshes = lower, upper = pair(isFixed=not isByHand)
        if isByHand and how == "isFixed":
            lower.isFixed = True
        elif isByHand:
            lower.invMass = 0.0
            lower.invIT = lower.invIT * (3.0 if how == "invIT" else 1.0)
        lower.set_force((1.0, 2.0, 3.0), (40.0, 50.0, 60.0))
        upper.linVelocity = np.array([[0.5, -9.0, 0.2]])
        for _ in range(3):
            lower.push((30.0, 20.0, 10.0), (1.0, 51.0, 1.0))
            ropes = [[0, 3, 1, 4, 0.5, True], [0, 2, 1, 6, 9.0, False]]
            run_timestep(meshes, None, 0.02, 0.5, constraints=ropes, mu=0.3, **way)
        assert lower.isFixed is True and not lower.get_rotated_inv_IT().any()
        runs.append(oracles.state_of(meshes))
    assert np.array_equal(*runs) and np.abs(runs[0][1, 10:]).max() > 0.1
    lower.isFixed = False
    run_timestep([lower], None, 0.02, 0.5, **way)
    assert lower.position[0, 1] < 50.0


def test_a_push_and_a_point_count_where_they_are():
    mesh, J = pair()[1], np.array([3.0, -2.0, 1.0])
    turn, point = oracles.rotation(mesh.orientation[0]), mesh.currVertices[3]
    mesh.push(J, point)
    assert mesh.linVelocity[0] == pytest.approx(J / mesh.mass)
    momentum = turn.apply(mesh.IT @ turn.inv().apply(mesh.angVelocity[0]))
    assert momentum == pytest.approx(np.cross(point - mesh.position[0], J))
    inside = np.array([0.1, 0.2, 0.0])
    assert [mesh.vertex_at(at) for at in (mesh.origVertices[3], inside, inside)] == [3, 8, 8]
    assert mesh.currVertices[8] == pytest.approx(mesh.position[0] + turn.apply(inside))


FORMS = {"flat": np.ravel, "list": np.ndarray.tolist}
FORMS["tuple"] = lambda rows: tuple(np.ravel(rows).tolist())


@pytest.mark.parametrize("form", FORMS)
def test_states_and_masses_may_be_assigned_in_any_shape(form):
    """Before and between steps, with the same bits as plain arrays."""
    for way in WAYS.values():
        runs = []
        for convert in (np.copy, FORMS[form]):
            meshes = lower, upper = pair()
            lower.invMass, upper.IT = convert(np.array([[0.25]])), convert(2.0 * upper.IT)
            upper.angVelocity = np.array([[1.0, 2.0, 3.0]])
            for name in (*oracles.STATE, "invIT"):
                for mesh in meshes:
                    setattr(mesh, name, convert(np.array(getattr(mesh, name))))
            found = [lower.detect_collision(upper), upper.lowest_vertex(), lower.bounding_box()]
            found += [lower.currVertices, lower.pose(), lower.get_rotated_inv_IT(), repr(lower)]
            ropes = [[0, 3, 1, 4, 0.5, True]]
            for _ in range(3):
                run_timestep(meshes, ground(), 0.02, 0.5, True, ropes, gyroscopic=True, **way)
                upper.invMass, upper.invIT = 0.5 * upper.invMass, convert(0.5 * upper.invIT)
            runs.append((repr(found), oracles.state_of(meshes).tobytes()))
        assert runs[0] == runs[1]


WRONG_MASSES = {"invMass": (-1.0, math.nan, math.inf, None, (1, 2))}
WRONG_MASSES |= {"IT": (np.eye(2), math.nan, None), "invIT": (np.full((3, 3), math.inf), "x")}
WRONG_MASSES |= {"currVertices": (np.eye(3), None, np.full((8, 3), math.nan))}


def test_what_makes_no_mass_is_refused_by_name_when_it_is_assigned():
    for name, values in WRONG_MASSES.items():
        for value in values:
            mesh = pair()[0]
            with pytest.raises(ValueError, match=f"mesh box: {name} must be "):
                setattr(mesh, name, value)
    for name in "mass density volume hullVolume origVertices faces tets".split():
        with pytest.raises(AttributeError, match=name):
            setattr(mesh, name, value := getattr(mesh, name))
        if isinstance(value, np.ndarray):
            with pytest.raises(ValueError, match="read-only"):
                value[0] = 0


@ways
@pytest.mark.parametrize("isFixed", [True, False])
@pytest.mark.parametrize(
    ("name", "value", "what"),
    [
        ("orientation", np.zeros((1, 4)), "the orientation is zero"),
        ("linVelocity", np.full((1, 3), math.nan), "linVelocity holds nan after the last step"),
        ("position", (0.0, 0.0, 1e99), "position holds 1e.99 after the last step"),
        ("position", np.zeros(2), "position must be 3 numbers"),
        ("linVelocity", [True, 2.0, 3.0], "linVelocity must be 3 numbers, not .True"),
        ("angVelocity", [None, 1.0, 2.0], "angVelocity holds nan after the last step"),
    ],
)
def test_a_state_in_which_no_step_can_begin_is_named(way, isFixed, name, value, what):
    meshes = pair(isFixed=isFixed)
    setattr(meshes[0], name, value)
    with warnings.catch_warnings(), pytest.raises((StateError, ValueError), match=what) as error:
        warnings.simplefilter("error")
        run_timestep(meshes, ground(), 0.02, 0.5, **way)
    assert "body 0, 'box'" in str(error.value)


def test_the_ground_is_fixed():
    for way in WAYS.values():
        with pytest.raises(ValueError, match="groundMesh must be fixed"):
            run_timestep([], pair()[0], 0.02, 0.5, **way)
        for name, value in (("linVelocity", (0.0, 0.1, 0.0)), ("angVelocity", (0.0, 1.0, 0.1))):
            floor = ground()
            setattr(floor, name, np.array([value]))
            with pytest.raises(ValueError, match="slide along its plane and turn about y"):
                run_timestep(pair(), floor, 0.02, 0.5, **way)


def mesh_with(name):
    """A function that makes a box, one of whose arguments is another value."""
    given = dict(zip(("origVertices", "faces", "tets"), shape("box"), strict=True))
    given |= {"density": 1.0, "position": [0, 0, 0], "orientation": (1, 0, 0, 0), "isFixed": False}
    return lambda value: Mesh("wrong", **given | {name: value})


VERTICES, FACES, TETS = shape("box")
TURNED = np.append(FACES[:3, ::-1], FACES[3:], axis=0)
REFUSED = {
    "orientation": (mesh_with("orientation"), ([0, 0, 0, 0], [1, 0, 0])),
    # four corners of one face; (12, 3), which would make nine rows of four
    "tet|volume": (mesh_with("tets"), (TETS + 1, [[0, 1, 2, 3]], FACES, None)),
    "face": (mesh_with("faces"), (FACES - 1, [[0, 1]])),
    "Vertices|volume": (mesh_with("origVertices"), (VERTICES * np.nan, VERTICES * [1, 1, 0], None)),
    "isFixed": (mesh_with("isFixed"), ("no",)),
    "no inverse, because it is too small": (mesh_with("origVertices"), (VERTICES * 1e-80,)),
    "a coordinate is not finite or beyond": (mesh_with("origVertices"), (VERTICES * 1e60,)),
    "outwards": (lambda x: Mesh("x", VERTICES, x, [], 1, (0, 0, 0), IDENTITY, False), (TURNED,)),
    "faces": (lambda x: shapes.from_surface("x", x, None, 1.0), (oracles.box(1, 1, 1), None, "")),
    "whole": (lambda x: shapes.from_surface("x", VERTICES, x, 1.0), (FACES + 0.5, [[True, 0, 1]])),
    "radius": (lambda x: shapes.sphere(x, 1), (-1, 0, math.nan, math.inf, "big", (1, 2))),
    "size": (lambda x: shapes.box(x, 1), (2.0, (1, -1, 1), (1, True, 1), None, [10**400] * 3)),
    "sides": (lambda x: shapes.cylinder(1, 1, 1, sides=x), (2, -3, 4.5, 10**9)),
    "points": (lambda x: shapes.convex_hull(x, 1), (np.eye(3), np.eye(4, 2), 3, ["123"])),
    "density": (lambda x: shapes.box((1, 1, 1), x), (0, -1, None, math.nan, True)),
    "position": (lambda x: shapes.box((1, 1, 1), 1, x), ((1, 2), math.nan, "here")),
    "force": (lambda x: pair()[0].set_force(x), ((1, 2), None, (0, 0, math.nan))),
    "load": (lambda x: setattr(pair()[0], "load", x), (3, "x", (1, 2), ((1, 2, 3), (4, 5)), True)),
    "point": (lambda x: pair()[0].vertex_at(x), ((1, 2), None, (9, 9, 9))),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_makes_no_body_is_refused_by_name(what):
    make, values = REFUSED[what]
    for value in values:
        with pytest.raises((TypeError, ValueError), match=f"mesh .*({what})"):
            make(value)


def test_a_ball_has_at_least_the_corners_asked_for():
    for asked, given in (4, 12), (12, 12), (13, 42), (162, 162), (163, 642):
        assert len(shapes.sphere(1.0, 1.0, corners=asked).hull.vertices) == given


def test_needles_whose_inertia_is_rounding_are_told_to_be_too_thin():
    told, turn = [], oracles.rotation((1.0, 0.5, 0.9, 0.2))
    for width in np.geomspace(1.5e-9, 9e-9, 20):
        try:
            mesh_with("origVertices")(turn.apply(VERTICES * [1.0, width, width]))
        except ValueError as error:
            told.append(str(error))
    assert len(told) > 4 and all("too thin" in one or "flat" in one for one in told)


@ways
def test_a_scene_goes_with_its_last_reference(way):
    gone = []
    for _ in range(3):
        meshes = pair()
        state = SolverState() if "contactSolver" in way else None
        for _ in range(2):
            link = [[0, 3, 1, 4, 0.5, True]]
            run_timestep(meshes, ground(), 0.02, 0.5, constraints=link, solverState=state, **way)
        gone += map(weakref.ref, meshes)
        kept = [mesh.position for mesh in meshes]
        del meshes, state
    gc.collect()
    assert [one for one in gone if one() is not None] == [] and len(kept) == 2
