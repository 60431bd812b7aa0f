"""Stand-in for the released loader, with its names and signatures; this project reads the files.

Meshes are built with the class `Mesh` of the RBSFunctions that Python finds, the student's. A file
that cannot be used raises a SceneError that names file, line and cause.
"""

from pathlib import Path

import numpy as np
from cppyy import our_module

from RBSFunctions import Mesh as Mesh


def load_mesh_file(file_path):
    """Returns `(vertices (V, 3), faces (F, 3), tets (T, 4))` of a .mesh or .off file."""
    return our_module("rbs.scenes.meshfiles").load_mesh_file(file_path)


def load_off_file(file_path):
    """Returns `(vertices (V, 3), faces (F, 3))` of a surface, cut into triangles."""
    vertices, faces, tets = load_mesh_file(file_path)
    # the last vertex is the inner point that tetrahedra need
    return vertices[:-1] if len(tets) else vertices, faces


def load_constraint_file(file_path, meshes):
    """Returns rows `[m1, v1, m2, v2, refValue, upper]`, a lower and an upper one per line.

    refValue : the bound times the present distance of the two vertices, in m
    """
    return our_module("rbs.scenes.scenefiles").load_constraint_file(file_path, meshes)


def load_scene_file(file_path):
    """Returns the meshes of a scene, a list of `Mesh`; mesh files lie beside the scene file."""
    scene_rows = our_module("rbs.scenes.scenefiles").scene_rows
    folder = Path(file_path).parent
    loaded, meshes = {}, []
    for name, density, isFixed, position, orientation in scene_rows(file_path):
        if name not in loaded:
            loaded[name] = load_mesh_file(folder / name)
        shape = (array.copy() for array in loaded[name])  # the released class changes its arrays
        meshes.append(Mesh(name, *shape, density, position, orientation, isFixed))
    return meshes


def flatten_meshes(meshes, flattenFaces=True, constraints=()):
    """Returns all meshes as one: `(vertices, faces, densities, edges of constraints)`.

    vertices (ΣV, 3), world; faces (ΣF, 3) int; densities (ΣV,), kg/m³, per vertex; edges (C, 2)
    int, the two vertices of each constraint. Only the vertices are new in each step, so all are
    returned, with flattenFaces or without.
    """
    counts = [len(mesh.currVertices) for mesh in meshes]
    starts = np.cumsum([0, *counts])
    vertices = np.vstack([np.zeros((0, 3)), *(mesh.currVertices for mesh in meshes)])
    faces = [np.add(mesh.faces, start) for mesh, start in zip(meshes, starts, strict=False)]
    densities = np.repeat([float(mesh.density) for mesh in meshes], counts)
    edges = [(starts[m1] + v1, starts[m2] + v2) for m1, v1, m2, v2, *_ in constraints]
    edges = np.array(edges, int).reshape(-1, 2)
    return vertices, np.vstack([np.zeros((0, 3), int), *faces]), densities, edges


def update_visual_constraints(ps_mesh, vertices, constEdges):
    """Returns `(nodes (2 C, 3), edges (C, 2))` of a curve network that draws the constraints.

    ps_mesh : unused; vertices (V, 3); constEdges (C, 2), as `flatten_meshes` returns them
    """
    constEdges = np.asarray(constEdges, dtype=np.int64).reshape(-1, 2)
    nodes = np.asarray(vertices)[constEdges.ravel()]
    return nodes, np.arange(len(nodes)).reshape(-1, 2)
