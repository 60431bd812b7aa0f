"""Steps a collapsing heap with the code of another checkout, for `timings.py --before`.

Arguments: path of the checkout, scene file, steps of the collapse, and settings by name as JSON.
For each line with a name, makes a step with these settings, and writes its processor time in s.
"""

import inspect
import json
import sys
import time
from pathlib import Path


def main(path, scene, collapsing, settings):
    path = str(Path(path).resolve())
    sys.path.insert(0, path)
    from rbs.scenes import simulation

    assert simulation.__file__.startswith(path), simulation.__file__
    settings = json.loads(settings)
    if "contactScheduling" not in inspect.signature(simulation.Settings).parameters:
        del settings["batches"]["contactScheduling"]
        settings["batches"]["broadPhase"] = "grid"  # which then meant batches, too
    make = getattr(simulation, "SceneSimulation", None) or simulation.Simulation
    runs = {name: make(scene, simulation.Settings(**own)) for name, own in settings.items()}
    for _ in range(int(collapsing)):
        runs["batches"].step()
    for run in runs.values():
        run.set_state(runs["batches"].state())
    for line in sys.stdin:
        begin = time.process_time()
        runs[line.strip()].step()
        print(time.process_time() - begin, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
