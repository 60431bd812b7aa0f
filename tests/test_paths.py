"""Blanks, letters beyond ASCII and Windows' separators, in the names of all files."""

import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from opengl import require_opengl
from program import CAMERA, DATA, PROGRAM, environment, run, summary_of

from rbs.recording import Recording
from rbs.simulation import Simulation
from rbs.textfiles import SceneError
from RigidBodySimulation import load_scene_file

FOLDER = "Räume, Körper & 物体"
SCENE = "ein schöner Turm-scene.txt"


@pytest.fixture
def strange(tmp_path):
    """A folder with two bodies and a constraint, their meshes in it and in a folder below."""
    folder = tmp_path / FOLDER
    (folder / "alle Netze").mkdir(parents=True)
    shutil.copy(DATA / "box.mesh", folder / "ein großer Würfel.mesh")
    shutil.copy(DATA / "octahedron.mesh", folder / "alle Netze" / "Achtflächner é.MESH")
    (folder / SCENE).write_text(
        "2\n"
        "ein großer Würfel.mesh 1 0 0 9 0 1 0 0 0\n"
        "alle Netze/Achtflächner é.MESH 2 0 0 30 0 1 0 0 0\n",
        encoding="utf-8",
    )
    constraints = folder / SCENE.replace("-scene", "-constraints")
    constraints.write_text("1\n0 0 1 0 0.8 1.2\n", encoding="utf-8")
    return folder


def test_every_file_of_a_run_may_have_blanks_and_any_letter(strange, tmp_path):
    pytest.importorskip("matplotlib", reason="pip install matplotlib")
    out = tmp_path / "à côté de"
    out.mkdir()
    recording, stats, plot = (out / f"mein Lauf ß.{ending}" for ending in ("npz", "csv", "png"))
    summary = summary_of(run(
        tmp_path, f"{FOLDER}/{SCENE}", "--steps", 30, "--record", recording, "--stats", stats,
        "--plot", plot,
    ))  # fmt: skip
    assert summary["scene"] == f"{FOLDER}/{SCENE}" and summary["constraints"].startswith("2 bounds")
    for path, what in ((recording, "recording"), (stats, "statistics"), (plot, "plot")):
        assert summary[what] == f"à côté de/{path.name}" and path.stat().st_size > 1000
    assert Recording(recording).meshNames == ["ein großer Würfel 0", "Achtflächner é 1"]
    for arguments in (["--verify", recording], ["--replay", recording, "--headless"],
                      ["--resume", recording, "--steps", 3, "--headless"]):  # fmt: skip
        process = run(tmp_path, *arguments)
        assert process.returncode == 0, process.stderr
    process = run(tmp_path, f"{FOLDER}/{SCENE}", "--headless", "--steps", 2, "--constraints",
                  strange / SCENE.replace("-scene", "-constraints"))  # fmt: skip
    assert process.returncode == 0, process.stderr


def test_pictures_and_videos_may_have_blanks_and_any_letter(strange, tmp_path):
    require_opengl()
    pytest.importorskip("imageio_ffmpeg", reason="pip install imageio-ffmpeg")
    camera = strange / "meine Kamera ü.json"
    camera.write_text(json.dumps(CAMERA))
    summary = summary_of(run(
        tmp_path, strange / SCENE, "--steps", 4, "--screenshots", "viele Bilder é", "--every", 2,
        "--video", "ein Film ö.mp4", "--size", "160x120", "--camera", camera,
    ))  # fmt: skip
    assert summary["pictures"] == "3 in viele Bilder é"
    assert summary["video"].startswith("ein Film ö.mp4: 3 pictures")
    assert len(list((tmp_path / "viele Bilder é").glob("frame_*.png"))) == 3
    assert (tmp_path / "ein Film ö.mp4").stat().st_size > 500


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("separator", ["/", "\\"])
def test_windows_separators_and_line_endings_make_no_difference(strange, separator, ending):
    scene = strange / "w-scene.txt"
    lines = [
        "2",
        f"alle Netze{separator}Achtflächner é.MESH 2 0 0 30 0 1 0 0 0",
        f".{separator}ein großer Würfel.mesh 1 0 0 9 0 1 0 0 0",
        "",
    ]
    scene.write_bytes(ending.join(lines).encode())
    meshes = load_scene_file(scene)
    assert [mesh.name for mesh in meshes] == ["Achtflächner é 0", "ein großer Würfel 1"]
    plain = load_scene_file(strange / SCENE)
    for mesh, other in zip(meshes, plain[::-1], strict=True):
        np.testing.assert_array_equal(mesh.currVertices, other.currVertices)


def test_a_recording_from_windows_finds_its_scene(strange, tmp_path):
    recording = tmp_path / "r.npz"
    run(strange, SCENE, "--steps", 3, "--record", recording)
    with np.load(recording) as content:
        arrays = dict(content)
    assert str(arrays["scene"]) == SCENE
    arrays["scene"] = np.array(f"C:\\Users\\Jörg\\{SCENE}")
    constraints = SCENE.replace("-scene", "-constraints")
    arrays["constraints"] = np.array(f"C:\\Users\\Jörg\\{constraints}")
    np.savez(strange / "w.npz", **arrays)
    process = run(tmp_path, "--verify", f"{FOLDER}/w.npz")
    assert process.returncode == 0, process.stderr


def test_the_ending_tells_a_name_with_blanks_from_a_column_too_many(strange):
    for line, cause in (
        ("box.mesh 1 1 0 0 9 0 1 0 0 0", "body 1 of 1 takes 10 columns, not 11"),
        ("box.mesh 1 0 0 9 0 1 0 0", "body 1 of 1 takes 10 columns, not 9"),
        ("a b.mesh 1 0 0 9 0 1 0 0", "the density must be a number, not 'b.mesh'"),
        ("no such.mesh 1 0 0 9 0 1 0 0 0", "no such.mesh"),
    ):
        (strange / "b-scene.txt").write_text(f"1\n{line}\n")
        with pytest.raises(SceneError, match=cause):
            load_scene_file(strange / "b-scene.txt")


def test_the_strange_scene_runs_like_any_other(strange):
    """The same bodies under plain names have the same bits."""
    plain = strange / "plain-scene.txt"
    shutil.copy(DATA / "box.mesh", strange)
    shutil.copy(DATA / "octahedron.mesh", strange)
    plain.write_text("2\nbox.mesh 1 0 0 9 0 1 0 0 0\noctahedron.mesh 2 0 0 30 0 1 0 0 0\n")
    constraints = strange / SCENE.replace("-scene", "-constraints")
    simulations = Simulation(strange / SCENE), Simulation(plain, constraintPath=constraints)
    for simulation in simulations:
        for _ in range(60):
            simulation.step()
    one, other = (simulation.state() for simulation in simulations)
    for name in one:
        np.testing.assert_array_equal(one[name], other[name])


@pytest.mark.skipif(os.name == "nt", reason="Windows has one encoding of names")
def test_a_locale_of_ascii_reads_the_same_names(strange, tmp_path):
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0"}
    scene = f"{FOLDER}/{SCENE}"
    summary_of(run(tmp_path, scene, "--steps", 3, "--record", "u.npz"))
    process = run(tmp_path, scene, "--steps", 3, "--record", "c.npz", "--stats", "c.csv", **plain)
    assert summary_of(process)["bodies"].startswith("2,") and process.stderr == ""
    assert Recording(tmp_path / "c.npz").meshNames == ["ein großer Würfel 0", "Achtflächner é 1"]
    # Each locale reads what was recorded in the other.
    assert run(tmp_path, "--verify", "u.npz", **plain).returncode == 0
    assert run(tmp_path, "--verify", "c.npz").returncode == 0
    (strange / "ein großer Würfel.mesh").unlink()
    process = run(tmp_path, scene, "--headless", **plain)
    assert process.returncode == 2 and len(process.stderr.splitlines()) == 1
    assert "there is no mesh file" in process.stderr


@pytest.mark.skipif(os.name == "nt", reason="Windows' names are text")
def test_a_plot_of_a_scene_whose_name_is_no_text(tmp_path):
    pytest.importorskip("matplotlib", reason="pip install matplotlib")
    shutil.copy(DATA / "box.mesh", tmp_path)
    name = os.fsdecode(b"\xff-scene.txt")
    (tmp_path / name).write_text("1\nbox.mesh 1 0 0 9 0 1 0 0 0\n")
    process = run(tmp_path, name, "--steps", 2, "--plot", "p.png")
    assert process.returncode == 0 and (tmp_path / "p.png").exists(), process.stderr


@pytest.mark.skipif(os.name == "nt", reason="Windows does not delete a current folder")
@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ("mixed --basic --headless --steps 2", 0, ""),
        ("{data}/tet-scene.txt --steps 2 --record {out}/r.npz --stats {out}/s.csv", 0, ""),
        ("--verify {out}/old.npz", 0, ""),
        ("--replay {out}/old.npz --stats {out}/s.csv", 0, ""),
        ("--resume {out}/old.npz --steps 2 --record {out}/r.npz", 0, ""),
        ("tet --steps 2 --stats s.csv", 2, "s.csv: "),
        ("tet --steps 2 --record r.npz", 2, "r.npz: "),
        ("a-scene.txt --headless", 2, "a-scene.txt: there is no such scene"),
        ("--finish r.npz", 2, "r.npz: "),
        ("--finish .", 2, ".: "),
    ],
)
def test_a_current_folder_that_has_been_deleted(tmp_path, arguments, code, words):
    out, gone = tmp_path / "out", tmp_path / "gone"
    out.mkdir()
    assert run(out, "tet", "--steps", 2, "--record", "old.npz").returncode == 0
    gone.mkdir()
    arguments = arguments.format(data=DATA, out=out)
    command = f"cd '{gone}' && rmdir '{gone}' && exec '{sys.executable}' '{PROGRAM}' {arguments}"
    process = subprocess.run(["sh", "-c", command], capture_output=True, text=True,
                             env=environment(), timeout=120)  # fmt: skip
    assert process.returncode == code, process.stderr
    assert len(process.stderr.splitlines()) == (code > 0), process.stderr
    if words:
        assert process.stderr.startswith(f"RigidBodySimulation.py: {words}"), process.stderr
    assert not gone.exists()
