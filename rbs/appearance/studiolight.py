"""Light of studio pictures: a sun, a sky, and what ground and bodies send back.

All light comes from some hundred lamps far away: parts of the sun's disc, of the sky, and of the
ground below. The map of a lamp (`rbs.pictures.studio`) contains the face that its light meets
first. It reaches a point unless that face belongs to another body, and lies in front of the point.
No rays need tracing, and a convex body does not shade itself.

Light is linear, in units in which white paper in the open has about 2, and reflection is diffuse.
Arrays of points, vectors and colours are (3, m), in single precision. Units: metres.
"""

import math

import numpy as np

from rbs.appearance.drawables import CREASE_ANGLE, SUN
from rbs.geometry.triples import dot

# Angle of the sun's disc, in radians. A wider disc makes softer shadows.
SUN_ANGLE = math.radians(2.0)
# Irradiance of the sun, and radiance of the sky at the zenith and at the horizon (r, g, b).
SUN_LIGHT = 5.6 * np.array([1.0, 0.945, 0.86])
ZENITH, HORIZON = np.array([0.44, 0.54, 0.72]), np.array([0.58, 0.59, 0.60])
# Reflectance of the ground.
GROUND = np.array([0.54, 0.524, 0.50])
# Mean irradiance of what blocks a lamp, and of the ground near bodies, as fractions of that of
# ground in the open. More is brighter between bodies, and on their lower sides.
BETWEEN_BODIES, BELOW_BODIES = 0.3, 0.65
# Reflectance of a body's gloss, seen head-on, and sharpness of the sun's reflection.
GLOSS, SHININESS = 0.04, 64
# Least cosine between normal and camera. Less makes outlines white.
LEAST_FACING = 0.15
# Angle in radians from each direction to the next, which spreads any number of them evenly.
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
# Cosine of the angle between faces beyond which they look like two.
CREASE_COSINE = math.cos(CREASE_ANGLE)


def spread(count):
    """Places evenly on the unit disc, as squared radius and angle, each (count,)."""
    k = np.arange(count)
    return (k + 0.5) / count, GOLDEN_ANGLE * k


def hemisphere(count):
    """`count` directions (n, 3) of equal solid angle upwards; every n-th are spread evenly, too."""
    y, angle = spread(count)
    across = np.sqrt(1.0 - y * y)
    return np.stack([across * np.cos(angle), y, across * np.sin(angle)], axis=1)


def sun_disc(count):
    """`count` directions (n, 3) of equal solid angle towards the sun's disc."""
    square, angle = spread(count)
    side = np.cross(SUN, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    x, y = math.tan(0.5 * SUN_ANGLE) * np.sqrt(square) * [np.cos(angle), np.sin(angle)]
    towards = SUN + x[:, None] * side + y[:, None] * np.cross(side, SUN)
    return towards / np.linalg.norm(towards, axis=1, keepdims=True)


def sky_radiance(height):
    """Radiance (n, 3) of the sky at these sines of elevation (n,)."""
    share = np.sqrt(height)[:, None]
    return (1.0 - share) * HORIZON + share * ZENITH


# Irradiance of the ground by the sky, and by sky and sun, in the open.
_SKY = hemisphere(1024)[:, 1]
OPEN_SKY = math.tau * np.mean(_SKY[:, None] * sky_radiance(_SKY), axis=0)
OPEN = OPEN_SKY + SUN[1] * SUN_LIGHT


class Faces:
    """The faces of a scene and, as face 0, the ground.

    plane (4, F + 1) : plane[:3] · x - plane[3] is the height of x above the face
    body (F + 1,) : the body of each, or `ground`, which is the number of bodies
    albedo (3, n + 1) : linear reflectance of the bodies and the ground
    """

    def __init__(self, corners, normals, bodyOfFace, albedo):
        """corners, normals : (F, 3, 3), places and normals at the corners; albedo : (n, 3)"""
        edges = np.roll(corners, -1, axis=1) - corners
        across = np.cross(edges[:, 0], edges[:, 1])
        area = np.maximum(np.linalg.norm(across, axis=1, keepdims=True), np.finfo(float).tiny)
        normal = across / area
        height = np.sum(normal * corners[:, 0], axis=1, keepdims=True)
        self.plane = _with_ground(np.concatenate([normal, height], axis=1), [0, 1, 0, 0])
        self.ground = len(albedo)
        self.body = np.insert(bodyOfFace, 0, self.ground).astype(np.int32)
        self.albedo = np.concatenate([albedo, [GROUND]]).T.astype(np.float32)
        # the weight of a corner grows from 0 on the opposite edge to 1 there
        growth = np.cross(normal[:, None], np.roll(edges, -1, axis=1)) / area[:, None]
        rest = 1.0 - np.sum(growth * corners, axis=2, keepdims=True)
        smooth = np.einsum("fki,fkj->fij", normals, np.concatenate([growth, rest], axis=2))
        ground = [0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0]
        self._smooth = _with_ground(smooth.reshape(-1, 12), ground).reshape(3, 4, -1)

    def normals(self, number, x):
        """Unit normals (3, m) of the smooth surface at points x (3, m) of faces `number` (m,)."""
        table = self._smooth.take(number, axis=2)
        return unit(np.stack([dot(row, x) + row[3] for row in table]))

    def are_alike(self, number, other):
        """Whether faces look like one surface: those of a body, without a crease between them."""
        cosine = dot(self.plane[:3].take(number, axis=1), self.plane[:3].take(other, axis=1))
        return (self.body.take(number) == self.body.take(other)) & (cosine > CREASE_COSINE)


def _with_ground(rows, ground):
    return np.concatenate([[ground], rows]).T.astype(np.float32)


def unit(vectors):
    """Unit vectors of (3, m)."""
    return vectors / np.sqrt(dot(vectors, vectors))


class Lamp:
    """Light from far away, in one direction.

    towards (3,) : unit; angle : solid angle that it stands for; radiance (3,); all float32
    """

    def __init__(self, towards, angle, radiance):
        parts = towards, angle, radiance
        self.towards, self.angle, self.radiance = (np.asarray(one, np.float32) for one in parts)

    def set_map(self, numbers, toPixels):
        """numbers : (n, n), of the faces that light meets first; toPixels : (2, 4), from a point
        (x, 1) to its row and column
        """
        self._numbers, self._size = numbers.ravel(), len(numbers)
        self._toPixels = toPixels.astype(np.float32)

    def blockers(self, faces, x, body, gap):
        """Bodies (m,) that block the light at points x (3, m) of bodies (m,); the ground for none.

        gap : m, least distance of a face in front of a point that it shades
        """
        row, column = (
            np.clip(dot(one, x) + one[3], 0.0, self._size - 1.0).astype(np.int32)
            for one in self._toPixels
        )
        number = self._numbers.take(row * self._size + column)
        blocker = faces.body.take(number)
        some = np.flatnonzero((number > 0) & (blocker != body))
        plane = faces.plane.take(number.take(some), axis=1)
        some = some[plane[3] - dot(plane, x.take(some, axis=1)) > gap]
        result = np.full(x.shape[1], faces.ground)
        result[some] = blocker.take(some)
        return result


class Light:
    """The lamps of a scene. sun, around : lists of Lamps, of the sun, and of sky and ground"""

    def __init__(self, faces, counts, gap, hasGround=True):
        """counts : dict of the numbers of lamps; gap : see `Lamp.blockers`

        hasGround : whether there is ground below, or else more of the sky at the horizon
        """
        self._faces, self._gap = faces, gap
        sky, below = hemisphere(counts["sky"]), hemisphere(counts["below"]) * [1.0, -1.0, 1.0]
        self.sun = [Lamp(towards, 0.0, SUN_LIGHT) for towards in sun_disc(counts["sun"])]
        self.around = [
            Lamp(towards, math.tau / len(sky), radiance)
            for towards, radiance in zip(sky, sky_radiance(sky[:, 1]), strict=True)
        ]
        ground = BELOW_BODIES / math.pi * GROUND * OPEN if hasGround else HORIZON
        self.around += [Lamp(towards, math.tau / len(below), ground) for towards in below]
        # radiance of each body
        sent = BETWEEN_BODIES / math.pi * OPEN[:, None] * faces.albedo[:, :-1]
        self._sent = sent.astype(np.float32)

    def sunlight(self, x, normal, body):
        """Visible fraction (m,) of the sun at points x (3, m) of bodies (m,)."""
        result = np.zeros(x.shape[1], dtype=np.float32)
        some = np.flatnonzero(dot(normal, self.sun[0].towards) > 0.0)
        own = self._faces, x.take(some, axis=1), body.take(some), self._gap
        free = sum(lamp.blockers(*own) == self._faces.ground for lamp in self.sun)
        result[some] = free / len(self.sun)
        return result

    def skylight(self, x, normal, body, first=0, stride=1):
        """Irradiance (3, m) of points by sky, ground and bodies; arguments as for `sunlight`.

        first, stride : use every stride-th lamp from the first on
        """
        light = np.zeros(x.shape, dtype=np.float32)
        total = np.full(x.shape[1], 1e-6, dtype=np.float32)
        for lamp in self.around[first::stride]:
            weight = lamp.angle * np.maximum(dot(normal, lamp.towards), 0.0)
            total += weight
            some = np.flatnonzero(weight)
            points = x.take(some, axis=1)
            blocker = lamp.blockers(self._faces, points, body.take(some), self._gap)
            sent = np.concatenate([self._sent, lamp.radiance[:, None]], axis=1)
            light[:, some] += weight.take(some) * sent.take(blocker, axis=1)
        return math.pi * light / total


def sun_times(share):
    """Irradiance (3, ...) by shares (...) of the sun's light."""
    return np.multiply.outer(SUN_LIGHT.astype(np.float32), share)


def shaded(albedo, normal, sunlight, skylight):
    """Light (3, ...) that surfaces reflect diffusely. sunlight, skylight : as of `Light`"""
    cosine = np.maximum(dot(normal, SUN.astype(np.float32)), 0.0)
    return albedo * (sun_times(cosine * sunlight) + skylight) / np.float32(math.pi)


def gloss(normal, ray, sunlight, skylight):
    """Light (3, ...) that surfaces mirror towards the camera, along -ray (3, ...)."""
    sun = SUN.astype(np.float32)
    half = unit(np.stack([sun[k] - ray[k] for k in range(3)]))
    shine = np.maximum(dot(normal, half), 0.0) ** SHININESS
    shine *= GLOSS * (SHININESS + 8.0) / (8.0 * math.pi) * np.maximum(dot(normal, sun), 0.0)
    grazing = 1.0 - np.clip(-dot(normal, ray), LEAST_FACING, 1.0)
    fresnel = GLOSS + (1.0 - GLOSS) * grazing**5  # Schlick's
    return sun_times(shine * sunlight) + np.float32(0.5 / math.pi) * fresnel * skylight
