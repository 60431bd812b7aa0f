"""Colours: of bodies by what is known of them, and of everything else that is drawn.

From the top: the colours; `body_colours` and the ways to colour; `legend`; the colour map.
All colours are (r, g, b) from 0 to 1.
"""

import math

import numpy as np

BACKGROUND = (0.62, 0.70, 0.80)
# What Polyscope's tone mapping, which leaves flat surfaces alone, makes of it.
SEEN_BACKGROUND = (0.839, 0.886, 0.945)
FIXED_COLOUR = (0.72, 0.72, 0.72)
PICKED_COLOUR = (0.90, 0.10, 0.55)
# Of a body that touches no other free one, where bodies are coloured by what they touch.
LONE_COLOUR = (0.93, 0.93, 0.90)
SHADOW_COLOUR = (0.30, 0.31, 0.33)
CREASE_COLOUR = (0.10, 0.12, 0.15)
# The colour map viridis at equal steps: its lightness falls evenly, also for the colour-blind.
# From light to heavy, and without the map's darkest tenth, on which no edge would show.
VIRIDIS = np.array([
    [253, 231, 37], [181, 222, 43], [110, 206, 88], [53, 183, 121], [31, 158, 137],
    [38, 130, 142], [49, 104, 142], [62, 73, 137], [72, 40, 120],
]) / 255.0  # fmt: skip
# Colours that the colour-blind tell apart (Okabe and Ito), and lighter ones of the same kind.
PALETTE = np.array([
    [230, 159, 0], [86, 180, 233], [0, 158, 115], [240, 228, 66], [0, 114, 178],
    [213, 94, 0], [204, 121, 167], [148, 203, 236], [126, 196, 160], [194, 106, 119],
]) / 255.0  # fmt: skip
# The two greys of the ground's squares.
GROUND_COLOURS = ((0.56, 0.57, 0.58), (0.61, 0.62, 0.63))
# Constraints from slack over taut to too long or too short: light blue, yellow, vermilion, which
# the colour-blind tell apart too (Okabe and Ito's palette).
CONSTRAINT_COLOURS = np.array([[86, 180, 233], [240, 228, 66], [213, 94, 0]]) / 255.0
# Overlays.
NORMAL_COLOUR = (0.0, 0.25, 0.55)
IMPULSE_COLOUR = (0.90, 0.62, 0.0)
FRICTION_COLOUR = (0.84, 0.15, 0.16)
VELOCITY_COLOUR = (0.0, 0.45, 0.30)
BOX_COLOUR = (0.20, 0.20, 0.25)
TRAIL_COLOUR = (0.35, 0.10, 0.45)
# m/s, of the darkest bodies where they are coloured by speed: a fall from 46 m.
TOP_SPEED = 30.0
# Densities that the legend has room for; of more, it shows only the ends.
LEGEND_LINES = 6


def body_colours(simulation, colouring="density"):
    """RGB of every body, (n, 3): grey if fixed, else by a name of COLOURINGS."""
    isFixed = np.array([[mesh.isFixed] for mesh in simulation.meshes])
    return np.where(isFixed, FIXED_COLOUR, COLOURINGS[colouring](simulation))


def legend(meshes, colouring="density"):
    """What the colours mean: rows (text, (r, g, b)).

    colouring : a name of COLOURINGS. Of densities, all are named, or the ends of too many.
    """
    free = [mesh for mesh in meshes if not mesh.isFixed]
    lines = []
    if colouring == "density":
        densities = sorted({mesh.density for mesh in free})
        if len(densities) > LEGEND_LINES:
            densities = [densities[0], densities[-1]]
        lines = [
            (f"density {density:g}", tuple(colour_of_density(density, densities[0], densities[-1])))
            for density in densities
        ]
    elif colouring == "speed":
        speeds = {"at rest": 0.0, f"{TOP_SPEED / 2:g} m/s": 0.5, f"{TOP_SPEED:g} m/s or more": 1.0}
        lines = [(text, tuple(viridis(place))) for text, place in speeds.items()]
    elif colouring == "contact island":
        lines = [("touches no other free body", LONE_COLOUR)]
    elif colouring == "sleep":
        lines = [("asleep", LONE_COLOUR)]
    return lines + [("fixed", FIXED_COLOUR)] * (len(free) < len(meshes))


def colours_by_density(simulation):
    """RGB of every body, (n, 3), by its density among the free bodies."""
    meshes = simulation.meshes
    densities = sorted({mesh.density for mesh in meshes if not mesh.isFixed})
    if not densities:
        return np.tile(FIXED_COLOUR, (len(meshes), 1))
    colours = {d: colour_of_density(d, densities[0], densities[-1]) for d in densities}
    return np.array([colours.get(mesh.density, FIXED_COLOUR) for mesh in meshes])


def colours_by_body(simulation):
    """RGB of every body, (n, 3): the palette over and over."""
    return PALETTE[np.arange(len(simulation.meshes)) % len(PALETTE)]


def colours_by_speed(simulation):
    """RGB of every body, (n, 3): viridis from rest, light, to TOP_SPEED and above, dark."""
    velocities = np.concatenate([mesh.linVelocity for mesh in simulation.meshes])
    place = np.clip(np.linalg.norm(velocities, axis=1) / TOP_SPEED, 0.0, 1.0)
    steps = np.linspace(0.0, 1.0, len(VIRIDIS))
    return np.stack([np.interp(place, steps, channel) for channel in VIRIDIS.T], axis=1)


def colours_by_island(simulation):
    """RGB of every body, (n, 3): one colour for all that hang together by contacts."""
    islands = contact_islands(simulation)
    return np.where(islands[:, None] < 0, LONE_COLOUR, PALETTE[islands % len(PALETTE)])


def contact_islands(simulation):
    """For every body the lowest index among those that it is connected with by contacts.

    Fixed bodies and the ground connect nothing. returns (n,) int, -1 for a body that touches no
    other free one, and where no step has been made
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(simulation.meshes)
    free = np.array([not mesh.isFixed for mesh in simulation.meshes] + [False])  # last: the ground
    report = simulation.report
    pairs = [(c.body1, c.body2) for c in report.contacts] if report is not None else []
    pairs = np.array(pairs, dtype=np.intp).reshape(-1, 2)
    first, second = pairs[free[pairs].all(axis=1)].T
    links = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    labels = connected_components(links, directed=False)[1]
    lowest = np.unique(labels, return_index=True)[1]
    touched = np.isin(np.arange(count), np.concatenate([first, second]))
    return np.where(touched, lowest[labels], -1)


def colour_of_density(density, lightest, heaviest):
    """RGB (3,) of a body: viridis over the logarithm of the density, from lightest to heaviest.

    Where all bodies are equally dense, the middle of the map.
    """
    if heaviest > lightest:
        return viridis(math.log(density / lightest) / math.log(heaviest / lightest))
    return viridis(0.5)


def viridis(place):
    """RGB (3,) of the colour map: place 0 is its light end, 1 its dark one."""
    steps = np.arange(len(VIRIDIS))
    return np.array([np.interp(place * steps[-1], steps, channel) for channel in VIRIDIS.T])


def colours_by_sleep(simulation):
    """RGB of every body, (n, 3): awake ones as by body, sleeping ones in one pale colour."""
    report = simulation.report
    isAsleep = None if report is None else report.isAsleep
    colours = colours_by_body(simulation)
    return colours if isAsleep is None else np.where(isAsleep[:, None], LONE_COLOUR, colours)


COLOURINGS = {
    "density": colours_by_density,
    "body": colours_by_body,
    "speed": colours_by_speed,
    "contact island": colours_by_island,
    "sleep": colours_by_sleep,
}
