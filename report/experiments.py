"""Measurements of movement, constraints and friction: one function per claim of the report.

Functions in EXPERIMENTS draw a panel on the given axis; those in SILENT draw nothing. All return
the numbers in the text, as text with the digits stated there. No result depends on time or chance.
Timings are in `timings.py`; experiments on how the program scales are in `mechanisms.py` and
`resting.py`. Units: metres, kilograms, seconds. The bodies are those of data/.
"""

import itertools
import math
import sys
import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import style

from Quaternion import QConj, QRotate
from rbs.scenes.scenefiles import find_scene
from rbs.scenes.simulation import Settings, Simulation
from rbs.stepping.settings import CHOSEN, CONSTRAINT_TOLERANCE
from RBSFunctions import GRAVITY, Mesh, ground as make_ground, resolve_collision, run_timestep
from RigidBodySimulation import load_mesh_file

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "data"
G = -GRAVITY
H = CHOSEN["timeStep"].default
E = CHOSEN["restitution"].default
BOX = np.array([12.0, 6.0, 8.0])  # sizes of data/box.mesh

EXPERIMENTS = {}
SILENT = {}


def experiment(function):
    """Decorator: adds a function of an axis to EXPERIMENTS under its own name."""
    EXPERIMENTS[function.__name__] = function
    return function


def silent(function):
    """Decorator: adds a function that draws nothing to SILENT."""
    SILENT[function.__name__] = function
    return function


# --------------------------------------------------------------------------------------------------
# Bodies and runs
# --------------------------------------------------------------------------------------------------


@lru_cache
def shape(name):
    return load_mesh_file(DATA / f"{name}.mesh")


def body(name, position=(0, 0, 0), orientation=(1, 0, 0, 0), size=1.0, isFixed=False, density=1.0):
    """Returns a `Mesh` of data/<name>.mesh, scaled by one factor or by three."""
    vertices, faces, tets = shape(name)
    return Mesh(name, vertices * size, faces, tets, density, position, orientation, isFixed)


def box(sizes, position, **settings):
    return body("box", position, size=np.array(sizes) / BOX, **settings)


def turn(axis, degrees):
    """Unit quaternion of a rotation about an axis by an angle."""
    axis, half = np.array(axis, dtype=float), math.radians(degrees) / 2
    return (math.cos(half), *(math.sin(half) * axis / np.linalg.norm(axis)))


def throw(mesh, velocity=(0, 0, 0), spin=(0, 0, 0)):
    mesh.linVelocity = np.array([velocity], dtype=float)
    mesh.angVelocity = np.array([spin], dtype=float)
    return mesh


def steps_of(meshes, seconds, h=H, e=E, ground=True, **options):
    """Runs the meshes; yields `(time, StepReport)` after each step."""
    groundMesh = make_ground() if ground else None
    for step in range(1, round(seconds / h) + 1):
        yield step * h, run_timestep(meshes, groundMesh, h, e, **options)


STATE = ("position", "orientation", "linVelocity", "angVelocity")


def state_of(meshes):
    return [[getattr(mesh, name).copy() for name in STATE] for mesh in meshes]


def restore(meshes, state):
    for mesh, values in zip(meshes, state, strict=True):
        for name, value in zip(STATE, values, strict=True):
            setattr(mesh, name, value.copy())


def scene(name, **settings):
    return Simulation(find_scene(name), Settings(**settings))


@lru_cache
def heap_scene(count):
    """Returns the path of a dense heap from data/make_pile.py, which collapses when released."""
    sys.path.insert(0, str(ROOT / "tests" / "benchmarks"))
    from benchmarkPiles import make_scene

    return make_scene("heap", count, tempfile.mkdtemp())


def up_axis_tilt(mesh):
    """Angle in degrees between a mesh's own y axis and the vertical."""
    up = QRotate(mesh.orientation, np.array([[0.0, 1.0, 0.0]]))[0]
    return math.degrees(math.acos(min(1.0, up[1])))


def slope(x, y):
    """Fits the exponent k of y   x^k on logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def text(value, digits):
    """Formats a number with so many decimals and a proper minus sign."""
    return f"{value:.{digits}f}".replace("-", "−")


def constants():
    """Parameters of the experiments that the text quotes."""
    return {
        "h": f"{H:g}",
        "e": f"{E:g}",
        "g": f"{G:g}",
        "boxX": f"{BOX[0]:g}",
        "boxY": f"{BOX[1]:g}",
        "boxZ": f"{BOX[2]:g}",
        "tolerance": f"{1e3 * CONSTRAINT_TOLERANCE:g}",
    }


# --------------------------------------------------------------------------------------------------
# Basic simulation
# --------------------------------------------------------------------------------------------------

REST_SECONDS = 10.0


def resting_box(h):
    """Returns times, tilts in degrees, and angular velocities in rad/s (n, 3)."""
    mesh = box(BOX, (0, BOX[1] / 2, 0))
    rows = []
    for t, _ in steps_of([mesh], REST_SECONDS, h):
        rows.append((t, up_axis_tilt(mesh), *mesh.angVelocity[0]))
    rows = np.array(rows)
    return rows[:, 0], rows[:, 1], rows[:, 2:5]


@experiment
def rest(axis):
    """A box that starts flat and at rest on the ground never comes to rest."""
    tilts, sways = [], []
    steps = (H, H / 4)
    for h, colour in zip(steps, (style.VERMILION, style.BLUE), strict=True):
        t, tilt, spin = resting_box(h)
        axis.plot(t, tilt, color=colour, linewidth=0.8, label=f"h = {h:g} s")
        late = t > REST_SECONDS / 2
        tilts.append(tilt[late].mean())
        sways.append(np.sqrt((spin[late] ** 2).sum(axis=1).mean()))
    axis.set(xlabel="time / s", ylabel="tilt / °", xlim=(0, 6), ylim=(0, 0.28))
    axis.legend(loc="upper left", ncols=2)
    return {
        "seconds": f"{REST_SECONDS:g}",
        "tilt": text(tilts[0], 2),
        "sway": text(math.degrees(sways[0]), 1),
        "fineStep": f"{H / 4:g}",
        "finer": f"{H / (H / 4):g}",
        "tiltRatio": text(tilts[0] / tilts[1], 1),
        "swayRatio": text(sways[0] / sways[1], 1),
    }


STACK_SECONDS = 2.0


def stack_of(count, isBottomFirst, seconds=STACK_SECONDS, h=H):
    """Simulates a stack of boxes, from the ground upwards, with the default settings."""
    meshes = [box(BOX, (0, BOX[1] * (k + 0.5), 0)) for k in range(count)]
    for _t, _ in steps_of(meshes if isBottomFirst else meshes[::-1], seconds, h):
        pass
    return meshes


def overlap_and_sinking(meshes):
    """Returns the deepest overlap of neighbours, and by how much the top box has sunk."""
    overlaps = [max(0.0, -meshes[0].currVertices[:, 1].min())]
    for lower, upper in itertools.pairwise(meshes):
        overlaps.append(lower.detect_collision(upper)[1])
    return max(overlaps), BOX[1] * (len(meshes) - 0.5) - meshes[-1].position[0, 1]


@experiment
def stack(axis):
    """Overlap that remains after a sweep, against the height of the stack."""
    counts = np.array([1, 2, 3, 4, 5, 6, 7, 8, 10])
    numbers = {}
    for isBottomFirst, colour, mark, label in (
        (True, style.VERMILION, "s", "listed upwards"),
        (False, style.BLUE, "o", "downwards"),
    ):
        depths = np.array([overlap_and_sinking(stack_of(n, isBottomFirst)) for n in counts])
        axis.plot(counts, depths[:, 0], mark + "-", color=colour, label=label)
        name = "up" if isBottomFirst else "down"
        for count in (2, 4, 8, 10):
            overlap, sinking = depths[list(counts).index(count)]
            numbers[f"{name}{count}"] = text(overlap, 2)
            numbers[f"{name}Sinking{count}"] = text(sinking, 1)
    axis.axhline(BOX[1] / 2, color=style.GREY, linewidth=0.8, linestyle=":")
    axis.annotate(
        "half a box",
        (1, BOX[1] / 2),
        xytext=(0, -2),
        textcoords="offset points",
        fontsize=7,
        color="0.35",
        va="top",
    )
    axis.set(xlabel="boxes in the stack", ylabel="deepest overlap / m", ylim=(0, None))
    axis.legend(loc="upper left", bbox_to_anchor=(0.0, 0.83))
    fine = overlap_and_sinking(stack_of(8, True, h=H / 4))
    return {
        "seconds": f"{STACK_SECONDS:g}",
        "fall": text(1e3 * G * H * H, 1),
        "height8": text(8 * BOX[1], 0),
        "half": f"{BOX[1] / 2:g}",
        "fine8": text(fine[0], 2),
        "fineStep": f"{H / 4:g}",
        **numbers,
    }


def bounces(height, e, h=H, seconds=None):
    """Times, energies per kilogram and contact steps of an octahedron falling on its tip.

    Without a duration, it stops after the first bounce.
    """
    tip = -shape("octahedron")[0][:, 1].min()
    mesh = body("octahedron", (0, tip + height, 0))
    rows, when = [(0.0, G * height)], []
    for t, report in steps_of([mesh], seconds or 10.0, h, e):
        v = mesh.linVelocity[0, 1]
        rows.append((t, G * (mesh.position[0, 1] - tip) + 0.5 * v * v))
        if report.contacts:
            when.append(len(rows) - 1)
            if seconds is None:
                break
    return *np.array(rows).T, when


@silent
def restitution():
    """Fraction of the speed that a bounce returns, from many heights, and after many bounces."""
    heights = np.geomspace(0.01, 10.0, 60)
    kept = []
    for height in heights:
        _, energy, _ = bounces(height, E)
        kept.append(math.sqrt(energy[-1] / energy[0]))
    kept, ends = np.array(kept), []
    for height in 10.0 + 0.2 * np.arange(11):
        _, energy, _ = bounces(height, 1.0, seconds=20.0)
        ends.append(energy[-1] / energy[0])
    ends = np.array(ends)
    return {
        "low": f"{heights[0]:g}",
        "high": f"{heights[-1]:g}",
        "count": str(len(ends)),
        "least": text(100 * (1 - ends.min()), 0),
        "most": text(100 * (1 - ends.max()), 0),
        "keptMost": text(kept.max(), 2),
        "keptLeast": text(kept.min(), 2),
        "keptHigh": text(kept[heights > 5].max(), 2),
        "seconds": "20",
    }


TUMBLE_SPIN = (1.5, 0.0, 1.5)  # midway between the short axis and a long one
TUMBLE_SECONDS = 10.0


def euler_reference(mesh, seconds, h):
    """Integrates free tumbling by RK4 with the step h: `(orientations, spins in world axes)`."""
    inertia, inverse = mesh.IT, np.linalg.inv(mesh.IT)

    def rates(q, w):
        w0, x, y, z = q
        a, b, c = w  # in body axes
        return 0.5 * np.array(
            [
                -x * a - y * b - z * c,
                w0 * a + y * c - z * b,
                w0 * b + z * a - x * c,
                w0 * c + x * b - y * a,
            ]
        ), inverse @ -np.cross(w, inertia @ w)

    q = mesh.orientation[0].copy()
    w = QRotate(QConj(mesh.orientation), mesh.angVelocity)[0]
    rows, spins = [q], [w]
    for _ in range(round(seconds / h)):
        k1 = rates(q, w)
        k2 = rates(q + h / 2 * k1[0], w + h / 2 * k1[1])
        k3 = rates(q + h / 2 * k2[0], w + h / 2 * k2[1])
        k4 = rates(q + h * k3[0], w + h * k3[1])
        q = q + h / 6 * (k1[0] + 2 * k2[0] + 2 * k3[0] + k4[0])
        w = w + h / 6 * (k1[1] + 2 * k2[1] + 2 * k3[1] + k4[1])
        q = q / np.linalg.norm(q)
        rows.append(q)
        spins.append(w)
    rows, spins = np.array(rows), np.array(spins)
    return rows, QRotate(rows, spins)


def tumbling():
    return throw(body("long-octahedron"), (3, 8, 0), TUMBLE_SPIN)


def angles_from_start(vectors):
    """Angles in degrees between each row and the first one."""
    unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.degrees(np.arccos(np.clip(unit @ unit[0], -1, 1)))


def tumbling_momenta(gyroscopic):
    """Angular momentum (n, 3) of the tumbling body at the start and after each step."""
    mesh, momenta = tumbling(), []
    for _ in range(round(TUMBLE_SECONDS / H) + 1):
        spin = QRotate(QConj(mesh.orientation), mesh.angVelocity)
        momenta.append(QRotate(mesh.orientation, spin @ mesh.IT.T)[0])
        run_timestep([mesh], None, H, E, gyroscopic=gyroscopic)
    return np.array(momenta)


@experiment
def gyroscopic(axis):
    """Directions of angular momentum and spin of a free tumbling body, with the exact solution."""
    mesh = tumbling()
    _, exactSpins = euler_reference(mesh, TUMBLE_SECONDS, H / 10)
    off, mended = (angles_from_start(tumbling_momenta(isExact)) for isExact in (False, True))
    wander = angles_from_start(exactSpins[::10])
    t = H * np.arange(len(off))
    axis.plot(t, off, color=style.VERMILION, label="L, default")
    axis.plot(t, mended, color=style.GREEN, label="L, with the term")
    axis.plot(t, wander, "--", color=style.BLUE, label="ω, exact")
    axis.set(xlabel="time / s", ylabel="angle / °", ylim=(-2, 2.0 * off.max()))
    axis.legend(loc="upper left")
    inertia = np.sort(np.diag(mesh.IT))
    return {
        "seconds": f"{TUMBLE_SECONDS:g}",
        "spin": text(np.linalg.norm(TUMBLE_SPIN), 1),
        "angle": text(off.max(), 0),
        "wander": text(wander.max(), 0),
        "mended": text(mended.max(), 1),
        "inertiaRatio": text(inertia[-1] / inertia[0], 1),
    }


ORDER_SECONDS = 2.0


@silent
def order():
    """Errors of position and orientation in free flight, against the time step."""
    steps = 0.08 / 2.0 ** np.arange(7)
    reference = euler_reference(tumbling(), ORDER_SECONDS, 1 / 1024)[0][-1]
    places, turns = [], []
    for h in steps:
        mesh = tumbling()
        for _t, _ in steps_of([mesh], ORDER_SECONDS, h, ground=False):
            pass
        exact = np.array([3.0, 8.0, 0.0]) * ORDER_SECONDS
        exact[1] -= 0.5 * G * ORDER_SECONDS**2
        places.append(np.linalg.norm(mesh.position[0] - exact))
        turns.append(2 * math.degrees(math.acos(min(1.0, abs(mesh.orientation[0] @ reference)))))
    return {
        "seconds": f"{ORDER_SECONDS:g}",
        "slope": text(slope(steps, places), 3),
        "points": str(len(steps)),
        "finer": f"{steps[0] / steps[-1]:g}",
        "turnCoarse": text(turns[0], 1),
        "turnFine": text(turns[-1], 1),
        "coarse": f"{steps[0]:g}",
        "fine": f"{steps[-1]:g}",
    }


CUBE = 1.0
WAY = (40, 40)  # other sides of the slab


def crossing_share(speed, thickness, closingOnly=False, h=H, phases=24):
    """Fraction of starts, spread over a step, from which a thrown cube crosses a fixed slab."""
    crossed = 0
    for phase in (np.arange(phases) + 0.5) / phases:
        slab = box((thickness, *WAY), (0, 0, 0), isFixed=True)
        start = -(thickness + CUBE) / 2 - speed * h * (1.0 + phase)
        cube = throw(box((CUBE,) * 3, (start, 0, 0)), (speed, 0, 0))
        for _t, _ in steps_of([slab, cube], 12 * h, h, ground=False, closingOnly=closingOnly):
            cube.position[0, 1], cube.linVelocity[0, 1] = 0.0, 0.0  # no gravity
        crossed += cube.position[0, 0] > 0 and cube.linVelocity[0, 0] > 0
    return crossed / phases


@silent
def tunnelling():
    """Least speed at which a body crosses another one, against thickness over time step."""
    least = []
    for h in (H, H / 4):
        for thickness in (0.25, 1.0, 3.0, 9.0):
            limit = (thickness + CUBE) / h
            for speed in limit * np.arange(0.46, 1.2, 0.01):
                if crossing_share(speed, thickness, h=h) > 0:
                    break
            least.append(speed / limit)
            if thickness == 1.0 and h == H:
                one = speed
    shares = {}
    for closingOnly in (False, True):
        for ratio in (0.95, 1.05):
            speed = ratio * 2 * CUBE / H
            shares[closingOnly, ratio] = text(
                100 * crossing_share(speed, CUBE, closingOnly, phases=100), 0
            )
    return {
        "cube": f"{CUBE:g}",
        "one": text(one, 0),
        "least": text(min(least), 2),
        "most": text(max(least), 2),
        "range": " to ".join(dict.fromkeys((text(min(least), 2), text(max(least), 2)))),
        "below": shares[False, 0.95],
        "above": shares[False, 1.05],
        "closingBelow": shares[True, 0.95],
        "closingAbove": shares[True, 1.05],
        "ratioBelow": "0.95",
        "ratioAbove": "1.05",
    }


@silent
def separating():
    """Effect of the impulses on separating contacts."""
    lower, upper = box(BOX, (0, 0, 0)), throw(box(BOX, (0, BOX[1] - 0.1, 0)), (0, 1, 0))
    collides, depth, normal, point = lower.detect_collision(upper)
    before = upper.linVelocity[0, 1] - lower.linVelocity[0, 1]
    resolve_collision(lower, upper, depth, normal, point, E)
    after = upper.linVelocity[0, 1] - lower.linVelocity[0, 1]
    shares, energies = {}, {}
    for only in (False, True):
        simulation = Simulation(heap_scene(200), Settings(closingOnly=only, broadPhase="grid"))
        pulling = total = 0
        for _ in range(300):
            simulation.step()
            pulls = [contact.impulse for contact in simulation.report.contacts]
            pulling += sum(impulse < 0 for impulse in pulls)
            total += len(pulls)
        shares[only] = pulling / total
        mass = sum(mesh.mass for mesh in simulation.meshes)
        energies[only] = simulation.kinetic_energy() / mass
    return {
        "parting": text(before, 1),
        "closing": text(-after, 1),
        "share": text(100 * shares[False], 0),
        "energyDefault": text(energies[False], 1),
        "energyClosing": text(energies[True], 1),
        "steps": "300",
        "bodies": "200",
    }


# --------------------------------------------------------------------------------------------------
# Constraints
# --------------------------------------------------------------------------------------------------

ROPE = 1.0
CHAIN_SECONDS = 2.0


def chain_stretch(links, sweeps):
    """Mean late elongation of a hanging chain, as a fraction of its ropes' length."""
    half = 3.4 * 0.5
    pitch = 2 * half + ROPE
    meshes = [
        body("octahedron", (0, -pitch * k, 0), size=0.5, isFixed=k == 0) for k in range(links + 1)
    ]
    low = int(meshes[0].origVertices[:, 1].argmin())
    high = int(meshes[0].origVertices[:, 1].argmax())
    rows = [[k, low, k + 1, high, ROPE, True] for k in range(links)]
    stretches = []
    for t, _ in steps_of(
        meshes, CHAIN_SECONDS, ground=False, constraints=rows, maxIterations=sweeps * links
    ):
        if t > CHAIN_SECONDS / 2:
            # subtracts the bodies' own length from that of the chain
            length = -meshes[-1].position[0, 1] - 2 * half * links
            stretches.append(length / (links * ROPE) - 1)
    return float(np.mean(stretches))


@silent
def stretch():
    """Stretch of hanging chains of several lengths, with 1 and with 16 sweeps per step."""
    numbers = {}
    for links in (5, 10, 20):
        numbers[f"one{links}"] = text(100 * chain_stretch(links, 1), 0)
        numbers[f"at{links}"] = text(100 * chain_stretch(links, 16), 1)
    return {"sweeps": "16", **numbers}


def overlaps_of(meshes):
    """Returns the depths of all overlapping pairs of meshes."""
    depths = []
    for i, first in enumerate(meshes):
        for second in meshes[i + 1 :]:
            collides, depth, _, _ = first.detect_collision(second)
            if collides and depth > 1e-9:
                depths.append(depth)
    return depths


@silent
def corrections():
    """Overlaps at the end of a step, with constraints and, from the same states, without."""
    simulation = scene("two_chain")
    with_, without = [], []
    for _ in range(200):
        before = state_of(simulation.meshes)
        simulation.settings.enforceConstraints = False
        simulation.step()
        without.append(max(overlaps_of(simulation.meshes), default=0.0))
        simulation.set_state(
            {
                plural: [values[k] for values in before]
                for k, plural in enumerate(
                    ("positions", "orientations", "linVelocities", "angVelocities")
                )
            }
        )
        simulation.settings.enforceConstraints = True
        simulation.step()
        with_.append(max(overlaps_of(simulation.meshes), default=0.0))
    with_, without = 1e2 * np.array(with_), 1e2 * np.array(without)
    return {
        "most": text(with_.max(), 0),
        "mostBefore": text(without.max(), 0),
        "deeper": text(100 * np.mean(with_ > without + 0.1), 0),
        "seconds": f"{200 * H:g}",
    }


def lowest_vertices(simulation):
    """Returns the height of each free body's lowest vertex."""
    return np.array([mesh.lowest_vertex()[1] for mesh in simulation.meshes if not mesh.isFixed])


@experiment
def cliques(axis):
    """Depth to which constraints press fully linked bodies into the ground, and their spin.

    The ground is resolved before the constraints, and the bodies should lie still.
    """
    spins, low, steps, late = {}, {}, 500, 400
    for constrained, colour, label in (
        (False, style.BLUE, "no constraints"),
        (True, style.VERMILION, "constraints"),
    ):
        simulation = scene("cube", enforceConstraints=constrained)
        squares, heights, visits = [], [], []
        for _ in range(steps):
            simulation.step()
            visits.append(simulation.report.constraintVisits)
            squares.append(np.mean([np.sum(mesh.angVelocity**2) for mesh in simulation.meshes]))
            heights.append(lowest_vertices(simulation).min())
        spins[constrained] = math.sqrt(np.mean(squares[late:]))
        low[constrained] = np.array(heights)
        t = H * np.arange(1, steps + 1)
        axis.plot(t, np.minimum(low[constrained], 0.05), color=colour, linewidth=0.9, label=label)
    axis.set(xlabel="time / s", ylabel="y / m", xlim=(1.8, 6), ylim=(-1.0, 0.06))
    axis.legend(loc="lower right", handlelength=1.0)
    violation, bounds = simulation.largest_violation(), len(simulation.constraints)
    deepest = low[True].argmin()
    return {
        "constrained": text(spins[True], 2),
        "unconstrained": text(spins[False], 2),
        "sweeps": text(np.mean(visits[late:]) / bounds, 1),
        "bounds": str(bounds),
        "violation": text(1e3 * violation, 2),
        "from": f"{late * H:g}",
        "to": f"{steps * H:g}",
        "deepest": text(-low[True].min(), 2),
        "deepestAt": text(t[deepest], 1),
        "deepestLate": text(-low[True][late:].min(), 2),
        "deepestWithout": text(max(0.0, -low[False].min()), 2),
    }


# --------------------------------------------------------------------------------------------------
# Friction
# --------------------------------------------------------------------------------------------------

FAST = 10.0


def stopping_distance(mu, e, h=H):
    mesh = throw(box(BOX, (0, BOX[1] / 2, 0)), (FAST, 0, 0))
    for _t, _ in steps_of([mesh], 1.1 * FAST / (mu * G), h, e, mu=mu):
        pass
    return mesh.position[0, 0]


@experiment
def stopping(axis):
    """Excess over v²/2μg of a sliding box's stopping distance, against μ."""
    mus = np.array([0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0])
    theory = FAST**2 / (2 * mus * G)
    excesses = {}
    axis.axhline(0, color=style.BLACK, linestyle="--", linewidth=0.8)
    for h, colour, mark in ((H, style.VERMILION, "s-"), (H / 4, style.BLUE, "o-")):
        distances = np.array([stopping_distance(mu, E, h) for mu in mus])
        excesses[h] = distances - theory
        axis.semilogx(mus, excesses[h], mark, color=colour, label=f"h = {h:g} s")
    axis.set(xlabel="friction μ", ylabel="beyond v²/2μg / m", ylim=(-0.05, 0.8))
    axis.set_xticks([0.1, 0.2, 0.5, 1.0], ["0.1", "0.2", "0.5", "1"])
    axis.minorticks_off()
    axis.legend(loc="upper right")
    return {
        "speed": f"{FAST:g}",
        "excess": text(excesses[H].mean(), 2),
        "excessFine": text(excesses[H / 4].mean(), 2),
        "fineStep": f"{H / 4:g}",
        "worst": text(100 * (excesses[H] / theory).max(), 0),
        "worstFine": text(100 * (excesses[H / 4] / theory).max(), 0),
        "ratio": text(excesses[H].mean() / excesses[H / 4].mean(), 1),
        "finer": f"{H / (H / 4):g}",
    }


INCLINE_MU = 0.4
INCLINE_SECONDS = 5.0


def slide_down(degrees, h=H, e=E):
    """Distance that a box slides down a slope in 5 s."""
    tilt = turn((0, 0, 1), -degrees)
    downhill, normal = QRotate(np.array([tilt, tilt]), np.eye(3)[:2])
    slab = box((400, 20, 200), -10 * normal, orientation=tilt, isFixed=True)
    mesh = box(BOX, BOX[1] / 2 * normal, orientation=tilt)
    start = mesh.position[0].copy()
    for _t, _ in steps_of([slab, mesh], INCLINE_SECONDS, h, e, ground=False, mu=INCLINE_MU):
        pass
    return float((mesh.position[0] - start) @ downhill)


def slope_law(angles):
    """Distance after 5 s on slopes of these angles in degrees (n,), by Coulomb's law."""
    slopes = np.radians(angles)
    pull = np.sin(slopes) - INCLINE_MU * np.cos(slopes)
    return 0.5 * G * INCLINE_SECONDS**2 * np.maximum(0.0, pull)


@experiment
def incline(axis):
    """Excess of a box's distance on a slope over Coulomb's law, against the angle."""
    angles = np.array([5, 10, 15, 18, 20, 21, 22, 23, 24, 26, 30, 35, 40])
    critical = math.degrees(math.atan(INCLINE_MU))
    axis.axhline(0, color=style.BLACK, linestyle="--", linewidth=0.8)
    excess = {}
    for h, colour, mark in ((H, style.VERMILION, "s-"), (H / 2, style.BLUE, "o-")):
        excess[h] = np.array([slide_down(angle, h) for angle in angles]) - slope_law(angles)
        axis.plot(angles, excess[h], mark, color=colour, label=f"h = {h:g} s")
    axis.axvline(critical, color=style.GREY, linewidth=0.8, linestyle=":")
    axis.annotate(
        "friction\nangle",
        (critical, 2.25),
        xytext=(3, 0),
        ha="left",
        va="top",
        textcoords="offset points",
        fontsize=7,
        color="0.35",
    )
    axis.set(xlabel="slope / °", ylabel="further than the law / m", ylim=(-0.1, 2.9))
    axis.legend(loc="upper left", ncols=2)
    below, k = angles < critical, list(angles).index(15)
    free = 0.5 * G * INCLINE_SECONDS**2 * math.sin(math.radians(20))
    return {
        "mu": f"{INCLINE_MU:g}",
        "critical": text(critical, 1),
        "seconds": f"{INCLINE_SECONDS:g}",
        "creep": text(excess[H][below].max(), 1),
        "creepLeast": text(excess[H][below].min(), 1),
        "excess": text(excess[H][~below].max(), 1),
        "halved": text(excess[H / 2][k] / excess[H][k], 2),
        "free": text(free, 0),
        "at": "20",
    }


ROLL_SPEED, ROLL_MU = 20.0, 0.5


def ball(subdivisions, radius=6.0):
    """A ball of 10 · 4ⁿ + 2 vertices on the ground; the first one is data/ball.mesh."""
    sys.path.insert(0, str(DATA))
    from make_data import make_ellipsoid

    points, faces = make_ellipsoid(radius, radius, radius, subdivisions)[:2]
    points, faces = np.array(points, dtype=float), np.array(faces)
    tets = np.column_stack([faces, np.full(len(faces), len(points))])
    points = np.concatenate([points, np.zeros((1, 3))])
    return Mesh("ball", points, faces, tets, 1.0, (0, -points[:, 1].min(), 0), (1, 0, 0, 0), False)


@silent
def rolling():
    """Speed of a ball thrown without spin, and of its rim, against time."""
    numbers = {}
    for subdivisions in (1, 3):
        mesh = throw(ball(subdivisions), (ROLL_SPEED, 0, 0))
        count = len(mesh.origVertices) - 1
        rows = []
        for t, _ in steps_of([mesh], 3.0, mu=ROLL_MU):
            rows.append((t, mesh.linVelocity[0, 0], -6.0 * mesh.angVelocity[0, 2]))
        t, v, rim = np.array(rows).T
        late = (t > 1.75) & (t <= 2.75)
        numbers[f"vertices{subdivisions}"] = str(count)
        numbers[f"missing{subdivisions}"] = text(100 * (1 - v[late].mean() / (5 / 7 * 20)), 0)
        numbers[f"slip{subdivisions}"] = text(100 * abs(1 - rim[late].mean() / v[late].mean()), 1)
    return {"speed": f"{ROLL_SPEED:g}", "mu": f"{ROLL_MU:g}", **numbers}


# --------------------------------------------------------------------------------------------------
# The same bits
# --------------------------------------------------------------------------------------------------


@silent
def samebits():
    """Distance of runs with the grid, and with the grid and one changed bit, from the default."""
    steps = 600
    reference = Simulation(heap_scene(200), Settings())
    others = {
        name: Simulation(heap_scene(200), Settings(broadPhase="grid"))
        for name in ("grid", "reversed", "nudged")
    }
    nudged = others["nudged"].meshes[100]
    x = nudged.position[0, 0]
    nudged.position = np.array([[np.nextafter(x, np.inf), *nudged.position[0, 1:]]])
    # name → bodies in the order of the reference
    bodies = {name: list(other.meshes) for name, other in others.items()}
    others["reversed"].meshes.reverse()
    parted = {name: [] for name in others}
    for step in range(steps):
        reference.step()
        for name, other in others.items():
            if name == "grid" and step >= 300:
                continue
            other.step()
            apart = [
                np.abs(a.position - b.position).max()
                for a, b in zip(reference.meshes, bodies[name], strict=True)
            ]
            parted[name].append(max(apart))
    t = H * np.arange(1, steps + 1)
    values = np.array(parted["nudged"])
    values = values[values > 0]
    return {
        "seconds": f"{steps * H:g}",
        "bodies": "200",
        "gridSteps": "300",
        "grid": f"{max(parted['grid']):g}",
        "decades": str(round(math.log10(values[-1] / values[0]))),
        "end": text(1e6 * values[-1], 1),
        "reversedMetre": text(t[np.argmax(np.array(parted["reversed"]) > 1.0)], 0),
    }
