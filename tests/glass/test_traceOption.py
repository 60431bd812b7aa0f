"""`--trace`, `Simulation.trace`, and the terms that `graders/compare.py` prints."""

import sys

import pytest
from oracles import ROOT

sys.path.insert(0, str(ROOT / "graders"))

from isolated.stepComparison import Comparison
from studentVariants import write_submission

from rbs.scenes.scenefiles import find_scene
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.settings import Settings
from RigidBodySimulation import Simulation, main

SLIDE = str(ROOT / "data/slide-scene.txt")


def traced(capsys, *arguments):
    code = main(list(arguments))
    return code, *capsys.readouterr()


def test_trace_prints_the_events_of_a_step_of_one_body(capsys):
    code, out, _ = traced(capsys, SLIDE, "--basic", "--trace", "41")
    assert code == 0 and "impulse of slab 2 and box 7" in out
    code, some, _ = traced(capsys, SLIDE, "--basic", "--trace", "41:box 7")
    assert code == 0 and set(some.splitlines()) < set(out.splitlines())
    assert traced(capsys, SLIDE, "--basic", "--trace", "41:7")[1] == some
    simulation = Simulation(SLIDE)
    simulation.run(40)
    assert simulation.trace(7) + "\n" == some and simulation.stepCount == 41
    assert simulation.trace(simulation.meshes[7]) != some  # the next step


def test_traces_with_another_schedule_and_of_a_resumed_recording_are_the_same(tmp_path, capsys):
    record = str(tmp_path / "run.h5")
    _, out, _ = traced(capsys, SLIDE, "--trace", "41")
    assert traced(capsys, SLIDE, "--trace", "41", "--contacts", "batches")[1] == out
    assert main([SLIDE, "--headless", "--steps", "40", "--record", record]) == 0
    capsys.readouterr()
    assert traced(capsys, "--resume", record, "--trace", "41")[1] == out
    code, _, error = traced(capsys, "--resume", record, "--trace", "40")
    assert code == 2 and error == "RigidBodySimulation.py: --trace: the first step is 41, not 40\n"


@pytest.mark.parametrize("body", ["nobody", "8"])
def test_bodies_that_do_not_exist_are_reported(body, capsys):
    code, _, error = traced(capsys, SLIDE, "--trace", f"3:{body}")
    assert code == 2 and error.count("\n") == 1
    assert error.endswith(f"--trace: no body '{body}'; there are 0 to 7\n")


@pytest.mark.parametrize("value", ["0", "x", "-3", ""])
def test_steps_that_do_not_exist_are_reported(value, capsys):
    with pytest.raises(SystemExit) as stop:
        main([SLIDE, f"--trace={value}"])
    assert stop.value.code == 2 and "--trace" in capsys.readouterr().err


def test_a_students_trace_differs_in_what_is_wrong(tmp_path, capsys):
    """The right solution has the same table; a wrong one first differs in its impulse."""
    scene = str(ROOT / "data/mixed-scene.txt")
    _, ours, _ = traced(capsys, scene, "--basic", "--trace", "43")
    right = str(write_submission(tmp_path / "right"))
    assert traced(capsys, scene, "--trace", "43", "--functions", right)[1] == ours
    edit = "(1.0 + CRCoeff) * np.sum", "CRCoeff * np.sum"
    wrong = str(write_submission(tmp_path / "wrong", [edit]))
    _, theirs, _ = traced(capsys, scene, "--trace", "43", "--functions", wrong)
    lines = zip(ours.splitlines(), theirs.splitlines(), strict=True)
    different = [[line.split()[0] for line in pair] for pair in lines if len(set(pair)) > 1]
    assert different == [["K"] * 2, ["j"] * 2, ["v1′"] * 2, ["ω1′"] * 2]


def test_a_failing_step_is_traced_up_to_where_it_fails(tmp_path, capsys):
    edit = (
        "    denominator = total",
        "    raise ValueError('no denominator')\n    denominator = total",
    )
    wrong = str(write_submission(tmp_path / "wrong", [edit]))
    code, out, error = traced(
        capsys, str(ROOT / "data/mixed-scene.txt"), "--trace", "43", "--functions", wrong
    )
    assert code == 3 and "no denominator" in error
    heads = [line for line in out.splitlines() if not line.startswith("       ")]
    assert "contact 1 of cylinder 1 and the ground" in heads[-1]


@pytest.mark.parametrize(
    ("scene", "edit", "symbols"),
    [
        ("mixed", ("total + np.sum(c1 * (c1 @ invI1.T)) + ", "total + "), ["K", "j", "v1′", "ω1′"]),
        ("tower_chain", ("invMasses[1] / total * push", "0.5 * push"), ["COM2′"]),
        ("tower_chain", ("/ (J @ invM @ J)", "/ (J @ J)"), ["K", "λ", "v2′", "ω2′"]),
        ("mixed", ("timeStep * gravity", "0.5 * timeStep * gravity"), ["v′", "COM′"]),
    ],
)
def test_compare_tells_the_terms_where_a_call_differs(tmp_path, scene, edit, symbols):
    ours = SceneSimulation(find_scene(ROOT / f"data/{scene}-scene.txt"), Settings())
    comparison = Comparison(write_submission(tmp_path / "wrong", [edit]), ours)
    while not comparison.problem and ours.stepCount < 60:
        comparison.step()
    assert comparison.problem and "ours" in comparison.problem
    compared = [line.split(" ours ") for line in comparison.terms if ", theirs " in line]
    different = [line[0].strip() for line in compared if len(set(line[1].split(", theirs "))) > 1]
    assert different == symbols
    if edit[1] == "total + ":  # K without its angular part is what the line says
        (line,) = (one for one in comparison.terms if one.split()[0] == "K")
        K = float(line.split("theirs ")[1].split()[0])
        assert K == pytest.approx(ours.meshes[1].invMass, rel=1e-3)
