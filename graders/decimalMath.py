"""Vectors, matrices and quaternions of `decimal.Decimal`, for the reference data only.

Fifty digits leave thirty-odd to spare beyond a double, so that a reference result is the double
nearest to the true value of the formula, however its terms cancel. Nothing here is shared with the
simulation: an error in Quaternion.py cannot be repeated in the data that it is graded against.

A vector is a tuple of three Decimals, a quaternion one of four, scalar part first, and a matrix a
tuple of three rows. All lengths, angles (radians) and so on are plain numbers without units.
"""

from decimal import Context, Decimal, localcontext

DIGITS = 50
ZERO = Decimal(0)
ONE = Decimal(1)
TWO = Decimal(2)

# A series is summed until a term falls below this: it is then five digits under the last digit
# kept of a sum near one, and so are all the later terms together.
NEGLIGIBLE = Decimal(10) ** -(DIGITS + 5)


def extended_precision():
    """A context manager within which Decimal arithmetic carries DIGITS digits."""
    return localcontext(Context(prec=DIGITS))


def exact(numbers):
    """A tuple of Decimals equal, digit for digit, to the doubles (n,) given."""
    return tuple(Decimal(float(number)) for number in numbers)


def add(a, b):
    return tuple(x + y for x, y in zip(a, b, strict=True))


def subtract(a, b):
    return tuple(x - y for x, y in zip(a, b, strict=True))


def scale(factor, a):
    return tuple(factor * x for x in a)


def dot(a, b):
    return sum((x * y for x, y in zip(a, b, strict=True)), ZERO)


def cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def norm(a):
    return dot(a, a).sqrt()


def normalised(a):
    return scale(ONE / norm(a), a)


def outer(a, b):
    """The matrix a bᵀ."""
    return tuple(scale(x, b) for x in a)


def identity():
    return ((ONE, ZERO, ZERO), (ZERO, ONE, ZERO), (ZERO, ZERO, ONE))


def add_matrices(a, b):
    return tuple(add(rowA, rowB) for rowA, rowB in zip(a, b, strict=True))


def scale_matrix(factor, a):
    return tuple(scale(factor, row) for row in a)


def transpose(a):
    return tuple(zip(*a, strict=True))


def apply(matrix, vector):
    return tuple(dot(row, vector) for row in matrix)


def product(a, b):
    """The matrix a b."""
    columns = transpose(b)
    return tuple(tuple(dot(row, column) for column in columns) for row in a)


def inverse(a):
    """The inverse of a matrix with rows a, b, c: columns b × c, c × a, a × b over a · (b × c)."""
    columns = (cross(a[1], a[2]), cross(a[2], a[0]), cross(a[0], a[1]))
    return scale_matrix(ONE / dot(a[0], columns[0]), transpose(columns))


def multiply_quaternions(a, b):
    """The Hamilton product a ∘ b: (s, u)(t, v) = (s t − u·v, s v + t u + u × v)."""
    (s, *u), (t, *v) = a, b
    vectorPart = add(add(scale(s, v), scale(t, u)), cross(u, v))
    return (s * t - dot(u, v), *vectorPart)


def rotation_matrix(q):
    """The matrix R with R v = q v q⁻¹, for a unit quaternion q = (s, u).

    R = (s² − |u|²) 1 + 2 u uᵀ + 2 s [u]×, where [u]× v = u × v.
    """
    s, *u = q
    x, y, z = u
    crossMatrix = ((ZERO, -z, y), (z, ZERO, -x), (-y, x, ZERO))
    symmetric = add_matrices(
        scale_matrix(s * s - dot(u, u), identity()), scale_matrix(TWO, outer(u, u))
    )
    return add_matrices(symmetric, scale_matrix(TWO * s, crossMatrix))


def cosine_and_sinc(squaredAngle):
    """(cos a, sin a / a) from a², by their power series

        cos a = Σ (−a²)ᵏ / (2k)!,    sin a / a = Σ (−a²)ᵏ / (2k + 1)!,

    which hold at a = 0 too. Angles stay below about 4 here, where no term exceeds 4⁴/4! ≈ 11: the
    cancellation costs about one digit of the fifty.
    """
    cosine, sinc = ZERO, ZERO
    term, factor = ONE, 0
    while abs(term) > NEGLIGIBLE:
        cosine += term
        sinc += term / (factor + 1)
        term *= -squaredAngle / ((factor + 1) * (factor + 2))
        factor += 2
    return cosine, sinc


def quaternion_exponential(v):
    """exp([0, v]) = [cos |v|, v sin |v| / |v|] for a vector v; the unit quaternion 1 at v = 0."""
    cosine, sinc = cosine_and_sinc(dot(v, v))
    return (cosine, *scale(sinc, v))
