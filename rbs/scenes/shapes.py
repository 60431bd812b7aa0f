"""Bodies: `box`, `sphere`, `cylinder`, `convex_hull`, and `from_surface`, of any closed surface.

Lengths have the units of the scene. Each function returns a `Mesh`, and raises ValueError, which
names an argument, if that is wrong.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, QhullError

from rbs.geometry.triples import ZERO, shown_value
from rbs.scenes.meshfiles import clean_surface, close_surface, fill_surface, warn_of_shape
from rbs.stepping.meshes import checked_count, checked_numbers
from RBSFunctions import Mesh

__all__ = ["box", "convex_hull", "cylinder", "from_surface", "sphere"]


def from_surface(
    name: str,
    vertices: Any,
    faces: ArrayLike | None = None,
    density: float | None = None,
    position: ArrayLike | None = None,
    orientation: ArrayLike = (1, 0, 0, 0),
    isFixed: bool = False,
) -> Mesh:
    """Makes a body from a closed surface, such as that of SciPy's ConvexHull.

    vertices : (V, 3), or an object with vertices and faces, such as a trimesh.Trimesh, or a
        trimesh.Scene, whose geometries become one body. Coincident vertices are merged, and with a
        warning those that differ by rounding, if there are gaps
    faces : (F, 3) int, triangles, with their corners in any order
    density : mass per volume, > 0; required
    position : (1, 3), COM in the world; None leaves the body where the vertices are

    The rest is as for `Mesh`. Warns if the surface is not convex. Raises ValueError if it is not
    closed.
    """
    try:
        if faces is None:
            surface = vertices.to_mesh() if hasattr(vertices, "to_mesh") else vertices
            vertices, faces = surface.vertices, surface.faces
        vertices = checked_numbers("vertices", vertices, 3)
        faces = checked_numbers("faces", faces, 3, dtype=np.int64)
        vertices, faces = clean_surface(vertices, faces)
        faces = close_surface(f"mesh {name}", vertices, faces, stacklevel=2)
        vertices, faces = clean_surface(vertices, faces)
        vertices, faces, tets = fill_surface(vertices, faces)
    except AttributeError:
        what = "without faces, vertices must be an object that has both"
        raise ValueError(f"mesh {name}: {what}, not {shown_value(vertices)}") from None
    except (IndexError, TypeError, ValueError) as error:
        raise ValueError(f"mesh {name}: {error}") from None
    mesh = Mesh(name, vertices, faces, tets, density, ZERO, orientation, isFixed)
    position = vertices[-1] - mesh.origVertices[-1] if position is None else position
    mesh.position = checked_numbers(f"mesh {name}: position", position, 3, 1)
    warn_of_shape(f"mesh {name}", mesh, stacklevel=2)
    return mesh


def convex_hull(
    points: ArrayLike,
    density: float,
    position: ArrayLike | None = None,
    name: str = "hull",
    orientation: ArrayLike = (1, 0, 0, 0),
    isFixed: bool = False,
) -> Mesh:
    """Makes a body from the convex hull of points (n, 3).

    The rest is as for `from_surface`. Raises ValueError if the hull has no volume.
    """
    try:
        hull = ConvexHull(checked_numbers("points", points, 3))
    except (QhullError, ValueError):
        raise ValueError(
            f"mesh {name}: points must be rows of 3 finite numbers, four or more not in a plane"
        ) from None
    return from_surface(name, hull.points, hull.simplices, density, position, orientation, isFixed)


def box(
    size: ArrayLike,
    density: float,
    position: ArrayLike = ZERO,
    name: str = "box",
    orientation: ArrayLike = (1, 0, 0, 0),
    isFixed: bool = False,
) -> Mesh:
    """Makes a box with sides (3,) along x, y and z. The rest is as for `convex_hull`."""
    points = _lengths(name, "size", size, 3) * (np.indices((2, 2, 2)).reshape(3, 8).T - 0.5)
    return convex_hull(points, density, position, name, orientation, isFixed)


def sphere(
    radius: float,
    density: float,
    position: ArrayLike = ZERO,
    name: str = "sphere",
    corners: int = 162,
    orientation: ArrayLike = (1, 0, 0, 0),
    isFixed: bool = False,
) -> Mesh:
    """Makes a ball: a polyhedron with its corners on the sphere. The rest is as for `convex_hull`.

    corners : at least so many, up to 10,000. With 162, its mass is 3.4 % less than the ball's, and
        rolling slows down; with 642, 0.9 % less
    """
    (radius,) = _lengths(name, "radius", radius)
    corners = checked_count(corners, f"mesh {name}: corners", 4, 10_000)
    points = _sphere_points(radius, corners)
    return convex_hull(points, density, position, name, orientation, isFixed)


def cylinder(
    radius: float,
    height: float,
    density: float,
    position: ArrayLike = ZERO,
    name: str = "cylinder",
    sides: int = 24,
    orientation: ArrayLike = (1, 0, 0, 0),
    isFixed: bool = False,
) -> Mesh:
    """Makes a cylinder around y, as a prism. The rest is as for `convex_hull`."""
    (radius,), (height,) = _lengths(name, "radius", radius), _lengths(name, "height", height)
    sides = checked_count(sides, f"mesh {name}: sides", 3, 9999)
    angles = 2.0 * np.pi * np.arange(sides) / sides
    rim = np.stack([radius * np.sin(angles), 0.0 * angles, radius * np.cos(angles)], axis=1)
    half = np.array([0.0, height / 2.0, 0.0])
    points = np.concatenate([rim - half, rim + half])
    return convex_hull(points, density, position, name, orientation, isFixed)


def _lengths(name, what, value, count=1):
    lengths = checked_numbers(f"mesh {name}: {what}", value, count, 1)[0]
    if not (lengths > 0.0).all():
        raise ValueError(f"mesh {name}: {what} must be positive, not {shown_value(value)}")
    return lengths


def _sphere_points(radius, corners):
    """Returns at least so many evenly spread points of a sphere (n, 3): an icosahedron, whose edges
    are halved until there are; n = 10 · 4ᵏ + 2.
    """
    golden = (1.0 + 5.0**0.5) / 2.0
    one = np.array([[0.0, a, b * golden] for a in (-1.0, 1.0) for b in (-1.0, 1.0)])
    points = np.concatenate([one, np.roll(one, 1, axis=1), np.roll(one, 2, axis=1)])
    while len(points) < corners:
        ends = ConvexHull(points).simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        a, b = np.unique(np.sort(ends, axis=1), axis=0).T
        middles = (points[a] + points[b]) / 2.0
        middles *= np.linalg.norm(points[0]) / np.linalg.norm(middles, axis=1, keepdims=True)
        points = np.concatenate([points, middles])
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True)
