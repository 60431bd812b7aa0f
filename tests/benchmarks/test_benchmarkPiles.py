"""benchmarkPiles.py: its windows and rows."""

import csv
import subprocess
import sys

import benchmarkPiles
import pytest


@pytest.mark.slow
def test_there_is_a_row_for_each_run_and_window(tmp_path):
    words = "--sizes 6 12 --kinds heap --windows 1-3 2-5 --all-up-to 6 --out".split()
    command = [sys.executable, benchmarkPiles.__file__, *words, tmp_path]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    with (tmp_path / "piles.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    found = [(row["bodies"], row["material"], row["steps"], row["run"]) for row in rows]
    assert found == [
        (bodies, material, steps, run)
        for bodies in ("6", "12")
        for material in ("no friction", "friction 0.5")
        for steps in ("1-3", "2-5")
        for run in ("all pairs", "grid", "batches", "soft step")[2 * (bodies != "6") :]
    ]
    for row in rows:
        assert float(row["contacts a body"]) == pytest.approx(
            float(row["contacts"]) / int(row["bodies"]), abs=0.005
        )
        assert f"{row['contacts a body']} contacts a body" in printed
    # between the sizes, for each material and window of the two runs that have both
    assert printed.count("time grows as N^") == 8


def test_windows_get_their_steps_and_no_others():
    class Run:
        steps = 0

        def step(self):
            self.steps += 1

        def counts(self):
            return None, self.steps, {}

    runs = {"one": Run(), "other": Run()}
    windows = [benchmarkPiles.read_window(text) for text in ("2-5", "4-28")]
    kept = benchmarkPiles.measure(runs, windows)
    assert list(kept) == [(window, name) for window in windows for name in runs]
    for (window, _), (seconds, counts) in kept.items():
        assert len(seconds) == len(window)
        # a step is counted after it has been made
        assert [made for _, made, _ in counts] == [step + 1 for step in window[::10]]
    assert all(run.steps == 28 for run in runs.values())
