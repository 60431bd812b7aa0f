"""Kills recorded runs by SIGKILL at random moments.

    python tests/campaigns/killedRuns.py --runs 200

Each recording must open, hold all but the last second, and have the states of a run that was not
killed; a second program replays every tenth run while it goes. Ends with exit code 1 otherwise.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from program import run, start

from rbs.recordings.recording import Recording
from rbs.recordings.replay import verify

SCENES = ("mixed", "stress", "stack")
# Seconds of a run at most, before it is killed; seconds that it may lose.
LONGEST, MOST_LOST = 5.0, 1.0


def killed_run(folder, scene, seconds, isReplayed):
    """Runs a scene for so many seconds and kills it; returns the steps made a second before."""
    process = start(folder, scene, "--steps", 10**6, "--record", "r.h5", "--stats", "s.csv")
    table = folder / "s.part.csv"
    while not table.exists() or len(table.read_bytes().splitlines()) < 2:
        assert process.poll() is None, "the program has ended"
        time.sleep(0.01)
    end = time.monotonic() + seconds
    time.sleep(max(0.0, seconds - MOST_LOST))
    madeBefore = len(table.read_bytes().splitlines()) - 3  # heading, start, line in progress
    if isReplayed:
        replay = run(folder, "--headless", "--replay", "r.h5")
        assert replay.returncode == 0, replay.stderr
    time.sleep(max(0.0, end - time.monotonic()))
    process.kill()
    process.communicate()
    return madeBefore if seconds >= MOST_LOST else -1


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", metavar="N", type=int, default=20)
    options = parser.parse_args()
    rng, bad, kept = np.random.default_rng(1), 0, []
    for number in range(options.runs):
        scene, seconds = SCENES[number % len(SCENES)], rng.uniform(0.0, LONGEST)
        with tempfile.TemporaryDirectory() as folder:
            madeBefore = killed_run(Path(folder), scene, seconds, number % 10 == 0)
            recording = Recording(Path(folder) / "r.h5")
            fault = verify(recording)
        kept.append(recording.lastStep)
        if recording.lastStep < madeBefore:
            fault += f"{recording.lastStep} steps kept, {madeBefore} made before"
        if fault:
            bad += 1
            print(f"run {number}, {scene}, {seconds:.2f} s: {fault}")
    print(f"{options.runs} runs killed; steps kept: {min(kept)} to {max(kept)}; failures: {bad}")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
