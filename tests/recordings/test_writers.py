"""The files that a run is written to: all kinds alike, whatever the run and the names."""

import html
import json
import os
import sys

import numpy as np
import pytest
from oracles import box_body
from program import DATA, call

from rbs.recordings.gltf import GltfWriter
from rbs.recordings.outputs import OutputError
from rbs.recordings.recording import Recording
from rbs.recordings.writers import OUTPUTS
from rbs.scenes.messages import measured, one_line, short
from rbs.scenes.scene import followed_by
from rbs.scenes.simulation import SceneSimulation
from RigidBodySimulation import Simulation, main, shapes

pytest.importorskip("k3d")
pygltflib = pytest.importorskip("pygltflib")
# By ending, the first bytes of a file.
SIGNATURES = {".h5": b"\x89HDF", ".csv": b"step,", ".html": b"<!doctype html>"}
SIGNATURES |= {".glb": b"glTF", ".gif": b"GIF8"}
# File names, as bytes, that a template, a formula or an encoding could take for something else.
NAMES = [b"run\\1 $x^{$", b"\\g<0> %s {0} [NAME][ABOUT]", b"<b>&\"'", b"caf\xe9  \xff"]


def content(path):
    """What a .glb or .html file says: a dict of its nodes' names and times, or a text."""
    if path.suffix == ".html":
        return path.read_text(encoding="utf-8")
    binary = path.read_bytes()
    return json.loads(binary[20 : 20 + int.from_bytes(binary[12:16], "little")])


@pytest.mark.skipif(os.name == "nt", reason="Windows does not allow these names")
@pytest.mark.parametrize("name", NAMES)
def test_names_are_only_names(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    # a scene file is UTF-8, and a backslash in it separates folders
    mesh = (name + b" \xc3\xbc").decode("utf-8", "replace").replace("\\", "")
    (tmp_path / f"{mesh}.mesh").write_bytes((DATA / "box.mesh").read_bytes())
    scene = os.fsdecode(name + b"-scene.txt")
    (tmp_path / scene).write_text(f"1\n{mesh}.mesh 1 0 0 9 0 1 0 0 0\n", encoding="utf-8")
    files = "--record r.h5 --stats s.csv --export e.html".split()
    code, output, errors = call(capsys, scene, "--steps", 2, *files)
    assert (code, errors) == (0, "") and output.count("\n") == 10
    for file in files[1::2]:
        path = tmp_path / file
        assert path.read_bytes().startswith(SIGNATURES[path.suffix])
    assert call(capsys, "--replay", "r.h5", "--export", "e.glb")[0] == 0
    assert content(tmp_path / "e.glb")["nodes"][0]["name"] == f"{mesh} 0"
    title = html.escape(one_line(os.fsdecode(name)))
    assert f"<title>{title}</title>" in content(tmp_path / "e.html")


@pytest.mark.parametrize("ending", [".glb", ".html"])
def test_an_export_of_a_backward_replay_plays_it_backwards(tmp_path, ending):
    """Also one that seeks, and one that is there twice: times grow."""
    simulation = Simulation.from_meshes([box_body(1, 1, 1, (0, 9, 0))])
    with simulation.record(tmp_path / "r.h5"):
        simulation.run(20)
    opened, path = Simulation.open(tmp_path / "r.h5"), tmp_path / f"back{ending}"
    writer = OUTPUTS["export"].start(path)
    for step in (20, 19, 18, 18, 16, 14, 10, 0, 4):
        opened.seek(step)
        writer.add(opened)
    writer.save(opened)
    times, heights = writer.times(), writer.poses()[0][:, 0, 1].tolist()
    assert (np.diff(times) > 0.0).all() and times[-1] == pytest.approx(0.02 * (20 + 4))
    assert heights[0] == min(heights) and heights[-2] == max(heights) == 9.0
    if ending == ".glb":
        assert content(path)["accessors"][0]["max"] == [pytest.approx(0.48)]


def test_a_body_turns_the_shorter_way_whatever_the_sign_of_its_quaternion(tmp_path):
    body = box_body(1, 2, 3, (0, 9, 0))
    body.angVelocity = np.array([[0.0, 3.0, 0.0]])
    simulation = Simulation.from_meshes([body])
    writer = OUTPUTS["export"].start(tmp_path / "r.glb")
    with followed_by(simulation, writer):
        for step in range(10):
            simulation.meshes[0].orientation = simulation.meshes[0].orientation * (-1.0) ** step
            simulation.step()
    turns = writer.poses()[1][:, 0]
    angles = 2.0 * np.arccos(np.sum(turns[1:] * turns[:-1], axis=1))
    np.testing.assert_allclose(angles, 0.06, atol=1e-6)


@pytest.mark.parametrize("ending", [".glb", ".html"])
def test_a_run_may_be_without_bodies_for_a_while(tmp_path, ending):
    """One that gets its only body later, one that loses it, and one that never has any."""
    box = box_body(1, 1, 1, (0, 9, 0))
    acts = {"add": lambda run: run.add(box), "remove": lambda run: run.remove(0)}
    spans = []
    for name, step, act in (("a", 2, "add"), ("b", 4, "remove")):
        simulation = Simulation.from_meshes([box] * (act == "remove"))
        writer = OUTPUTS["export"].start(tmp_path / f"{name}{ending}", "speed")
        with followed_by(simulation, writer), simulation.record(tmp_path / f"{name}.h5"):
            acts[act](simulation.run(step))
            simulation.run(6 - step)
        writer.save(simulation)
        assert Simulation.verify(tmp_path / f"{name}.h5") == ""
        spans.append(writer.poses()[3].tolist())
    assert ending == ".html" or spans == [[[3], [6]], [[0], [4]]]  # a page has every second state
    with pytest.raises(OutputError, match="the run has no bodies"):
        Simulation.from_meshes([]).export(tmp_path / f"c{ending}", 2)


@pytest.mark.parametrize("ending", [".h5", ".csv", ".mp4", ".gif", ".glb", ".html"])
def test_a_writer_that_ends_early_leaves_nothing_or_what_it_has(tmp_path, capsys, ending):
    """And an old file of that name stays as it was."""
    pytest.importorskip("imageio_ffmpeg")
    (tmp_path / f"a{ending}").write_bytes(b"old")
    (row,) = (one for one in OUTPUTS.values() if ending in one.writers)
    isVideo = ending in (".mp4", ".gif")
    options = (lambda: np.zeros((32, 32, 3), np.uint8), 25.0, 1) if isVideo else ()
    writer, simulation = row.start(tmp_path / f"a{ending}", *options), Simulation("singlebox")
    with followed_by(simulation, writer):
        simulation.run(3)
    writer.close()
    writer.close()
    del writer  # an ffmpeg that goes on would write its file once more
    assert (tmp_path / f"a{ending}").read_bytes() == b"old"
    kept = list(tmp_path.glob("*.part*"))
    assert len(kept) == (ending in (".h5", ".csv"))
    if ending == ".h5":
        assert Recording(kept[0]).lastStep == 3
    elif ending == ".csv":
        assert kept[0].read_text().count("\n") == 5 and "4 rows kept" in capsys.readouterr().err


def test_texts_are_made_safe_and_short():
    assert one_line("a\nb\x1b[31m\udcff") == "a b [31m "
    assert short("a \n b", "c") == "a b c" and short("x" * 50) == "x" * 37 + "..."
    assert [measured(x, "N") for x in (0.5, -1e3, 2.5e7)] == ["0.5 N", "-1 kN", "25 MN"]


@pytest.mark.parametrize("ending", [".mp4", ".gif"])
def test_a_video_has_every_kth_step_once_at_its_rate(tmp_path, monkeypatch, ending):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    if os.name != "nt":  # in a group of its own, which Ctrl-C in a terminal does not reach
        real, own = imageio_ffmpeg.get_ffmpeg_exe(), tmp_path.with_name(f"ffmpeg{ending}")
        text = f"import os, sys; assert os.getpgid(0) == os.getpid(); os.execv('{real}', sys.argv)"
        own.write_text(f"#!{sys.executable}\n{text}\n")
        own.chmod(0o755)
        monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(own))
    simulation = Simulation("singlebox").run(3)

    def draw():
        return np.full((33, 34, 3), 8 * simulation.stepCount, np.uint8)

    writer = OUTPUTS["video"].start(tmp_path / f"v{ending}", draw, 12.5, 4)
    for _ in range(20):
        writer.add(simulation)
        writer.add(simulation)  # as after a frame in which no step was made
        simulation.step()
    writer.save(simulation)
    writer.close()
    assert [path.name for path in tmp_path.iterdir()] == [f"v{ending}"] and writer.count == 5
    reader = imageio_ffmpeg.read_frames(str(tmp_path / f"v{ending}"))
    about = next(reader)
    shown = [np.frombuffer(frame, np.uint8).mean() for frame in reader]
    assert about["fps"] == pytest.approx(12.5, abs=0.01)
    np.testing.assert_allclose(shown, [8 * step for step in (3, 7, 11, 15, 19)], atol=4)


@pytest.mark.skipif(os.name == "nt", reason="the encoder is a shell script")
@pytest.mark.parametrize("script", ["cat >/dev/null; exit 1", "exit 0", "few frames"])
def test_a_video_that_ffmpeg_does_not_finish_is_reported(tmp_path, monkeypatch, script):
    real = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    if script == "few frames":  # it is only asked to count them, or encodes the first three
        few = "(head -c 36864; cat >/dev/null) |"
        script = f'case $* in *rawvideo*) {few} {real} "$@";; *) exec {real} "$@";; esac'
    ffmpeg, path, simulation = tmp_path / "ffmpeg", tmp_path / "v.mp4", Simulation("singlebox")
    ffmpeg.write_text(f"#!/bin/sh\n{script}\n")
    ffmpeg.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(ffmpeg))
    path.write_bytes(b"old")
    writer = OUTPUTS["video"].start(path, lambda: np.zeros((64, 64, 3), np.uint8), 25.0, 1)
    with pytest.raises(OSError) as raised:
        for _ in range(50):
            writer.add(simulation)
            simulation.step()
        writer.save(simulation)
    assert raised.value.filename == str(path) and "ffmpeg has ended" in str(raised.value)
    writer.close()
    assert path.read_bytes() == b"old" and len(list(tmp_path.iterdir())) == 2


# Exports as glTF, read back by pygltflib and by trimesh.
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


def values(document, index):
    """The single-precision numbers of an accessor (n, w)."""
    accessor = document.accessors[index]
    count, begin = accessor.count * WIDTHS[accessor.type], document.bufferViews[index].byteOffset
    numbers = np.frombuffer(document.binary_blob(), np.float32, count, begin or 0)
    return numbers.reshape(accessor.count, -1)


def pose(document, node, path, time):
    """A node's translation, rotation or scale at a time that is in the file."""
    (animation,) = document.animations
    for channel in animation.channels:
        if (channel.target.node, channel.target.path) == (node, path):
            sampler = animation.samplers[channel.sampler]
            times = values(document, sampler.input)[:, 0]
            return values(document, sampler.output)[np.abs(times - time).argmin()]
    return np.array(getattr(document.nodes[node], path), dtype=np.float32)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The bridge, exported and recorded: (document, Recording)."""
    folder = tmp_path_factory.mktemp("export")
    names = ["--record", str(folder / "b.h5"), "--export", str(folder / "b.glb")]
    assert main(["bridge", "--steps", "60", *names]) == 0
    return pygltflib.GLTF2().load(str(folder / "b.glb")), Recording(folder / "b.h5")


def test_poses_are_those_of_the_recording(exported):
    document, recording = exported
    for step in range(0, 61, 6):
        frame = recording.frame(step)
        for b, position in enumerate(frame["positions"].astype(np.float32)):
            found = pose(document, b, "translation", 0.02 * step)
            np.testing.assert_array_equal(found, position)
            x, y, z, w = pose(document, b, "rotation", 0.02 * step)
            assert abs(abs(np.array([w, x, y, z]) @ frame["orientations"][b]) - 1.0) < 1e-6
    positions = {mesh.primitives[0].attributes.POSITION for mesh in document.meshes}
    assert len(positions) < len(document.nodes) / 3  # each shape is stored once


def test_rods_join_the_vertices_of_constraints(exported):
    document, recording = exported
    simulation = SceneSimulation(recording.source)
    simulation.set_state(recording.frame(30))
    m1, v1, m2, v2, *_ = simulation.constraints[0]
    ends = [simulation.meshes[m].currVertices[v] for m, v in ((m1, v1), (m2, v2))]
    node = [node.name for node in document.nodes].index("constraint 0")
    begin, scale = (pose(document, node, path, 0.6) for path in ("translation", "scale"))
    x, y, z, w = pose(document, node, "rotation", 0.6)
    along = np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)])
    np.testing.assert_allclose([begin, begin + scale[1] * along], ends, atol=1e-4)


def test_trimesh_finds_each_body_at_its_first_place(tmp_path):
    trimesh, simulation = pytest.importorskip("trimesh"), Simulation("tower_chain")
    start, meshes = simulation.state()["positions"], list(simulation.meshes)
    writer = GltfWriter(tmp_path / "run.glb")
    with followed_by(simulation, writer):
        simulation.run(10).remove(1)
        simulation.run(10)
    writer.save(simulation)
    colours = writer.poses()[2]
    assert (colours == colours[0]).all() and np.ptp(colours[0], axis=0).max() > 0.1
    document = pygltflib.GLTF2().load(str(tmp_path / "run.glb"))
    hidden = {c.target.node for c in document.animations[0].channels if c.target.path == "scale"}
    assert 1 in hidden and not hidden & {0, *range(2, len(meshes))}
    scene = trimesh.load(tmp_path / "run.glb")
    for mesh, position in zip(meshes, start, strict=True):
        transform, geometry = scene.graph[mesh.name]
        body = scene.geometry[geometry].copy()
        body.merge_vertices(merge_norm=True)
        assert body.is_watertight and body.volume == pytest.approx(mesh.volume, rel=1e-4)
        np.testing.assert_allclose(transform[:3, 3], position, rtol=1e-6)


def test_faces_without_area_have_normals_in_an_export(tmp_path):
    """A closed surface with a vertex in the middle of an edge: one triangle is a line."""
    points = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2], (1, 0, 0)], dtype=float)
    faces = [[0, 2, 1], [0, 3, 2], [1, 2, 3], [0, 4, 3], [4, 1, 3], [0, 1, 4]]
    wedge = shapes.from_surface("wedge", points, faces, 1.0, (0, 3, 0))
    simulation = Simulation.from_meshes([wedge])
    simulation.export(tmp_path / "w.glb", 1)
    document = pygltflib.GLTF2().load(str(tmp_path / "w.glb"))
    normals = values(document, document.meshes[0].primitives[0].attributes.NORMAL)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)
