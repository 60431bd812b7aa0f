"""`graders/compare.py`: the first step, call and quantity in which a student's steps leave ours."""

import json
import re
import shutil

import numpy as np
import pytest
import studentVariants
from isolated.stepComparison import Comparison
from oracles import DATA
from studentVariants import EARLY, HOSTILE, LOST, START, VARIANTS, edited, write_submission, written
from worker.steps import Scene

from rbs.program.submissions import POSITION, VELOCITY, load_submission
from rbs.program.submittedsteps import SubmittedSteps
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.settings import Settings

# Two pairs that are linked, one of them from below the ground on; the first body is fixed there.
SCENE = """\
5
box.mesh          1 1   0  2 0  1 0 0 0
tetrahedron.mesh  1 0   2 12 1  0.9 0.3 0.1 0.2
octahedron.mesh   1 0  -1 24 0  0.8 0.1 0.5 -0.2
box.mesh          1 0  25  6 3  0.9 0.2 0.1 0.3
tetrahedron.mesh  1 0  26 17 2  0.5 0.5 0.5 -0.5
"""
CONSTRAINTS = "2\n1 0 2 1 0.95 1.05\n3 0 4 0 0.98 1.02\n"
STEPS = 30

# The variants, by the call in which their mistake is found. Some right with the graders are wrong
# here: the graders pass other shapes than their own run_timestep does.
FOUND = {}
for name, (_name, _edits, where, *_verdict) in studentVariants.table_rows().items():
    FOUND.setdefault(where, []).append(name)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    for mesh in DATA.glob("*.mesh"):
        shutil.copy(mesh, folder)
    (folder / "all-scene.txt").write_text(SCENE)
    (folder / "all-constraints.txt").write_text(CONSTRAINTS)
    return folder / "all-scene.txt"


def compared(folder, scene, files, steps=STEPS):
    """The Comparison of a solution, after so many steps or the first difference."""
    ours = SceneSimulation(scene, Settings(timeStep=0.02, restitution=0.5))
    functions, place = load_submission(written(folder / "student", files)).functions, str(folder)
    scenes = []

    def ask(order):
        """What a worker answers, in this process."""
        order = json.loads(json.dumps(order))
        if "bodies" in order:
            scenes.append(Scene(order, functions, place))
        answer = scenes[-1].built() if "bodies" in order else scenes[-1].call(order)
        return json.loads(json.dumps(answer))

    with np.errstate(all="ignore"):
        comparison = Comparison(ours, steps)
        comparison.build(ask)
        while not comparison.isOver:
            comparison.step()
    return comparison


# In the quick suite, one variant of each call, and those with a tensor or state of another kind; of
# the others, every second one.
QUICK = {where: names[:1] for where, names in FOUND.items()}
QUICK[""] += ["released", "in-place", "skeleton-guarded"]
CASES = [(where, QUICK[where]) for where in FOUND]
CASES += [pytest.param(where, FOUND[where][1::2], marks=pytest.mark.slow) for where in FOUND]


# Mistakes beside a tensor that is turned as in the release: the call, the edit, and the hint.
BESIDE_RELEASED = {
    VELOCITY: (("-n, -np.cross(r2, n)", "-n, np.cross(r2, n)"), "the last block of J has"),
    "resolve_collision": (("+ np.sum(c2 * (c2 @ invI2.T))", ""), "the rotational term of mesh 2"),
    POSITION: (
        ("    isValid =", "    return True, currPositions\n    isValid ="),
        "not implemented",
    ),
}


@pytest.mark.parametrize("call", BESIDE_RELEASED)
def test_what_is_allowed_for_hides_no_mistake(call, scene, tmp_path):
    edit, hint = BESIDE_RELEASED[call]
    comparison = compared(tmp_path, scene, edited(*VARIANTS["released"], edit))
    assert f" {call}: " in comparison.problem and " v1," not in comparison.problem
    assert comparison.terms[-1].startswith(f"hint: {hint}") and " - or " not in comparison.terms[-1]


@pytest.mark.parametrize(("where", "names"), CASES)
def test_each_variant_is_found_where_its_mistake_is(where, names, scene, tmp_path):
    for name in names:
        comparison = compared(tmp_path / name, scene, studentVariants.files_of_variant(name))
        assert bool(comparison.problem) == bool(where), f"{name}: {comparison.problem}"
        assert where in comparison.problem
        assert where or comparison.largest < 1e-14


DRIVERS = {
    "raises": ((START, "    raise ValueError\n"), r"RBSFunctions.py:\d+ in \w+: ValueError$"),
    "none": (("def run_timestep", "def no"), "run_timestep: is not in RBSFunctions.py"),
    "lost position": (
        ("pair[k].position = corrected[k]", "pair[0].position = corrected[0]"),
        r"run_timestep: position of box 3 is \(.*\) in ours, \(.*\) in theirs .* functions agree",
    ),
    "bodies put to sleep": (
        (
            "    for mesh in meshes:\n        mesh.integrate",
            "    meshes[2].isFixed = True\n    for mesh in meshes:\n        mesh.integrate",
        ),
        "step 1: run_timestep: isFixed of .* 2 is False in ours, True in theirs at .* agree",
    ),
    "tensor changed": (
        ("    m1.update_vertices()\n", "    m1.update_vertices()\n    m1.invIT = 2.0 * m1.invIT\n"),
        "step 1: resolve_collision: invIT of box 3, which no call may change, is",
    ),
    "no ground": (
        ("if lowest[1] <= 0.0:", "if lowest[1] <= -9.0:"),
        r"run_timestep: position of box 3 is \(.*\) in ours",
    ),
    "vertices of before": (
        ("    m1.update_vertices()\n    m2.update_vertices()\n", ""),
        "resolve_collision: currVertices of .* are out of date",
    ),
    "another velocity returned": (
        ("return False, (v1, v2), (w1, w2)", "return False, (v1, currLinVelocities[1]), (w1, w2)"),
        "resolve_velocity_constraint: constraint . of .* differs in .*v2′",
    ),
}


@pytest.mark.parametrize("name", DRIVERS)
def test_what_run_timestep_does_otherwise_is_found(name, scene, tmp_path):
    edit, text = DRIVERS[name]
    assert re.search(text, compared(tmp_path, scene, edited(edit), 110).problem)


def test_the_released_run_timestep_is_named_and_hides_nothing(tmp_path):
    files = edited(LOST, EARLY, *VARIANTS["restitution-twice"])
    comparison = compared(tmp_path, DATA / "tower_chain-scene.txt", files, 60)
    lost, early = comparison.remarks
    assert lost.startswith("run_timestep loses a corrected linVelocity, as in the coursework's")
    assert early.startswith("run_timestep ends before the constraints hold, as in the")
    assert comparison.problem.startswith("step 56: resolve_collision: contact 1: impulse of box 0")


def test_a_touch_of_no_depth_is_nobodys_mistake(scene, tmp_path):
    """After falling by h² g = 0.00392 in a step, one box touches another, and one the ground."""
    touching = scene.with_name("touching-scene.txt")
    touching.write_text(
        "3\nbox.mesh 1 1 0 2 0 1 0 0 0\nbox.mesh 1 0 0 8.00392 0 1 0 0 0\n"
        "box.mesh 1 0 30 3.00392 0 1 0 0 0\n"
    )
    stricter = [
        ("np.all(high >= otherLow) and", "np.all(high >= otherLow + 1e-12) and"),
        ("if lowest[1] <= 0.0:", "if lowest[1] <= -1e-12:"),
    ]
    comparison = compared(tmp_path, touching, edited(*stricter), 1)
    assert (comparison.problem, comparison.remarks) == ("", {})
    alone = SceneSimulation(touching)
    alone.submitted = SubmittedSteps(tmp_path / "student")
    alone.step()
    ours, theirs = (one.state()["linVelocities"][:, 1] for one in (comparison.ours, alone))
    assert theirs[:2] == pytest.approx([0.0, -0.196]) and ours[1] == pytest.approx(0.098)


def test_a_difference_ends_it_with_1(scene, tmp_path, run):
    edits = VARIANTS["arms-exchanged"] + VARIANTS["small-tensor"]
    ended = run("compare.py", write_submission(tmp_path / "a", edits), scene, "--steps", 2)
    assert (ended.returncode, ended.stderr) == (1, "")
    remark, line, *terms = ended.stdout.splitlines()
    assert remark.startswith("IT is six times too small, as in the released skeleton")
    assert line.startswith("step 1: resolve_collision: contact 1: impulse of box 3 and the ground")
    assert [one.split()[0] for one in terms if "theirs" in one] == ["K", "j", "v1′", "ω1′"]


SET = {"tolerance=1e-3": "28 steps agree", "tolerance=9": "of box 1", "x=1": "no parameter x"}


@pytest.mark.parametrize(("given", "said"), SET.items())
def test_run_timestep_is_given_parameters_of_its_own(given, said, tmp_path, run):
    words = write_submission(tmp_path / "a"), "tower_chain", "--steps", 28, "--set", given
    assert said in run("compare.py", *words).stdout


ENDS = {
    "endless-loop": (1, "step 1: stopped after 1 s, at RBSFunctions.py:"),
    "returns-nothing": (60, "step 24: detect_collision: returns nothing; RBS"),
}


@pytest.mark.parametrize("name", ENDS)
def test_a_process_that_ends_early_is_reported(name, scene, tmp_path, run):
    student, (limit, text) = write_submission(tmp_path / "a", HOSTILE[name]), ENDS[name]
    ended = run("compare.py", student, scene, "--time-limit", limit)
    assert (ended.returncode, ended.stderr) == (1, "")
    assert ended.stdout.startswith(text) and ended.stdout.count("\n") == 1
