"""A number that overflows stops the program cleanly."""

import re

import numpy as np
from program import DATA, record, run

from rbs.recordings.recording import Recording
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.meshes import LARGEST_NUMBER


def test_program_ends_with_one_line_and_keeps_the_recording(tmp_path):
    simulation = SceneSimulation(DATA / "mixed-scene.txt")
    simulation.step()
    # 1.8e73 m a step: it leaves the numbers' range after some dozen of them
    simulation.meshes[4].linVelocity = np.array([[0.9 * LARGEST_NUMBER, 0.0, 0.0]])
    record(tmp_path / "start.h5", simulation, 0)
    words = "--resume start.h5 --record r.h5 --stats s.csv --steps 400".split()
    process = run(tmp_path, *words, PYTHONWARNINGS="always")
    assert process.returncode == 3
    (line,) = process.stderr.splitlines()
    found = re.fullmatch(
        r"RigidBodySimulation.py: step (\d+) cannot be made: body 4, '\w+ 4': "
        r"\w+ holds \S+ after [\w ]+",
        line,
    )
    step = int(found[1])
    assert 50 < step < 60 and "stopped by an error" in process.stdout
    assert Recording(tmp_path / "r.h5").lastStep == step - 1
    assert len((tmp_path / "s.csv").read_text().splitlines()) == step
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r.h5", "s.csv", "start.h5"]
    assert run(tmp_path, "--verify", "r.h5").returncode == 0
