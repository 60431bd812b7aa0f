"""Settings that a scene recommends: how they are read, and when they are used."""

import shutil

import pytest
from program import DATA, call

from rbs.recordings.lookup import SceneOpener
from rbs.recordings.recording import Recording
from rbs.scenes.files import SceneError
from rbs.scenes.scenefiles import SceneSource
from rbs.scenes.settingtexts import recommended_values
from rbs.stepping.settings import Settings
from RigidBodySimulation import Simulation

STANDING = {"contactSolver": "soft-step", "friction": 0.5, "restitution": 0.0}


@pytest.fixture
def make_scene(tmp_path, monkeypatch):
    """Writes a scene of one box with these comment lines into the current folder; its path."""
    shutil.copy(DATA / "box.mesh", tmp_path)
    monkeypatch.chdir(tmp_path)

    def make(lines="# nothing"):
        (tmp_path / "a-scene.txt").write_text(f"# a box\n{lines}\n1\nbox.mesh 1 0 0 9 0 1 0 0 0")
        return tmp_path / "a-scene.txt"

    return make


OPTIONS = "gyroscopic no-constraints time-step 0.01 max-iterations 7 scheduling queue"
VALUES = {"gyroscopic": True, "enforceConstraints": False, "timeStep": 0.01, "maxIterations": 7}
# Comment lines, and what they recommend, or None.
LINES = {
    "# it suggests friction\n#suggestsfriction 1\n# suggests": {},
    "# suggests friction 0.5\n#suggests\tsubsteps 6  \r": {"friction": 0.5, "substeps": 6},
    f"# suggests {OPTIONS}": {**VALUES, "constraintScheduling": "queue"},
    "# suggests friction 0.5\n  ## suggests mu 0.2": None,
    "# suggests scheduling quick": None,
    "# suggests gyroscopic 1": None,
    "# suggests solver soft-step broad-phase grid": None,
    "# suggests friction 0.5 friction 0.25": None,
    "# suggests friction 0.5\n# suggests restitution 0 friction 0.5": None,
    "# suggests gyroscopic gyroscopic": None,
}


@pytest.mark.parametrize(("lines", "expected"), LINES.items())
def test_words_are_those_of_the_command_line(make_scene, lines, expected):
    """An error about the last line names its file and number."""
    path = make_scene(lines)
    source = SceneSource.of_files(path)
    if expected is not None:
        assert recommended_values(source) == expected
        return
    with pytest.raises(SceneError) as error:
        recommended_values(source)
    assert str(error.value).startswith(f"{path}:{2 + lines.count(chr(10))}: recommended settings: ")


def test_wrong_recommendation_ends_the_program_unless_it_is_not_asked_for(make_scene, capsys):
    path = make_scene("# suggests frictoin 1")
    code, output, errors = call(capsys, path, "--headless", "--steps", 1)
    assert (code, output) == (2, "") and errors.count("\n") == 1 and f"{path}:2: " in errors
    assert call(capsys, path, "--headless", "--steps", 1, "--basic")[0] == 0


# Options, and the settings that they give to a scene that recommends those of STANDING.
RUNS = {
    "": STANDING,
    "--solver impulse --friction 0.2": STANDING | {"contactSolver": "impulse", "friction": 0.2},
    "--basic --friction 0.2": {"friction": 0.2},
}


@pytest.mark.parametrize("words", RUNS)
def test_recommendations_are_used_told_and_recorded(tmp_path, capsys, words):
    path = tmp_path / "r.h5"
    code, _, errors = call(capsys, "stack", *words.split(), "--record", path, "--steps", 2)
    assert code == 0 and ("stack-scene.txt" in errors) == ("--basic" not in words)
    ((_, settings),) = Recording(path).settingsHistory
    assert Settings(**settings) == Settings(**RUNS[words])
    assert call(capsys, "--verify", path)[::2] == (0, "")  # a recording has its settings in it


def test_in_the_window_each_scene_has_its_own_settings_and_what_was_given():
    stack, slide, tower = (DATA / f"{name}-scene.txt" for name in ("stack", "slide", "tower"))
    opener = SceneOpener()
    opener.open(slide).settings.change("gravity", 0.0)
    assert opener.open(tower).settings == Settings()
    assert opener.open(stack).settings == Settings(**STANDING)
    assert opener.open(slide).settings == Settings(friction=0.2)
    # Options that are given hold for all scenes whose solver uses them.
    opener = SceneOpener({"restitution": 0.9, "broadPhase": "grid"})
    second = opener.open(slide)
    expected = Settings(restitution=0.9, friction=0.2, broadPhase="grid")
    assert second.settings == expected == second.startSettings
    assert opener.open(stack).settings == Settings(**STANDING | {"restitution": 0.9})
    assert SceneOpener({}, isBasic=True).open(slide).settings == Settings()
    # and in Python
    assert Simulation("stack").settings == Settings(**STANDING)
    for basic in (Simulation("stack", recommended=False), Simulation("stack", Settings())):
        assert basic.settings == Settings() and basic.recommended == ""
