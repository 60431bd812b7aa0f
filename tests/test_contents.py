"""A recording knows its scene by what the files hold, and not by their names or places."""

import json
import shutil

import numpy as np
import pytest
from program import DATA, run

from rbs.recording import Recording

SCENE = "2\nbox.mesh 1 0 0 9 0 1 0 0 0\ntetrahedron.mesh 2 0 0 30 0 1 0 0 0\n"


def make(folder, scene=SCENE, constraints="1\n0 0 1 0 0.8 1.2\n"):
    """A scene of two bodies and a constraint, with its meshes, in a new folder."""
    folder.mkdir()
    (folder / "a-scene.txt").write_text(scene)
    (folder / "a-constraints.txt").write_text(constraints)
    for name in ("box.mesh", "tetrahedron.mesh"):
        shutil.copy(DATA / name, folder)
    return folder


@pytest.fixture
def recorded(tmp_path):
    """A folder with a scene and a recording of ten steps of it."""
    folder = make(tmp_path / "a")
    process = run(folder, "a-scene.txt", "--steps", 10, "--record", "r.npz")
    assert process.returncode == 0, process.stderr
    return folder


def with_other_box(folder):
    text = (folder / "box.mesh").read_text()
    number = text.split("Vertices")[1].split()[1]
    (folder / "box.mesh").write_text(text.replace(number, str(float(number) * 1.01)))


CHANGES = {
    "density": (lambda f: (f / "a-scene.txt").write_text(SCENE.replace("mesh 1 0", "mesh 7 0")),
                "the scene a-scene.txt holds"),
    "isFixed": (lambda f: (f / "a-scene.txt").write_text(SCENE.replace("mesh 1 0", "mesh 1 1")),
                "the scene a-scene.txt holds"),
    "mesh": (with_other_box, "the mesh box.mesh holds"),
    "constraints": (lambda f: (f / "a-constraints.txt").write_text("1\n0 0 1 0 0.8 1.3\n"),
                    "the constraints a-constraints.txt hold"),
    "mesh and density": (lambda f: (with_other_box(f), CHANGES["density"][0](f)),
                         "the scene a-scene.txt and the mesh box.mesh hold"),
}  # fmt: skip


@pytest.mark.parametrize("case", CHANGES)
def test_what_has_changed_is_named(recorded, case):
    change, words = CHANGES[case]
    change(recorded)
    line = f"RigidBodySimulation.py: r.npz: {words} something else than when it was recorded"
    process = run(recorded, "--verify", "r.npz")
    assert (process.returncode, process.stdout, process.stderr) == (1, "", line + "\n")
    process = run(recorded, "--resume", "r.npz", "--steps", 2, "--headless")
    assert (process.returncode, process.stdout) == (2, "")
    assert process.stderr == f"{line}, so it cannot be gone on with\n"
    # A replay shows what was recorded, in bodies that may look otherwise.
    process = run(recorded, "--replay", "r.npz", "--headless")
    assert process.returncode == 0 and process.stderr == line + "\n"


def test_a_scene_of_the_same_name_elsewhere_is_not_taken_for_it(recorded, tmp_path):
    """In the current folder lies another scene of that name; beside the recording, its own."""
    other = make(tmp_path / "b", SCENE.replace("box.mesh 1 0", "box.mesh 50 0"))
    assert run(other, "--verify", "../a/r.npz").returncode == 0
    run(other, "--resume", "../a/r.npz", "--from", 5, "--steps", 5, "--record", "on.npz")
    with np.load(recorded / "r.npz") as whole, np.load(other / "on.npz") as resumed:
        np.testing.assert_array_equal(resumed["positions"], whole["positions"][5:])
    # Where only the other is there, it is named.
    shutil.move(recorded / "r.npz", tmp_path / "r.npz")
    process = run(other, "--verify", "../r.npz")
    assert process.returncode == 1 and "the scene a-scene.txt holds something" in process.stderr
    # Beside a recording that has been moved to it, neither; the right one is where it was then.
    shutil.move(tmp_path / "r.npz", other / "r.npz")
    assert run(recorded, "--verify", "../b/r.npz").returncode == 0
    assert run(other, "--verify", "r.npz", "../a/a-scene.txt", "--constraints",
               "../a/a-constraints.txt").returncode == 0  # fmt: skip


def test_a_mesh_beside_the_same_scene_tells_two_places_apart(recorded, tmp_path):
    other = make(tmp_path / "b")
    with_other_box(other)
    shutil.move(recorded / "r.npz", other / "r.npz")
    assert run(recorded, "--verify", "../b/r.npz").returncode == 0
    process = run(other, "--verify", "r.npz")
    assert process.returncode == 1 and "r.npz: the mesh box.mesh holds" in process.stderr


def test_places_and_line_ends_make_no_difference(recorded, tmp_path):
    moved = tmp_path / "moved"
    shutil.move(recorded, moved)
    for name in ("a-scene.txt", "a-constraints.txt", "box.mesh"):
        content = (moved / name).read_bytes()
        (moved / name).write_bytes(content.replace(b"\n", b"\r\n"))
    process = run(tmp_path, "--verify", "moved/r.npz")
    assert process.returncode == 0, process.stderr


def test_recordings_without_hashes_go_on_as_before(recorded):
    with np.load(recorded / "r.npz") as file:
        arrays = {name: file[name] for name in file if name != "contentHashes"}
    np.savez(recorded / "old.npz", **arrays)
    assert Recording(recorded / "old.npz").contentHashes is None
    assert run(recorded, "--verify", "old.npz").returncode == 0
    CHANGES["density"][0](recorded)
    process = run(recorded, "--resume", "old.npz", "--steps", 2, "--headless")
    assert process.returncode == 0 and process.stderr == ""


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"scene": 1}', '{"scene": "a", "constraints": "", "meshes": []}',
             '{"scene": "a", "constraints": "", "meshes": {"m": null}}', "[" * 100_000],
)  # fmt: skip
def test_hashes_that_cannot_be_read_are_told(recorded, text):
    with np.load(recorded / "r.npz") as file:
        arrays = dict(file) | {"contentHashes": np.array(text)}
    np.savez(recorded / "bad.npz", **arrays)
    process = run(recorded, "--replay", "bad.npz", "--headless")
    assert (process.returncode, process.stdout) == (2, "")
    assert process.stderr == (
        "RigidBodySimulation.py: bad.npz: the hashes of its scene's files cannot be read\n"
    )


def test_a_recording_has_the_hashes_of_what_was_read(recorded):
    with np.load(recorded / "r.npz") as file:
        hashes = json.loads(str(file["contentHashes"]))
    assert set(hashes) == {"scene", "constraints", "meshes"}
    assert set(hashes["meshes"]) == {"box.mesh", "tetrahedron.mesh"}
    assert len({hashes["scene"], hashes["constraints"], *hashes["meshes"].values()}) == 4
    run(recorded, "a-scene.txt", "--steps", 1, "--record", "n.npz", "--no-constraints")
    assert Recording(recorded / "n.npz").contentHashes["meshes"] == hashes["meshes"]
