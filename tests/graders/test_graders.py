"""The graders, the reference data they grade against, and the reading of hostile data files."""

import os
import pickle
import re

import make_reference
import pytest
from oracles import DATA
from reference import graderData

FILES = "integrationGrading.py", "ResolveCollisionsGrading.py", "Constraints.py"
INTEGRATION, COLLISIONS, CONSTRAINTS = FILES
LAYOUTS = {
    "integration.data": graderData.INTEGRATION_LAYOUT,
    "collision-resolution.data": graderData.COLLISION_LAYOUT,
    "constraint-resolution.data": graderData.CONSTRAINT_LAYOUT,
}

# The quantities are of size 1 to 100, and a few dozen roundings stand between inputs and results.
ROUNDING = 1e-12


def reported_errors(output):
    """A dict from quantity to the error in the table, or to the number of bools that differ."""
    errors = {}
    for line in output.splitlines():
        cells = re.split(r"\s{3,}", line.strip())
        if len(cells) in (4, 5) and cells[0] != "quantity":
            errors[cells[0]] = float(cells[1].removesuffix(" differ"))
    return errors


@pytest.mark.parametrize("grader, count", [(INTEGRATION, 6), (COLLISIONS, 12), (CONSTRAINTS, 18)])
def test_the_simulation_passes_on_our_data(grader, count, run, tmp_path):
    graded = run(grader, cwd=tmp_path)
    assert (graded.returncode, graded.stderr) == (0, "")
    errors = reported_errors(graded.stdout)
    assert len(errors) == count and max(errors.values()) < ROUNDING
    assert graded.stdout.splitlines()[-1].startswith(f"PASS: all {count} quantities")


@pytest.mark.parametrize("grader", FILES)
def test_released_data_pass_in_their_own_convention(grader, released_data, run):
    graded = run(grader, "--data", released_data)
    assert "data of the convention released-2024" in graded.stdout
    assert graded.returncode == 0, graded.stdout + graded.stderr
    assert max(reported_errors(graded.stdout).values()) < ROUNDING
    if grader == INTEGRATION:
        assert re.search(r"^resultPositions .* 101$", graded.stdout, re.MULTILINE)


class Intruder:
    """Pickles as a call that writes the file `trace`."""

    def __reduce__(self):
        return os.system, ("touch trace",)


CONTENT = (DATA / "collision-resolution.data").read_bytes()


def pickled(key, change):
    """The collision data's pickle after a change of one entry."""
    data = pickle.loads(CONTENT)
    return pickle.dumps(data | {key: change(data[key])})


UNUSABLE = {
    "missing": (None, "No such file"),
    "missing key": (pickle.dumps({"faces1": 0}), "no entry origVertices1, "),
    "too few samples": (pickled("depth", lambda a: a[:-1]), "depth holds float64 of shape (99,)"),
    "flat mesh": (pickled("origVertices1", lambda a: a * [1, 1, 0]), "mesh 1 is not a body"),
    "a call": (pickle.dumps({"depth": Intruder()}), f"{os.system.__module__}.system is refused"),
    "another name": (pickle.dumps({"depth": complex(1, 2)}), "builtins.complex is refused"),
}


@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
@pytest.mark.parametrize("case", UNUSABLE)
def test_unusable_data_are_refused_in_one_line(case, tmp_path, run):
    content, cause = UNUSABLE[case]
    path = tmp_path / "collision-resolution.data"
    if content is not None:
        path.write_bytes(content)
    graded = run(COLLISIONS, "--data", tmp_path, cwd=tmp_path)
    assert (graded.returncode, graded.stdout) == (2, "")
    (line,) = graded.stderr.splitlines()
    assert str(path) in line and cause in line
    assert {*tmp_path.iterdir()} <= {path}


def test_the_data_are_those_of_the_formulas(tmp_path):
    make_reference.make_reference(tmp_path)
    for name, layout in LAYOUTS.items():
        stored, made = (graderData.load_grader_data(p / name, layout) for p in (DATA, tmp_path))
        for key in layout:
            assert made[key] == pytest.approx(stored[key], abs=ROUNDING), (name, key)
        for content in ((DATA / name).read_bytes(), (tmp_path / name).read_bytes()):
            # The name that every NumPy since version 1.0 can import.
            assert b"numpy.core.multiarray" in content and b"numpy._core" not in content
