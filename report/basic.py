"""Section 1: what the basic step gets wrong, each with an experiment that tests its cause."""

import itertools
import math

import numpy as np
import runs
import style
from oracles import body, shape
from runs import AWAKE, BOX, SOFT, STEPS, E, G, H, box, experiment, run

from Quaternion import QConj, QRotate
from RBSFunctions import ground as make_ground, resolve_collision

PANEL = (4.35, 4.1)
SWAY_STEPS, SWEEPS = 2000, 20  # over the corners


def swaying(steps, mesh):
    """Returns sway (RMS of the angular velocity, °/s) and mean tilt (°) in the second half."""
    spins, tilts = [], []
    for _ in steps:
        spins.append(float((mesh.angVelocity**2).sum()))
        tilts.append(runs.tilt_of(mesh))
    half = len(spins) // 2
    return math.degrees(math.sqrt(np.mean(spins[half:]))), float(np.mean(tilts[half:]))


def flat_box():
    return box((0, BOX[1] / 2, 0))


def sway(h=H, **options):
    mesh = flat_box()
    return swaying(run([mesh], SWAY_STEPS, h, **options), mesh)


def sway_on_corners(sweeps):
    """Sway in °/s if each corner that touches gets impulses (e = 0), in sweeps over the corners."""
    mesh, up = flat_box(), np.array([0.0, 1.0, 0.0])
    return swaying(runs.on_corners(mesh, up, SWAY_STEPS, sweeps), mesh)[0]


@experiment(PANEL)
def rest(axis):
    """Sway and tilt of a box at rest against the time step, and its cause: one point a contact."""
    rows = np.array([sway(h) for h in STEPS])
    powers = []
    for k, (name, (colour, mark)) in enumerate(zip(("tilt", "sway"), style.LOOKS, strict=False)):
        values = rows[:, 1 - k]
        axis.loglog(STEPS, values[0] * (np.array(STEPS) / H) ** (2 - k), color=colour)
        axis.loglog(STEPS, values, mark, color=colour, label=name)
        powers.append(runs.exponent(STEPS, values))
    style.ticks(axis, x=STEPS)
    axis.set(xlabel="time step h / s", ylabel="sway / (°/s), tilt / °", ylim=(4e-3, 60))
    axis.legend(loc="upper left", reverse=True)
    numbers = {"sway": rows[0, 0], "cured": sway(**AWAKE)[0], "sweeps": SWEEPS}
    numbers |= {"tiltPower": powers[0], "swayPower": powers[1]}
    once, often = sway_on_corners(1), sway_on_corners(SWEEPS)
    return numbers | {"corners": once, "cornersSwept": often}


GAIN_SECONDS = 20.0


def gain(h, **options):
    """Energy over time of an elastic box laid flat, as heights in m, and what changed it.

    Corrections lift the body, and a step of free flight loses g² h²/2 per mass. An impulse with
    e = 1 changes nothing.
    """
    mesh, lifts, heights = flat_box(), 0.0, []
    start, steps = runs.energy_of(mesh), round(GAIN_SECONDS / h)
    for report in run([mesh], steps, h, 1.0, **options):
        lifts += sum(contact.depth for contact in report.contacts)
        heights.append((runs.energy_of(mesh) - start) / (mesh.mass * G))
    return heights, {"lifts": lifts, "flight": steps * G * h * h / 2}


@experiment(PANEL)
def energy(axis):
    """Energy that an elastic box at rest gains, and where it comes from."""
    numbers = {"seconds": GAIN_SECONDS}
    for key, name, h, options, look in (
        ("cured", "soft step", H, AWAKE, {"color": style.GREEN, "linestyle": ":"}),
        ("fine", "h/4", H / 4, {}, {"color": style.BLUE, "linestyle": "--"}),
        ("basic", "basic step", H, {}, {"color": style.VERMILION}),
    ):
        heights, sources = gain(h, **options)
        axis.plot(h * np.arange(1, len(heights) + 1), heights, label=name, **look)
        numbers[key] = heights[-1]
    axis.set(xlabel="time / s", ylabel="energy gained / m", ylim=(-0.1, None))
    axis.legend(loc="upper left", reverse=True)
    return numbers | sources | {"sum": sources["lifts"] - sources["flight"]}


def kept_speed(height, h=H, **options):
    """Fraction of the speed that the first bounce of an octahedron on its tip returns."""
    tip = -shape("octahedron")[0][:, 1].min()
    mesh = body("octahedron", (0, tip + height, 0))
    for _ in run([mesh], 1000, h, **options):
        v, y = mesh.linVelocity[0, 1], mesh.position[0, 1] - tip
        if v > 0.0:
            return math.sqrt((G * y + 0.5 * v * v) / (G * height))


def envelope(height, h, sign):
    """Bound of `kept_speed`: e (√(1 + s²) ± s), with s = g h / 2 v and v = √(2 g height)."""
    s = G * h / 2 / np.sqrt(2 * G * height)
    return E * (np.hypot(1, s) + sign * s)


@experiment(PANEL)
def bounce(axis):
    """Fraction of the speed that one bounce returns, against the height, within its bounds."""
    heights, inside = np.geomspace(0.02, 10.0, 60), []
    for h, colour, mark, name in ((H, style.VERMILION, "s", "h"), (H / 4, style.BLUE, "o", "h/4")):
        kept = np.array([kept_speed(height, h) for height in heights])
        low, high = (envelope(heights, h, sign) for sign in (-1, 1))
        inside += ((low - 1e-9 <= kept) & (kept <= high + 1e-9)).tolist()
        axis.fill_between(heights, low, high, color=colour, alpha=0.2, linewidth=0)
        axis.plot(heights, kept, mark, color=colour, markersize=2, label=name)
    axis.set(xlabel="height / m", ylabel="returned speed, ratio", xscale="log", ylim=(0.35, 0.7))
    style.ticks(axis, x=(0.1, 1, 10))
    axis.legend(loc="upper right")
    return {"inside": sum(inside), "drops": len(inside)}


SPIN, TUMBLE_SECONDS = (1.5, 0.0, 1.5), 10.0  # midway between the short axis and a long one


@experiment(PANEL)
def tumble(axis):
    """Angle over time by which the angular momentum of a free body has turned; it should not."""
    spin, largest = np.array(SPIN), {}
    momentum = body("long-octahedron").IT @ spin
    cosine = momentum @ spin / np.linalg.norm(momentum) / np.linalg.norm(spin)
    law = 2 * math.degrees(math.acos(cosine))
    for key, name, h, options, colour, look in (
        ("basic", "basic step", H, {}, style.VERMILION, {"linestyle": "-"}),
        ("fine", "h/4", H / 4, {}, style.BLUE, {"linestyle": "", "marker": "o", "markevery": 100}),
        ("cured", "with the term", H, {"gyroscopic": True}, style.GREEN, {"linestyle": "--"}),
        ("soft", None, H, SOFT, None, {}),
    ):
        mesh, momenta = runs.throw(body("long-octahedron"), spin=SPIN), []
        for _ in run([mesh], round(TUMBLE_SECONDS / h), h, ground=False, **options):
            turned = QRotate(QConj(mesh.orientation), mesh.angVelocity)
            momenta.append(QRotate(mesh.orientation, turned @ mesh.IT.T)[0])
        unit = np.array(momenta) / np.linalg.norm(momenta, axis=1, keepdims=True)
        angles = np.degrees(np.arccos(np.clip(unit @ unit[0], -1, 1)))
        largest[key] = angles.max()
        if name:
            time = h * np.arange(1, len(angles) + 1)
            axis.plot(time, angles, color=colour, label=name, **look)
    axis.axhline(law, color=style.BLACK, linewidth=0.8, linestyle=":")
    axis.set(xlabel="time / s", ylabel="angle / °", ylim=(-1, 80), xlim=(0, 5))
    axis.legend(loc="upper right")
    return largest | {"predicted": law}


COUNT, STACK_STEPS, PASSES = 8, 100, 20


def stack_overlap(order=1, passes=1, **options):
    """Deepest overlap in m after STACK_STEPS steps of a stack listed upwards (1) or downwards (-1).

    passes : over the pairs in a step; those after the first correct positions only
    """
    meshes, floor = runs.stacked(COUNT), make_ground()
    listed = meshes[::order]
    for _ in run(listed, STACK_STEPS, **options):
        for _ in range(passes - 1):
            for lower, upper in itertools.pairwise(listed):
                isHit, depth, normal, point = lower.detect_collision(upper)
                if isHit:
                    resolve_collision(lower, upper, depth, normal, point, -1.0)  # no impulse
            low = meshes[0].lowest_vertex()
            if low[1] <= 0.0:
                resolve_collision(meshes[0], floor, low[1], (0, 1, 0), low, -1.0)
    return runs.overlap_of(meshes)


@experiment()
def stack():
    """Overlap in a stack: with its order, with more passes over the pairs, and cured."""
    numbers = {"count": COUNT, "seconds": STACK_STEPS * H, "passes": PASSES}
    numbers |= {"up": stack_overlap(), "down": stack_overlap(-1), "cured": stack_overlap(**SOFT)}
    return numbers | {"passed": stack_overlap(passes=PASSES)}
