"""Colours of bodies, by one of their properties, and of everything else: (r, g, b) from 0 to 1."""

import math
from typing import NamedTuple

import numpy as np

BACKGROUND = (0.62, 0.70, 0.80)
# BACKGROUND after Polyscope's tone mapping, which does not change flat surfaces.
SEEN_BACKGROUND = (0.839, 0.886, 0.945)
FIXED_COLOUR = (0.72, 0.72, 0.72)
PICKED_COLOUR = (0.90, 0.10, 0.55)
# Colour of a body that sleeps, when colouring by sleep.
ASLEEP_COLOUR = (0.93, 0.93, 0.90)
SHADOW_COLOUR = np.array([0.455, 0.47, 0.495])
# Colour towards which bodies turn pale beside those that stand out, and how far, 0 to 1.
PALE_COLOUR, PALENESS = np.array([0.88, 0.88, 0.88]), 0.8
MARK_COLOUR = (0.10, 0.12, 0.15)
CREASE_COLOUR = (0.14, 0.15, 0.18)


def _from_hex(words):
    return np.array([list(bytes.fromhex(word)) for word in words.split()]) / 255.0


# The colour map viridis at equal steps, for light to heavy. Its lightness falls evenly, also for
# the colour-blind. The darkest tenth is omitted, because no edge would be visible on it.
VIRIDIS = _from_hex("fde725 b5de2b 6ece58 35b779 1f9e89 26828e 31688e 3e4989 482878")
# Colours that the colour-blind can tell apart (Okabe and Ito), and lighter variants.
PALETTE = _from_hex("e69f00 56b4e9 009e73 f0e442 0072b2 d55e00 cc79a7 94cbec 7ec4a0 c26a77")
GROUND_COLOUR, LINE_COLOUR = np.array([0.76, 0.77, 0.78]), np.array([0.55, 0.57, 0.60])
# Colours of slack, taut and exceeded constraints: light blue, reddish purple and vermilion.
CONSTRAINT_COLOURS = PALETTE[[1, 6, 5]]
# Overlays.
NORMAL_COLOUR = (0.0, 0.25, 0.55)
IMPULSE_COLOUR = (0.90, 0.62, 0.0)
FRICTION_COLOUR = (0.84, 0.15, 0.16)
VELOCITY_COLOUR = (0.0, 0.45, 0.30)
BOX_COLOUR = (0.20, 0.20, 0.25)
GHOST_COLOUR = (0.35, 0.0, 0.60)  # of our bodies beside a student's
TRAIL_COLOUR = (0.05, 0.50, 0.62)
CELL_COLOUR = (0.55, 0.40, 0.15)
# Speed of the brightest bodies when colouring by speed, in m/s. Less separates slow speeds better.
TOP_SPEED = 30.0
# Factor of light before the tone curve. More is brighter and paler.
EXPOSURE = 0.60


class Highlight(NamedTuple):
    """What a picture shows of a moment within a step.

    poses : (7, n), of the bodies, see `poses_of`; bodies : list of those that stand out
    arrows : dict of name and (point (3,), arrow (3,) in metres, colour)
    """

    poses: np.ndarray
    bodies: list
    arrows: dict

    def paled(self, colours):
        """Returns RGB of all bodies (n, 3), pale except for those that stand out."""
        stands = np.isin(np.arange(len(colours)), self.bodies)[:, None]
        return np.where(stands, colours, colours + PALENESS * (PALE_COLOUR - colours))


class BodyColours:
    """Colours of a scene's bodies; those of densities span the extremes of these meshes.

    index : (n,), of the bodies' colours in the palette
    """

    def __init__(self, meshes):
        densities = [mesh.density for mesh in meshes if not mesh.isFixed]
        densities = densities or [mesh.density for mesh in meshes] or [1.0]
        self._extremes = min(densities), max(densities)
        self.index = np.arange(len(meshes))

    def of(self, simulation, colouring):
        """RGB of every body, (n, 3): grey if fixed, otherwise by a name of COLOURINGS."""
        if not simulation.meshes:
            return np.zeros((0, 3))
        isFixed = np.array([mesh.isFixed for mesh in simulation.meshes])
        return np.where(isFixed[:, None], FIXED_COLOUR, COLOURINGS[colouring](self, simulation))

    def by_body(self, simulation):
        """Repeats the palette."""
        return PALETTE[self.index % len(PALETTE)]

    def by_density(self, simulation):
        """Viridis over the logarithm of the density."""
        return self._of_densities([mesh.density for mesh in simulation.meshes])

    def _of_densities(self, densities):
        low, high = np.log(self._extremes)
        return viridis(0.5 + (np.log(densities) - 0.5 * (low + high)) / (high - low or math.inf))

    def by_speed(self, simulation):
        """Viridis from dark, at rest, to bright, at TOP_SPEED and above."""
        velocities = np.concatenate([mesh.linVelocity for mesh in simulation.meshes])
        return viridis(1.0 - np.linalg.norm(velocities, axis=1) / TOP_SPEED)

    def by_sleep(self, simulation):
        """Awake bodies as by body, sleeping ones in one pale colour."""
        report, colours = simulation.report, self.by_body(simulation)
        if report is not None and report.hasSleepers:
            # bodies added since the step come last
            colours[np.flatnonzero(report.isAsleep)] = ASLEEP_COLOUR
        return colours

    def legend(self, simulation, colouring):
        """Returns the legend of a colouring, a name of COLOURINGS: rows (text, (r, g, b))."""
        meshes, lines = simulation.meshes, []
        if colouring == "density":
            densities = sorted(set(self._extremes))
            texts = [f"density {density:g} kg/m³" for density in densities]
            lines = list(zip(texts, map(tuple, self._of_densities(densities)), strict=True))
        elif colouring == "speed":
            texts = "at rest", f"{TOP_SPEED / 2:g} m/s", f"{TOP_SPEED:g} m/s or more"
            lines = [(text, tuple(viridis(1.0 - k / 2))) for k, text in enumerate(texts)]
        elif colouring == "sleep":
            lines = [("asleep", ASLEEP_COLOUR)]
        return lines + [("fixed", FIXED_COLOUR)] * any(mesh.isFixed for mesh in meshes)


def linear(colours):
    """Converts sRGB colours to linear light."""
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def toned(light):
    """Converts linear light to sRGB by the ACES tone curve in Narkowicz's approximation."""
    x = EXPOSURE * light
    x = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)


def viridis(place):
    """Returns the RGB (..., 3) of the colour map, from its light end at 0 to its dark end at 1."""
    steps = np.linspace(0.0, 1.0, len(VIRIDIS))
    return np.stack([np.interp(place, steps, channel) for channel in VIRIDIS.T], axis=-1)


COLOURINGS = {
    "body": BodyColours.by_body,
    "density": BodyColours.by_density,
    "speed": BodyColours.by_speed,
    "sleep": BodyColours.by_sleep,
}
# Those that show something of the last step's report.
REPORT_COLOURINGS = ("sleep",)
