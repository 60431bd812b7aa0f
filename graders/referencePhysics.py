"""Rigid-body physics in extended precision, written apart from the simulation that it judges.

Nothing is imported from RBSFunctions, GJK or Quaternion: the formulas are taken from the
interface's definitions and carried out with fifty digits (`decimalMath`), a body at a time, in the
plainest way. Collisions are found by trying every direction that can matter, not by GJK.

Units are arbitrary but consistent (metres, seconds, kilograms, radians). A vector is a tuple of
three Decimals, an orientation a unit quaternion of four, scalar part first; both in world axes
unless something else is said. Bodies are immutable, and functions return new ones.
"""

from dataclasses import dataclass, replace
from decimal import Decimal

from decimalMath import (
    ONE,
    TWO,
    ZERO,
    add,
    add_matrices,
    apply,
    cross,
    dot,
    identity,
    inverse,
    multiply_quaternions,
    norm,
    normalised,
    outer,
    product,
    quaternion_exponential,
    rotation_matrix,
    scale,
    scale_matrix,
    subtract,
    transpose,
)
from gradingTools import EXACT, RELEASED_2024

GRAVITY = (ZERO, Decimal("-9.8"), ZERO)
DENSITY = ONE

# Two fifty-digit lengths of the size used here (about 10) that agree to this are the same length:
# their rounding errors are near 1e-47, and `MARGIN` keeps different ones a long way apart.
TIE = Decimal("1e-30")

# How clearly a random sample must fall to one side of every decision (collides or not, which
# direction is the shallowest, which bound is violated), so that double precision decides alike.
MARGIN = Decimal("1e-6")


class NotGeneric(Exception):
    """A sample lies so close to a tie that its reference result would be a matter of taste."""


def demand(condition, complaint):
    if not condition:
        raise NotGeneric(complaint)


@dataclass(frozen=True)
class Solid:
    """A body's shape and mass, in its rest axes, with the centre of mass at the origin.

    vertices : tuple of V vectors
    faces : tuple of F triples of indices, anticlockwise seen from outside
    inverseMass : Decimal, 1 / kg
    inverseInertia : 3 × 3, about the centre of mass
    convention : EXACT or RELEASED_2024
    """

    vertices: tuple
    faces: tuple
    inverseMass: Decimal
    inverseInertia: tuple
    convention: str


@dataclass(frozen=True)
class Body:
    """A solid, where it is (its centre of mass, its orientation) and how it moves."""

    solid: Solid
    position: tuple
    orientation: tuple
    linVelocity: tuple = (ZERO, ZERO, ZERO)
    angVelocity: tuple = (ZERO, ZERO, ZERO)

    def carry(self, restPoint):
        """Where the body's motion takes a point given in rest axes."""
        return add(apply(rotation_matrix(self.orientation), restPoint), self.position)

    def world_vertices(self):
        return tuple(self.carry(vertex) for vertex in self.solid.vertices)

    def world_inverse_inertia(self):
        """The inverse inertia tensor in world axes, R I⁻¹ Rᵀ: Rᵀ takes a world vector to rest axes.

        The released reference solution has it the other way round (quirk 2 of the contract).
        """
        rotation = rotation_matrix(self.orientation)
        if self.solid.convention == RELEASED_2024:
            rotation = transpose(rotation)
        return product(product(rotation, self.solid.inverseInertia), transpose(rotation))


def make_solid(vertices, faces, tets, convention=EXACT):
    """The Solid of density DENSITY made of tetrahedra (T, 4) over vertices in any coordinates.

    With D = (b − a) · ((c − a) × (d − a)) > 0, the Jacobian determinant of the map from the unit
    tetrahedron, and S = a + b + c + d, a tetrahedron a, b, c, d has (F. Tonon, "Explicit exact
    formulas for the 3-D tetrahedron inertia tensor", J. Math. Stat. 1, 2005)

        ∫ 1 dV = D/6,    ∫ x dV = D/24 S,    ∫ x xᵀ dV = D/120 (aaᵀ + bbᵀ + ccᵀ + ddᵀ + SSᵀ).

    The second moments C, taken about the centre of mass, give the inertia tensor tr(C) 1 − C.
    """
    determinants = [_determinant([vertices[k] for k in tet]) for tet in tets]
    volume = sum(determinants) / 6
    firstMoment = (ZERO, ZERO, ZERO)
    for tet, determinant in zip(tets, determinants, strict=True):
        for k in tet:
            firstMoment = add(firstMoment, scale(determinant / 24, vertices[k]))
    centre = scale(ONE / volume, firstMoment)
    centred = tuple(subtract(vertex, centre) for vertex in vertices)

    secondMoment = scale_matrix(ZERO, identity())
    for tet, determinant in zip(tets, determinants, strict=True):
        corners = [centred[k] for k in tet]
        total = (ZERO, ZERO, ZERO)
        for corner in corners:
            total = add(total, corner)
        for vector in (*corners, total):
            term = scale_matrix(determinant / 120, outer(vector, vector))
            secondMoment = add_matrices(secondMoment, term)
    trace = sum(secondMoment[k][k] for k in range(3))
    inertia = add_matrices(scale_matrix(trace, identity()), scale_matrix(-ONE, secondMoment))
    if convention == RELEASED_2024:
        # Quirk 1 of the contract: D/6, the volume, stands where D belongs.
        inertia = scale_matrix(ONE / 6, inertia)
    return Solid(
        vertices=centred,
        faces=tuple(tuple(int(k) for k in face) for face in faces),
        inverseMass=ONE / (DENSITY * volume),
        inverseInertia=inverse(scale_matrix(DENSITY, inertia)),
        convention=convention,
    )


def _determinant(corners):
    a, b, c, d = corners
    determinant = dot(subtract(b, a), cross(subtract(c, a), subtract(d, a)))
    demand(determinant > 0, "a tetrahedron is flat or inside out")
    return determinant


def integrate(body, timeStep):
    """The body after one step of semi-implicit Euler: velocity first, then the pose with it.

    The angular velocity, constant over the step, turns the body by |ω| h about ω: the exponential
    of the pure quaternion ω h / 2, from the left as ω is in world axes. Torque-free precession is
    left out, as in the simulation.
    """
    linVelocity = add(body.linVelocity, scale(timeStep, GRAVITY))
    turn = quaternion_exponential(scale(timeStep / TWO, body.angVelocity))
    return replace(
        body,
        position=add(body.position, scale(timeStep, linVelocity)),
        orientation=multiply_quaternions(turn, body.orientation),
        linVelocity=linVelocity,
    )


# ---- Collision of two convex bodies -------------------------------------------------------------


@dataclass(frozen=True)
class Contact:
    """The shallowest overlap of two bodies.

    depth : Decimal > 0, how far body 2 must move along the normal to separate
    normal : unit vector
    point : the point of body 2 deepest inside body 1; point + depth normal is on body 1's surface
    """

    depth: Decimal
    normal: tuple
    point: tuple


def detect_collision(body1, body2):
    """The Contact of two convex bodies, or None where they are apart.

    Moved by t along a unit direction d, body 2 clears body 1 once t reaches their overlap along d,
    max over 1 of a·d − min over 2 of b·d. Bodies are apart when some overlap is negative, and the
    penetration depth is the least overlap of all directions. That overlap is the distance from the
    origin to a supporting plane of the Minkowski difference, so the least one belongs to a face of
    the difference; and those faces come from faces of body 1, faces of body 2, or a pair of edges.
    """
    hull1, hull2 = body1.world_vertices(), body2.world_vertices()
    overlaps = []
    for direction in _candidate_directions(hull1, body1.solid.faces, hull2, body2.solid.faces):
        overlap = _overlap(hull1, hull2, direction)
        if overlap < -MARGIN:
            return None
        overlaps.append((overlap, direction))
    depth, normal = min(overlaps)
    demand(depth > MARGIN, "the bodies only just touch")
    rivals = [overlap for overlap, other in overlaps if dot(other, normal) < ONE - TIE]
    demand(min(rivals) > depth + MARGIN, "two directions are equally shallow")
    point = _deepest_point(hull1, hull2, depth, normal)
    lifted = add(point, scale(depth, normal))
    for place, hull, faces in (
        (point, hull2, body2.solid.faces),
        (lifted, hull1, body1.solid.faces),
    ):
        demand(abs(_height_above(place, hull, faces)) < TIE, "the contact is off the surface")
    return Contact(depth, normal, point)


def _overlap(hull1, hull2, direction):
    return max(dot(a, direction) for a in hull1) - min(dot(b, direction) for b in hull2)


def _candidate_directions(hull1, faces1, hull2, faces2):
    """Yield unit vectors both ways along every face normal and every product of two edges."""
    for hull, faces in ((hull1, faces1), (hull2, faces2)):
        for face in faces:
            normal = _face_normal(hull, face)
            yield from (normal, scale(-ONE, normal))
    for edge1 in _edge_vectors(hull1, faces1):
        for edge2 in _edge_vectors(hull2, faces2):
            common = cross(edge1, edge2)
            demand(norm(common) > MARGIN, "two edges are parallel")
            axis = normalised(common)
            yield from (axis, scale(-ONE, axis))


def _face_normal(hull, face):
    """The outward unit normal of a triangle."""
    a, b, c = (hull[k] for k in face)
    return normalised(cross(subtract(b, a), subtract(c, a)))


def _edge_vectors(hull, faces):
    """A vector along every edge of the triangles, once each.

    The diagonals of flat quadrilaterals are among them. They do no harm: the overlap along any
    direction whatever is at least the depth.
    """
    pairs = {tuple(sorted((face[k - 1], face[k]))) for face in faces for k in range(3)}
    return [subtract(hull[j], hull[i]) for i, j in sorted(pairs)]


def _extremes(hull, direction):
    """The vertices farthest along the direction: one, the ends of an edge, or those of a face."""
    heights = [dot(vertex, direction) for vertex in hull]
    top = max(heights)
    demand(
        all(height > top - TIE or height < top - MARGIN for height in heights),
        "a vertex almost touches",
    )
    return [v for v, height in zip(hull, heights, strict=True) if height > top - TIE]


def _deepest_point(hull1, hull2, depth, normal):
    """The point of hull 2 that lies deepest in hull 1, by what touches once they are apart.

    A vertex b of hull 2 against a face: b. A vertex a of hull 1 against a face: the point of that
    face which comes to lie on a, a − depth n. Two edges, a + s u and b + t w: the point of the
    second that comes to lie on the first, where a + s u = b' + t w with b' = b + depth n. The cross
    product with u leaves (b' − a) × u = t (u × w).
    """
    top, bottom = _extremes(hull1, normal), _extremes(hull2, scale(-ONE, normal))
    if len(top) >= 3 and len(bottom) == 1:
        return bottom[0]
    if len(top) == 1 and len(bottom) >= 3:
        return subtract(top[0], scale(depth, normal))

    demand(len(top) == len(bottom) == 2, "the contact is neither a point nor two crossing edges")
    (a, aEnd), (b, bEnd) = top, bottom
    u, w = subtract(aEnd, a), subtract(bEnd, b)
    offset = subtract(add(b, scale(depth, normal)), a)
    common = cross(u, w)
    t = dot(cross(offset, u), common) / dot(common, common)
    return add(b, scale(t, w))


def _height_above(point, hull, faces):
    """Largest height of the point above a face's plane: 0 on the hull's surface, < 0 inside."""
    return max(dot(subtract(point, hull[face[0]]), _face_normal(hull, face)) for face in faces)


def resolve_collision(body1, body2, contact, restitution):
    """Both bodies, moved apart and with the impulse of the contact applied.

    Each moves by its share of the depth, w_i = m_i⁻¹ / (m_1⁻¹ + m_2⁻¹), body 1 against the normal
    and body 2 along it. An impulse j n on body 2 and −j n on body 1 at the point p changes the
    velocity of p on body i, v_i = linVelocity_i + ω_i × r_i with r_i = p − COM_i, so that
    (v_1 − v_2)·n falls by j k, where

        k = m_1⁻¹ + m_2⁻¹ + (r_1 × n)ᵀ I_1⁻¹ (r_1 × n) + (r_2 × n)ᵀ I_2⁻¹ (r_2 × n).

    It must become −restitution times itself: j = (1 + restitution) (v_1 − v_2)·n / k.
    """
    normal = contact.normal
    totalInverseMass = body1.solid.inverseMass + body2.solid.inverseMass
    share1, share2 = (body.solid.inverseMass / totalInverseMass for body in (body1, body2))
    body1 = _moved(body1, scale(-share1 * contact.depth, normal))
    body2 = _moved(body2, scale(share2 * contact.depth, normal))
    point = add(contact.point, scale(share2 * contact.depth, normal))

    effectiveInverseMass = totalInverseMass
    for body in (body1, body2):
        lever = cross(subtract(point, body.position), normal)
        effectiveInverseMass += dot(lever, apply(body.world_inverse_inertia(), lever))
    closing = dot(subtract(_velocity_at(body1, point), _velocity_at(body2, point)), normal)
    impulse = scale((ONE + restitution) * closing / effectiveInverseMass, normal)
    return _pushed(body1, scale(-ONE, impulse), point), _pushed(body2, impulse, point)


def _moved(body, displacement):
    return replace(body, position=add(body.position, displacement))


def _velocity_at(body, point):
    return add(body.linVelocity, cross(body.angVelocity, subtract(point, body.position)))


def _pushed(body, impulse, point):
    """The body after an impulse (N s) at a point: Δv = m⁻¹ P, Δω = I⁻¹ (r × P)."""
    angularImpulse = cross(subtract(point, body.position), impulse)
    return replace(
        body,
        linVelocity=add(body.linVelocity, scale(body.solid.inverseMass, impulse)),
        angVelocity=add(body.angVelocity, apply(body.world_inverse_inertia(), angularImpulse)),
    )


# ---- Distance constraints -----------------------------------------------------------------------


def resolve_position_constraint(bodies, points, bound, isUpper, tolerance):
    """Project two bodies onto C = |p_1 − p_2| − bound = 0 where they violate C ≤ 0 (or C ≥ 0).

    Returns (wasValid, bodies). The bodies are shifted, not turned: with n = (p_1 − p_2)/|p_1 − p_2|
    and shares w_i of the inverse mass, COM_1 −= w_1 C n and COM_2 += w_2 C n take up C together.
    """
    body1, body2 = bodies
    gap = subtract(*points)
    excess = norm(gap) - bound
    limit = tolerance if isUpper else -tolerance
    demand(abs(excess - limit) > MARGIN, "a bound is violated by the tolerance exactly")
    if (excess < limit) == isUpper:
        return True, bodies

    totalInverseMass = body1.solid.inverseMass + body2.solid.inverseMass
    shift = scale(excess / (norm(gap) * totalInverseMass), gap)
    return False, (
        _moved(body1, scale(-body1.solid.inverseMass, shift)),
        _moved(body2, scale(body2.solid.inverseMass, shift)),
    )


def resolve_velocity_constraint(bodies, points, tolerance):
    """Project two bodies' velocities onto J v = 0, the rate at which |p_1 − p_2| changes.

    Returns (wasValid, bodies). J = [n, r_1 × n, −n, −(r_2 × n)], as n·v_i of a point is
    n·linVelocity_i + (r_i × n)·ω_i; and Δv = −M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ J v is the least change, in
    kinetic energy, that brings J v to zero: an impulse −λ n at p_1 and λ n at p_2 with
    λ = J v / (J M⁻¹ Jᵀ).
    """
    normal = normalised(subtract(*points))
    rate, inverseMass = ZERO, ZERO
    for sign, body, point in zip((ONE, -ONE), bodies, points, strict=True):
        lever = cross(subtract(point, body.position), normal)
        rate += sign * (dot(normal, body.linVelocity) + dot(lever, body.angVelocity))
        inverseMass += body.solid.inverseMass + dot(
            lever, apply(body.world_inverse_inertia(), lever)
        )
    if abs(rate) <= tolerance:
        demand(rate == 0, "a velocity is nearly, not quite, valid")
        return True, bodies
    demand(abs(rate) > tolerance + MARGIN, "a velocity is nearly, not quite, valid")

    impulse = scale(rate / inverseMass, normal)
    return False, (
        _pushed(bodies[0], scale(-ONE, impulse), points[0]),
        _pushed(bodies[1], impulse, points[1]),
    )
