"""Mesh: mass properties by three independent ways, and what a mesh does with what it is given."""

import copy
import math
import pickle

import numpy as np
import pytest
from oracles import (
    IDENTITY,
    SHAPES,
    body,
    box_body,
    ground,
    quaternion,
    random_quaternions,
    shape,
    turned,
)

from Quaternion import Q2RotMatrix
from rbs.stepping.settings import GRAVITY
from RBSFunctions import Mesh, refresh_vertices, resolve_collision, run_timestep

# Sums over some hundred tetrahedra in double precision.
ROUNDING = 1e-12

# No factor of these hides in another: a missing density, a volume for a determinant, or a second
# power of the scale where the fifth belongs shows in every one.
ODD = [(0.37, 0.013), (1.9, 311.0)]


# Three ways to (volume, COM (3,), inertia tensor (3, 3) about the COM for density 1).


def assembled(volume, centre, secondMoments):
    """I = tr(C) 1 - C with C = S - V c cᵀ, from V, the COM c and S = ∫ x xᵀ about the origin."""
    C = secondMoments - volume * np.outer(centre, centre)
    return volume, centre, np.trace(C) * np.eye(3) - C


def in_closed_form(name):
    """Uses the sizes in make_data.py. For a body with mean squares x², y², z² about its COM
    that is symmetric enough, the tensor is V diag(y² + z², z² + x², x² + y²).
    """
    centre = np.zeros(3)
    if name == "box":
        a, b, c = 12.0, 6.0, 8.0
        volume, squares = a * b * c, np.square([a, b, c]) / 12
    elif name == "tetrahedron":
        # Alternate corners of an a × b × c box: a third of its volume, x² = (4 (a/2)²)/20 = a²/20.
        a, b, c = 8.0, 7.0, 6.0
        volume, squares, centre = a * b * c / 3, np.square([a, b, c]) / 20, np.array([4, 3.5, 3])
    elif name in ("octahedron", "long-octahedron"):
        # Eight tetrahedra with three edges a, b, c from the origin: a b c/6 each, x² = 2 a²/20.
        a, b, c = (3.4, 3.4, 3.4) if name == "octahedron" else (10.4, 10.4, 1.4)
        volume, squares = 4 / 3 * a * b * c, np.square([a, b, c]) / 10
    elif name == "cylinder":
        # Prism on a regular n-gon of radius R: n triangles of area R² sin(φ)/2 with φ = 2π/n, and
        # the mean of x² + y² over a triangle (0, p, q) is (p² + q² + p·q)/6 = R² (2 + cos φ)/6.
        n, R, length = 20, 5.0, 20.0
        phi = 2 * math.pi / n
        volume = n / 2 * R * R * math.sin(phi) * length
        across = R * R * (2 + math.cos(phi)) / 12
        squares = np.array([across, across, length * length / 12])
    return volume, centre, volume * (squares.sum() * np.eye(3) - np.diag(squares))


def by_quadrature(vertices, tets):
    """The four-point Gauss rule in each tetrahedron, exact for the squares in S."""
    far, near = (5 + 3 * math.sqrt(5)) / 20, (5 - math.sqrt(5)) / 20
    weights = near + (far - near) * np.eye(4)
    corners = vertices[tets]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    points = (weights @ corners).reshape(-1, 3)
    w = np.repeat(volumes / 4, 4)
    return assembled(w.sum(), w @ points / w.sum(), (w[:, None] * points).T @ points)


def by_surface(vertices, faces):
    """Uses the faces alone, by the divergence theorem: ∫ x_k² dV = ⅓ ∮ x_k³ n_k dA, and so on.

    Every term is a polynomial of degree three over a triangle, for which this six-point rule
    (degree 4; Dunavant 1985) is exact. No tetrahedron is used.
    """
    a, b = 0.445948490915965, 0.091576213509771
    wa, wb = 0.223381589678011, 0.109951743655322
    rule = [(x, x, 1 - 2 * x, w) for x, w in ((a, wa), (b, wb))]
    corners = vertices[faces]
    areas = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for p, q, r, weight in rule:
        for bary in ((p, q, r), (q, r, p), (r, p, q)):
            x = np.einsum("k,fkd->fd", bary, corners)
            flux = weight * areas
            volume += (x * flux).sum() / 3
            first += (x * x * flux).sum(axis=0) / 2
            # ∫ x_k x_l dV = ½ ∮ x_k² x_l n_k dA for k ≠ l, and ⅓ ∮ x_k³ n_k dA for k = l
            mixed = np.einsum("fk,fl,fk->kl", x * x, x, flux)
            second += mixed / np.where(np.eye(3) > 0, 3, 2)
    return assembled(volume, first / volume, (second + second.T) / 2)


def assert_mass_properties(mesh, expected, restVertices, density, tolerance):
    """The mesh against (volume, COM, tensor for density 1); tolerance relative to the quantity."""
    volume, centre, tensor = expected
    extent = np.ptp(restVertices, axis=0).max()
    assert mesh.volume == pytest.approx(volume, rel=tolerance)
    assert mesh.mass == pytest.approx(density * volume, rel=tolerance)
    assert np.abs(restVertices - centre - mesh.origVertices).max() < tolerance * extent
    assert np.abs(mesh.IT - density * tensor).max() < tolerance * density * np.abs(tensor).max()
    assert mesh.invMass == pytest.approx(1 / (density * volume), rel=tolerance)
    assert np.abs(mesh.invIT @ (density * tensor) - np.eye(3)).max() < 10 * tolerance


@pytest.mark.parametrize("name", [name for name in SHAPES if name != "ellipsoid"])
def test_closed_forms(name):
    # The vertices in data/ are rounded to 1e-9, the sizes are 1.4 and more.
    mesh = body(name, density=0.37)
    assert_mass_properties(mesh, in_closed_form(name), shape(name)[0], 0.37, 1e-8)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize(("density", "scale"), ODD)
def test_mass_properties_by_quadrature_and_by_surface(name, density, scale):
    vertices, faces, tets = shape(name)
    rng = np.random.default_rng(SHAPES.index(name))
    # Turned, so that the tensor is full, and put down a few sizes away from the origin.
    vertices = scale * (turned(vertices, random_quaternions(rng, 1)[0]) + [9, -7, 5])
    mesh = Mesh(name, vertices, faces, tets, density, np.zeros(3), IDENTITY, False)
    if name != "octahedron":  # its moments are equal, so its tensor is diagonal however turned
        assert np.abs(mesh.IT - np.diag(np.diag(mesh.IT))).max() > 1e-3 * mesh.IT.max()
    byTets, byFaces = by_quadrature(vertices, tets), by_surface(vertices, faces)
    assert_mass_properties(mesh, byTets, vertices, density, ROUNDING)
    assert_mass_properties(mesh, byFaces, vertices, density, 100 * ROUNDING)


def test_the_orientation_of_a_tetrahedron_does_not_matter():
    vertices, faces, tets = shape("cylinder")
    shuffled = np.random.default_rng(5).permuted(tets, axis=1)
    corners = vertices[shuffled]
    assert 0 < (np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0).sum() < len(tets)
    one, other = (
        Mesh("", vertices, faces, t, 3.0, np.zeros(3), IDENTITY, False) for t in (tets, shuffled)
    )
    assert other.mass == pytest.approx(one.mass, rel=ROUNDING)
    assert np.abs(other.IT - one.IT).max() < ROUNDING * one.IT.max()


@pytest.mark.parametrize("name", SHAPES)
def test_rotated_inverse_tensor_is_that_of_the_rotated_body(name):
    vertices, faces, tets = shape(name)
    for q in random_quaternions(np.random.default_rng(11), 10):
        mesh = body(name, orientation=q, density=0.6)
        world = mesh.get_rotated_inv_IT()
        # R I⁻¹ Rᵀ by the formula …
        R = Q2RotMatrix(mesh.orientation)
        assert np.abs(world - R @ mesh.invIT @ R.T).max() < ROUNDING * np.abs(world).max()
        assert np.array_equal(world, world.T)
        # … and by its meaning: a mesh built from the turned vertices, itself not turned. This
        # distinguishes R I⁻¹ Rᵀ from Rᵀ I⁻¹ R.
        straight = Mesh(name, turned(vertices, q), faces, tets, 0.6, np.zeros(3), IDENTITY, False)
        assert np.abs(world - straight.invIT).max() < ROUNDING * np.abs(world).max()


def test_the_callers_arrays_are_not_modified_and_not_kept():
    vertices = shape("tetrahedron")[0].copy()
    faces, tets = (array.copy() for array in shape("tetrahedron")[1:])
    position, orientation = np.array([[1.0, 2.0, 3.0]]), np.array([[2.0, 0.0, 0.0, 2.0]])
    given = vertices, faces, tets, position, orientation
    before = [array.copy() for array in given]
    mesh = Mesh("", vertices, faces, tets, 1.0, position, orientation, False)
    other = body("box", (2, 2, 3))
    mesh.integrate_timestep(0.1)
    resolve_collision(mesh, other, 0.1, [1, 0, 0], [2, 2, 3], 0.5)
    run_timestep([mesh, other], ground(), 0.1, 0.5)
    assert mesh.position[0, 0] != 1  # something did happen
    assert all(np.array_equal(a, b) for a, b in zip(given, before, strict=True))
    # and what the caller does to the arrays later is no business of the mesh
    rest, current = mesh.origVertices.copy(), mesh.position.copy()
    for array in given:
        array[:] = 1
    assert np.array_equal(mesh.origVertices, rest) and np.array_equal(mesh.position, current)
    assert np.array_equal(mesh.tets, before[2]) and np.array_equal(mesh.faces, before[1])


def test_what_cannot_move_has_no_inverse_mass():
    fixed, nothing = body("box", isFixed=True, density=3.0), ground()
    for mesh in (fixed, nothing):
        assert mesh.invMass == 0.0 and not mesh.get_rotated_inv_IT().any()
        before = mesh.position.copy()
        mesh.linVelocity = np.ones((1, 3))
        mesh.integrate_timestep(0.1)
        assert np.array_equal(mesh.position, before)
        assert not nothing.detect_collision(mesh)[0] and not mesh.detect_collision(nothing)[0]
    assert fixed.mass == pytest.approx(3 * 12 * 6 * 8)
    assert fixed.IT[0, 0] == pytest.approx(fixed.mass * (6**2 + 8**2) / 12)


def test_boxes_and_collisions_follow_position_and_orientation_each_by_itself():
    """Moves or turns a box of 12 × 6 × 8 beside a small one, by assignment and in place."""
    long, small = body("box"), box_body(1.0, 1.0, 1.0, (0.0, 5.5, 0.0))
    upright = quaternion([0, 0, 1], 90)
    flat, low = long.orientation.copy(), long.position.copy()

    def touches():
        assert long.bounding_box_collision(small) == small.bounding_box_collision(long)
        assert long.bounding_box_collision(small) == long.detect_collision(small)[0]
        return long.bounding_box_collision(small)

    assert not touches()
    long.orientation = upright[None]
    assert touches()
    long.orientation[:] = flat
    assert not touches()
    long.position = low + np.array([[0.0, 2.5, 0.0]])
    assert touches()
    long.position[:] = low
    assert not touches()


def test_nonsense_raises():
    vertices, faces, tets = shape("box")
    names = "name origVertices faces tets density position orientation isFixed".split()
    values = "wrong", vertices, faces, tets, 1.0, [0, 0, 0], IDENTITY, False
    arguments = dict(zip(names, values, strict=True))
    Mesh(**arguments)
    for name, wrong in (
        ("orientation", [0, 0, 0, 0]),
        ("orientation", [1, 0, 0]),
        ("position", [[1, 2, 3], [4, 5, 6]]),
        ("faces", faces - 1),
        ("tets", tets + 1),
        ("tets", [[0, 1, 2, 3]]),  # four corners of one face
        ("tets", faces),  # (12, 3) would make nine rows of four
        ("density", 0.0),
        ("density", np.nan),
        ("origVertices", vertices * np.nan),
        ("origVertices", vertices * [1, 1, 0]),
    ):
        with pytest.raises(ValueError):
            Mesh(**arguments | {name: wrong})


def test_what_a_caller_writes_counts_and_what_a_caller_keeps_stays():
    meshes = boxes(2)
    stepped(meshes)
    kept = meshes[1].position
    before = kept.copy()
    meshes[0].linVelocity[0, 1] = 10.0
    stepped(meshes)
    assert meshes[0].linVelocity[0, 1] == 10.0 + GRAVITY * 0.02
    assert np.array_equal(kept, before) and not np.array_equal(meshes[1].position, before)
    for vertices in (boxes(1)[0].currVertices, refresh_vertices(boxes(2))):
        with pytest.raises(ValueError, match="read-only"):
            vertices[0] = 7.0
    lowest = meshes[0].currVertices.copy()
    meshes[0].lowest_vertex()[:] = 7.0
    assert np.array_equal(meshes[0].currVertices, lowest)


def test_rows_of_a_step_on_arrays_keep_their_values_for_who_keeps_them():
    meshes = boxes(2)
    stepped(meshes, contactScheduling="batches")
    for part in (lambda row: row, lambda row: row[0], lambda row: row.T):
        kept = part(meshes[1].position)
        before = kept.copy()
        stepped(meshes, contactScheduling="batches")
        assert np.array_equal(kept, before)
        assert not np.array_equal(part(meshes[1].position), before)


@pytest.mark.parametrize("way", [{"contactScheduling": "batches"}, {"contactSolver": "soft-step"}])
def test_other_attributes_do_not_hide_an_assigned_state(way):
    """One attribute less and one more: as many as the step has left."""
    (mesh,) = meshes = boxes(1)
    mesh.colour = "red"
    stepped(meshes, **way)
    stepped(meshes, **way)
    del mesh.colour
    mesh.position = np.array([[1.0, 90.0, 2.0]])
    for _ in range(10):
        stepped(meshes, **way)
    assert mesh.position[0, [0, 2]] == pytest.approx([1.0, 2.0]) and mesh.position[0, 1] < 90.0


def test_states_in_tables_are_those_of_a_loop_whatever_a_caller_does():
    rng = np.random.default_rng(11)
    names = ("position", "orientation", "linVelocity", "angVelocity")
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

    done = set()
    for _ in range(120):
        change, name, k = rng.choice((assign, add, fix, halve)), rng.choice(names), rng.integers(6)
        value = rng.normal(size=(1, 4 if name == "orientation" else 3))
        copies = [copy.copy(many[k]), copy.deepcopy(many[k]), pickle.loads(pickle.dumps(many[k]))]
        before = many[k].position.copy()
        for meshes, options in ((ones, {}), (many, {"contactScheduling": "batches"})):
            change(meshes[k], name, value)
            stepped(meshes[:4] if k % 2 else meshes, **options)
            stepped(meshes, **options)
        done.add((change, name))
        for one, other in zip(ones, many, strict=True):
            for attribute in rng.permutation(names)[: rng.integers(5)]:
                assert np.array_equal(getattr(one, attribute), getattr(other, attribute))
        assert all(np.array_equal(mesh.position, before) for mesh in copies) or change is add
    assert len(done) == 16


def stepped(meshes, **options):
    run_timestep(meshes, ground(), 0.02, 0.5, **options)


def boxes(count):
    """Boxes high in the air, apart."""
    return [box_body(1.0, 2.0, 1.5, (3.0 * k, 50.0, 0.0)) for k in range(count)]


def test_world_vertices_of_many_are_those_of_each():
    rng = np.random.default_rng(5)
    shapes = [SHAPES[k % len(SHAPES)] for k in range(40)]
    ones, many = ([body(name) for name in shapes] for _ in range(2))
    positions, orientations = 100 * rng.normal(size=(40, 1, 3)), rng.normal(size=(40, 1, 4))
    for m, twin, position, orientation in zip(ones, many, positions, orientations, strict=True):
        m.position = twin.position = position
        m.orientation = twin.orientation = orientation
    together = refresh_vertices(many)
    for m, twin in zip(ones, many, strict=True):
        assert np.shares_memory(twin.currVertices, together)
        assert not np.shares_memory(m.currVertices, together)
        assert np.array_equal(m.currVertices, twin.currVertices)
    assert np.array_equal(together, np.concatenate([m.currVertices for m in ones]))
    for k in (0, 3, 17, 39):
        ones[k].position = many[k].position = many[k].position + 1.0
    assert np.array_equal(refresh_vertices(many), np.concatenate([m.currVertices for m in ones]))
    assert refresh_vertices([]).shape == (0, 3)
