"""Exports, read back by a reader of our own that shares nothing with the library that writes."""

import json
import struct

import numpy as np
import pytest

from rbs.recordings.gltf import GltfWriter
from rbs.recordings.recording import Recording
from rbs.scenes.simulation import SceneSimulation
from RigidBodySimulation import Simulation, main

pytest.importorskip("pygltflib")
TYPES = {5126: np.float32, 5125: np.uint32}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


class Glb:
    """A .glb file: its JSON, and `values` of an accessor."""

    def __init__(self, path):
        content = path.read_bytes()
        magic, version, length, size, kind = struct.unpack_from("<4sIII4s", content)
        assert (magic, version, length, kind) == (b"glTF", 2, len(content), b"JSON")
        self.json = json.loads(content[20 : 20 + size])
        binary, kind = struct.unpack_from("<I4s", content, 20 + size)
        assert kind == b"BIN\0" and 28 + size + binary == length
        self.binary = content[28 + size :]

    def values(self, index):
        accessor = self.json["accessors"][index]
        view = self.json["bufferViews"][accessor["bufferView"]]
        width, kind = WIDTHS[accessor["type"]], TYPES[accessor["componentType"]]
        count, begin = accessor["count"] * width, view.get("byteOffset", 0)
        return np.frombuffer(self.binary, kind, count, begin).reshape(-1, width)

    def pose(self, node, path, time):
        """A node's translation, rotation or scale at a time that is in the file."""
        (animation,) = self.json["animations"]
        for channel in animation["channels"]:
            if channel["target"] == {"node": node, "path": path}:
                sampler = animation["samplers"][channel["sampler"]]
                times = self.values(sampler["input"])[:, 0]
                return self.values(sampler["output"])[np.abs(times - time).argmin()]
        return np.array(self.json["nodes"][node][path], dtype=np.float32)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The bridge, exported and recorded: (Glb, Recording)."""
    folder = tmp_path_factory.mktemp("export")
    names = ["--record", str(folder / "b.h5"), "--export", str(folder / "b.glb")]
    assert main(["bridge", "--steps", "60", *names]) == 0
    return Glb(folder / "b.glb"), Recording(folder / "b.h5")


def test_poses_are_those_of_the_recording(exported):
    glb, recording = exported
    for step in range(0, 61, 6):
        frame = recording.frame(step)
        for b, position in enumerate(frame["positions"].astype(np.float32)):
            np.testing.assert_array_equal(glb.pose(b, "translation", 0.02 * step), position)
            x, y, z, w = glb.pose(b, "rotation", 0.02 * step)
            assert abs(abs(np.array([w, x, y, z]) @ frame["orientations"][b]) - 1.0) < 1e-6
    positions = {mesh["primitives"][0]["attributes"]["POSITION"] for mesh in glb.json["meshes"]}
    assert len(positions) < len(glb.json["nodes"]) / 3  # each shape is stored once
    assert np.abs(glb.pose(3, "translation", 1.2) - glb.pose(3, "translation", 0.0)).max() > 0.1


def test_lines_join_the_vertices_of_constraints(exported):
    glb, recording = exported
    simulation = SceneSimulation(recording.source)
    simulation.set_state(recording.frame(30))
    m1, v1, m2, v2, *_ = simulation.constraints[0]
    ends = [simulation.meshes[m].currVertices[v] for m, v in ((m1, v1), (m2, v2))]
    node = [node["name"] for node in glb.json["nodes"]].index("constraint 0")
    begin, scale = (glb.pose(node, path, 0.6) for path in ("translation", "scale"))
    x, y, z, w = glb.pose(node, "rotation", 0.6)
    along = np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)])
    np.testing.assert_allclose([begin, begin + scale[1] * along], ends, atol=1e-4)


def test_other_libraries_open_the_file(tmp_path):
    """pygltflib's reader finds what was written; trimesh finds each body, at its first place."""
    pygltflib, trimesh = pytest.importorskip("pygltflib"), pytest.importorskip("trimesh")
    simulation = Simulation("tower_chain")
    start, meshes = simulation.state()["positions"], list(simulation.meshes)
    writer = GltfWriter(tmp_path / "run.glb")
    with simulation.followed_by(writer):
        simulation.run(10).remove(1)
        simulation.run(10)
    writer.save(simulation)
    document = pygltflib.GLTF2().load(str(tmp_path / "run.glb"))
    names = [node.name for node in document.nodes]
    assert names[: len(meshes)] == [mesh.name for mesh in meshes] and names[-1] == "ground"
    (animation,) = document.animations
    times = {document.accessors[sampler.input].count for sampler in animation.samplers}
    assert times == {21}
    hidden = {c.target.node for c in animation.channels if c.target.path == "scale"}
    assert 1 in hidden and not hidden & {0, *range(2, len(meshes))}
    scene = trimesh.load(tmp_path / "run.glb")
    for mesh, position in zip(meshes, start, strict=True):
        transform, geometry = scene.graph[mesh.name]
        body = scene.geometry[geometry].copy()
        body.merge_vertices(merge_norm=True)
        assert body.is_watertight and body.volume == pytest.approx(mesh.volume, rel=1e-4)
        np.testing.assert_allclose(transform[:3, 3], position, rtol=1e-6)
