"""`--trace`: the events of one step, as a table of text."""

from program import call
from studentVariants import write_submission


def test_trace_prints_the_events_of_a_step_of_one_body(capsys):
    traced = "slide", "--basic", "--trace"
    code, out, _ = call(capsys, *traced, "41")
    assert code == 0 and "impulse of slab 2 and box 7" in out
    code, some, _ = call(capsys, *traced, "41:box 7")
    assert code == 0 and set(some.splitlines()) < set(out.splitlines())
    assert call(capsys, *traced, "41:7")[1] == some


def test_a_failing_step_is_traced_up_to_where_it_fails(tmp_path, capsys):
    begin = "    denominator = total"
    wrong = write_submission(
        tmp_path / "wrong", [(begin, f"    raise ValueError('none')\n{begin}")]
    )
    code, out, error = call(capsys, "mixed", "--trace", "43", "--functions", wrong)
    assert code == 3 and "none" in error
    heads = [line for line in out.splitlines() if not line.startswith("       ")]
    assert "contact 1 of cylinder 1 and the ground" in heads[-1]
