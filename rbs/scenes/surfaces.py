"""Closed surfaces of triangles: turned outwards, filled with tetrahedra, and their volumes."""

import warnings
from contextlib import suppress

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

# Least volume of a tetrahedron or of a surface, relative to the cube of the mesh's extent; smaller
# ones count as flat. Far above the rounding of a volume, far below the thinnest of usual meshes.
FLAT_VOLUME = 1e-13
# Digits to which numbers of 32 and 64 bits are exact.
DIGITS_32, DIGITS_64 = 7, 15
# Largest relative excess of the hull's volume over that of a convex mesh. Coordinates rounded to
# four decimals make about 1e-5. Smaller values report invisible dents; larger ones hide visible
# ones.
CONVEXITY_TOLERANCE = 1e-4
# Corners of a hull from which a body is warned of. In contact, time and memory grow with the
# product of the numbers of corners; beyond some hundred, the motion hardly differs.
MANY_CORNERS = 5000


class NonConvexWarning(UserWarning):
    """A mesh is not convex, and collides as its convex hull."""


def clean_surface(vertices, faces):
    """Merges coincident vertices (V, 3), drops those without a face, and returns both tables.

    Faces (F, 3) that lose a corner are dropped, too. Otherwise the order stays the same. Raises
    ValueError if the faces are not triangles of these vertices.
    """
    if faces.size and (
        faces.shape[1:] != (3,) or not 0 <= faces.min() <= faces.max() < len(vertices)
    ):
        raise ValueError(f"faces must be rows of 3 indices, 0 to {len(vertices) - 1}")
    used, faces = np.unique(joined_faces(vertices, faces), return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def joined_faces(vertices, faces, tolerance=0.0):
    """Returns the faces (F, 3) with the first of coincident vertices as corners.

    Vertices within a tolerance of each other count as coincident, and so do those that are joined
    by others. Faces that lose a corner are dropped.
    """
    if tolerance:
        pairs = cKDTree(vertices).query_pairs(tolerance, output_type="ndarray").T
        graph = coo_array((np.ones(pairs.shape[1]), pairs), 2 * (len(vertices),))
        merged = connected_components(graph, directed=False)[1]
        first = np.unique(merged, return_index=True)[1]
    else:
        # 0.0, not -0.0
        places = vertices + 0.0
        _, first, merged = np.unique(places, axis=0, return_index=True, return_inverse=True)
    faces = first[merged.ravel()][faces]
    return faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]


def orient_surface(vertices, faces):
    """Orients the triangles (F, 3) of a closed surface counter-clockwise seen from outside.

    Neighbours are made consistent. A connected piece of negative volume is flipped, unless it is a
    cavity in another. Where solids touch along an edge, it may belong to more than two triangles,
    half of them each way; all must then be consistent. Raises ValueError if an edge does not belong
    to two triangles otherwise, or the surface is not orientable.
    """
    count = len(faces)
    if count == 0:
        raise ValueError("no triangles")
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    edges, edge, owners = np.unique(
        np.sort(ends, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    ways = np.bincount(edge.ravel(), np.where(ends[:, 0] < ends[:, 1], 1, -1))
    if (owners != 2).any() and not ways.any():
        return faces if enclosed_volume(vertices, faces) >= 0.0 else faces[:, ::-1].copy()
    if (owners != 2).any():
        k = edge.ravel()[(owners != 2)[edge.ravel()].argmax()]
        (low, high), count = edges[k], int(owners[k])
        raise ValueError(
            f"the surface is not closed: the edge between vertices {low} and {high} belongs to "
            f"{count} triangle{'s'[count == 1 :]}, not to 2"
        )
    # Each triangle has two nodes, as it is and turned over (+ count). Those that agree are linked:
    # consistent neighbours traverse their common edge in opposite directions.
    sides = np.argsort(edge.ravel(), kind="stable").reshape(-1, 2)
    one, other = sides.T // 3
    differ = np.equal(*(ends[:, 0] < ends[:, 1])[sides.T]) * count
    links = np.append(one, one + count), np.append(other + differ, other + count - differ)
    graph = coo_array((np.ones(len(links[0])), links), (2 * count, 2 * count))
    asItIs, turned = connected_components(graph, directed=False)[1].reshape(2, -1)
    if (asItIs == turned).any():
        raise ValueError("the surface has no inside (it is not orientable)")
    _, first, piece = np.unique(np.minimum(asItIs, turned), return_index=True, return_inverse=True)
    # the first triangle of each piece stays, and so do those that agree with it
    result = np.where((asItIs != asItIs[first][piece])[:, None], faces[:, ::-1], faces)
    if enclosed_volume(vertices, result) < 0.0:
        result = result[:, ::-1].copy()
    pieces = [np.flatnonzero(piece == k) for k in range(len(first))]
    boxes = [[f(vertices[faces[piece]], axis=(0, 1)) for f in (np.min, np.max)] for piece in pieces]
    for piece, (low, high) in zip(pieces, boxes, strict=True):
        if enclosed_volume(vertices, result[piece]) < 0.0:
            if not any((one < low).all() and (high < other).all() for one, other in boxes):
                result[piece] = result[piece][:, ::-1]
    return result


def close_surface(name, vertices, faces, stacklevel, digits_of=None):
    """Returns the faces (F, 3) of a closed surface, oriented outwards.

    If there are gaps, corners are merged that coincide, then those within the rounding of their
    numbers, with a warning that begins with `name`. Raises ValueError if gaps are left.

    digits_of : function that returns to how many digits the coordinates are exact, relative to the
        largest; None or 0 are those of single precision if all fit in it, else of double precision
    """
    try:
        return orient_surface(vertices, faces)
    except ValueError as error:
        gaps = error
    if not (digits := digits_of and digits_of()):
        with np.errstate(over="ignore"):
            isSingle = (vertices == vertices.astype(np.float32)).all()
        digits = DIGITS_32 if isSingle else DIGITS_64
    for tolerance in (0.0, 2.0 * 10.0 ** (1 - digits) * np.abs(vertices).max(initial=0.0)):
        joined = joined_faces(vertices, faces, tolerance)
        with suppress(ValueError):
            closed = orient_surface(vertices, joined)
            if tolerance and (count := len(np.unique(faces)) - len(np.unique(joined))):
                told = f"within {tolerance:.1g} of others, the rounding of their numbers: {count}"
                warnings.warn(f"{name}: merged corners that lie {told}", stacklevel=stacklevel + 1)
            return closed
    raise gaps


def fill_surface(vertices, faces):
    """Joins the triangles (F, 3) of a closed surface, oriented outwards, to the vertices' mean.

    Returns `(vertices (V + 1, 3), faces, tets (T, 4))`: the mean is the last vertex, and each
    triangle has a tetrahedron, unless that is flat. If the mean does not see all faces from inside,
    as in a torus, there are no tetrahedra and no further vertex. Raises ValueError without volume.
    """
    points = np.vstack([vertices, np.mean(vertices, axis=0)])
    tets = np.insert(faces, 0, len(vertices), axis=1)
    volumes, least = tetrahedron_volumes(points, tets), flat_volume(vertices)
    if not volumes.sum() > least:
        raise ValueError("the surface has no volume")
    if volumes.min() < -least:
        return vertices, faces, tets[:0]
    return points, faces, tets[volumes > least]


def flat_volume(vertices):
    """Returns the volume up to which a solid with these vertices (V, 3) counts as flat."""
    return FLAT_VOLUME * np.max(np.ptp(vertices, axis=0)) ** 3


def tetrahedron_volumes(vertices, tets):
    """Returns the signed volumes (T,) of tetrahedra (T, 4) with corners a, b, c, d.

    They are positive if a, b, c run counter-clockwise seen from d.
    """
    a, b, c, d = (vertices[tets[:, k]] for k in range(4))
    return np.sum((b - a) * np.cross(c - a, d - a), axis=1) / 6.0


def enclosed_volume(vertices, faces):
    """Returns the signed volume inside closed surfaces, by the divergence theorem."""
    return float(tetrahedron_volumes(vertices, np.insert(faces, 0, 0, axis=1)).sum())


def warn_of_shape(name, mesh, stacklevel):
    """Warns if a mesh is not convex, or its hull has more corners than a motion needs.

    stacklevel : 2 for the caller's caller, see `warnings.warn`
    """
    volume, hullVolume, count = mesh.volume, mesh.hullVolume, len(mesh.hull.vertices)
    if hullVolume > volume * (1.0 + CONVEXITY_TOLERANCE):
        hull = f"convex hull {hullVolume:.6g}, {hullVolume / volume - 1.0:.2%} more"
        told = f"{name} is not convex (volume {volume:.6g}, {hull}) and collides as its hull"
        warnings.warn(told, NonConvexWarning, stacklevel=stacklevel + 1)
    if count > MANY_CORNERS:
        told = f"{name} has {count} corners, which makes its contacts slow; some hundred are enough"
        warnings.warn(told, stacklevel=stacklevel + 1)
