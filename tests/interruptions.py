"""Interrupts recordings at random: any number of signals, at any time.

    python tests/campaigns.py interrupts

Each run records tower in many small chunks, and writes a table. One to five signals come at random
times, often in bursts, and often while the recording is being saved: Ctrl-C, kill, hang-up, or kill
-9, which no program can see. Half of the recordings that are left in pieces are finished by a
`--finish` that is interrupted the same way. After all that there must be a whole recording, or a
folder that `--finish` makes one of; whatever place a message names must be there; and no traceback.
"""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from rbs.recording import Recording, finish  # noqa: E402

# The program with chunks every few states, and joining that takes its time.
PROGRAM = """
import sys, time
import rbs.recording
rbs.recording.CHUNK_SECONDS, rbs.recording.CHUNK_SHARE = 0.01, 0.0
rbs.recording.JOIN_PATIENCE = float(sys.argv[1])
joined, pause = rbs.recording._joined, float(sys.argv[2])
def slowly(*arguments):
    for rows in joined(*arguments):
        time.sleep(pause)
        yield rows
rbs.recording._joined = slowly
import RigidBodySimulation
RigidBodySimulation.watch_signals()
open("started", "w").close()
sys.argv[1:] = sys.argv[3:]
RigidBodySimulation.command()
"""
SIGNALS = (signal.SIGINT, signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL)
# Seconds that a program has to end by itself, after the last signal.
PATIENCE = 60.0


def interrupted(folder, arguments, rng):
    """Runs the program and sends signals; (exit code, stderr, the signals)."""
    (folder / "started").unlink(missing_ok=True)
    patience, pause = rng.choice(["0", "1"]), rng.choice(["0", "0.002"])
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, patience, pause, *arguments], cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    end = time.monotonic() + PATIENCE
    # What a signal does before Python has started is Python's affair; nothing is written then.
    while not (folder / "started").exists() and process.poll() is None:
        if time.monotonic() > end:
            process.kill()
        time.sleep(0.001)
    sent = []
    time.sleep(rng.uniform(0.0, 1.2))
    for _ in range(rng.randint(1, 5)):
        if process.poll() is not None:
            break
        sent.append(rng.choice(SIGNALS))
        process.send_signal(sent[-1])
        time.sleep(rng.choice([0.0, rng.uniform(0.0, 0.02), rng.uniform(0.0, 0.3)]))
    try:
        _, errors = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        _, errors = process.communicate()
        errors += "\nTraceback of this script: the program did not end"
    return process.returncode, errors, sent


def complaints(folder, code, errors, sent):
    """What is wrong with how a run has ended: a list of texts."""
    found = []
    lines = [line for line in errors.splitlines() if line.strip() and "step/s" not in line]
    if "Traceback" in errors or len(lines) > 1:
        found.append(f"stderr: {errors[-400:]!r}")
    allowed = {0, 2, *(128 + number for number in sent)}
    if signal.SIGKILL in sent:
        allowed.add(-signal.SIGKILL)
    if code not in allowed or (code == 2 and "--finish" not in errors):
        found.append(f"exit code {code} after {[number.name for number in sent]}: {errors[-200:]}")
    if places := re.search(r"what there is of the run is in (.*)", errors):
        for place in places[1].split(" and "):
            if not (folder / place).exists():
                found.append(f"there is no {place}, which the message names")
    if (folder / "r.npz").exists():
        try:
            recording = Recording(folder / "r.npz")
            if recording.damage() != "":
                found.append("r.npz is damaged")
        except ValueError as error:
            found.append(f"r.npz cannot be read: {error}")
    return found


def one_run(folder, rng, counts):
    """One run, interrupted, and what comes of it; returns a list of complaints."""
    steps = str(rng.choice([20, 100, 400, 2000]))
    arguments = ["tower", "--steps", steps, "--record", "r.npz", "--stats", "s.csv"]
    end = interrupted(folder, arguments, rng)
    found = complaints(folder, *end)
    counts["signals"] += len(end[2])
    counts["ended by kill -9"] += end[0] == -signal.SIGKILL
    counts["stopped, all saved"] += end[0] > 2 and not (folder / "r.npz.part").exists()
    part = folder / "r.npz.part"
    tries = 0
    while part.exists() and tries < 3 and rng.random() < 0.5:
        tries += 1
        counts["interrupted --finish"] += 1
        end = interrupted(folder, ["--finish", "r.npz"], rng)
        counts["signals"] += len(end[2])
        if end[0] == 2:
            found.append(f"--finish refuses: {end[1]}")
        found += complaints(folder, *end)
    if part.exists():
        counts["left in pieces"] += 1
        try:
            path, first, last = finish(folder / "r.npz")
        except (OSError, ValueError) as error:
            return [*found, f"--finish refuses: {error}; {sorted(os.listdir(part))}"]
        counts["of them before the first chunk"] += last < first
    if (folder / "r.npz").exists():
        counts["whole in the end"] += 1
        found += complaints(folder, 0, "", [])
    if part.exists():
        found.append("--finish leaves the folder")
    return found
