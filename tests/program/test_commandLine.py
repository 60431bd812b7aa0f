"""The simulation behind the command line; runs, pictures and videos; and where nothing can draw."""

import json
import os
import shutil
import signal
import sys
from functools import partial
from pathlib import Path

import numpy as np
import program
import pytest
from oracles import ROOT
from PIL import Image
from program import DATA, PROGRAM, call, python, require_opengl, run_script, summary_of, wait_for
from studentVariants import STUDENT

from rbs.program.options import TABLE, WINDOW, parse_options
from rbs.recordings.lookup import SceneOpener
from rbs.recordings.recording import Recording
from rbs.scenes.files import SceneError
from rbs.scenes.messages import COMMAND
from rbs.scenes.scenefiles import SceneSource
from rbs.scenes.settingtexts import recommended_values
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.settings import Settings
from RigidBodySimulation import Simulation, load_constraint_file, load_scene_file

onLinux = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="displays and EGL are found this way on Linux only"
)


def test_headless_run_ends_with_a_summary_of_what_happened(capsys):
    code, output, _ = call(capsys, "mixed", "--basic", "--headless", "--steps", 120)
    summary, simulation = summary_of(output), SceneSimulation(DATA / "mixed-scene.txt")
    begin = simulation.potential_energy()
    for _ in range(120):
        simulation.step()
    now = f"{simulation.kinetic_energy() / 1e6:.6g} MJ now"  # this scene weighs 480 t
    assert summary["kinetic energy"] == f"0 J at the start, {now}"
    now = f"{simulation.potential_energy() / 1e6:.6g} MJ now"
    assert summary["potential energy"] == f"{begin / 1e6:.6g} MJ at the start, {now}"
    assert summary["scene"].endswith("mixed-scene.txt") and summary["bodies"].startswith("15 (8 ")
    assert summary["steps"].startswith("120 of 0.02 s: 2.4 s") and code == 0


# Options; the constraint file that they mean, and what they mean in run_timestep. 40 visits are
# two and a half sweeps.
OURS = DATA / "tower_chain-constraints.txt"
CHAINS = {
    "": (OURS, {}),
    "--no-constraints": (None, {}),
    "--constraints strut.txt": ("strut.txt", {}),
    "--max-iterations 40": (OURS, {"maxIterations": 40}),
    "--scheduling batches": (OURS, {"constraintScheduling": "batches"}),
}


def test_constraints_are_those_of_run_timestep(tmp_path, monkeypatch, capsys):
    """From step 53 on several are taut, and the order of visits makes a difference."""
    monkeypatch.chdir(tmp_path)
    # From the fixed foot to the body on top, and nothing in between.
    (tmp_path / "strut.txt").write_text("1\n0 0 8 0 1 2\n")
    scene, found = DATA / "tower_chain-scene.txt", set()
    for words, (file, options) in CHAINS.items():
        arguments = [*words.split(), "--steps", 60, "--record", "r.h5"]
        assert call(capsys, "tower_chain", *arguments)[0] == 0
        recording = Recording("r.h5")
        positions = np.array([recording.frame(step)["positions"] for step in range(61)])
        found.add(positions.tobytes())
        if file is not None:
            options = {**options, "constraints": load_constraint_file(file, load_scene_file(scene))}
        expected = program.by_hand(scene, 60, 0.5, 0.02, **options)
        np.testing.assert_array_equal(positions, expected["positions"])
        assert recording.source.constraints == (tmp_path / (file or OURS)).read_text()
    assert len(found) == len(CHAINS)


def test_pictures_and_video_of_a_run_and_its_replay_under_any_name(tmp_path):
    require_opengl()
    pytest.importorskip("imageio_ffmpeg", reason="pip install imageio-ffmpeg")
    # A size in the file has no effect on the picture's; H.264 takes even sides only.
    (tmp_path / "ü.json").write_text(json.dumps({**program.CAMERA, "windowWidth": 640}))
    options = "--size 161x121 --camera ü.json --show trails".split()
    outputs = "--record", "r.h5", "--video", "ein Film ö.mp4", "--screenshots", "viele/Bilder é"
    summary = summary_of(python(tmp_path, PROGRAM, "tet", "--steps", 20, *outputs, *options))
    assert summary["video"].startswith("ein Film ö.mp4: 11 frames at 25 fps")
    folder = tmp_path / "viele" / "Bilder é"
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["frame_000000.png", "frame_000010.png", "frame_000020.png"]
    assert {Image.open(path).size for path in folder.iterdir()} == {(161, 121)}
    outputs = "--video b.gif --every 10 --screenshots other --colours density"
    summary = summary_of(python(tmp_path, PROGRAM, "--replay", "r.h5", *outputs.split(), *options))
    assert summary["video"].startswith("b.gif: 3 frames at 5 fps")
    for name in names:
        assert (tmp_path / "other" / name).read_bytes() != (folder / name).read_bytes()
    assert len(list(tmp_path.iterdir())) == 6


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows cannot send Ctrl-C to one process")
def test_video_that_ctrl_c_ends_is_whole(tmp_path):
    require_opengl()
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="pip install imageio-ffmpeg")
    words = "tet --video v.mp4 --steps 100000 --size 160x120 --every 1"
    process = program.start(tmp_path, *words.split(), start_new_session=True)
    part = tmp_path / "v.part.mp4"
    wait_for(lambda: part.exists() and part.stat().st_size, lambda: process.poll() is None)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the encoder as well
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 130 and "stopped by Ctrl-C" in output, errors
    assert [path.name for path in tmp_path.iterdir()] == ["v.mp4"]
    said = next(line for line in output.splitlines() if line.startswith("video"))
    count, _ = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "v.mp4"))
    assert count > 1 and f" {count} frames" in said


@onLinux
def test_without_opengl_a_run_tells_what_to_install(tmp_path):
    # where libglvnd looks for its drivers, of which Mesa is one
    process = python(
        tmp_path, PROGRAM, "tower", "--steps", 3, __EGL_VENDOR_LIBRARY_FILENAMES="/nonexistent"
    )
    assert process.returncode == 0 and "3 of 0.02 s" in process.stdout
    assert process.stderr.count("\n") == 1 and "apt-get install" in process.stderr


def test_what_a_run_or_a_grader_does_not_need_may_be_missing(tmp_path):
    for name in "h5py PIL polyscope".split():
        (tmp_path / f"{name}.py").write_text("raise ImportError('')")
    words = PROGRAM, "tower", "--headless", "--steps", 3
    for command in (words, [ROOT / "graders" / "integrationGrading.py"]):
        process = python(tmp_path, *command, PYTHONPATH=str(tmp_path))
        assert (process.returncode, process.stderr) == (0, "")


SCRIPTS = "RigidBodySimulation graders/* report/build report/gallery report/shots".split()
SCRIPTS = [one for name in SCRIPTS for one in sorted(ROOT.glob(f"{name}.py"))]


@pytest.mark.skipif(os.name == "nt", reason="Windows cannot send Ctrl-C to one process")
@pytest.mark.parametrize("program", [*SCRIPTS, Path(COMMAND)], ids=lambda one: one.stem)
def test_ctrl_c_during_imports_ends_a_program_without_a_word(program, tmp_path):
    (tmp_path / COMMAND).write_text("from RigidBodySimulation import program")  # as pip's does
    (tmp_path / "numpy.py").write_text("import signal\nsignal.raise_signal(signal.SIGINT)\n")
    process = python(tmp_path, program, PYTHONPATH=os.pathsep.join(map(str, (tmp_path, ROOT))))
    assert (process.returncode, process.stdout, process.stderr) == (-signal.SIGINT, "", "")


TOOLS = "data/scripts/make_pile.py 5 --out f/x", "data/scripts/make_data.py --out f/x"
TOOLS += "data/scripts/make_reference.py --out f", "report/submission.py f/x.zip"
TOOLS += "tests/byhand benchmark nosuch", "tests/byhand hashes f", "tests/byhand experiments nosuch"


@pytest.mark.parametrize("words", TOOLS)
def test_a_tool_tells_in_one_line_what_it_cannot_use(words, tmp_path):
    (tmp_path / "f").touch()
    tool, *rest = words.split()
    ended = run_script(ROOT / tool, *rest, cwd=tmp_path)
    assert ended.returncode in (1, 2) and ended.stderr.count("\n") == 1, ended.stderr


@onLinux
@pytest.mark.parametrize("words", ["tower --headless --steps 2", "tower --trace 1", "integration"])
def test_what_cannot_be_printed_is_told_in_one_line(words, tmp_path):
    words = (PROGRAM, *words.split()) if " " in words else (ROOT / "graders/integrationGrading.py",)
    with open("/dev/full", "w") as full:
        fill = partial(os.dup2, full.fileno(), 1)
        ended = python(tmp_path, *words, preexec_fn=fill, PYTHONUNBUFFERED="")
    said = f"{words[0].name}: cannot write: No space left on device\n"
    assert (ended.returncode, ended.stderr) == (2, said)
    ended = python(tmp_path, *words, preexec_fn=lambda: os.close(1))
    assert (ended.returncode, ended.stderr) == (0, "")


@onLinux
@pytest.mark.parametrize("closed", [(2,), (0, 1, 2)])
def test_closed_streams_and_names_that_are_not_utf_8_change_no_verdict(closed, tmp_path):
    """Pipes and files that are opened do not get the numbers of these streams."""
    folder = shutil.copytree(STUDENT, tmp_path / "M\udcfcller")
    words = ROOT / "graders" / "grade.py", folder, "--out", tmp_path / "out"
    for more in ((), ("--resume",)):
        ended = python(tmp_path, *words, *more, preexec_fn=lambda: [*map(os.close, closed)])
        assert (ended.returncode, ended.stderr) == (0, "")
    assert len(list((tmp_path / "out").glob("M*ller.txt"))) == 1


# A zero byte after each help, unless the exit code is another one.
ALL_HELP = """
import os, runpy, sys
for script in sys.argv[1:]:
    sys.argv, sys.path[0] = [script, "--help"], os.path.dirname(script)
    try:
        runpy.run_path(script, run_name="__main__")
    except SystemExit as ended:
        print(ended.code or chr(0))
"""


def test_help_is_printed_where_characters_are_lacking(tmp_path):
    ended = python(tmp_path, "-c", ALL_HELP, *SCRIPTS, PYTHONIOENCODING="ascii")
    assert (ended.returncode, ended.stderr) == (0, "")
    *helps, _ = ended.stdout.split(chr(0))
    assert len(helps) == len(SCRIPTS) and all("--help" in one for one in helps)


# Words, and the scene, the overlays, gravity and constraints that they mean.
MEANT = {
    "--show contacts mixed": ("mixed", ["contacts"], None, None),
    "--show trails --show contacts mixed": ("mixed", ["trails", "contacts"], None, None),
    "--show=trails --gravity -1,2,-3 tet": ("tet", ["trails"], (-1.0, 2.0, -3.0), None),
    "--gravity -1e1,0,1 mixed": ("mixed", None, (-10.0, 0.0, 1.0), None),
    "mixed --gravity -.5,-1,0 --no-constraints": ("mixed", None, (-0.5, -1.0, 0.0), False),
}


@pytest.mark.parametrize("words", MEANT)
def test_an_option_takes_its_own_values_and_no_other_word(words):
    options = parse_options(words.split())
    found = options.scene, options.overlays, options.gravity, options.enforceConstraints
    assert found == MEANT[words] and options.steps is None is options.from_step


def test_each_option_is_refused_without_what_it_needs_and_with_what_it_excludes(capsys):
    """For every row of the table; the message names both."""
    words = "every 3 from 1 size 64x48 steps 2 trace 3 show trails look plain colours speed "
    words += "video v.mp4 export e.glb record r.h5 stats s.csv solver soft-step"
    values, count = dict(zip(words.split()[::2], words.split()[1::2], strict=True)), 0

    def refused(*some):
        words = []
        for one in some:
            words += [one.name] if one.name != "SCENE" else ["tet"]
            words += [values.get(one.name.strip("-"), "1")] if one.value else []
        with pytest.raises(SystemExit):
            parse_options(words)
        return capsys.readouterr().err

    rows = [one for one in TABLE if not one.name.startswith(("--broad", "--contacts", "--sched"))]
    for one in rows:
        if one.needs and WINDOW not in one.needs:
            assert f"{one.name} needs {one.needs[0]}" in refused(one)
        for other in rows:
            if other is not one and {other.name, other.kind} & set(one.excludes):
                helped = [row for row in rows if row.name in one.needs[:1] + other.needs[:1]]
                message, count = refused(one, other, *helped), count + 1
                assert "cannot be used with" in message and one.name in message, message
    assert count > 50


# Settings that a scene recommends: how they are read, and when they are used.
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
