"""Springs: soft bounds of the soft step, as impulses.

A bound that is violated by C, with the speed u at which C grows and the effective mass m, is a
spring and damper of angular frequency ω and damping ratio ζ. Integrated implicitly over a substep
h, that is the impulse

    λ ← s (λ - m (u + β C)),   s = a₂/(1 + a₂),   β = ω/a₁,   a₁ = 2 ζ + h ω,   a₂ = h ω a₁:

Catto: Soft Constraints. Game Developers Conference 2011.

A load F violates the bound by F / (m ω²). As ω is relative to the frequency of the substeps, that
is a length in proportion to h²: with another h, bodies at rest would be thrown back, or drop, by
the difference. That becomes the bound's offset: it acts on violations beyond it, or, where it is
negative, before there are any.
"""

import math

import numpy as np


class Spring:
    """A soft bound with the frequency in units of the substeps' (1/h) and the damping ratio.

    h : s; rate : 1/s, β; softness : s
    """

    def __init__(self, frequency, damping, h):
        self.h = h
        self._angle = 2.0 * math.pi * frequency  # h ω
        a1 = 2.0 * damping + self._angle
        a2 = self._angle * a1
        self.rate, self.softness = self._angle / (h * a1), a2 / (1.0 + a2)

    def ratios(self, substep):
        """h over the lengths of substeps before, (M,); 1 where there have been none, which is 0."""
        isKnown = substep > 0.0
        return np.where(isKnown, self.h / np.where(isKnown, substep, self.h), 1.0)

    def converted(self, offset, impulse, mass, violation, ratio):
        """Offsets for substeps that are `ratio` times as long.

        impulse : of the bounds, in the last substep, and violation : of them. By either they have
            given way: in motion these differ, and the smaller one is a load's
        """
        stiffness = self._angle**2 * mass * ratio / self.h  # m ω² h, of those substeps
        give = impulse / np.where(stiffness > 0.0, stiffness, np.inf)
        give = np.minimum(give, np.maximum(violation - offset, 0.0))
        return offset + (give - ratio * give * ratio)


def lasting(offset, violation):
    """What is left of offsets where bounds are violated by so much, negative where they are apart.

    They end with the load: what is no longer violated has none, and none holds bodies apart.
    """
    held = np.minimum(np.maximum(offset, offset - violation), 0.0)
    return np.where(offset > 0.0, np.minimum(offset, np.maximum(violation, 0.0)), held)
