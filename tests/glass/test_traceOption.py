"""`--trace`: the events of one step, as a table of text."""

import sys

from oracles import ROOT

sys.path.insert(0, str(ROOT / "graders"))

from studentVariants import write_submission

from RigidBodySimulation import main

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
