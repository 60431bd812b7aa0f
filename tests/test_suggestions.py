"""Settings that a scene suggests: how they are read, when they are used, and when they are not."""

import shutil

import pytest
from program import DATA, by_hand, run, summary_of

from rbs.opening import open_file
from rbs.options import SETTING_FIELDS, make_parser
from rbs.recording import Recording
from rbs.scenes import SceneSource
from rbs.simulation import Settings, Simulation
from rbs.suggestions import SUGGESTIONS, SceneOpener, suggested_settings
from rbs.textfiles import SceneError


@pytest.fixture
def make_scene(tmp_path):
    """Writes a scene of one box with these comment lines; returns its path."""
    shutil.copy(DATA / "box.mesh", tmp_path)

    def make(*lines, name="a"):
        path = tmp_path / f"{name}-scene.txt"
        path.write_text("\n".join(["# a box", *lines, "1", "box.mesh 1 0 0 9 0 1 0 0 0", ""]))
        return path

    return make


def test_every_option_that_changes_the_settings_is_a_word():
    options = make_parser().format_help()
    assert set(SUGGESTIONS.values()) == set(SETTING_FIELDS)
    assert all(f"--{word} " in options or f"--{word}\n" in options for word in SUGGESTIONS)


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ([], Settings()),
        (["# it suggests friction", "#suggestsfriction 1", "# suggests"], Settings()),
        (["# suggests friction 0.5"], Settings(friction=0.5)),
        (["#suggests\tfriction 0.5  ", "  ## suggests restitution 0.2\r"],
         Settings(friction=0.5, restitution=0.2)),
        (["# suggests friction 0.5", "# suggests friction 0.25"], Settings(friction=0.25)),
        (["# suggests closing-only no-constraints time-step 0.01 max-iterations 7"],
         Settings(closingOnly=True, enforceConstraints=False, timeStep=0.01, maxIterations=7)),
        (["# suggests scheduling queue broad-phase grid"],
         Settings(constraintScheduling="queue", broadPhase="grid")),
    ],
)  # fmt: skip
def test_words_are_those_of_the_command_line(make_scene, lines, expected):
    assert suggested_settings(SceneSource.of_files(make_scene(*lines)))[0] == expected


@pytest.mark.parametrize(
    ("words", "cause"),
    [
        ("frictoin 0.5", "'frictoin' cannot be suggested; what can: restitution, "),
        ("friction 0.5 0.4", "'0.4' cannot be suggested"),
        ("friction", "suggested settings: friction: expected one argument"),
        ("friction x", "suggested settings: friction: 'x' is not a number"),
        ("friction -1", "suggested settings: friction: the friction must be finite and not neg"),
        ("restitution 2", "suggested settings: restitution: the restitution must lie between 0"),
        ("scheduling quick", "suggested settings: scheduling: invalid choice: 'quick'"),
        ("closing-only 1", "suggested settings: unrecognized arguments: 1"),
        ("--friction 1", "'--friction' cannot be suggested"),
        ("friction --basic", "'--basic' cannot be suggested"),
        ("-h", "'-h' cannot be suggested"),
        ("constraints a.txt", "'constraints' cannot be suggested"),
    ],
)
def test_what_cannot_be_suggested_is_told_with_file_and_line(make_scene, words, cause):
    path = make_scene("# suggests restitution 0.1", f"# suggests {words}")
    with pytest.raises(SceneError) as error:
        suggested_settings(SceneSource.of_files(path))
    assert str(error.value).startswith(f"{path}:3: {cause}")


def test_wrong_suggestion_ends_the_program_unless_it_is_not_asked_for(make_scene, tmp_path):
    path = make_scene("# suggests frictoin 1")
    process = run(tmp_path, path, "--headless", "--steps", 1)
    assert process.returncode == 2 and process.stderr.count("\n") == 1
    assert f"{path}:2: 'frictoin' cannot be suggested" in process.stderr
    for words in (["--basic"], ["--friction", 0]):
        summary_of(run(tmp_path, path, "--headless", "--steps", 1, *words))
    Simulation(path).step()  # loaded by hand, a comment is a comment


def recorded_settings(folder, *words):
    """The settings that a run with these words has recorded, and what it has told on stderr."""
    process = run(folder, *words, "--record", "r.h5", "--steps", 2)
    assert process.returncode == 0, process.stderr
    ((_, settings),) = Recording(folder / "r.h5").settingsHistory
    return settings, process.stderr


def test_suggestions_are_used_told_and_recorded_unless_an_option_is_given(tmp_path):
    told = "RigidBodySimulation.py: {} suggests friction 0.5 restitution 0.3; --basic does without"
    settings, errors = recorded_settings(tmp_path, "mixed")
    assert (settings["friction"], settings["restitution"]) == (0.5, 0.3)
    assert errors == told.format(DATA / "mixed-scene.txt") + "\n"
    process = run(tmp_path, "--verify", "r.h5")
    assert process.returncode == 0 and process.stderr == ""
    process = run(tmp_path, "--resume", "r.h5", "--record", "s.h5", "--steps", 2)
    assert process.returncode == 0 and process.stderr == ""
    assert Recording(tmp_path / "s.h5").settingsHistory[0][1]["friction"] == 0.5

    for words in (["--basic"], ["--friction", "0"], ["--broad-phase", "all"]):
        settings, errors = recorded_settings(tmp_path, "mixed", *words)
        assert (settings["friction"], settings["restitution"]) == (0.0, 0.5) and errors == ""
    settings, _ = recorded_settings(tmp_path, "mixed", "--restitution", 0.9)
    assert (settings["friction"], settings["restitution"]) == (0.0, 0.9)
    # A recording in the basic behaviour goes on in it, and is verified in it.
    settings, _ = recorded_settings(tmp_path, "mixed", "--basic")
    assert run(tmp_path, "--verify", "r.h5").returncode == 0
    process = run(tmp_path, "--resume", "r.h5", "--basic")
    assert process.returncode == 2 and "--basic does not go with --resume" in process.stderr


def test_basic_is_run_timestep_with_its_defaults(tmp_path):
    process = run(tmp_path, "mixed", "--basic", "--record", "r.h5", "--steps", 120)
    assert process.returncode == 0
    expected = by_hand(DATA / "mixed-scene.txt", 120, 0.5, 0.02)["positions"][-1]
    assert (Recording(tmp_path / "r.h5").frame(120)["positions"] == expected).all()


def test_in_the_window_each_scene_has_what_it_suggests_and_what_was_changed_by_hand(capsys):
    mixed, slide, tower = (DATA / f"{name}-scene.txt" for name in ("mixed", "slide", "tower"))
    first, _ = suggested_settings(SceneSource.of_files(mixed))
    opener = SceneOpener(first, True)
    assert opener(slide, first).settings == Settings(friction=0.2)
    assert "slide-scene.txt suggests friction 0.2" in capsys.readouterr().err
    settings = opener(tower, Settings(friction=0.2, timeStep=0.01)).settings
    assert settings == Settings(timeStep=0.01)
    settings = opener(mixed, settings).settings
    assert settings == Settings(timeStep=0.01, friction=0.5, restitution=0.3)
    settings.friction = 0.9
    assert opener(slide, settings).settings == Settings(timeStep=0.01, friction=0.9)


def test_in_the_window_explicit_options_count_for_all_scenes(capsys):
    settings = Settings(restitution=0.9)
    opener = SceneOpener(settings, False)
    assert opener(DATA / "slide-scene.txt", settings).settings is settings
    assert capsys.readouterr().err == ""
    assert open_file(DATA / "slide-scene.txt", None).settings == Settings()
