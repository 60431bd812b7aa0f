"""Springs: soft bounds of the soft step, as impulses.

Let a bound be violated by C, let u be the speed at which C grows, and m the effective mass. The
bound acts as a spring and damper with the angular frequency ω and the damping ratio ζ. Implicit
integration over a substep h gives the impulse

    λ ← s (λ - m (u + β C)),   s = a₂/(1 + a₂),   β = ω/a₁,   a₁ = 2 ζ + h ω,   a₂ = h ω a₁

(Catto: Soft Constraints. Game Developers Conference 2011).

A load F violates the bound by F / (m ω²). As ω is relative to the substep frequency, this length is
proportional to h². Without compensation, a change of h would throw bodies at rest upwards or drop
them by the difference. The difference therefore becomes an offset of the bound, which then acts
only on the violation beyond it or, if it is negative, even before there is a violation.
"""

import math

import numpy as np


class Spring:
    """Soft bound with a frequency in units of the substep frequency 1/h, and a damping ratio.

    h : s; rate : β, 1/s; softness : s, dimensionless
    """

    def __init__(self, frequency, damping, h):
        self.h = h
        self._angle = 2.0 * math.pi * frequency  # h ω
        a1 = 2.0 * damping + self._angle
        a2 = self._angle * a1
        self.rate, self.softness = self._angle / (h * a1), a2 / (1.0 + a2)

    def converted(self, offset, impulse, mass, violation, ratio):
        """Returns the offsets for substeps that have become `ratio` times as long.

        impulse : of the bounds in the last substep; violation : of the bounds. Each implies a
            displacement; in motion the two differ, and the smaller one is due to the load
        """
        stiffness = self._angle**2 * mass * ratio / self.h  # m ω² h of the earlier substeps
        give = impulse / np.where(stiffness > 0.0, stiffness, np.inf)
        give = np.minimum(give, np.maximum(violation - offset, 0.0))
        return offset + give * (1.0 - ratio * ratio)


def lasting(offset, violation):
    """Returns the offsets that remain at these violations (negative: separations).

    A positive one is at most the violation; a negative one shrinks by the separation.
    """
    return np.minimum(offset - np.minimum(violation, 0.0), np.maximum(violation, 0.0))
