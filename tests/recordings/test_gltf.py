"""Exports as glTF, read back by pygltflib and by trimesh."""

import numpy as np
import pytest

from rbs.recordings.gltf import GltfWriter
from rbs.recordings.recording import Recording
from rbs.scenes.scene import followed_by
from rbs.scenes.simulation import SceneSimulation
from RigidBodySimulation import Simulation, main

pygltflib = pytest.importorskip("pygltflib")
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
