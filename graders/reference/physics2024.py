"""The inertia of the coursework's 2024 reference solution, which its grader data were made with.

It has two quirks, which are implemented in this module only:

1. The tensor is six times too small: the integral over a tetrahedron uses its volume instead of
   the Jacobian determinant, which is 6 × volume.
2. The inverse tensor is turned to world axes as Rᵀ I⁻¹ R, the wrong way round.
"""

import numpy as np

INERTIA_DIVISOR = 6  # quirk 1


def in_world_axes(R, inverse, isReleased):
    """R I⁻¹ Rᵀ, or Rᵀ I⁻¹ R as released (quirk 2). R, inverse : (3, 3), or (n, 3, 3)"""
    if isReleased:
        R = np.swapaxes(R, -1, -2)
    return R @ inverse @ np.swapaxes(R, -1, -2)


def rotation_matrices(q):
    """R (n, 3, 3) with R v = q v q⁻¹, for quaternions (n, 4) of any length but zero."""
    q = np.reshape(q, (-1, 4))
    w, x, y, z = (q / np.sqrt(np.sum(q * q, axis=1, keepdims=True))).T
    rows = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return np.moveaxis(rows, -1, 0)


def mass_properties(vertices, tets):
    """Returns volume, centroid (3,), and inertia tensor (3, 3) about it for density 1.

    vertices (V, 3), anywhere; tets (T, 4), in any orientation. Over a tetrahedron with the corners
    x_i the integral of x xᵀ is V/20 (Σ x_i x_iᵀ + (Σ x_i)(Σ x_i)ᵀ) (F. Tonon, "Explicit exact
    formulas for the 3-D tetrahedron inertia tensor", J. Math. Stat. 1, 2005). With C the sum of
    these, the tensor is tr(C) 1 − C.
    """
    corners = np.asarray(vertices)[np.asarray(tets, dtype=np.int64)]
    a, b, c, d = np.moveaxis(corners, 1, 0)
    volumes = np.abs(np.sum((b - a) * np.cross(c - a, d - a), axis=1)) / 6
    centre = volumes @ corners.sum(axis=1) / (4 * volumes.sum())
    corners = corners - centre
    sums = corners.sum(axis=1)
    moments = np.swapaxes(corners, 1, 2) @ corners + sums[:, :, None] * sums[:, None]
    C = np.sum(volumes[:, None, None] * moments, axis=0) / 20
    return volumes.sum(), centre, np.trace(C) * np.eye(3) - C
