"""The readers, on hundreds of damaged files: real ones with mutations.

The reader either loads something whole or raises its own error in one line. Both must happen often,
or the damage was too great or too small. The cases are the same in every run.
"""

import math
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

NASTY_WORDS = (
    *(b"nan", b"-inf", b"1e308", b"1e-320", b"1e9", b"0", b"-0.0", b"-1", b"1", b"3", b"9" * 400),
    *(b"0x1F", b"1_000", b"1,5", b"--1", b"+1", b"true", b"\xd9\xa3", b"#", b"\xef\xbb\xbf"),
    *(b"\x00", b"..", b"../../etc/passwd", b"/dev/zero", b"t.mesh/", b"a-scene.txt", b"End"),
    *(b"Vertices", b"Triangles", b"OFF", b"[", b"}", b'"', b"1e400", b"", b" "),
)


def mutated(content, generator):
    """The bytes after one or two operations on their lines."""
    for _ in range(generator.choice([1, 1, 1, 2])):
        pieces = content.split(b"\n")
        i = generator.randrange(len(pieces))
        words, nasty = pieces[i].split(b" "), generator.choice(NASTY_WORDS)
        kind = generator.choice("flip cut delete double swap comment word word word".split())
        if kind == "flip" and pieces[i]:
            flipped = pieces[i][-1] ^ (1 << generator.randrange(8))
            pieces[i] = pieces[i][:-1] + bytes([flipped])
        elif kind == "cut":
            pieces[-1] = pieces[-1][: -generator.randrange(1, 9)]
        elif kind == "delete":
            del pieces[i]
        elif kind == "double":
            pieces.insert(i, pieces[i])
        elif kind == "swap":
            pieces[i], pieces[0] = pieces[0], pieces[i]
        elif kind == "comment":
            pieces[i] += b" # " + nasty
        else:
            words[generator.randrange(len(words))] = nasty
            pieces[i] = b" ".join(words)
        content = b"\n".join(pieces)
    return content


def check_scene():
    """Bodies, and bounds between them, that can be simulated."""
    simulation = SceneSimulation("a-scene.txt")
    for mesh in simulation.meshes:
        assert 0.0 < mesh.mass < math.inf and np.isfinite(mesh.invIT).all()
        assert abs(np.linalg.norm(mesh.orientation) - 1.0) < 1e-12
    simulation.step()
    assert simulation.is_finite()


@pytest.mark.parametrize("name", FILES)
def test_text_file(sceneFolder, name):
    content, outcomes = (sceneFolder / name).read_bytes(), Counter()
    for seed in range(CASES):
        damaged = mutated(content, random.Random(f"{name} {seed}"))
        (sceneFolder / name).write_bytes(damaged)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # NumPy's would be a second line
                warnings.simplefilter("ignore", UserWarning)
                check_scene()
        except SceneError as told:
            assert str(told).isprintable() and len(str(told)) < 1000
            outcomes["refused"] += 1
        else:
            outcomes["loaded"] += 1
    assert min(outcomes["loaded"], outcomes["refused"]) >= LEAST_SHARE * CASES, outcomes
