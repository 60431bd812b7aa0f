"""Integration and collision detection in 50 decimal digits, written apart from the simulation.

Nothing is imported from RBSFunctions, GJK or Quaternion, so none of their errors is repeated here.
More than thirty of the digits are beyond a double's: a result, rounded once at the end, is the
double nearest to the formula's true value, however its terms cancel.

Vectors are NumPy arrays of mpmath's numbers, in world axes, in m, s and radians.
"""

import sys

import numpy as np

try:
    from mpmath import mp
except ModuleNotFoundError:
    sys.exit("make_reference.py needs mpmath: pip install mpmath")

import reference  # noqa: F401, makes rbs importable

from rbs.glass.model import multiply, unit

mp.dps = 50

# Converts numbers to 50 digits, doubles exactly.
exact = np.frompyfunc(mp.mpf, 1, 1)
cos, sinc = (np.frompyfunc(function, 1, 1) for function in (mp.cos, mp.sinc))

GRAVITY = exact(["0", "-9.8", "0"])

# Difference, in m, below which lengths are equal; their rounding errors are near 1e-48.
TIE = exact("1e-30")

# Least distance of a random sample, in m, from every decision (whether bodies collide, which
# direction is the shallowest), so that double precision decides alike. If an assertion fails,
# another seed is needed.
MARGIN = exact("1e-6")


def integrate(position, orientation, linVelocity, angVelocity, timeStep):
    """Returns n states, arrays (n, w), after one step of semi-implicit Euler: velocity first.

    The angular velocity, constant over the step, turns the body by |ω| h about ω: with v = ω h / 2,
    by the quaternion exp([0, v]) = [cos |v|, v sin |v| / |v|], from the left as ω is in world axes.
    Torque-free precession is omitted, as in the simulation.
    """
    linVelocity = linVelocity + timeStep * GRAVITY
    v = timeStep / 2 * angVelocity
    angle = np.sqrt(np.sum(v * v, axis=1, keepdims=True))
    turned = multiply(np.hstack([cos(angle), sinc(angle) * v]), unit(orientation))
    return position + timeStep * linVelocity, turned, linVelocity, angVelocity


def detect_collision(hull1, faces1, hull2, faces2):
    """Returns the contact (7,) of two convex bodies, [depth, *normal, *point], or zeros.

    hull : (V, 3), world vertices of a body; faces : (F, 3), anticlockwise seen from outside
    depth > 0 is the distance that body 2 must move along the unit normal to separate; the point is
    that of body 2 deepest inside body 1, and point + depth normal is on body 1's surface.

    Moved by t along a unit direction d, body 2 clears body 1 once t reaches their overlap along d,
    max over 1 of a·d − min over 2 of b·d. Bodies are apart when some overlap is negative, and the
    penetration depth is the least overlap of all directions. That overlap is the distance from the
    origin to a supporting plane of the Minkowski difference, so the least one belongs to a face of
    the difference; and those faces come from faces of body 1, faces of body 2, or a pair of edges.
    """
    (normals1, edges1), (normals2, edges2) = _features(hull1, faces1), _features(hull2, faces2)
    crossed = np.cross(edges1[:, None], edges2).reshape(-1, 3)
    axes = unit(np.vstack([normals1, normals2, crossed]))
    heights1, heights2 = axes @ hull1.T, axes @ hull2.T
    along = heights1.max(axis=1) - heights2.min(axis=1)
    against = heights2.max(axis=1) - heights1.min(axis=1)
    directions, overlaps = np.vstack([axes, -axes]), np.concatenate([along, against])

    depth, normal = overlaps.min(), directions[overlaps.argmin()]
    assert abs(depth) > MARGIN, "the bodies only just touch"
    if depth < 0:
        return np.zeros(7)
    others = overlaps[directions @ normal < 1 - TIE]
    assert others.min() > depth + MARGIN, "two directions are equally shallow"
    return np.hstack([depth, normal, _deepest_point(hull1, hull2, depth, normal)])


def _features(hull, faces):
    """Outward face normals and edge vectors of a body, of any length.

    Of the two triangles at an edge, one runs along it towards the larger index. Diagonals of flat
    quadrilaterals count as edges, which does no harm: no direction's overlap is below the depth.
    """
    a, b, c = hull[faces.T]
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    edges = hull[end[start < end]] - hull[start[start < end]]
    return np.cross(b - a, c - a), edges


def _support_feature(hull, direction):
    """The vertices farthest along the direction: one, the ends of an edge, or those of a face."""
    heights = hull @ direction
    isFarthest = heights > heights.max() - TIE
    assert all(isFarthest | (heights < heights.max() - MARGIN)), "a vertex almost touches"
    return hull[isFarthest]


def _deepest_point(hull1, hull2, depth, normal):
    """The point of hull 2 that is deepest in hull 1, by the features that touch once apart.

    A vertex b of hull 2 against a face: b. A vertex a of hull 1 against a face: the point of that
    face which comes to lie on a, a − depth n. Two edges, a + s u and b + t w: the point of the
    second that comes to lie on the first, where a + s u = b' + t w with b' = b + depth n. The cross
    product with u leaves (b' − a) × u = t (u × w).
    """
    top, bottom = _support_feature(hull1, normal), _support_feature(hull2, -normal)
    if len(bottom) == 1:
        return bottom[0]
    if len(top) == 1:
        return top[0] - depth * normal
    (a, aEnd), (b, bEnd) = top, bottom
    u, w = aEnd - a, bEnd - b
    common = np.cross(u, w)
    t = np.cross(b + depth * normal - a, u) @ common / (common @ common)
    return b + t * w
