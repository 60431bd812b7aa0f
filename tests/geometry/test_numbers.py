"""Numbers that overflow stop a run cleanly, and unusual parameters do what the README says."""

import math
import re
import warnings

import numpy as np
import pytest
from oracles import STATE, state_of
from program import DATA, record, run

from rbs.recordings.recording import Recording
from rbs.scenes.simulation import SceneSimulation, Settings
from rbs.stepping.meshes import LARGEST_NUMBER, StateError

G = 9.8
ways = pytest.mark.parametrize("way", [{}, {"contactScheduling": "batches"}])


@ways
@pytest.mark.parametrize(
    "name, value", [*zip(STATE, (1e80, math.nan, math.inf, 1e80), strict=True)]
)
def test_a_wrong_number_stops_at_the_step_and_names_the_body(name, value, way):
    simulation = SceneSimulation(DATA / "mixed-scene.txt", Settings(**way))
    for _ in range(5):
        simulation.step()
    mesh = simulation.meshes[4]
    wrong = np.array(getattr(mesh, name))
    wrong[0, 1] = value
    setattr(mesh, name, wrong)
    before, when = state_of(simulation.meshes), simulation.time
    said = rf"^step 6 cannot be made: body 4, 'tetrahedron 4': {name} holds \S+ after .*$"
    with warnings.catch_warnings(), pytest.raises(StateError, match=said):
        warnings.simplefilter("error")
        simulation.step()
    # as before the step
    np.testing.assert_array_equal(state_of(simulation.meshes), before)
    assert simulation.stepCount == 5 and simulation.time == when


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
