"""The graders, the reference data they grade against, and the reading of hostile data files."""

import os
import pickle
import re
import runpy
import subprocess
import sys

import make_reference
import numpy as np
import pytest
from oracles import DATA, ROOT
from reference.graderData import (
    COLLISION_LAYOUT,
    CONSTRAINT_LAYOUT,
    INTEGRATION_LAYOUT,
    load_grader_data,
)
from reference.rigidModel import solids_of
from scipy.spatial import ConvexHull

import RBSFunctions

GRADERS = ROOT / "graders"
FILES = {
    "integrationGrading.py": "integration.data",
    "ResolveCollisionsGrading.py": "collision-resolution.data",
    "Constraints.py": "constraint-resolution.data",
}
LAYOUTS = dict(
    zip(FILES.values(), (INTEGRATION_LAYOUT, COLLISION_LAYOUT, CONSTRAINT_LAYOUT), strict=True)
)
INTEGRATION, COLLISIONS, CONSTRAINTS = FILES

# The quantities are of size 1 to 100, and a few dozen roundings stand between inputs and results.
ROUNDING = 1e-12


@pytest.fixture
def grade_here(monkeypatch, capsys):
    """Runs a grader within this process, where functions can be replaced."""

    def grade_here(grader, *options):
        monkeypatch.setattr(sys, "argv", [grader, *map(str, options)])
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(GRADERS / grader), run_name="__main__")
        printed = capsys.readouterr()
        return subprocess.CompletedProcess([], ended.value.code, printed.out, printed.err)

    return grade_here


def reported_errors(output):
    """A dict from quantity to the error in the table, or to the number of bools that differ."""
    errors = {}
    for line in output.splitlines():
        cells = re.split(r"\s{3,}", line.strip())
        if len(cells) == 4 and cells[0] != "quantity":
            errors[cells[0]] = float(cells[1].removesuffix(" differ"))
    return errors


def load(name):
    return load_grader_data(DATA / name, LAYOUTS[name])


# ---- The graders on sound data ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("grader", "count"), [(INTEGRATION, 8), (COLLISIONS, 16), (CONSTRAINTS, 18)]
)
def test_the_simulation_passes_on_our_data(grader, count, run, tmp_path):
    graded = run(grader, cwd=tmp_path)
    assert (graded.returncode, graded.stderr) == (0, "")
    errors = reported_errors(graded.stdout)
    assert len(errors) == count and max(errors.values()) < ROUNDING
    assert graded.stdout.splitlines()[-1].startswith(f"PASS: all {count} quantities")


@pytest.mark.parametrize("grader", FILES)
def test_released_data_pass_in_their_own_convention(grader, released_data, grade_here):
    graded = grade_here(grader, "--data", released_data)
    assert "data of the convention released-2024" in graded.stdout
    assert graded.returncode == 0, graded.stdout + graded.stderr
    assert max(reported_errors(graded.stdout).values()) < ROUNDING
    if grader == INTEGRATION:
        assert "1 of 30 samples graded" in graded.stdout


# ---- The graders on a wrong simulation ----------------------------------------------------------

# Each takes a function of the simulation and returns a wrong one.


def flipped_impulse(resolve_collision):
    def wrong(m1, m2, *contact):
        before = [(m.linVelocity.copy(), m.angVelocity.copy()) for m in (m1, m2)]
        resolve_collision(m1, m2, *contact)
        for m, (linVelocity, angVelocity) in zip((m1, m2), before, strict=True):
            m.linVelocity = 2 * linVelocity - m.linVelocity
            m.angVelocity = 2 * angVelocity - m.angVelocity

    return wrong


def blind_to_shallow_contacts(detect_collision):
    def wrong(self, m):
        isCollision, depth, *contact = detect_collision(self, m)
        return isCollision and depth > 1.0, depth, *contact

    return wrong


def not_a_number(integrate_timestep):
    def wrong(self, timeStep):
        integrate_timestep(self, timeStep)
        self.linVelocity = self.linVelocity * np.nan

    return wrong


def opposite_bound(resolve):
    return lambda *given: resolve(*given[:4], not given[4], given[5])


def velocities_left_alone(resolve):
    return lambda *given: (resolve(*given)[0], *given[2:4])


MESH = RBSFunctions.Mesh
WRONG = (
    (COLLISIONS, RBSFunctions, "resolve_collision", flipped_impulse, "resultLinVelocities, mesh 2"),
    (COLLISIONS, MESH, "detect_collision", blind_to_shallow_contacts, "isCollision"),
    (INTEGRATION, MESH, "integrate_timestep", not_a_number, "resultLinVelocities"),
    (
        CONSTRAINTS,
        RBSFunctions,
        "resolve_position_constraint",
        opposite_bound,
        "positionWasValidUpper",
    ),
    (
        CONSTRAINTS,
        RBSFunctions,
        "resolve_velocity_constraint",
        velocities_left_alone,
        "correctedAngVelocities, mesh 2",
    ),
)


@pytest.mark.parametrize("case", WRONG, ids=lambda case: case[3].__name__)
def test_a_wrong_simulation_fails(case, grade_here, monkeypatch):
    grader, owner, function, mistake, failing = case
    monkeypatch.setattr(owner, function, mistake(getattr(owner, function)))
    graded = grade_here(grader)
    assert graded.returncode == 1
    assert failing in re.split(r": |; ", graded.stdout.splitlines()[-1])


# ---- Data files that cannot be used -------------------------------------------------------------


class Intruder:
    """Pickles as a call of a function."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


CONTENT = (DATA / "collision-resolution.data").read_bytes()


def pickled(key, change):
    """The collision data's pickle after a change of one entry."""
    data = pickle.loads(CONTENT)
    return pickle.dumps(data | {key: change(data[key])})


UNUSABLE = {
    "truncated": (CONTENT[:5000], "not a readable data file"),
    "not a dictionary": (pickle.dumps([1, 2]), "list instead of a dictionary"),
    "missing key": (pickle.dumps({"faces1": 0}), "no entry origVertices1, "),
    "too few samples": (pickled("depth", lambda a: a[:-1]), "depth holds float64 of shape (99,)"),
    "words": (pickled("depth", lambda a: ["deep"] * len(a)), "depth holds <U4"),
    "objects": (pickled("depth", lambda a: a.astype(object)), "depth holds object"),
    "flat mesh": (pickled("origVertices1", lambda a: a * [1, 1, 0]), "mesh 1 is not a body"),
    "another name": (pickle.dumps({"depth": complex(1, 2)}), "builtins.complex is refused"),
}


@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
@pytest.mark.parametrize("case", UNUSABLE)
def test_unusable_data_are_refused_in_one_line(case, tmp_path, grade_here):
    content, cause = UNUSABLE[case]
    path = tmp_path / "collision-resolution.data"
    path.write_bytes(content)
    assert_refused(grade_here(COLLISIONS, "--data", tmp_path), path, cause)


def test_missing_files_are_named(tmp_path, grade_here):
    path = tmp_path / "integration.data"
    assert_refused(grade_here(INTEGRATION, "--data", tmp_path), path, "No such file")


def test_a_pickle_that_runs_code_is_refused_and_not_run(tmp_path, run):
    path, trace = tmp_path / "constraint-resolution.data", tmp_path / "trace"
    path.write_bytes(pickle.dumps({"depth": Intruder(os.system, f"touch {trace}")}))
    graded = run(CONSTRAINTS, "--data", tmp_path)
    assert_refused(graded, path, f"{os.system.__module__}.system is refused")
    assert not trace.exists()


def assert_refused(graded, path, cause):
    assert (graded.returncode, graded.stdout) == (2, "")
    (line,) = graded.stderr.splitlines()
    assert str(path) in line and cause in line


# ---- Reading sound data of every kind -----------------------------------------------------------


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_every_pickle_protocol_is_read(protocol, tmp_path):
    expected = load("constraint-resolution.data")
    stored = dict(expected)
    # As the coursework's scripts collect them: lists of bools, bare or in arrays of one, and pairs.
    stored["positionWasValidUpper"] = [np.array([x]) for x in stored["positionWasValidUpper"]]
    stored["positionWasValidLower"] = list(stored["positionWasValidLower"])
    stored["velocityWasValid"] = stored["velocityWasValid"].tolist()
    stored["correctedPositionsUpper"] = tuple(stored["correctedPositionsUpper"])
    # Other layouts of the same numbers: by columns, and with the bytes the other way round.
    stored["randomPositions"] = np.asfortranarray(stored["randomPositions"])
    stored["randomLinVelocities"] = stored["randomLinVelocities"].astype(">f8")
    stored["tets1"] = stored["tets1"].astype(np.int32)
    path = tmp_path / "constraint-resolution.data"
    path.write_bytes(pickle.dumps(stored, protocol=protocol))
    data = load_grader_data(path, CONSTRAINT_LAYOUT)
    for key, values in expected.items():
        assert data[key].dtype == values.dtype
        assert np.array_equal(data[key], values), key


# ---- The reference ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("modules", "absent"),
    [
        ("make_reference", {"Quaternion", "GJK", "RBSFunctions"}),
        ("grade, integrationGrading, ResolveCollisionsGrading, Constraints", {"mpmath"}),
    ],
)
def test_the_reference_knows_nothing_of_the_simulation_nor_the_graders_of_mpmath(modules, absent):
    program = f"import sys; sys.path[:0] = {[str(GRADERS), str(ROOT)]!r}; import {modules}; "
    program += f"sys.exit(len({absent!r} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", program], timeout=120).returncode == 0


def test_the_reference_is_made_again_with_the_same_bits(tmp_path, monkeypatch):
    """For the first samples; `make_reference.py --out DIR` makes whole files."""
    monkeypatch.setattr(make_reference, "SAMPLE_COUNT", 20)
    make_reference.make_reference(tmp_path)
    for name, layout in LAYOUTS.items():
        stored, made = load(name), load_grader_data(tmp_path / name, layout)
        for key, (_kind, *axes) in layout.items():
            first = stored[key][tuple(slice(20 if one == "samples" else None) for one in axes)]
            assert made[key].tobytes() == first.tobytes(), (name, key)
        for content in ((DATA / name).read_bytes(), (tmp_path / name).read_bytes()):
            # The name that every NumPy since version 1.0 can import.
            assert b"numpy.core.multiarray" in content and b"numpy._core" not in content


def world_poses(data):
    """For every sample the world vertices (V1, 3), (V2, 3) of both meshes, in plain NumPy."""
    hull1, hull2 = (solid.vertices for solid in solids_of(data).values())
    for position, q in zip(data["randomPositions"], data["randomOrientations"], strict=True):
        yield hull1, hull2 @ rotation_of(q).T + position


def rotation_of(q):
    """The rotation matrix of a unit quaternion (s, u): axis v goes to v + 2 u × (s v + u × v)."""
    s, u = q[0], q[1:]
    return np.array([v + 2 * np.cross(u, s * v + np.cross(u, v)) for v in np.eye(3)]).T


def test_detection_agrees_with_the_hull_of_the_minkowski_difference():
    data = load("collision-resolution.data")
    kinds = []
    for sample, (hull1, hull2) in enumerate(world_poses(data)):
        facets = ConvexHull((hull1[:, None] - hull2).reshape(-1, 3)).equations
        nearest = facets[facets[:, 3].argmax()]
        assert data["isCollision"][sample] == (nearest[3] < 0)
        if data["isCollision"][sample]:
            normal = data["intNormal"][sample]
            assert data["depth"][sample] == pytest.approx(-nearest[3], abs=ROUNDING)
            assert normal == pytest.approx(nearest[:3], abs=ROUNDING)
            point = data["intPosition"][sample]
            opposite = point + data["depth"][sample] * normal
            for place, hull in ((point, hull2), (opposite, hull1)):
                planes = ConvexHull(hull).equations
                assert max(planes @ [*place, 1.0]) == pytest.approx(0.0, abs=ROUNDING)
            kinds.append((touching(hull1, normal), touching(hull2, -normal)))
    assert 40 <= len(kinds) <= 70
    # Every kind of contact occurs: vertex of mesh 2 on a box face, box vertex on a face, two edges.
    counts = {kind: kinds.count(kind) for kind in set(kinds)}
    assert counts.keys() == {(4, 1), (1, 3), (2, 2)}
    assert min(counts.values()) >= 5


def touching(hull, direction):
    """The number of vertices that are farthest along a direction."""
    heights = hull @ direction
    return int((heights > heights.max() - 1e-9).sum())


def test_either_bound_is_often_violated_and_a_tenth_of_the_velocities_are_valid():
    data = load("constraint-resolution.data")
    upper, lower = (data[f"positionWasValid{which}"].sum() for which in ("Upper", "Lower"))
    assert 20 <= upper <= 80 and 20 <= lower <= 80 and data["velocityWasValid"].sum() == 10


def test_collision_results_keep_momentum_and_restore_half_the_closing_speed():
    """Conservation laws, which the formula of the impulse does not mention, hold in the results."""
    data = load("collision-resolution.data")
    masses, _centres, _vertices, inertia = zip(*solids_of(data).values(), strict=True)
    for sample in np.flatnonzero(data["isCollision"]):
        rotation = rotation_of(data["randomOrientations"][sample])
        tensors = inertia[0], rotation @ inertia[1] @ rotation.T
        positions = data["resultPositions"][:, sample]
        kinds = "LinVelocities", "AngVelocities"
        before = [(np.zeros(3), np.zeros(3)), [data[f"random{kind}"][sample] for kind in kinds]]
        after = [[data[f"result{kind}"][k, sample] for kind in kinds] for k in (0, 1)]
        for momentum in (linear_momentum, angular_momentum):
            assert momentum(after, masses, tensors, positions) == pytest.approx(
                momentum(before, masses, tensors, positions), rel=1e-13, abs=1e-10
            )
        normal = data["intNormal"][sample]
        share = masses[0] / sum(masses)  # m_2⁻¹ / (m_1⁻¹ + m_2⁻¹)
        point = data["intPosition"][sample] + share * data["depth"][sample] * normal
        speeds = [closing_speed(state, positions, point, normal) for state in (before, after)]
        assert speeds[1] == pytest.approx(-0.5 * speeds[0], abs=1e-11)


def linear_momentum(states, masses, tensors, positions):
    return sum(mass * v for mass, (v, _) in zip(masses, states, strict=True))


def angular_momentum(states, masses, tensors, positions):
    """About the origin of the world."""
    bodies = zip(tensors, masses, positions, states, strict=True)
    return sum(tensor @ w + mass * np.cross(x, v) for tensor, mass, x, (v, w) in bodies)


def closing_speed(states, positions, point, normal):
    (v1, w1), (v2, w2) = states
    arms = [point - position for position in positions]
    return (v1 + np.cross(w1, arms[0]) - v2 - np.cross(w2, arms[1])) @ normal
