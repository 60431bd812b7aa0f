"""Springs: soft bounds of the soft step, as impulses.

Let a bound be violated by C, let u be the speed at which C grows, and m the effective mass. The
bound acts as a spring and damper with the angular frequency ω and the damping ratio ζ. Implicit
integration over a substep h gives the impulse

    λ ← s (λ - m (u + β C)),   s = a₂/(1 + a₂),   β = ω/a₁,   a₁ = 2 ζ + h ω,   a₂ = h ω a₁

(Catto: Soft Constraints. Game Developers Conference 2011).
"""

import math


class Spring:
    """Soft bound with a frequency in units of the substep frequency 1/h, and a damping ratio.

    h : s; rate : β, 1/s; softness : s, dimensionless
    """

    def __init__(self, frequency, damping, h):
        self.h, angle = h, 2.0 * math.pi * frequency  # h ω
        a1 = 2.0 * damping + angle
        a2 = angle * a1
        self.rate, self.softness = angle / (h * a1), a2 / (1.0 + a2)
