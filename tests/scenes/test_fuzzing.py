"""The readers, on hundreds of damaged files: each is loaded whole, or refused in one line.

Both must happen often, or the damage was too great or too small. All runs have the same cases.
"""

import random
import warnings
from collections import Counter

import numpy as np
import pytest
from test_loading import FILES

from rbs.scenes.simulation import SceneSimulation
from rbs.scenes.textfiles import SceneError

# Of all cases, at least this share is loaded, and at least this share refused.
CASES, LEAST_SHARE = 80, 0.08
NASTY = "nan -inf 1e308 1e-320 1e9 0 -0.0 -1 1 3 0x1F 1_000 1,5 --1 +1 ٣ \ufeff \0 .. /dev/zero"
NASTY = [*f"{NASTY} t.mesh/ a-scene.txt End Vertices OFF [ #".split(" "), "9" * 400]


def damaged(text, generator):
    """The text after one or two operations on its lines."""
    lines = text.split("\n")
    for _ in range(generator.choice([1, 1, 1, 2])):
        i = generator.randrange(len(lines))
        line, words = lines[i], lines[i].split(" ")
        words[generator.randrange(len(words))] = generator.choice(NASTY)
        others = [], [line, line], [line[:-1]]
        lines[i : i + 1] = generator.choice([*4 * [[" ".join(words)]], *others])
    return "\n".join(lines)


@pytest.mark.parametrize("name", FILES)
def test_text_file(sceneFolder, name):
    text, outcomes = (sceneFolder / name).read_text(), Counter()
    for seed in range(CASES):
        (sceneFolder / name).write_text(damaged(text, random.Random(f"{name} {seed}")))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # NumPy's would be a second line
                warnings.simplefilter("ignore", UserWarning)
                simulation = SceneSimulation("a-scene.txt")
                simulation.step()
        except SceneError as told:
            assert str(told).isprintable() and len(str(told)) < 1000
            outcomes["refused"] += 1
        else:
            assert all(0.0 < mesh.mass < np.inf for mesh in simulation.meshes)
            outcomes["loaded"] += 1
    assert min(outcomes["loaded"], outcomes["refused"]) >= LEAST_SHARE * CASES, outcomes
