"""Rigid-body physics in 50 decimal digits, written apart from the simulation that it judges.

Nothing is imported from RBSFunctions, GJK or Quaternion, so none of their errors is repeated here.
The formulas are those of the interface's definitions, in their plainest form. More than thirty of
the digits are beyond a double's: a result, rounded once at the end, is the double nearest to the
formula's true value, however its terms cancel.

Vectors and matrices are NumPy arrays of mpmath's numbers. Orientations are unit quaternions (4,),
scalar part first. Everything is in world axes unless stated otherwise, in m, s, kg and radians.
Bodies are immutable, and functions return new ones.
"""

import sys
from dataclasses import dataclass, replace

import numpy as np

try:
    from mpmath import mp
except ModuleNotFoundError:
    sys.exit("make_reference.py needs mpmath: pip install mpmath")

from reference.graderData import RELEASED_2024

mp.dps = 50

# Convert numbers to 50 digits, doubles exactly; and take square roots, of arrays as well.
exact = np.frompyfunc(mp.mpf, 1, 1)
sqrt = np.frompyfunc(mp.sqrt, 1, 1)

ZERO = exact([0, 0, 0])
GRAVITY = exact(["0", "-9.8", "0"])

# Difference, in m, below which lengths are equal; their rounding errors are near 1e-48.
TIE = exact("1e-30")

# Least distance of a random sample, in m or m/s, from every decision (whether bodies collide, which
# direction is the shallowest, which bound is violated), so that double precision decides alike. If
# an assertion fails, another seed is needed.
MARGIN = exact("1e-6")


def unit(vectors):
    """Vectors divided by their lengths."""
    return vectors / sqrt((vectors * vectors).sum(axis=-1, keepdims=True))


def multiply_quaternions(a, b):
    """The Hamilton product a ∘ b: (s, u)(t, v) = (s t − u·v, s v + t u + u × v)."""
    (s, u), (t, v) = (a[0], a[1:]), (b[0], b[1:])
    return np.array([s * t - u @ v, *(s * v + t * u + np.cross(u, v))])


def rotation_matrix(q):
    """The matrix R with R v = q v q⁻¹, for a unit quaternion q = (s, u).

    R = (s² − |u|²) 1 + 2 u uᵀ + 2 s [u]×, where [u]× v = u × v has the rows e_k × u.
    """
    s, u = q[0], q[1:]
    return (s * s - u @ u) * np.eye(3) + 2 * np.outer(u, u) + 2 * s * np.cross(np.eye(3), u)


@dataclass(frozen=True)
class Body:
    """A body of density 1: its shape and mass in rest axes, its pose and its velocities."""

    vertices: np.ndarray  # (V, 3), in rest axes, with the centre of mass at the origin
    faces: np.ndarray  # (F, 3), indices, anticlockwise seen from outside
    inverseMass: mp.mpf
    inverseInertia: np.ndarray  # (3, 3), about the centre of mass, in rest axes
    convention: str  # EXACT or RELEASED_2024
    position: np.ndarray  # (3,), of the centre of mass
    orientation: np.ndarray  # (4,)
    linVelocity: np.ndarray  # (3,)
    angVelocity: np.ndarray  # (3,)

    def carry(self, restPoints):
        """The world coordinates of points (..., 3) given in rest axes."""
        return restPoints @ rotation_matrix(self.orientation).T + self.position

    def world_inverse_inertia(self):
        """The inverse inertia tensor in world axes, R I⁻¹ Rᵀ: Rᵀ takes a vector to rest axes."""
        R = rotation_matrix(self.orientation)
        if self.convention == RELEASED_2024:
            R = R.T  # Quirk 2 of the contract: turned the wrong way round.
        return R @ self.inverseInertia @ R.T


def make_body(vertices, faces, tets, convention):
    """Makes a Body of tetrahedra (T, 4) over vertices (V, 3), unturned, at rest at the origin.

    With D = (b − a) · ((c − a) × (d − a)) > 0, the Jacobian determinant of the map from the unit
    tetrahedron, and S = a + b + c + d, a tetrahedron a, b, c, d has (F. Tonon, "Explicit exact
    formulas for the 3-D tetrahedron inertia tensor", J. Math. Stat. 1, 2005)

        ∫ 1 dV = D/6,    ∫ x dV = D/24 S,    ∫ x xᵀ dV = D/120 (aaᵀ + bbᵀ + ccᵀ + ddᵀ + SSᵀ).

    The second moments C, taken about the centre of mass, give the inertia tensor tr(C) 1 − C.
    """
    corners = vertices[tets]
    determinants = np.array([(b - a) @ np.cross(c - a, d - a) for a, b, c, d in corners])
    volume = determinants.sum() / 6
    centre = determinants @ corners.sum(axis=1) / (24 * volume)

    secondMoment = 0
    for D, abcd in zip(determinants, corners - centre, strict=True):
        S = abcd.sum(axis=0)
        secondMoment = secondMoment + D / 120 * (abcd.T @ abcd + np.outer(S, S))
    inertia = np.trace(secondMoment) * np.eye(3) - secondMoment
    if convention == RELEASED_2024:
        # Quirk 1 of the contract: D/6, the volume, instead of D.
        inertia = inertia / 6
    inverseInertia = np.array(mp.inverse(mp.matrix(inertia.tolist())).tolist())
    shape = vertices - centre, faces, 1 / volume, inverseInertia, convention
    return Body(*shape, ZERO, exact([1, 0, 0, 0]), ZERO, ZERO)


def integrate(body, timeStep):
    """The body after one step of semi-implicit Euler: velocity first, then the pose with it.

    The angular velocity, constant over the step, turns the body by |ω| h about ω: with v = ω h / 2,
    by the quaternion exp([0, v]) = [cos |v|, v sin |v| / |v|], from the left as ω is in world axes.
    Torque-free precession is omitted, as in the simulation.
    """
    linVelocity = body.linVelocity + timeStep * GRAVITY
    v = timeStep / 2 * body.angVelocity
    turn = np.array([mp.cos(sqrt(v @ v)), *(mp.sinc(sqrt(v @ v)) * v)])
    pose = {"position": body.position + timeStep * linVelocity}
    pose["orientation"] = multiply_quaternions(turn, body.orientation)
    return replace(body, **pose, linVelocity=linVelocity)


def detect_collision(body1, body2):
    """Returns the contact (7,) of two convex bodies, [depth, *normal, *point], or None.

    depth > 0 is the distance that body 2 must move along the unit normal to separate; the point is
    that of body 2 deepest inside body 1, and point + depth normal is on body 1's surface.

    Moved by t along a unit direction d, body 2 clears body 1 once t reaches their overlap along d,
    max over 1 of a·d − min over 2 of b·d. Bodies are apart when some overlap is negative, and the
    penetration depth is the least overlap of all directions. That overlap is the distance from the
    origin to a supporting plane of the Minkowski difference, so the least one belongs to a face of
    the difference; and those faces come from faces of body 1, faces of body 2, or a pair of edges.
    """
    (hull1, normals1, edges1), (hull2, normals2, edges2) = _features(body1), _features(body2)
    crossed = np.cross(edges1[:, None], edges2).reshape(-1, 3)
    axes = unit(np.vstack([normals1, normals2, crossed]))
    heights1, heights2 = axes @ hull1.T, axes @ hull2.T
    along = heights1.max(axis=1) - heights2.min(axis=1)
    against = heights2.max(axis=1) - heights1.min(axis=1)
    directions, overlaps = np.vstack([axes, -axes]), np.concatenate([along, against])

    depth, normal = overlaps.min(), directions[overlaps.argmin()]
    assert abs(depth) > MARGIN, "the bodies only just touch"
    if depth < 0:
        return None
    others = overlaps[directions @ normal < 1 - TIE]
    assert others.min() > depth + MARGIN, "two directions are equally shallow"
    return np.hstack([depth, normal, _deepest_point(hull1, hull2, depth, normal)])


def _features(body):
    """World vertices, outward face normals and edge vectors of a body, the last two of any length.

    Of the two triangles at an edge, one runs along it towards the larger index. Diagonals of flat
    quadrilaterals count as edges, which does no harm: no direction's overlap is below the depth.
    """
    hull = body.carry(body.vertices)
    a, b, c = hull[body.faces.T]
    start, end = body.faces.ravel(), np.roll(body.faces, -1, axis=1).ravel()
    edges = hull[end[start < end]] - hull[start[start < end]]
    return hull, np.cross(b - a, c - a), edges


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


def move_apart(bodies, displacement):
    """Moves body 1 against the displacement and body 2 along it.

    Their shares m_i⁻¹ / (m_1⁻¹ + m_2⁻¹) keep the common centre of mass in place.
    """
    body1, body2 = bodies
    shift = displacement / (body1.inverseMass + body2.inverseMass)
    moved1 = replace(body1, position=body1.position - body1.inverseMass * shift)
    return moved1, replace(body2, position=body2.position + body2.inverseMass * shift)


def apply_impulse(bodies, points, normal, restitution):
    """Applies an impulse of a contact or constraint: −λ n to body 1 at p_1, λ n to body 2 at p_2.

    Returns (J v before, bodies afterwards). With r_i = p_i − COM_i and both bodies' velocities,

        J = [n, r_1 × n, −n, −(r_2 × n)],    v = [linVelocity_1, ω_1, linVelocity_2, ω_2],

    J v is the velocity of p_1 relative to p_2 along n, as n·(ω × r) = (r × n)·ω. The impulse
    changes v by −M⁻¹ Jᵀ λ and J v by −k λ, with

        k = J M⁻¹ Jᵀ = m_1⁻¹ + m_2⁻¹ + (r_1 × n)ᵀ I_1⁻¹ (r_1 × n) + (r_2 × n)ᵀ I_2⁻¹ (r_2 × n).

    J v must become −restitution times itself: λ = (1 + restitution) J v / k.
    """
    ends = []
    for n, body, point in zip((normal, -normal), bodies, points, strict=True):
        arm = np.cross(point - body.position, n)
        ends.append((body, n, arm, body.world_inverse_inertia() @ arm))
    rate = sum(n @ body.linVelocity + arm @ body.angVelocity for body, n, arm, _ in ends)
    k = sum(body.inverseMass + arm @ turn for body, _, arm, turn in ends)
    impulse = (1 + restitution) * rate / k
    changed = []
    for body, n, _, turn in ends:
        linVelocity = body.linVelocity - impulse * body.inverseMass * n
        angVelocity = body.angVelocity - impulse * turn
        changed.append(replace(body, linVelocity=linVelocity, angVelocity=angVelocity))
    return rate, changed


def resolve_collision(bodies, contact, restitution):
    """Moves both bodies apart, then applies the impulse at the point, which moves with body 2."""
    depth, normal, point = contact[0], contact[1:4], contact[4:]
    parted = move_apart(bodies, depth * normal)
    point = point + parted[1].position - bodies[1].position
    return apply_impulse(parted, (point, point), normal, restitution)[1]


def resolve_position_constraint(bodies, points, bound, isUpper, tolerance):
    """Projects two bodies onto C = |p_1 − p_2| − bound = 0 if they violate C ≤ 0 (or C ≥ 0).

    Returns (wasValid, bodies). The bodies move along p_1 − p_2, and do not turn.
    """
    gap = points[0] - points[1]
    C = sqrt(gap @ gap) - bound
    limit = tolerance if isUpper else -tolerance
    assert abs(C - limit) > MARGIN, "a bound is all but violated"
    wasValid = (C < limit) == isUpper
    return wasValid, bodies if wasValid else move_apart(bodies, C * unit(gap))


def resolve_velocity_constraint(bodies, points, tolerance):
    """Projects two bodies' velocities onto J v = 0; J v is the rate of change of |p_1 − p_2|.

    Returns (wasValid, bodies). The impulse is the change to J v = 0 of least kinetic energy.
    """
    rate, bodies = apply_impulse(bodies, points, unit(points[0] - points[1]), restitution=0)
    assert rate == 0 or abs(rate) > tolerance + MARGIN, "a velocity is all but valid"
    return rate == 0, bodies
