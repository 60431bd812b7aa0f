"""The default step is the coursework's text: whoever edits one of its functions sees it move."""

import inspect

import numpy as np
import pytest
from oracles import DATA, body, box_body, ground, quaternion, restore, state_of

import RBSFunctions
from RBSFunctions import Mesh, resolve_collision, run_timestep
from RigidBodySimulation import load_constraint_file, load_scene_file

SCREEN_LINES = 60
STEPS = 60


def moved_by(change, meshes, constraints=(), steps=STEPS):
    """The states after so many steps, with what `change` has done to the functions."""
    change()
    for _ in range(steps):
        run_timestep(meshes, ground(), 0.02, 0.5, constraints=constraints)
    return state_of(meshes)


def load(name):
    """Meshes and constraints of one of our scenes."""
    meshes = load_scene_file(DATA / f"{name}-scene.txt")
    path = DATA / f"{name}-constraints.txt"
    return meshes, load_constraint_file(path, meshes) if path.is_file() else ()


def test_the_step_fits_on_a_screen():
    """Its code, that is: without the signature and the docstring, and without blank lines."""
    source = inspect.getsource(run_timestep).split('"""')[2]
    code = [line for line in source.splitlines() if line.strip()]
    assert 20 < len(code) < SCREEN_LINES
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


def unstoppable(
    currPositions, currConstPoints, currLinVelocities, currAngVelocities, invMasses,
    invInertiaTensors, tolerance,
):  # fmt: skip
    return True, currLinVelocities, currAngVelocities


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
def test_each_function_of_the_coursework_is_seen_in_the_motion(name, monkeypatch):
    owner, replacement, scene = REPLACED[name]
    steps = 130  # until the bodies have met each other and the ground
    expected = moved_by(lambda: None, *load(scene), steps)
    changed = moved_by(lambda: monkeypatch.setattr(owner, name, replacement), *load(scene), steps)
    assert np.abs(changed - expected).max() > 0.01


@pytest.mark.parametrize("name", REPLACED)
def test_each_function_of_the_coursework_is_called(name, monkeypatch):
    """The same bits where it only passes on, with the coursework's number of arguments."""
    owner, _, scene = REPLACED[name]
    original, calls = getattr(owner, name), []
    count = len(inspect.signature(REPLACED[name][1]).parameters)

    def passing_on(*arguments):
        assert len(arguments) == count
        calls.append(1)
        return original(*arguments)

    expected = moved_by(lambda: None, *load(scene), 130)
    changed = moved_by(lambda: monkeypatch.setattr(owner, name, passing_on), *load(scene), 130)
    assert len(calls) > 3 and np.array_equal(changed, expected)


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
    balls = []
    for x, speed in ((-5.0, 3.0), (5.0, -3.0)):
        plain = body("tetrahedron", (x, 100.0, 0.0), size=0.01)
        ball = Ball("ball", plain.origVertices, plain.faces, plain.tets, 1.0, plain.position,
                    plain.orientation, False)  # fmt: skip
        ball.linVelocity = np.array([[speed, 0.0, 0.0]])
        balls.append(ball)
    contacts = 0
    for _ in range(100):
        contacts += len(run_timestep(balls, None, 0.02, 1.0).contacts)
    assert contacts > 0
    # equal masses and a central hit: they have exchanged their velocities
    assert balls[0].linVelocity[0, 0] == pytest.approx(-3.0)
    assert balls[1].linVelocity[0, 0] == pytest.approx(3.0)


def test_all_options_are_checked_before_anything_moves():
    """Also a scheduling where there is nothing to schedule."""
    for wrong in (
        {"constraintScheduling": "quue"}, {"broadPhase": "gird"}, {"mu": -1.0}, {"tolerance": -1.0},
        {"tolerance": np.nan}, {"mu": np.inf},
    ):  # fmt: skip
        mesh = box_body(1.0, 1.0, 1.0, (0.0, 5.0, 0.0))
        with pytest.raises(ValueError):
            run_timestep([mesh], ground(), 0.02, 0.5, **wrong)
        assert np.array_equal(mesh.position, [[0.0, 5.0, 0.0]])


@pytest.mark.parametrize("substeps", [np.inf, np.nan, None, 2.5, 0])
def test_substeps_that_are_no_number_of_steps_are_refused(substeps):
    words = f"substeps must be a whole number of 1 or more, not {substeps}"
    with pytest.raises(ValueError, match=words):
        run_timestep([], None, 0.02, 0.5, contactSolver="soft-step", substeps=substeps)


@pytest.mark.parametrize("broadPhase", ["all", "grid"])
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


# --------------------------------------------------------------------------------------------------
# What a caller may hand over
# --------------------------------------------------------------------------------------------------

broadPhases = pytest.mark.parametrize("broadPhase", ["all", "grid"])


def two_boxes():
    return [box_body(1.0, 1.0, 1.0, (3.0 * k, 50.0, 0.0)) for k in range(2)]


@broadPhases
@pytest.mark.parametrize(("row", "said"), [
    ([0, 0, 2, 0, 1.0, True], "constraint 1: there is no mesh 2, only 0 to 1"),
    ([-1, 0, 1, 0, 1.0, True], "constraint 1: there is no mesh -1"),
    ([0.5, 0, 1, 0, 1.0, True], "constraint 1: there is no mesh 0.5"),
    ([0, 8, 1, 0, 1.0, True], "constraint 1: mesh 0 has no vertex 8, only 0 to 7"),
    ([0, 0, 1, -1, 1.0, True], "constraint 1: mesh 1 has no vertex -1"),
    ([0, 0, 1, np.nan, 1.0, True], "constraint 1: mesh 1 has no vertex nan"),
    ([0, 0, 1, 0, np.nan, True], "constraint 1: the reference value must be finite"),
])  # fmt: skip
def test_a_constraint_of_what_is_not_there_is_refused_by_name(row, said, broadPhase):
    meshes = two_boxes()
    before = state_of(meshes)
    with pytest.raises(ValueError, match=said):
        run_timestep(
            meshes, None, 0.02, 0.5, constraints=[[0, 0, 1, 0, 9.0, True], row],
            broadPhase=broadPhase,
        )  # fmt: skip
    assert np.array_equal(state_of(meshes), before)


@broadPhases
def test_a_reference_value_may_be_an_array_of_one(broadPhase):
    states = []
    for value in (2.0, np.array([2.0]), np.array([[2.0]])):
        meshes = two_boxes()
        run_timestep(
            meshes, None, 0.02, 0.5, constraints=[[0, 0, 1, 0, value, True]], broadPhase=broadPhase
        )
        states.append(state_of(meshes))
    assert not np.array_equal(states[0], state_of(two_boxes()))
    assert all(np.array_equal(state, states[0]) for state in states)


@broadPhases
def test_a_mesh_that_is_in_the_list_twice_is_refused(broadPhase):
    meshes = two_boxes()
    with pytest.raises(ValueError, match="mesh 2, 'box', is in the list twice"):
        run_timestep([*meshes, meshes[1]], None, 0.02, 0.5, broadPhase=broadPhase)


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
    for _ in range(25):
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
    assert contacts > 30
