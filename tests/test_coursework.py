"""The default step is the coursework's text: whoever edits one of its functions sees it move."""

import inspect

import numpy as np
import pytest
from oracles import DATA, IDENTITY, box_body, ground, quaternion, restore, shape, state_of

import RBSFunctions
from RBSFunctions import Mesh, resolve_collision, run_timestep
from RigidBodySimulation import load_constraint_file, load_scene_file

broadPhases = pytest.mark.parametrize("broadPhase", ["all", "grid"])


def load(name):
    """Meshes and constraints of one of our scenes."""
    meshes = load_scene_file(DATA / f"{name}-scene.txt")
    path = DATA / f"{name}-constraints.txt"
    return meshes, load_constraint_file(path, meshes) if path.is_file() else ()


def test_the_step_fits_on_a_screen():
    """Its code, that is: without the signature and the docstring, and without blank lines."""
    source = inspect.getsource(run_timestep).split('"""')[2]
    assert 20 < sum(bool(line.strip()) for line in source.splitlines()) < 60
    for name in ("integrate_timestep", "detect_collision", "resolve_collision"):
        assert f"{name}(" in source


# What a student may have written instead: each with the signature of the coursework, and in plain
# NumPy. Each is wrong, or slow, in a way that can be seen in the motion.


def weightless(self, timeStep):
    self.position = self.position + timeStep * self.linVelocity
    self.currVertices = self.origVertices + self.position


def blind(self, m):
    return False, 0.0, np.zeros((1, 3)), np.zeros((1, 3))


def boxes_only(self, m):
    return False


def swapped(m1, m2, depth, contactNormal, penPoint, CRCoeff):
    resolve_collision(m1, m2, depth, contactNormal, penPoint, 0.0)


def slack(currPositions, currConstPoints, refValue, invMasses, upper, tolerance):
    return True, currPositions


def unstoppable(positions, points, linVelocities, angVelocities, invMasses, tensors, tolerance):
    return True, linVelocities, angVelocities


def turned_back(self):
    return 2.0 * self.invIT


REPLACED = {
    "integrate_timestep": (Mesh, weightless, "mixed"),
    "detect_collision": (Mesh, blind, "mixed"),
    "bounding_box_collision": (Mesh, boxes_only, "mixed"),
    "get_rotated_inv_IT": (Mesh, turned_back, "mixed"),
    "resolve_collision": (RBSFunctions, swapped, "mixed"),
    "resolve_position_constraint": (RBSFunctions, slack, "cube"),
    "resolve_velocity_constraint": (RBSFunctions, unstoppable, "cube"),
}


@pytest.mark.parametrize("name", REPLACED)
def test_each_function_of_the_coursework_is_called_and_seen_in_the_motion(name, monkeypatch):
    """The same bits where one only passes on, with the coursework's number of arguments."""
    owner, replacement, scene = REPLACED[name]
    original, calls = getattr(owner, name), []

    def passing_on(*arguments):
        assert len(arguments) == len(inspect.signature(replacement).parameters)
        calls.append(1)
        return original(*arguments)

    states = []
    for function in (original, passing_on, replacement):
        monkeypatch.setattr(owner, name, function)
        meshes, constraints = load(scene)
        for _ in range(130):  # until the bodies have met each other and the ground
            run_timestep(meshes, ground(), 0.02, 0.5, constraints=constraints)
        states.append(state_of(meshes))
    assert len(calls) > 3 and np.array_equal(states[0], states[1])
    assert np.abs(states[0] - states[2]).max() > 0.01


class Ball(Mesh):
    """Collides as a ball about its COM, with other balls."""

    radius = 2.0

    def detect_collision(self, m):
        t = m.position - self.position
        distance = np.linalg.norm(t)
        depth = self.radius + m.radius - distance
        normal = t / distance
        return depth >= 0.0, depth, normal, m.position - m.radius * normal


def test_a_subclass_may_detect_its_own_collisions():
    """Small tetrahedra, far apart by their boxes, that collide as the balls that they are."""
    vertices, faces, tets = shape("tetrahedron")
    balls = []
    for x, speed in ((-5.0, 3.0), (5.0, -3.0)):
        position = (x, 100.0, 0.0)
        ball = Ball("ball", 0.01 * vertices, faces, tets, 1.0, position, IDENTITY, False)
        ball.linVelocity = np.array([[speed, 0.0, 0.0]])
        balls.append(ball)
    contacts = 0
    for _ in range(100):
        contacts += len(run_timestep(balls, None, 0.02, 1.0).contacts)
    assert contacts > 0
    # equal masses and a central hit: they have exchanged their velocities
    assert balls[0].linVelocity[0, 0] == pytest.approx(-3.0)
    assert balls[1].linVelocity[0, 0] == pytest.approx(3.0)


@broadPhases
def test_an_exception_leaves_the_meshes_as_they_were(broadPhase, monkeypatch):
    """In the middle of the constraints, after collisions have been resolved."""
    meshes = [
        box_body(2.0, 2.0, 2.0, (0.0, 0.9, 0.0), orientation=quaternion([0, 0, 1], 3)),
        box_body(2.0, 2.0, 2.0, (0.3, 2.8, 0.0)),
    ]
    before = state_of(meshes)

    def failing(*arguments):
        raise RuntimeError("not written yet")

    constraints = [[0, 0, 1, 0, 1.0, True]]
    options = {"constraints": constraints, "broadPhase": broadPhase}
    with monkeypatch.context() as patch, pytest.raises(RuntimeError):
        patch.setattr(RBSFunctions, "resolve_velocity_constraint", failing)
        run_timestep(meshes, ground(), 0.02, 0.5, **options)
    assert np.array_equal(state_of(meshes), before)
    report = run_timestep(meshes, ground(), 0.02, 0.5, **options)
    assert len(report.contacts) >= 2 and not np.array_equal(state_of(meshes), before)


def two_boxes():
    return [box_body(1.0, 1.0, 1.0, (3.0 * k, 50.0, 0.0)) for k in range(2)]


REFUSED = [
    ([0, 0, 2, 0, 1.0, True], "no mesh 2"),
    ([-1, 0, 1, 0, 1.0, True], "no mesh -1"),
    ([0.5, 0, 1, 0, 1.0, True], "no mesh 0.5"),
    ([0, 8, 1, 0, 1.0, True], "mesh 0 has no vertex 8"),
    ([0, 0, 1, np.nan, 1.0, True], "mesh 1 has no vertex nan"),
    ([0, 0, 1, 0, np.nan, True], "reference value"),
]


@broadPhases
def test_what_is_not_there_is_refused_by_name(broadPhase):
    meshes = two_boxes()
    before = state_of(meshes)
    for row, said in REFUSED:
        constraints = [[0, 0, 1, 0, 9.0, True], row]
        with pytest.raises(ValueError, match=f"constraint 1: .*{said}"):
            run_timestep(meshes, None, 0.02, 0.5, constraints=constraints, broadPhase=broadPhase)
    with pytest.raises(ValueError, match="mesh 2, 'box', is in the list twice"):
        run_timestep([*meshes, meshes[1]], None, 0.02, 0.5, broadPhase=broadPhase)
    assert np.array_equal(state_of(meshes), before)


@broadPhases
def test_a_reference_value_may_be_an_array_of_one(broadPhase):
    states = []
    for value in (2.0, np.array([2.0]), np.array([[2.0]])):
        meshes, constraint = two_boxes(), [0, 0, 1, 0, value, True]
        run_timestep(meshes, None, 0.02, 0.5, constraints=[constraint], broadPhase=broadPhase)
        states.append(state_of(meshes))
    assert not np.array_equal(states[0], state_of(two_boxes()))
    assert all(np.array_equal(state, states[0]) for state in states)


@broadPhases
def test_fixed_has_one_meaning(broadPhase):
    """Fixed at the start, by assignment or by its inverse mass, a body stays; freed, it falls."""
    for way in ("start", "isFixed", "invMass"):
        lower = box_body(2.0, 2.0, 2.0, (0.0, 50.0, 0.0), isFixed=way == "start")
        upper = box_body(2.0, 2.0, 2.0, (0.3, 51.9, 0.0))
        if way == "isFixed":
            lower.isFixed = True
        elif way == "invMass":
            lower.invMass = 0.0  # its inverse inertia is kept, and counts for nothing
        upper.linVelocity = np.array([[0.5, -3.0, 0.2]])
        assert lower.isFixed and not upper.isFixed
        report = run_timestep([lower, upper], None, 0.02, 0.5, mu=0.3, broadPhase=broadPhase)
        assert len(report.contacts) == 1
        assert np.array_equal(state_of([lower])[0, :3], [0.0, 50.0, 0.0])
        assert not state_of([lower])[0, 7:].any()
        if way == "start":
            expected = state_of([upper])
        assert np.array_equal(state_of([upper]), expected)
    lower.isFixed = False
    run_timestep([lower], None, 0.02, 0.5, broadPhase=broadPhase)
    assert lower.position[0, 1] < 50.0


def test_the_sign_of_zero_is_kept_by_what_is_fixed_and_by_both_steps():
    """To the last bit, which `array_equal` does not look at; in states and in reports."""
    runs = []
    for broadPhase in ("all", "grid"):
        rng = np.random.default_rng(3)
        tilts = [quaternion([1.0, 0.0, s], 20.0 * t) for s in (1.0, -1.0) for t in (1, 0, -1, 0)]
        meshes = [
            box_body(2.0, 2.0, 2.0, (-0.0, 3.0 * k, -0.0), orientation=q, isFixed=k % 2 == 0)
            for k, q in enumerate(tilts)
        ]
        for mesh in meshes[1::2]:
            mesh.position = mesh.position + np.array([[0.0, 0.5, 0.0]]) * rng.random()
            mesh.linVelocity = np.array([[-0.0, -20.0, 0.0]])
        contacts = []
        for _ in range(150):
            report = run_timestep(meshes, ground(), 0.02, 0.0, mu=0.3, broadPhase=broadPhase)
            contacts += report.contacts
        assert len(contacts) > 20
        assert all(np.signbit(mesh.position[0, 0]) for mesh in meshes[::2])
        runs.append((state_of(meshes).tobytes(), repr(contacts)))
    assert runs[0] == runs[1]


def test_friction_where_nothing_is_pressed_keeps_the_bits_of_both_steps():
    """A velocity of -0.0 and an impulse of nothing: 0.0 in both steps."""
    states = []
    for broadPhase in ("all", "grid"):
        meshes = [box_body(2.0, 2.0, 2.0, (1.9 * k, 5.0, 0.0)) for k in range(2)]
        for k, mesh in enumerate(meshes):  # they part
            mesh.linVelocity = np.array([[2.0 * k - 1.0, -0.0, -0.0]])
        report = run_timestep(meshes, None, 0.0, 0.5, mu=0.5, broadPhase=broadPhase)
        assert len(report.contacts) == 1 and report.contacts[0].impulse < 0.0
        states.append(state_of(meshes).tobytes())
    assert states[0] == states[1]


@broadPhases
def test_what_a_list_of_meshes_remembers_steers_no_result(broadPhase):
    """A warm list against fresh copies, resumed at random steps, pushed and put elsewhere."""
    rng = np.random.default_rng(8)
    warm, _ = load("mixed")
    contacts = 0
    for _ in range(20):
        for _ in range(rng.integers(1, 12)):
            run_timestep(warm, ground(), 0.02, 0.5, broadPhase=broadPhase)
        for mesh in warm:
            if rng.random() < 0.1 and not mesh.isFixed:
                mesh.linVelocity = mesh.linVelocity + rng.normal(size=(1, 3))
            if rng.random() < 0.05:
                mesh.position = mesh.position + rng.normal(size=(1, 3))
        fresh, _ = load("mixed")
        restore(fresh, state_of(warm))
        for _ in range(3):
            reports = [
                run_timestep(meshes, ground(), 0.02, 0.5, broadPhase=broadPhase)
                for meshes in (warm, fresh)
            ]
            assert state_of(warm).tobytes() == state_of(fresh).tobytes()
            assert reports[0].contacts == reports[1].contacts
            contacts += len(reports[0].contacts)
    assert contacts > 15
