"""Blanks, letters beyond ASCII and Windows' separators, in the names of all files."""

import json
import shutil

import numpy as np
import pytest
from opengl import require_opengl
from program import CAMERA, DATA, run, summary_of

from rbs.recording import Recording
from rbs.replay import Replay
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
    recording, stats, plot = (out / f"mein Lauf ß.{ending}" for ending in ("h5", "csv", "png"))
    summary = summary_of(run(
        tmp_path, f"{FOLDER}/{SCENE}", "--steps", 30, "--record", recording, "--stats", stats,
        "--plot", plot,
    ))  # fmt: skip
    assert summary["scene"] == f"{FOLDER}/{SCENE}" and summary["constraints"].startswith("2 bounds")
    for path, what in ((recording, "recording"), (stats, "statistics"), (plot, "plot")):
        assert summary[what] == f"à côté de/{path.name}" and path.stat().st_size > 1000
    names = [mesh.name for mesh in Replay(Recording(recording)).meshes]
    assert names == ["ein großer Würfel 0", "Achtflächner é 1"]
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
    assert summary["video"].startswith("ein Film ö.mp4: 3 frames")
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
