"""Closed surfaces of triangles: turned outwards, filled with tetrahedra, and their volumes."""

import warnings

import numpy as np

# Least depth of an inner point below the plane of each face, relative to the mesh's extent: far
# above rounding. Larger values refuse more surfaces.
INSIDE_MARGIN = 1e-9
# Largest relative excess of the hull's volume over that of a convex mesh. Coordinates rounded to
# four decimals make about 1e-5. Smaller values report invisible dents; larger ones hide visible
# ones.
CONVEXITY_TOLERANCE = 1e-4
# Halvings of the edges of an icosahedron that make a sphere: 162 points, 97 % of its volume.
SPHERE_HALVINGS = 2


class NonConvexWarning(UserWarning):
    """A mesh is not convex, and collides as its convex hull."""


def clean_surface(vertices, faces):
    """Merges coincident vertices (V, 3), drops those without a face, and returns both tables.

    Faces (F, 3) that lose a corner are dropped, too. Otherwise the order stays the same.
    """
    _, first, merged = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    faces = first[merged.ravel()][faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def orient_surface(vertices, faces):
    """Orients the triangles (F, 3) of a closed surface counter-clockwise seen from outside.

    Neighbours are made consistent, and a connected piece of negative volume is flipped. Raises
    ValueError if an edge does not belong to two triangles, or the surface is not orientable.
    """
    neighbours = [[] for _ in faces]
    for (low, high), owners in faces_at_edges(faces).items():
        if len(owners) != 2:
            raise ValueError(not_closed(low, high, len(owners)))
        (one, oneAscends), (other, otherAscends) = owners
        # consistent neighbours traverse their common edge in opposite directions
        neighbours[one].append((other, oneAscends == otherAscends))
        neighbours[other].append((one, oneAscends == otherAscends))

    result = faces.copy()
    turned = [None] * len(faces)
    for start in range(len(faces)):
        if turned[start] is None:
            piece = _agree_with(start, neighbours, turned)
            flips = [face for face in piece if turned[face]]
            result[flips] = result[flips][:, ::-1]
            if enclosed_volume(vertices, result[piece]) < 0.0:
                result[piece] = result[piece][:, ::-1]
    return result


def _agree_with(start, neighbours, turned):
    """Returns the triangles connected with `start`. Marks in `turned` those to be flipped."""
    turned[start] = False
    piece = [start]
    for face in piece:  # grows during the loop
        for other, differs in neighbours[face]:
            if turned[other] is None:
                turned[other] = turned[face] ^ differs
                piece.append(other)
            elif turned[other] != turned[face] ^ differs:
                raise ValueError("the surface has no inside (it is not orientable)")
    return piece


def fill_surface(vertices, faces):
    """Joins the triangles (F, 3) of a closed surface, oriented outwards, to one inner point.

    Returns `(vertices (V + 1, 3), faces, tets (T, 4))`: the inner point is the last vertex, and
    each triangle with an area has a tetrahedron. Raises ValueError if no point sees all faces.
    """
    normals = area_vectors(vertices, faces)
    lengths = np.sqrt(np.sum(normals * normals, axis=1))
    extent = np.max(np.ptp(vertices, axis=0))
    solid = lengths > INSIDE_MARGIN * extent * extent
    if not solid.any():
        raise ValueError("the mesh has no volume")
    normals = normals[solid] / lengths[solid, None]
    offsets = np.sum(normals * vertices[faces[solid, 0]], axis=1)

    inner = find_inner_point(vertices, normals, offsets, INSIDE_MARGIN * extent)
    apex = np.full(len(normals), len(vertices))
    return np.vstack([vertices, inner]), faces, np.column_stack([apex, faces[solid]])


def find_inner_point(vertices, normals, offsets, margin):
    """Returns a point (3,) more than `margin` behind all planes normals · x = offsets.

    It is the mean of the vertices if that will do, as in every convex body. Otherwise a linear
    programme maximises the least distance t from the planes, normals · x + t ≤ offsets.
    """
    mean = np.mean(vertices, axis=0)
    if np.max(normals @ mean - offsets) < -margin:
        return mean
    # takes long to import, and few files need it
    from scipy.optimize import linprog

    planes = np.column_stack([normals, np.ones(len(normals))])
    best = linprog([0.0, 0.0, 0.0, -1.0], planes, offsets, bounds=[(None, None)] * 4)
    if best.status != 0 or best.x[3] <= margin:
        raise ValueError(
            "the surface cannot be filled, because no point sees all of it from inside; give it as "
            "a .mesh with tetrahedra"
        )
    return best.x[:3]


def area_vectors(vertices, faces):
    """Returns outward normals (F, 3) of faces (F, 3), whose length is twice the face's area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def tetrahedron_volumes(vertices, tets):
    """Returns the signed volumes (T,) of tetrahedra (T, 4) with corners a, b, c, d.

    They are positive if a, b, c run counter-clockwise seen from d.
    """
    a, b, c, d = (vertices[tets[:, k]] for k in range(4))
    return np.sum((b - a) * np.cross(c - a, d - a), axis=1) / 6.0


def enclosed_volume(vertices, faces):
    """Returns the signed volume inside closed surfaces, by the divergence theorem."""
    a, b, c = (vertices[faces[:, k]] - vertices[0] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def faces_at_edges(faces):
    """Returns a dict from edges (low, high) to lists of (face, whether low comes first)."""
    owners = {}
    for face, corners in enumerate(faces.tolist()):
        for tail, head in zip(corners, corners[1:] + corners[:1], strict=True):
            key = (min(tail, head), max(tail, head))
            owners.setdefault(key, []).append((face, tail < head))
    return owners


def not_closed(low, high, count):
    """Returns the message for an edge that belongs to `count` triangles."""
    return (
        f"the surface is not closed: the edge between vertices {low} and {high} "
        f"belongs to {count} triangle{'s' * (count != 1)}, not to 2"
    )


def warn_unless_convex(name, volume, hullVolume, stacklevel):
    """Warns if a mesh is not convex. stacklevel : 2 for the caller's caller, see `warnings.warn`"""
    if hullVolume > volume * (1.0 + CONVEXITY_TOLERANCE):
        warnings.warn(
            f"{name} is not convex (volume {volume:.6g}, convex hull {hullVolume:.6g}) and "
            "collides as its hull",
            NonConvexWarning,
            stacklevel=stacklevel + 1,
        )


def box_points(size):
    """Returns the corners (8, 3) of a box with these sides (3,) around the origin."""
    return size * (np.indices((2, 2, 2)).reshape(3, 8).T - 0.5)


def cylinder_points(radius, height, sides):
    """Returns the corners (2 · sides, 3) of a regular prism around the y axis."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    rim = np.stack([radius * np.sin(angles), 0.0 * angles, radius * np.cos(angles)], axis=1)
    half = np.array([0.0, height / 2.0, 0.0])
    return np.concatenate([rim - half, rim + half])


def sphere_points(radius):
    """Returns evenly spread points (162, 3) of a sphere: an icosahedron, its edges halved twice."""
    golden = (1.0 + 5.0**0.5) / 2.0
    one = np.array([[0.0, a, b * golden] for a in (-1.0, 1.0) for b in (-1.0, 1.0)])
    points = np.concatenate([one, np.roll(one, 1, axis=1), np.roll(one, 2, axis=1)])
    edge = 2.0
    for _ in range(SPHERE_HALVINGS):
        away = np.linalg.norm(points[:, None] - points, axis=2)
        a, b = np.nonzero(np.triu(away, 1) * (away < 1.25 * edge))
        middles = (points[a] + points[b]) / 2.0
        middles *= np.linalg.norm(points[0]) / np.linalg.norm(middles, axis=1, keepdims=True)
        points, edge = np.concatenate([points, middles]), edge / 2.0
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True)
