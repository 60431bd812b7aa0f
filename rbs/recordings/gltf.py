"""Export of a run as glTF 2.0 (.glb), which Blender and other 3-D programs open.

Each body is a node with animated translation and rotation, in real time, step by step. Repeated
shapes are stored once. A constraint is a rod between its two vertices. pygltflib writes the file.
Units: metres, seconds. The y axis points up, as in glTF.
"""

import numpy as np

from rbs.appearance.colours import CONSTRAINT_COLOURS, GROUND_COLOUR, linear
from rbs.recordings.poses import PoseWriter, continuous, frame_run, placed, rod

# Side of the ground, as a multiple of the scene's size; and roughness of surfaces, 0 to 1.
GROUND_SIZE, ROUGHNESS = 2.5, 0.6


class GltfWriter(PoseWriter):
    """Collects the poses of a run, and writes them as one glTF file at its end."""

    package = "pygltflib"

    def write(self, simulation):
        """Writes the file. Raises OSError."""
        document, times = _Document(self.module), self.times()
        document.times = document.accessor(times, isBounded=True)
        positions, orientations, colours, (first, last) = self.poses()
        camera, size = frame_run(self.meshes, positions, orientations)
        shapes, numbers = self.shapes(colours[-1])  # in their last colours, which cannot change
        meshes = [document.mesh(*shape) for shape in shapes]
        state = np.arange(len(times))
        for b, mesh in enumerate(self.meshes):
            node = document.node(mesh.name, meshes[numbers[b]])
            document.animate(node, "translation", positions[:, b])
            document.animate(node, "rotation", np.roll(orientations[:, b], -1, axis=1))
            isThere = (first[b] <= state) & (state <= last[b])
            if not isThere.all():  # a size of zero hides it
                document.animate(node, "scale", np.repeat(isThere[:, None], 3, 1), "STEP")
        bodies, points, (first, last) = self.links()
        if len(bodies):
            ends = placed(positions[:, bodies], orientations[:, bodies], points)
            isThere = (first <= state[:, None]) & (state[:, None] <= last)
            vertices, faces = rod(size)
            mesh = document.mesh(CONSTRAINT_COLOURS[1], "rod", vertices, None, faces)
            document.add_rods(mesh, ends, isThere)
        if simulation.groundMesh is not None:
            document.add_ground(camera.centre, size)
        document.write(self.partial)


class _Document:
    """A glTF document under construction: one binary buffer, and the lists of the format."""

    def __init__(self, gltf):
        self._gltf = gltf
        self._chunks, self._length, self._parts = [], 0, {}
        self._animation = gltf.Animation(name="motion")
        self.document = gltf.GLTF2(
            asset=gltf.Asset(version="2.0", generator="Rigid bodies"),
            scene=0,
            scenes=[gltf.Scene(nodes=[])],
        )

    def accessor(self, values, isIndex=False, isBounded=False):
        """Adds a single-precision copy of an array (n,) or (n, w); returns its accessor's index."""
        gltf = self._gltf
        array = np.ascontiguousarray(values, dtype=np.uint32 if isIndex else np.float32)
        view = gltf.BufferView(buffer=0, byteOffset=self._length, byteLength=array.nbytes)
        self._chunks.append(array.tobytes())
        self._length += array.nbytes
        self.document.bufferViews.append(view)
        rows = array.reshape(len(array), -1)
        self.document.accessors.append(
            gltf.Accessor(
                bufferView=len(self.document.bufferViews) - 1,
                count=len(array),
                componentType=gltf.UNSIGNED_INT if isIndex else gltf.FLOAT,
                type={1: gltf.SCALAR, 3: gltf.VEC3, 4: gltf.VEC4}[rows.shape[1]],
                min=rows.min(axis=0).tolist() if isBounded else None,
                max=rows.max(axis=0).tolist() if isBounded else None,
            )
        )
        return len(self.document.accessors) - 1

    def mesh(self, colour, key, points, normals, corners):
        """Adds a matt mesh of an sRGB colour; returns its index.

        key : of the points (C, 3), normals (C, 3) or None, and faces (F, 3), which are stored once
        """
        gltf, document = self._gltf, self.document
        if key not in self._parts:
            normal = None if normals is None else self.accessor(normals)
            attributes = gltf.Attributes(self.accessor(points, isBounded=True), normal)
            self._parts[key] = attributes, self.accessor(np.ravel(corners), isIndex=True)
        surface = gltf.PbrMetallicRoughness(
            baseColorFactor=[*linear(np.asarray(colour)).tolist(), 1.0],
            metallicFactor=0.0,
            roughnessFactor=ROUGHNESS,
        )
        document.materials.append(gltf.Material(pbrMetallicRoughness=surface))
        (attributes, indices), material = self._parts[key], len(document.materials) - 1
        primitive = gltf.Primitive(attributes=attributes, indices=indices, material=material)
        document.meshes.append(gltf.Mesh(primitives=[primitive]))
        return len(document.meshes) - 1

    def node(self, name, mesh):
        """Adds a node and returns its index."""
        self.document.nodes.append(self._gltf.Node(name=name, mesh=mesh))
        self.document.scenes[0].nodes.append(len(self.document.nodes) - 1)
        return len(self.document.nodes) - 1

    def animate(self, node, path, values, interpolation="LINEAR"):
        """Sets a node's translation, rotation or scale (T, w), and animates it if it changes."""
        values = np.asarray(values, dtype=np.float64)
        setattr(self.document.nodes[node], path, values[0].tolist())
        if (values == values[0]).all():
            return
        animation, gltf = self._animation, self._gltf
        form = {"input": self.times, "interpolation": interpolation}
        animation.samplers.append(gltf.AnimationSampler(output=self.accessor(values), **form))
        form = {"target": gltf.AnimationChannelTarget(node=node, path=path)}
        form["sampler"] = len(animation.samplers) - 1
        animation.channels.append(gltf.AnimationChannel(**form))

    def add_rods(self, mesh, ends, isThere):
        """Adds rods between points (T, R, 2, 3), as a transformed `rod` each.

        isThere : (T, R); a size of zero hides the others
        """
        for r in range(ends.shape[1]):
            begin, along = ends[:, r, 0], ends[:, r, 1] - ends[:, r, 0]
            length = np.linalg.norm(along, axis=1, keepdims=True)
            node = self.node(f"constraint {r}", mesh)
            self.animate(node, "translation", begin)
            turns = continuous(_turns_from_y(along / np.where(length > 0.0, length, 1.0)))
            self.animate(node, "rotation", np.roll(turns, -1, axis=1))
            scale = np.insert(np.ones((len(length), 2)), 1, length[:, 0], axis=1)
            self.animate(node, "scale", scale * isThere[:, r : r + 1])

    def add_ground(self, middle, size):
        """Adds a square at y = 0 below a point (3,); size : of the scene, in m."""
        half = 0.5 * GROUND_SIZE * size
        corners = np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]]) * half
        corners = corners + middle * np.array([1.0, 0.0, 1.0])
        normals = np.tile([0.0, 1.0, 0.0], (4, 1))
        faces = [0, 1, 2, 0, 2, 3]
        self.node("ground", self.mesh(GROUND_COLOUR, "ground", corners, normals, faces))

    def write(self, path):
        if self._animation.channels:
            self.document.animations.append(self._animation)
        self.document.buffers.append(self._gltf.Buffer(byteLength=self._length))
        self.document.set_binary_blob(b"".join(self._chunks))
        self.document.save_binary(path)


def _turns_from_y(directions):
    """Quaternions (T, 4) of the shortest rotations from the y axis to unit vectors (T, 3)."""
    cosine = directions[:, 1]
    turns = np.stack([1.0 + cosine, directions[:, 2], 0.0 * cosine, -directions[:, 0]], axis=1)
    turns[cosine < -1.0 + 1e-9] = [0.0, 1.0, 0.0, 0.0]
    return turns / np.linalg.norm(turns, axis=1, keepdims=True)
