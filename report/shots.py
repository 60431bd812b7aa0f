"""Pictures and videos of the report: `python report/shots.py still_NAME video_NAME ...`.

Stills go to figures/, videos to videos/.
"""

from rbs.scenes.messages import prepare

if __name__ == "__main__":
    prepare()

from functools import partial
from pathlib import Path

import numpy as np
from basic import COUNT
from cure import BLOW, CALM_STEPS, STARTS
from friction import MU, PLANK, RIDER, SPEED, carried_law, stopping
from gallery import along_row, by_shape
from links import calmed
from PIL import ImageFont
from runs import AWAKE, BATCHED, BOX, RESTING, SOFT, box, heap, overlap_of, scene, stacked, throw
from staging import DARK, FONT, Shot, choose, still, video

from rbs.pictures import overlays
from RigidBodySimulation import Settings, Simulation

FOLDER = Path(__file__).resolve().parent
overlays.CONSTRAINT_WIDTH = 11.0  # pixels: pictures are shown at a third of their size
VERMILION = (213, 94, 0)
BASIC, SOFT_STEP = "basic step", "soft step"


def both(make, *arguments, **settings):
    """Returns what a function makes with the basic step and with the soft step."""
    ways = {BASIC: BATCHED, SOFT_STEP: SOFT}
    return {key: partial(make, *arguments, **settings, **way) for key, way in ways.items()}


def stack(**settings):
    return Simulation.from_meshes(stacked(COUNT), settings=Settings(**settings), name="stack")


class Lanes(Simulation):
    """Bodies of several runs, `lanes`, in one picture."""

    lanes = ()

    def run(self, count):
        super().run(count)
        sources = [mesh for one in self.lanes for mesh in one.run(count).meshes]
        for mesh, source in zip(self.meshes, sources, strict=True):
            mesh.position, mesh.orientation = source.position, source.orientation
        return self


FRICTIONS, LANE, START = (0.0, 0.2, 0.4, 0.6, 0.8), 13.0, -14.0  # m


def slides():
    """Returns boxes that are thrown along the floor, each with its friction, and a plank below a
    smaller box.
    """
    plank, rider = box((START, 1, 2.2 * LANE), PLANK), box((START + 6, 3, 2.2 * LANE), RIDER)
    runs = [([box((START, BOX[1] / 2, LANE * (k - 3)))], mu) for k, mu in enumerate(FRICTIONS)]
    runs.append(([plank, rider], MU))
    for meshes, _ in runs:
        throw(meshes[0], (SPEED, 0, 0))
    every = Lanes.from_meshes([mesh for meshes, _ in runs for mesh in meshes])
    every.lanes = [Simulation.from_meshes(own, settings=Settings(friction=mu)) for own, mu in runs]
    return every


def thrown():
    """Returns the box with friction MU alone."""
    mesh = throw(box((START, BOX[1] / 2, 0)), (SPEED, 0, 0))
    return Simulation.from_meshes([mesh], settings=Settings(friction=MU), name="thrown")


def draw_stops(simulation, draw, pixel):
    """Draws where the bodies' front edges began, and where Coulomb's law has them now."""
    if len(simulation.meshes) == 1:
        return
    time, font = np.array([simulation.time]), ImageFont.truetype(FONT, 34)
    plank, rider = simulation.meshes[-2:]
    lanes = [(START, 0, LANE * (k - 3), *stopping(time, mu), mu) for k, mu in enumerate(FRICTIONS)]
    laws = carried_law(time, plank.mass, rider.mass)[0]
    lanes.append((START, 0, 2.2 * LANE, laws[0], MU))
    lanes.append((START + 6, 2, 2.2 * LANE, laws[1], None))
    for (x, y, z, way, mu), mesh in zip(lanes, simulation.meshes, strict=True):
        high, _, far = mesh.origVertices.max(0)  # the least are the negatives
        for end, colour in ((x + high, DARK), (x + high + way, VERMILION)):
            line = [pixel((end, y + 0.05, z + far + gap)) for gap in (0.2, 2.6)]
            draw.line(line, fill=colour, width=9)
        if mu is not None:
            draw.text(pixel((x - high - 1, 0, z)), f"μ = {mu:g}", DARK, font, anchor="rm")


def row(**settings):
    """Returns a box that strikes two at rest, see cure.py."""
    boxes = [box((x, BOX[1] / 2, 0)) for x in STARTS]
    one = Simulation.from_meshes(boxes, settings=Settings(restitution=0.0, **settings), name="row")
    one.run(CALM_STEPS)
    throw(boxes[0], (BLOW, 0, 0))
    return one


def spin(simulation):
    return f"turns at {np.degrees(np.linalg.norm(simulation.meshes[0].angVelocity)):.1f}°/s"


def violation(simulation):
    return f"largest violation {100 * simulation.largest_violation():.1f} cm"


SLIDES, CORNER = f"{BASIC}, μ from 0 to 0.8", f"μ = {MU:g}, a corner"
SHOTS = {
    "bounce": Shot(
        {BASIC: partial(scene, "mixed")},
        ((22, 34, 88), (1, 15, 0), 37),
        by_shape,
        (960, 560),
        moments=(40, 90, 400),
        steps=range(0, 601, 2),
        readout=lambda one: f"kinetic energy {one.kinetic_energy() / 1e6:.2f} MJ",
    ),
    "stack": Shot(
        both(stack),
        ((62, 33, 88), (0, 23.5, 0), 31),
        along_row,
        steps=range(0, 201, 2),
        readout=lambda one: f"deepest overlap {overlap_of(one.meshes):.2f} m",
    ),
    "chains": Shot(
        {
            "basic step, 1 sweep": partial(scene, "two_chain", maxIterations=1, **BATCHED),
            "basic step, 31 sweeps": partial(scene, "two_chain", **BATCHED),
            SOFT_STEP: partial(scene, "two_chain", **SOFT),
        },
        ((60, 100, 330), (54, 79, 0), 33),
        by_shape,
        (560, 480),
        steps=range(0, 401, 2),
        readout=violation,
    ),
    "bridge": Shot(
        both(scene, "bridge"),
        ((20, 56, 190), (0, 29, 0), 13),
        by_shape,
        (960, 294),
        isStacked=True,
        steps=range(0, 301, 2),
        readout=violation,
    ),
    "friction": Shot(
        {SLIDES: slides, CORNER: thrown},
        {SLIDES: ((6, 150, 66), (6, 0, -1.5), 28), CORNER: ((10, 2.5, 16), (5.0, 0.4, 4), 6)},
        along_row,
        (720, 480),
        steps=range(0, 281, 2),
        draws=draw_stops,
        readout=lambda one: spin(one) if len(one.meshes) == 1 else "",
    ),
    "pyramid": Shot(
        both(scene, "pyramid", **RESTING),
        ((96, 64, 350), (0, 42, 0), 17),
        along_row,
        (900, 420),
        band=0.1,
        moments=(140, 140),
        steps=range(0, 201, 2),
        readout=lambda one: f"top {14.5 * BOX[1] - one.meshes[-1].position[0, 1]:.1f} m too low",
    ),
    "blow": Shot(
        {"two boxes asleep": partial(row, **SOFT), "two boxes awake": partial(row, **AWAKE)},
        ((12, 26, 88), (12, 2, 0), 20),
        along_row,
        (960, 300),
        isStacked=True,
        steps=range(0, 121, 2),
        readout=lambda one: f"{one.report.isAsleep.sum():.0f} asleep",
    ),
    "heap": Shot(
        {"1000 bodies, soft step": partial(heap, 1000, **SOFT)},
        ((185, 140, 400), (-8, 18, -5), 34),
        None,
        (960, 600),
        moments=(0, 150, 1150),
        steps=range(0, 1201, 12),
        rate=12.5,
        readout=lambda one: (
            f"{100 * one.report.isAsleep.mean():.0f} % asleep" if one.report else ""
        ),
    ),
}
STILL = {"steps": range(0), "camera": ((10, 150, 66), (10, 0, -2), 28), "size": (1260, 610)}
SHOTS["stops"] = SHOTS["friction"]._replace(panes={"": slides}, moments=(260,), **STILL)
STILL = {"steps": range(0), "isStacked": False, "size": (1080, 330)}
SHOTS["calm"] = SHOTS["bridge"]._replace(panes=both(calmed), moments=(120, 120), **STILL)
STILLS = {f"still_{name}": shot for name, shot in SHOTS.items() if shot.moments}
VIDEOS = {f"video_{name}": shot for name, shot in SHOTS.items() if shot.steps}

if __name__ == "__main__":
    for chosen in choose((*STILLS, *VIDEOS), __doc__.splitlines()[0]):
        name = chosen.partition("_")[2]
        if chosen in STILLS:
            still(SHOTS[name], FOLDER / "figures" / f"{name}.jpg")
        else:
            video(SHOTS[name], FOLDER / "videos" / f"{name}.mp4")
