"""Kills recorded runs by SIGKILL at random moments: `python tests/killedRuns.py --runs 200`.

Each recording must open, hold all but the last second, and have the states of a run that was not
killed; a second program replays every tenth run while it goes. Ends with exit code 1 otherwise.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from program import PROGRAM, environment, run

sys.path.insert(0, str(PROGRAM.parent))

from rbs.recording import Recording, RecordingError
from rbs.state import STATE_NAMES

# Scene, and the steps of the run that is not killed.
SCENES = {"mixed": 20_000, "stress": 8_000, "stack": 3_000}
# Seconds of a run at most, before it is killed.
LONGEST = 5.0
# Seconds that a killed run may lose.
MOST_LOST = 1.0


def killed_run(folder, scene, seconds, isReplayed):
    """Runs a scene for so many seconds, and kills it.

    returns how many steps had been made a second before
    """
    command = [sys.executable, PROGRAM, scene, "--steps", "1000000", "--record", "r.h5"]
    command += ["--stats", "s.csv"]
    process = subprocess.Popen(
        command, cwd=folder, env=environment(), stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
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
    process.wait()
    return madeBefore if seconds >= MOST_LOST else -1


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", metavar="N", type=int, default=20)
    parser.add_argument("--seed", metavar="S", type=int, default=1)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    bad, kept, replayed = [], [], 0
    with tempfile.TemporaryDirectory() as home:
        home = Path(home)
        wholes = {}
        for scene, steps in SCENES.items():
            run(home, scene, "--steps", steps, "--record", f"{scene}.h5")
            wholes[scene] = Recording(home / f"{scene}.h5")
        for number in range(options.runs):
            scene = list(SCENES)[number % len(SCENES)]
            folder = home / str(number)
            folder.mkdir()
            isReplayed, seconds = number % 10 == 0, rng.uniform(0.0, LONGEST)
            madeBefore = killed_run(folder, scene, seconds, isReplayed)
            replayed += isReplayed
            try:
                recording = Recording(folder / "r.h5")
            except RecordingError as error:
                bad.append(f"run {number}, {scene}, {seconds:.2f} s: {error}")
                continue
            kept.append(recording.lastStep)
            if recording.lastStep < madeBefore:
                bad.append(f"run {number}: {recording.lastStep} kept, {madeBefore} made before")
            for step in range(min(recording.lastStep, wholes[scene].lastStep) + 1):
                one, other = recording.frame(step), wholes[scene].frame(step)
                if any(one[name].tobytes() != other[name].tobytes() for name in STATE_NAMES):
                    bad.append(f"run {number}, {scene}: step {step} differs")
                    break
    print(*bad, sep="\n")
    print(f"{options.runs} runs killed, {replayed} of them replayed while they went; steps kept: "
          f"{min(kept)} to {max(kept)}; failures: {len(bad)}")  # fmt: skip
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
