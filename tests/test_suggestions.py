"""Settings that a scene recommends: how they are read, and when they are used."""

import shutil
from dataclasses import asdict

import pytest
from program import DATA, by_hand, run, summary_of

from rbs.recording import Recording
from rbs.scenes import SceneSource
from rbs.settings import Settings
from rbs.simulation import Simulation
from rbs.suggestions import SceneOpener, apply_settings, recommended_values
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


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ([], {}),
        (["# it suggests friction", "#suggestsfriction 1", "# suggests"], {}),
        (["# suggests friction 0.5"], {"friction": 0.5}),
        (["#suggests\tfriction 0.5  ", "  ## suggests restitution 0.2\r"],
         {"friction": 0.5, "restitution": 0.2}),
        (["# suggests friction 0.5", "# suggests friction 0.25"], {"friction": 0.25}),
        (["# suggests closing-only no-constraints time-step 0.01 max-iterations 7"],
         {"closingOnly": True, "enforceConstraints": False, "timeStep": 0.01, "maxIterations": 7}),
        (["# suggests scheduling queue broad-phase grid"],
         {"constraintScheduling": "queue", "broadPhase": "grid"}),
    ],
)  # fmt: skip
def test_words_are_those_of_the_command_line(make_scene, lines, expected):
    assert recommended_values(SceneSource.of_files(make_scene(*lines))) == expected


@pytest.mark.parametrize(
    ("words", "cause"),
    [
        ("frictoin 0.5", "'frictoin' is none; there are restitution, "),
        ("friction 0.5 0.4", "'0.4' is none"),
        ("friction", "friction has no value"),
        ("friction x", "friction must be a finite number of 0 or more, not 'x'"),
        ("friction -1", "friction must be a finite number of 0 or more, not -1"),
        ("scheduling quick", "scheduling must be one of sweep, queue, batches, not 'quick'"),
        ("closing-only 1", "'1' is none"),
        ("--friction 1", "'--friction' is none"),
        ("constraints a.txt", "'constraints' is none"),
        ("solver soft-step closing-only", "closingOnly has no effect with contactSolver soft-step"),
    ],
)
def test_what_cannot_be_recommended_is_told_with_file_and_line(make_scene, words, cause):
    path = make_scene("# suggests restitution 0.1", f"# suggests {words}")
    with pytest.raises(SceneError) as error:
        recommended_values(SceneSource.of_files(path))
    assert str(error.value).startswith(f"{path}:3: recommended settings: {cause}")


def test_wrong_recommendation_ends_the_program_unless_it_is_not_asked_for(make_scene, tmp_path):
    path = make_scene("# suggests frictoin 1")
    process = run(tmp_path, path, "--headless", "--steps", 1)
    assert process.returncode == 2 and process.stderr.count("\n") == 1
    assert f"{path}:2: recommended settings: 'frictoin' is none" in process.stderr
    summary_of(run(tmp_path, path, "--headless", "--steps", 1, "--basic"))
    Simulation(path).step()  # loaded by hand, a comment is a comment


def recorded_settings(folder, *words):
    """The settings that a run with these words has recorded, and what it has printed on stderr."""
    process = run(folder, *words, "--record", "r.h5", "--steps", 2)
    assert process.returncode == 0, process.stderr
    ((_, settings),) = Recording(folder / "r.h5").settingsHistory
    return Settings(**settings), process.stderr


def test_recommendations_are_used_reported_and_recorded(tmp_path):
    standing = {"contactSolver": "soft-step", "friction": 0.5, "restitution": 0.0}
    settings, errors = recorded_settings(tmp_path, "stack")
    assert settings == Settings(**standing)
    assert errors == (
        f"RigidBodySimulation.py: using the settings recommended in {DATA / 'stack-scene.txt'} "
        "(restitution 0, friction 0.5, solver soft-step); --basic ignores them\n"
    )
    process = run(tmp_path, "--verify", "r.h5")
    assert process.returncode == 0 and process.stderr == ""
    process = run(tmp_path, "--resume", "r.h5", "--record", "s.h5", "--steps", 2)
    assert process.returncode == 0 and process.stderr == ""
    assert Recording(tmp_path / "s.h5").settingsHistory[0][1]["friction"] == 0.5


@pytest.mark.parametrize(
    ("words", "changes"),
    [
        (["ramp", "--time-step", 0.01], {"timeStep": 0.01}),
        (["stack", "--substeps", 20], {"substeps": 20}),
        (["stack", "--friction", 0], {"friction": 0.0}),
        (["stack", "--solver", "impulse", "--broad-phase", "grid"],
         {"contactSolver": "impulse", "broadPhase": "grid"}),
    ],
)  # fmt: skip
def test_an_option_overrides_that_one_recommendation(tmp_path, words, changes):
    standing = {"contactSolver": "soft-step", "friction": 0.5, "restitution": 0.0}
    settings, errors = recorded_settings(tmp_path, *words)
    assert settings == Settings(**{**standing, **changes})
    used = [word for word in ("restitution", "friction", "solver") if word in errors]
    kept = {**standing, **changes}
    assert used == [word for word, name in (("restitution", "restitution"),
                                            ("friction", "friction"),
                                            ("solver", "contactSolver"))
                    if kept[name] == standing[name]]  # fmt: skip


def test_basic_drops_all_recommendations(tmp_path):
    assert recorded_settings(tmp_path, "stack", "--basic") == (Settings(), "")
    settings = recorded_settings(tmp_path, "stack", "--basic", "--friction", 0.2)[0]
    assert settings == Settings(friction=0.2)
    process = run(tmp_path, "--resume", "r.h5", "--basic")
    assert process.returncode == 2 and "--basic does not go with --resume" in process.stderr


def test_what_the_recommended_solver_ignores_is_refused_and_explained(tmp_path):
    process = run(tmp_path, "stack", "--broad-phase", "grid", "--headless")
    assert process.returncode == 2
    assert process.stderr == (
        "RigidBodySimulation.py: --broad-phase has no effect with --solver soft-step, which "
        f"{DATA / 'stack-scene.txt'} recommends; --basic ignores that\n"
    )


def test_basic_is_run_timestep_with_its_defaults(tmp_path):
    process = run(tmp_path, "settle", "--basic", "--record", "r.h5", "--steps", 120)
    assert process.returncode == 0
    expected = by_hand(DATA / "settle-scene.txt", 120, 0.5, 0.02)["positions"][-1]
    assert (Recording(tmp_path / "r.h5").frame(120)["positions"] == expected).all()


def opened(name, **given):
    simulation = Simulation(DATA / f"{name}-scene.txt")
    apply_settings(simulation, given)
    return simulation


def test_in_the_window_each_scene_has_what_it_recommends_and_what_was_changed_by_hand(capsys):
    stack, slide, tower = (DATA / f"{name}-scene.txt" for name in ("stack", "slide", "tower"))
    first = opened("tower")
    opener = SceneOpener(first, {})
    assert opener(slide, first.settings).settings == Settings(friction=0.2)
    assert "settings recommended in" in capsys.readouterr().err
    settings = opener(tower, Settings(friction=0.2, timeStep=0.01)).settings
    assert settings == Settings(timeStep=0.01)
    settings.broadPhase = "grid"
    settings = opener(stack, settings).settings  # whose solver ignores the broad phase
    standing = {"contactSolver": "soft-step", "friction": 0.5, "restitution": 0.0}
    assert settings == Settings(timeStep=0.01, **standing)
    settings.friction = 0.9
    expected = Settings(timeStep=0.01, friction=0.9, broadPhase="grid")
    assert opener(slide, settings).settings == expected


def test_in_the_window_given_options_hold_for_all_scenes(capsys):
    first = opened("tower", restitution=0.9)
    opener = SceneOpener(first, {"restitution": 0.9})
    second = opener(DATA / "slide-scene.txt", first.settings)
    assert second.settings == Settings(restitution=0.9, friction=0.2)
    opener = SceneOpener(opened("tower"), {}, isBasic=True)
    assert opener(DATA / "slide-scene.txt", None).settings == Settings()
    assert asdict(second.startSettings) == asdict(second.settings)
