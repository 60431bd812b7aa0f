"""The graders, the reference data they grade against, and the reading of hostile data files."""

import os
import pickle
import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "graders"))

import make_reference
from reference.graderData import (
    COLLISION_LAYOUT,
    CONSTRAINT_LAYOUT,
    INTEGRATION_LAYOUT,
    GraderDataError,
    load_grader_data,
)

import RBSFunctions

ROOT = Path(__file__).resolve().parents[2]
GRADERS = ROOT / "graders"
DATA = ROOT / "data"
FILES = {
    "integrationGrading.py": "integration.data",
    "ResolveCollisionsGrading.py": "collision-resolution.data",
    "Constraints.py": "constraint-resolution.data",
}
LAYOUTS = {
    "integration.data": INTEGRATION_LAYOUT,
    "collision-resolution.data": COLLISION_LAYOUT,
    "constraint-resolution.data": CONSTRAINT_LAYOUT,
}
RELEASED = ("--convention", "released-2024")

# The quantities are of size 1 to 100, and a few dozen roundings stand between inputs and results.
ROUNDING = 1e-12


def run(*command, cwd):
    return subprocess.run(
        [sys.executable, *map(str, command)], cwd=cwd, capture_output=True, text=True, timeout=120
    )


def grade(grader, *options, cwd):
    return run(GRADERS / grader, *options, cwd=cwd)


@pytest.fixture
def grade_here(monkeypatch, capsys):
    """Like `grade`, within this process: SciPy is loaded already, and functions can be replaced."""

    def grade_here(grader, *options):
        monkeypatch.setattr(sys, "argv", [grader, *map(str, options)])
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(GRADERS / grader), run_name="__main__")
        printed = capsys.readouterr()
        return subprocess.CompletedProcess([], ended.value.code, printed.out, printed.err)

    return grade_here


def reported_errors(output):
    """A dict from quantity to the error in the table: a float, or the number of bools that differ.

    A row of the table is the quantity, the error, the sample, the number of samples, in columns at
    least three blanks apart.
    """
    errors = {}
    for line in output.splitlines():
        cells = re.split(r"\s{3,}", line.strip())
        if len(cells) == 4 and cells[0] != "quantity":
            errors[cells[0]] = float(cells[1].removesuffix(" differ"))
    return errors


def load(name):
    return load_grader_data(DATA / name, LAYOUTS[name])


@pytest.fixture(scope="module")
def released_data(tmp_path_factory):
    """A folder of data with the quirks of the coursework's 2024 release."""
    folder = tmp_path_factory.mktemp("released")
    made = run(GRADERS / "make_reference.py", *RELEASED, "--out", folder, cwd=folder)
    assert made.returncode == 0, made.stderr
    return folder


# ---- The graders on sound data ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("grader", "quantityCount"),
    [("integrationGrading.py", 4), ("ResolveCollisionsGrading.py", 12), ("Constraints.py", 11)],
)
def test_the_simulation_passes_on_our_data(grader, quantityCount, tmp_path):
    graded = grade(grader, cwd=tmp_path)
    assert graded.returncode == 0, graded.stdout + graded.stderr
    errors = reported_errors(graded.stdout)
    assert len(errors) == quantityCount
    assert max(errors.values()) < ROUNDING
    assert graded.stdout.splitlines()[-1].startswith(f"PASS: all {quantityCount} quantities")
    assert graded.stderr == ""


@pytest.mark.parametrize("grader", FILES)
def test_released_data_pass_in_their_own_convention_only(grader, released_data, grade_here):
    graded = grade_here(grader, "--data", released_data)
    assert "data of the convention released-2024" in graded.stdout
    assert graded.returncode == 0, graded.stdout + graded.stderr
    assert max(reported_errors(graded.stdout).values()) < ROUNDING
    if grader == "integrationGrading.py":
        assert "1 of 100 samples graded" in graded.stdout
    assert_failed(grade_here(grader, "--data", released_data, "--convention", "exact"))


# A step of the integrator does not depend on the inertia: the two conventions are alike there, but
# for the number of samples that the released file has results for.
@pytest.mark.parametrize("grader", ["ResolveCollisionsGrading.py", "Constraints.py"])
def test_our_data_fail_in_the_released_convention(grader, grade_here):
    graded = grade_here(grader, *RELEASED)
    assert_failed(graded)
    # The wrong tensors show in the velocities and nowhere else.
    for quantity, error in reported_errors(graded.stdout).items():
        assert (error > 0.1) == ("Velocities" in quantity), quantity


def assert_failed(graded):
    """Graded, and found wrong; a grader that crashes has the same exit code, but no verdict."""
    assert graded.returncode == 1
    assert graded.stdout.splitlines()[-1].startswith("FAIL:"), graded.stderr


def test_data_without_any_result_are_refused(released_data, tmp_path, grade_here):
    data = pickle.loads((released_data / "integration.data").read_bytes())
    for key in data:
        if key.startswith("result"):
            data[key][0] = 0.0
    path = tmp_path / "integration.data"
    path.write_bytes(pickle.dumps(data))
    graded = grade_here("integrationGrading.py", "--data", tmp_path, *RELEASED)
    assert_refused(graded, path, "no sample has a result")


# ---- The graders on a wrong simulation ----------------------------------------------------------

# Each takes a function of the simulation and returns a wrong one in its place.


def flipped_impulse(resolve_collision):
    def wrong(m1, m2, *contact):
        before = [(m.linVelocity.copy(), m.angVelocity.copy()) for m in (m1, m2)]
        resolve_collision(m1, m2, *contact)
        for m, (linVelocity, angVelocity) in zip((m1, m2), before, strict=True):
            m.linVelocity = 2 * linVelocity - m.linVelocity
            m.angVelocity = 2 * angVelocity - m.angVelocity

    return wrong


def opposite_normal(detect_collision):
    def wrong(self, m):
        isCollision, depth, intNormal, intPosition = detect_collision(self, m)
        return isCollision, depth, -intNormal, intPosition

    return wrong


def blind_to_shallow_contacts(detect_collision):
    def wrong(self, m):
        isCollision, depth, *contact = detect_collision(self, m)
        return isCollision and depth > 1.0, depth, *contact

    return wrong


def explicit_euler(integrate_timestep):
    def wrong(self, timeStep):
        position = self.position + self.linVelocity * timeStep
        integrate_timestep(self, timeStep)
        self.position = position

    return wrong


def not_aNumber(integrate_timestep):
    def wrong(self, timeStep):
        integrate_timestep(self, timeStep)
        self.linVelocity = self.linVelocity * np.nan

    return wrong


def opposite_bound(resolve_position_constraint):
    def wrong(positions, points, refValue, invMasses, upper, tolerance):
        return resolve_position_constraint(
            positions, points, refValue, invMasses, not upper, tolerance
        )

    return wrong


def velocities_left_alone(resolve_velocity_constraint):
    def wrong(positions, points, linVelocities, angVelocities, *others):
        wasValid, *_ = resolve_velocity_constraint(
            positions, points, linVelocities, angVelocities, *others
        )
        return wasValid, linVelocities, angVelocities

    return wrong


@pytest.mark.parametrize(
    ("grader", "name", "mistake", "failing"),
    [
        (
            "ResolveCollisionsGrading.py",
            "resolve_collision",
            flipped_impulse,
            "resultLinVelocities, mesh 2",
        ),
        ("ResolveCollisionsGrading.py", "Mesh.detect_collision", opposite_normal, "intNormal"),
        (
            "ResolveCollisionsGrading.py",
            "Mesh.detect_collision",
            blind_to_shallow_contacts,
            "isCollision",
        ),
        ("integrationGrading.py", "Mesh.integrate_timestep", explicit_euler, "resultPositions"),
        ("integrationGrading.py", "Mesh.integrate_timestep", not_aNumber, "resultLinVelocities"),
        ("Constraints.py", "resolve_position_constraint", opposite_bound, "positionWasValidUpper"),
        (
            "Constraints.py",
            "resolve_velocity_constraint",
            velocities_left_alone,
            "correctedAngVelocities, mesh 2",
        ),
    ],
)
def test_a_wrong_simulation_fails(grader, name, mistake, failing, grade_here, monkeypatch):
    owner = RBSFunctions
    *path, function = name.split(".")
    for part in path:
        owner = getattr(owner, part)
    monkeypatch.setattr(owner, function, mistake(getattr(owner, function)))
    graded = grade_here(grader)
    assert_failed(graded)
    assert failing in re.split(r": |; ", graded.stdout.splitlines()[-1])


# ---- Data files that cannot be used -------------------------------------------------------------


class Intruder:
    """Pickles as a call of a function."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


def lying_dtype():
    """A pickled array of Python objects that says it holds plain bytes.

    numpy.dtype("O8") is made, its flags are then overwritten by zero, and bytes given as contents:
    NumPy's own unpickling takes them for pointers.
    """
    flagless = b"(K\x03X\x01\x00\x00\x00|NNNK\x08K\x01K\x00tb"
    dtype = b"cnumpy\ndtype\n(X\x02\x00\x00\x00O8I00\nI01\ntR" + flagless
    return (
        b"\x80\x03}X\x05\x00\x00\x00depth"
        b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(K\x00tC\x01btR"
        b"(K\x01(K\x01t" + dtype + b"\x89C\x08AAAAAAAAtbs."
    )


def pickled(change):
    """The collision data's pickle after a change of their dictionary."""
    data = pickle.loads((DATA / "collision-resolution.data").read_bytes())
    change(data)
    return pickle.dumps(data)


def assign(key, make):
    """A change: data[key] = make(data[key])."""
    return lambda data: data.update({key: make(data[key])})


WHOLE = (DATA / "collision-resolution.data").read_bytes
UNUSABLE = {
    "truncated": lambda: (WHOLE()[:5000], "not a readable data file"),
    "empty": lambda: (b"", "not a readable data file"),
    "text": lambda: (b"these are not the data\n", "not a readable data file"),
    "not a dictionary": lambda: (pickle.dumps([1, 2]), "list in place of a dictionary"),
    "missing key": lambda: (pickled(lambda data: data.pop("depth")), "no entry depth"),
    "wrong shape": lambda: (pickled(assign("intNormal", lambda a: a[:, :2])), "intNormal has"),
    "too few samples": lambda: (
        pickled(assign("depth", lambda a: a[:-1])),
        "depth has shape (99,)",
    ),
    "lone result": lambda: (
        pickled(assign("resultPositions", lambda pair: pair[:1])),
        "resultPositions has shape (1, 100, 3) in place of (2, 100, 3)",
    ),
    "words": lambda: (pickled(assign("depth", lambda a: ["deep"] * len(a))), "depth holds <U4"),
    "index out of range": lambda: (pickled(assign("tets2", lambda a: a + 1)), "tets2 names"),
    "infinite input": lambda: (
        pickled(assign("randomPositions", lambda a: a / 0.0)),
        "randomPositions holds a number that is not finite",
    ),
    "zero quaternion": lambda: (
        pickled(assign("randomOrientations", lambda a: 0 * a)),
        "zero quaternion",
    ),
    "no vertex": lambda: (pickled(assign("origVertices1", lambda a: a[:0])), "is empty"),
    "huge integers": lambda: (
        pickled(assign("depth", lambda a: [10**400] * len(a))),
        "depth holds object where float64 is expected",
    ),
    "bytes that are not there": lambda: (
        b"\x80\x04\x8e" + b"\xff" * 7 + b"\x7f.",
        "not a readable data file",
    ),
    "flat mesh": lambda: (
        pickled(assign("origVertices1", lambda a: a * [1, 1, 0])),
        "mesh 1 is not a body",
    ),
    "objects": lambda: (
        pickle.dumps({"depth": np.array([None])}),
        "dtype 'O8' is not plain numbers",
    ),
    "ndarray called": lambda: (
        pickle.dumps({"depth": Intruder(np.ndarray, (10**9,))}),
        "not a readable data file",
    ),
}


@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
@pytest.mark.parametrize("case", UNUSABLE)
def test_unusable_data_are_refused_in_one_line(case, tmp_path, grade_here):
    content, cause = UNUSABLE[case]()
    path = tmp_path / "collision-resolution.data"
    path.write_bytes(content)
    assert_refused(grade_here("ResolveCollisionsGrading.py", "--data", tmp_path), path, cause)


# With an ordinary unpickler the first ends the process, and the second may end others too.
@pytest.mark.parametrize(
    ("content", "cause"),
    [
        (lying_dtype(), "dtype 'O8' is not plain numbers"),
        # LONG_BINPUT into slot 2³¹ − 1: the unpickler would make room for all before it.
        (b"\x80\x03]r\xff\xff\xff\x7f.", "more values than it can hold"),
    ],
    ids=["lying dtype", "huge memo"],
)
def test_data_that_would_crash_the_grader_are_refused(content, cause, tmp_path):
    path = tmp_path / "integration.data"
    path.write_bytes(content)
    graded = grade("integrationGrading.py", "--data", tmp_path, cwd=tmp_path)
    assert_refused(graded, path, cause)


def test_a_missing_file_is_named(tmp_path):
    graded = grade("Constraints.py", "--data", tmp_path / "nowhere", cwd=tmp_path)
    assert_refused(graded, tmp_path / "nowhere" / "constraint-resolution.data", "No such file")


def test_a_folder_in_place_of_the_file_is_named(tmp_path, grade_here):
    path = tmp_path / "integration.data"
    path.mkdir()
    graded = grade_here("integrationGrading.py", "--data", tmp_path)
    assert_refused(graded, path, "cannot be read")


@pytest.mark.parametrize("grader", FILES)
def test_a_pickle_that_runs_code_is_refused_and_not_run(grader, tmp_path):
    trace = tmp_path / "trace"
    path = tmp_path / FILES[grader]
    path.write_bytes(pickle.dumps({"depth": Intruder(os.system, f"touch {trace}")}))
    graded = grade(grader, "--data", tmp_path, cwd=tmp_path)
    assert_refused(graded, path, f"{os.system.__module__}.system is refused")
    assert not trace.exists()


def assert_refused(graded, path, cause):
    assert graded.returncode == 2, graded.stdout + graded.stderr
    assert graded.stdout == ""
    (line,) = graded.stderr.splitlines()
    assert str(path) in line
    assert cause in line


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


def test_a_name_outside_the_list_is_refused_whatever_it_does(tmp_path):
    path = tmp_path / "integration.data"
    path.write_bytes(pickle.dumps({"depth": complex(1, 2)}))
    with pytest.raises(GraderDataError, match="builtins.complex is refused"):
        load_grader_data(path, INTEGRATION_LAYOUT)


# ---- The reference ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("modules", "absent"),
    [
        ("make_reference", {"Quaternion", "GJK", "RBSFunctions"}),
        ("grade, integrationGrading, ResolveCollisionsGrading, Constraints", {"mpmath"}),
    ],
)
def test_the_reference_knows_nothing_of_the_simulation_nor_the_graders_of_mpmath(
    modules, absent, tmp_path
):
    program = (
        f"import sys; sys.path[:0] = {[str(GRADERS), str(ROOT)]!r}; import {modules}; "
        f"sys.exit(len({absent!r} & set(sys.modules)))"
    )
    assert run("-c", program, cwd=tmp_path).returncode == 0


def test_the_reference_without_mpmath_says_what_to_install(tmp_path):
    program = (
        f"import sys; sys.path[:0] = {[str(GRADERS)]!r}; sys.modules['mpmath'] = None; "
        "import make_reference"
    )
    process = run("-c", program, cwd=tmp_path)
    assert (process.returncode, process.stdout) == (1, "")
    assert process.stderr == "make_reference.py needs mpmath: pip install mpmath\n"


def test_the_reference_is_made_again_with_the_same_bytes(tmp_path):
    make_reference.make_reference(tmp_path)
    for name in LAYOUTS:
        stored = (DATA / name).read_bytes()
        assert (tmp_path / name).read_bytes() == stored, name
        # The name that every NumPy since version 1.0 can import.
        assert b"numpy.core.multiarray" in stored
        assert b"numpy._core" not in stored


def world_poses(data):
    """For every sample the world vertices (V1, 3), (V2, 3) of both meshes, in plain NumPy."""
    solids = make_reference.make_meshes("exact")[1]
    hull1, hull2 = (np.array(solid.vertices, dtype=float) for solid in solids)
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


def test_either_bound_is_often_violated_and_a_tenth_of_the_velocities_are_valid():
    data = load("constraint-resolution.data")
    upper, lower = (data[f"positionWasValid{which}"].sum() for which in ("Upper", "Lower"))
    assert 20 <= upper <= 80 and 20 <= lower <= 80 and data["velocityWasValid"].sum() == 10


def touching(hull, direction):
    """The number of vertices that lie farthest along a direction."""
    heights = hull @ direction
    return int((heights > heights.max() - 1e-9).sum())


def test_collision_results_keep_momentum_and_restore_half_the_closing_speed():
    """Conservation laws, which the formula of the impulse does not mention, hold in the results."""
    data = load("collision-resolution.data")
    solids = make_reference.make_meshes("exact")[1]
    masses = [1 / float(solid.inverseMass) for solid in solids]
    inertia = [np.linalg.inv(np.array(solid.inverseInertia, dtype=float)) for solid in solids]
    for sample in np.flatnonzero(data["isCollision"]):
        rotation = rotation_of(data["randomOrientations"][sample])
        tensors = inertia[0], rotation @ inertia[1] @ rotation.T
        positions = data["resultPositions"][:, sample]
        before = [
            (np.zeros(3), np.zeros(3)),
            (data["randomLinVelocities"][sample], data["randomAngVelocities"][sample]),
        ]
        after = [
            (data["resultLinVelocities"][k, sample], data["resultAngVelocities"][k, sample])
            for k in (0, 1)
        ]
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
    return sum(
        tensor @ w + mass * np.cross(x, v)
        for tensor, mass, x, (v, w) in zip(tensors, masses, positions, states, strict=True)
    )


def closing_speed(states, positions, point, normal):
    (v1, w1), (v2, w2) = states
    arms = [point - position for position in positions]
    return (v1 + np.cross(w1, arms[0]) - v2 - np.cross(w2, arms[1])) @ normal
