"""Measurements of movement, constraints and friction, each beside the law that predicts it.

A function with an axis draws data over their law. All return numbers, `{name: number or text}`, for
numbers.json. Those from `row` are a row of the report's table: `predicted` and `measured`, of the
same quantity; `coarse` and `fine`, the effect with the time step H and with a quarter of it; and
`cured`. No result depends on time or chance. Units: metres, kilograms, seconds.
"""

import itertools
import math
import sys
import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "benchmarks"))

import style

from Quaternion import QConj, QRotate
from rbs.softstep.contacts import DAMPING, FREQUENCY
from rbs.softstep.step import SolverState
from rbs.stepping.settings import CONSTRAINT_TOLERANCE, CONSTRAINT_VISITS, SETTINGS
from RBSFunctions import Mesh, ground as make_ground, run_timestep
from RigidBodySimulation import Settings, Simulation, load_mesh_file

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "data"
G, H, E = (SETTINGS[name].default for name in ("gravity", "timeStep", "restitution"))
MARS = 3.7  # gravity there
BOX = np.array([12.0, 6.0, 8.0])  # sizes of data/box.mesh
SOFT = {"contactSolver": "soft-step"}
STEPS = (H, H / 2, H / 4)
COLOURS = (style.VERMILION, style.ORANGE, style.BLUE)
PANELS, SILENT = {}, {}


def panel(function):
    """Decorator of an experiment that draws on an axis."""
    PANELS[function.__name__] = function
    return function


def silent(function):
    """Decorator of an experiment that draws nothing."""
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


def throw(mesh, velocity=(0, 0, 0), spin=(0, 0, 0)):
    mesh.linVelocity, mesh.angVelocity = np.array([velocity], float), np.array([spin], float)
    return mesh


def run(meshes, steps, h=H, e=E, ground=True, **options):
    """Makes steps; yields the `StepReport` of each."""
    if options.get("contactSolver") == "soft-step":
        options["solverState"] = SolverState()
    groundMesh = make_ground() if ground else None
    for _ in range(steps):
        yield run_timestep(meshes, groundMesh, h, e, **options)


def finish(steps):
    for _ in steps:
        pass


def scene(name, **settings):
    return Simulation(name, Settings(**settings))


@lru_cache
def heap_scene(count):
    """Returns the path of a dense heap from make_pile.py, which collapses when released."""
    from benchmarkPiles import make_heap

    return make_heap(count, tempfile.mkdtemp())


def up_axis_tilt(mesh):
    """Angle in degrees between a mesh's own y axis and the vertical."""
    up = QRotate(mesh.orientation, np.array([[0.0, 1.0, 0.0]]))[0]
    return math.degrees(math.acos(min(1.0, up[1])))


def lift_of(mesh):
    """Returns the height in m to which a mesh's kinetic energy could lift it."""
    spin = QRotate(QConj(mesh.orientation), mesh.angVelocity)[0]
    energy = float(mesh.mass * (mesh.linVelocity**2).sum() + spin @ mesh.IT @ spin) / 2
    return energy / (mesh.mass * G) + float(mesh.position[0, 1])


def exponent(x, y):
    """Fits p of y ∝ x^p on logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def row(predicted, measured, coarse, fine, cured, **others):
    """Returns the numbers of a row of the table, and others."""
    names = "predicted measured coarse fine cured".split()
    return dict(zip(names, (predicted, measured, coarse, fine, cured), strict=True)) | others


def overlap_of(meshes):
    """Returns the deepest overlap of neighbours in a stack, and of its foot with the ground."""
    depths = [lower.detect_collision(upper)[1] for lower, upper in itertools.pairwise(meshes)]
    return max(0.0, -meshes[0].currVertices[:, 1].min(), *depths)


@silent
def settings():
    """Settings of the experiments that the text quotes."""
    sizes = " × ".join(f"{side:g}" for side in BOX)
    numbers = {"h": H, "e": E, "mu": SETTINGS["friction"].default, "g": G, "mars": MARS}
    numbers["box"] = sizes
    numbers["substeps"] = SETTINGS["substeps"].default
    return numbers | {"omega": 2 * math.pi * FREQUENCY, "zeta": DAMPING}


@panel
def contact(axis):
    """Diagram of a corner contact: centres, arms, normal, impulses and friction."""
    axis.axis("off")
    axis.set(xlim=(0, 15.5), ylim=(-0.1, 6.9), aspect="equal")

    def square(corner, angle, width, height, colour):
        turned = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        corners = corner + np.array([(0, 0), (width, 0), (width, height), (0, height)]) @ turned
        axis.fill(*corners.T, facecolor=colour, edgecolor="0.3", linewidth=0.6, alpha=0.5)
        return corners.mean(axis=0)

    def arrow(start, shift, name, place, colour, width=1.0):
        options = {"arrowstyle": "-|>", "color": colour, "linewidth": width, "mutation_scale": 7}
        options |= {"shrinkA": 0, "shrinkB": 0}
        axis.annotate("", np.add(start, shift), start, arrowprops=options)
        axis.text(*np.add(start, place), name, color=colour, fontsize=8, ha="center", va="center")

    q = np.array([8.6, 2.9])
    first = square((1.2, 0.1), 0.0, 9.4, 2.8, style.ORANGE)
    second = square(q, 0.3, 5.2, 2.3, style.SKY)
    for name, place, shift in (("$x_1$", first, (-0.2, 0.55)), ("$x_2$", second, (0.55, 0.3))):
        axis.plot(*place, "o", color=style.BLACK, markersize=2.5)
        axis.text(*np.add(place, shift), name, fontsize=8, ha="center", va="center")
    arrow(first, q - first, "$r_1$", (1.9, 0.25), style.BLACK, 0.7)
    arrow(second, q - second, "$r_2$", (-0.3, -0.9), style.BLACK, 0.7)
    arrow(q, (0, 3.4), "$j n$", (-0.75, 3.0), style.BLUE)
    arrow(q, (0, -2.6), "$-j n$", (0.95, -2.2), style.BLUE)
    arrow(q, (-2.9, 0), r"$-j_\tau \tau$", (-2.4, 0.6), style.VERMILION)
    arrow(q, (0, 1.4), "$n$", (0.45, 1.5), style.GREEN, 1.6)
    arrow((12.3, 1.6), (2.4, 0), r"sliding, $\tau$", (1.1, -0.65), style.GREY, 0.8)
    axis.plot(*q, "o", color=style.BLACK, markersize=2.5)
    axis.text(*(q + [0.5, -0.5]), "$q$", fontsize=8, ha="center", va="center")


# --------------------------------------------------------------------------------------------------
# Rest: lengths are g h², speeds are g h
# --------------------------------------------------------------------------------------------------

REST_STEPS = 2000


def rocking(h, gravity=G, **options):
    """Root mean square of the angular velocity, °/s, and mean tilt, °, of a box put down flat."""
    mesh, squares, tilts = box(BOX, (0, BOX[1] / 2, 0)), [], []
    for _ in run([mesh], REST_STEPS, h, gravity=(0, -gravity, 0), **options):
        squares.append(float((mesh.angVelocity**2).sum()))
        tilts.append(up_axis_tilt(mesh))
    late = slice(REST_STEPS // 2, None)
    return math.degrees(math.sqrt(np.mean(squares[late]))), float(np.mean(tilts[late]))


@panel
def rest(axis):
    """Sway and tilt of a box at rest, against the time step, on two planets."""
    numbers, found = {}, {}
    for gravity, fill in ((G, "full"), (MARS, "none")):
        rows = np.array([rocking(h, gravity) for h in STEPS])
        found[gravity] = rows
        for k, (colour, mark) in enumerate(((style.VERMILION, "s"), (style.BLUE, "o"))):
            axis.loglog(STEPS, rows[:, k], mark, color=colour, fillstyle=fill)
    reference = found[G][-1]
    for power, value, colour in ((1, reference[0], style.VERMILION), (2, reference[1], style.BLUE)):
        for gravity, dash in ((G, "-"), (MARS, "--")):
            law = gravity / G * value * (np.array(STEPS) / STEPS[-1]) ** power
            axis.loglog(STEPS, law, dash, color=colour, linewidth=0.8)
    axis.set(xlabel="time step h / s", ylabel="sway / (°/s), tilt / °", ylim=(1e-3, 30))
    axis.set_xticks(STEPS, [f"{h:g}" for h in STEPS])
    axis.minorticks_off()
    axis.annotate("sway: gh", (STEPS[1], 9), ha="center", color=style.VERMILION)
    axis.annotate("tilt: gh²", (STEPS[1], 3e-3), color=style.BLUE)
    cured = rocking(H, **SOFT, sleeping=False)
    for k, name in enumerate(("sway", "tilt")):
        values = found[G][:, k]
        gravity = exponent((G, MARS), [values[0], found[MARS][0, k]])
        power = exponent(STEPS, values)
        numbers[name] = row(k + 1, power, values[0], values[-1], cured[k], gravity=gravity)
    return numbers


STACKED, STACK_STEPS = 8, 100


def stacked(count=STACKED):
    return [box(BOX, (0, BOX[1] * (k + 0.5), 0)) for k in range(count)]


@panel
def stack(axis):
    """Deepest overlap in a stack, in units of g h², step by step; at equal times; by its order."""
    ends, atEqualTime = [], []
    for h, colour in zip(STEPS, COLOURS, strict=True):
        meshes, depths = stacked(), []
        for _ in run(meshes, round(STACK_STEPS * H / h), h):
            depths.append(overlap_of(meshes))
        shown = np.array(depths[:STACK_STEPS]) / (G * h * h)
        axis.plot(shown, color=colour)
        ends.append(depths[STACK_STEPS - 1])
        atEqualTime.append(depths[-1])
    style.name_lines(axis, {f"h = {h:g} s": one for h, one in zip(STEPS, COLOURS, strict=True)})
    axis.set(xlabel="steps", ylabel="overlap / gh²", xlim=(0, STACK_STEPS), ylim=(0, None))
    soft, reverse = stacked(), stacked()
    finish(run(soft, STACK_STEPS, **SOFT))
    finish(run(reverse[::-1], STACK_STEPS))
    others = {"count": STACKED, "seconds": STACK_STEPS * H}
    others |= {"quarter": ends[-1], "reverse": overlap_of(reverse)}
    power = exponent(STEPS, ends)
    return row(2, power, ends[0], atEqualTime[-1], overlap_of(soft), **others)


GAIN_STEPS, GAIN_SECONDS = 100, (20, 100)


def gain(h, steps, **options):
    """Metres by which the energy gained by a box laid flat could lift it, after each of `steps`."""
    mesh, lifts = box(BOX, (0, BOX[1] / 2, 0)), []
    for step, _ in enumerate(run([mesh], max(steps), h, 1.0, **options), 1):
        if step in steps:
            lifts.append(lift_of(mesh) - BOX[1] / 2)
    return lifts


@silent
def energy():
    """Energy that an elastic box at rest gains, as a height: (g h)² / g after so many steps."""
    lifts = [gain(h, [GAIN_STEPS])[0] for h in STEPS]
    late = [round(seconds / H) for seconds in GAIN_SECONDS]
    others = dict(zip(("early", "late"), gain(H, late), strict=True))
    others |= dict(zip(("earlySeconds", "lateSeconds"), GAIN_SECONDS, strict=True))
    cured = gain(H, [GAIN_STEPS], **SOFT, sleeping=False)[0]
    same = gain(H / 4, [4 * GAIN_STEPS])[0]
    return row(2, exponent(STEPS, lifts), lifts[0], same, cured, **others)


# --------------------------------------------------------------------------------------------------
# Flight and impact
# --------------------------------------------------------------------------------------------------

FALL_SECONDS = 2.0


@silent
def fall():
    """How far semi-implicit Euler is below the parabola: g h t / 2."""

    def below(h, **options):
        mesh = body("octahedron")
        finish(run([mesh], round(FALL_SECONDS / h), h, ground=False, **options))
        return -mesh.position[0, 1] - 0.5 * G * FALL_SECONDS**2

    return row(
        0.5 * G * H * FALL_SECONDS,
        below(H),
        below(H),
        below(H / 4),
        below(H, **SOFT),
        seconds=FALL_SECONDS,
    )


def kept_speed(height, h=H, **options):
    """Fraction of the speed that the first bounce of an octahedron on its tip returns."""
    tip = -shape("octahedron")[0][:, 1].min()
    mesh = body("octahedron", (0, tip + height, 0))
    for _ in run([mesh], 1000, h, **options):
        v, y = mesh.linVelocity[0, 1], mesh.position[0, 1] - tip
        if v > 0.0:
            return math.sqrt((G * y + 0.5 * v * v) / (G * height))


def envelope(height, h, sign):
    """Bound of `kept_speed`: e (√(v² + (g h / 2)²) ± g h / 2) / v, with v = √(2 g height)."""
    v, half = np.sqrt(2 * G * height), G * h / 2
    return E * (np.hypot(v, half) + sign * half) / v


BOUNCE_HEIGHT = 0.1


@panel
def bounce(axis):
    """Fraction of the speed that one bounce returns, against the height, within its bounds."""
    heights = np.geomspace(0.01, 10.0, 60)
    inside = []
    for h, colour, mark in ((H, style.VERMILION, "s"), (H / 4, style.BLUE, "o")):
        kept = np.array([kept_speed(height, h) for height in heights])
        low, high = (envelope(heights, h, sign) for sign in (-1, 1))
        inside += ((low - 1e-9 <= kept) & (kept <= high + 1e-9)).tolist()
        axis.semilogx(heights, kept, mark, color=colour, markersize=2)
        place = 0.4, 0.62 if h == H else 0.595
        axis.annotate(f"h = {h:g} s", place, color=colour, fontsize=7)
        axis.semilogx(heights, low, color=colour, linewidth=0.7)
        axis.semilogx(heights, high, color=colour, linewidth=0.7)
    axis.set(xlabel="height / m", ylabel="speed after / before", ylim=(0.35, 0.65))
    near, most = BOUNCE_HEIGHT * np.linspace(0.9, 1.1, 41), []
    for h, options in ((H, {}), (H / 4, {}), (H, SOFT)):
        most.append(max(kept_speed(height, h, **options) for height in near))
    bound = float(envelope(BOUNCE_HEIGHT, H, 1))
    others = {"height": BOUNCE_HEIGHT, "inside": sum(inside), "drops": len(inside)}
    others["tries"] = len(near)
    return row(bound, most[0], *most, **others)


CUBE, WALL = 1.0, 1.0  # sizes along the flight: a and d
WALL_SIDES = (40, 40)
TUNNEL_SPEED = 75.0


def crossing_share(speed, h=H, phases=40, **options):
    """Fraction of starts, spread over a step, from which a cube crosses a fixed wall."""
    crossed = 0
    for phase in (np.arange(phases) + 0.5) / phases:
        wall = box((WALL, *WALL_SIDES), (0, 0, 0), isFixed=True)
        start = -(WALL + CUBE) / 2 - speed * h * (1.0 + phase)
        cube = throw(box((CUBE,) * 3, (start, 0, 0)), (speed, 0, 0))
        finish(run([wall, cube], 12, h, ground=False, gravity=(0, 0, 0), **options))
        crossed += cube.position[0, 0] > 0 and cube.linVelocity[0, 0] > 0
    return crossed / phases


def crossing_law(speed, h=H, pulls=True):
    """The same fraction by geometry: 1 - (d + a) / (2 v h), or 1 - (d + a) / (v h) if pulled back.

    Impulses between separating bodies pull. For e ≤ ½ only: with more, the next one pulls across.
    """
    way = speed * h / (WALL + CUBE)
    clean = np.maximum(0.0, 1 - 1 / way)
    pushed = np.maximum(0.0, 1 - 0.5 / way)
    return np.where(pulls & (E * way > 0.5), clean, pushed)


@panel
def tunnel(axis):
    """Fraction of cubes that cross a wall, against their way in a step."""
    limit = (WALL + CUBE) / H
    ratios = np.concatenate((np.arange(0.4, 1.5, 0.1) + 0.05, (0.49, 0.51)))
    errors = []
    for closingOnly, colour, mark, label in (
        (False, style.VERMILION, "s", "basic step"),
        (True, style.BLUE, "o", "approaching only"),
    ):
        shares = [crossing_share(r * limit, closingOnly=closingOnly) for r in ratios]
        errors.append(np.abs(shares - crossing_law(ratios * limit, pulls=not closingOnly)).max())
        fine = np.linspace(0.4, 1.5, 500)
        law = crossing_law(fine * limit, pulls=not closingOnly)
        axis.plot(fine, 100 * law, color=colour, linewidth=0.8)
        axis.plot(ratios, 100 * np.array(shares), mark, color=colour, markersize=3)
        axis.annotate(label, (0.42, 76 if closingOnly else 86), color=colour, fontsize=7)
    axis.set(xlabel="v h / (d + a)", ylabel="cubes that cross / %", ylim=(-2, 96))
    crossing = [r for r in (0.499, 0.501) if crossing_share(r * limit, phases=500) > 0]
    pulled, others = 1.05 * limit, {"side": CUBE, "speed": TUNNEL_SPEED}
    others |= {"least": crossing[0], "worst": 100 * max(errors)}
    others["pulled"] = 100 * float(crossing_law(pulled))
    others["pulledShare"] = 100 * crossing_share(pulled, phases=120)
    cases = (H, 120, {}), (H / 4, 40, {}), (H, 40, SOFT)
    shares = [100 * crossing_share(TUNNEL_SPEED, h, count, **one) for h, count, one in cases]
    law = 100 * float(crossing_law(TUNNEL_SPEED))
    return row(law, shares[0], *shares, **others)


TUMBLE_SPIN, TUMBLE_SECONDS = (1.5, 0.0, 1.5), 10.0  # midway between the short axis and a long one


@silent
def tumble():
    """Largest angle by which the angular momentum of a free body turns, which should be none."""

    def swing(h, **options):
        mesh, momenta = throw(body("long-octahedron"), (0, 0, 0), TUMBLE_SPIN), []
        for _ in run([mesh], round(TUMBLE_SECONDS / h), h, ground=False, **options):
            spin = QRotate(QConj(mesh.orientation), mesh.angVelocity)
            momenta.append(QRotate(mesh.orientation, spin @ mesh.IT.T)[0])
        unit = np.array(momenta) / np.linalg.norm(momenta, axis=1, keepdims=True)
        return math.degrees(np.arccos(np.clip(unit @ unit[0], -1, 1)).max())

    spin = np.array(TUMBLE_SPIN)
    momentum = body("long-octahedron").IT @ spin
    cosine = momentum @ spin / np.linalg.norm(momentum) / np.linalg.norm(spin)
    law = 2 * math.degrees(math.acos(cosine))
    spin = ", ".join(f"{part:g}" for part in TUMBLE_SPIN)
    return row(law, swing(H), swing(H), swing(H / 4), swing(H, gyroscopic=True), spin=spin)


# --------------------------------------------------------------------------------------------------
# Constraints
# --------------------------------------------------------------------------------------------------

LINKS, ROPE = 20, 1.0


def chain():
    """Returns meshes and constraints of a hanging chain; the first body is fixed."""
    half = 3.4 * 0.5
    meshes = [
        body("octahedron", (0, -(2 * half + ROPE) * k, 0), size=0.5, isFixed=k == 0)
        for k in range(LINKS + 1)
    ]
    ends = meshes[0].origVertices[:, 1]
    low, high = int(ends.argmin()), int(ends.argmax())
    return meshes, [[k, low, k + 1, high, ROPE, True] for k in range(LINKS)]


def tug(h=H, **options):
    """Step in which each body first moves after the last one is thrown downwards, (LINKS,)."""
    meshes, rows = chain()
    throw(meshes[-1], (0, -1, 0))
    start, moved = [mesh.position[0, 1] for mesh in meshes], np.zeros(LINKS + 1, int)
    options = {"gravity": (0, 0, 0), "ground": False, **options}
    for step, _ in enumerate(run(meshes, LINKS, h, constraints=rows, **options), 1):
        for k in range(1, LINKS + 1):
            if not moved[k] and abs(meshes[k].position[0, 1] - start[k]) > 1e-9:
                moved[k] = step
    return moved[1:]


SWEEPS = (1, 4, 48)  # the last number is that of the soft step


@panel
def tugs(axis):
    """Step in which a tug reaches each link, for several numbers of sweeps."""
    links, isLaw, first = np.arange(1, LINKS + 1), True, {}
    for sweeps, colour, mark in zip(SWEEPS, COLOURS, "s^o", strict=True):
        moved = tug(maxIterations=sweeps * LINKS, tolerance=0.0)
        law = np.maximum(1, np.ceil((LINKS - links) / sweeps))
        isLaw &= bool((moved == law).all())
        first[sweeps] = int(moved[0])
        axis.plot(links, law, color=colour, linewidth=0.8)
        axis.plot(links, moved, mark, color=colour, markersize=3)
        name = f"{sweeps} sweep" + "s" * (sweeps > 1)
        axis.annotate(name, (11, 10.5 + 3 * SWEEPS[::-1].index(sweeps)), color=colour, fontsize=7)
    axis.set(xlabel="link, from the anchor", ylabel="step of the tug", ylim=(0, LINKS + 2))
    meshes, rows = chain()
    (report,) = run(meshes, 1, constraints=rows, ground=False, **SOFT)
    coarse, fine = (int(tug(h, maxIterations=LINKS, tolerance=0.0)[0]) for h in (H, H / 4))
    others = {
        "isLaw": isLaw,
        "links": LINKS,
        "softSweeps": report.constraintVisits // LINKS,
        "visits": CONSTRAINT_VISITS,
        "equalVisits": SWEEPS[-1] * LINKS,
        "equal": first[SWEEPS[-1]],
        "default": int(tug()[0]),
        "exact": int(tug(tolerance=0.0)[0]),
        "tolerance": 1e3 * CONSTRAINT_TOLERANCE,
    }
    soft = int(tug(**SOFT, sleeping=False)[0])
    return row(LINKS - 1, coarse, coarse, fine, soft, **others)


@silent
def drift():
    """Largest violation of a bridge's constraints at the end of a step, in cm, and when visits are
    left.
    """
    simulation = scene("bridge", contactScheduling="batches")
    rows, most = simulation.constraints, simulation.max_iterations()
    worst = {True: 0.0, False: 0.0}  # whether visits have run out → violation
    for _ in range(200):
        simulation.step()
        hasRunOut = simulation.report.constraintVisits >= most
        worst[hasRunOut] = max(worst[hasRunOut], 100 * simulation.largest_violation())
    numbers = {"worst": worst[True], "finished": worst[False]}
    return numbers | {"link": max(row[4] for row in rows), "sweeps": most // len(rows)}


def lowest_body(simulation):
    """Returns the free body whose lowest vertex is lowest."""
    free = [mesh for mesh in simulation.meshes if not mesh.isFixed]
    return min(free, key=lambda mesh: mesh.lowest_vertex()[1])


CLIQUE_SECONDS = 4.0


@silent
def clique():
    """Depth to which constraints press bodies, each linked to all others, into the ground."""

    def depth(h=H, **settings):
        simulation, low = scene("cube", timeStep=h, **settings), 0.0
        for _ in range(round(CLIQUE_SECONDS / h)):
            simulation.step()
            low = min(low, lowest_body(simulation).lowest_vertex()[1])
        return -low

    depths = [depth(h) for h in STEPS]
    others = {"without": depth(enforceConstraints=False), "seconds": CLIQUE_SECONDS}
    power = exponent(STEPS, depths)
    return row(1, power, depths[0], depths[-1], depth(**SOFT), **others)


# --------------------------------------------------------------------------------------------------
# Friction
# --------------------------------------------------------------------------------------------------

MU, SLIDE_SECONDS, GENTLE = 0.4, 5.0, 10.0
NEAR = 0.3  # degrees from the steepest slope that holds to the next one tried


def slide_on(degrees, lane=0.0, sizes=(400, 20, 200), height=0.0):
    """Returns a fixed slab, a box on it, and the unit vectors (3,) downhill and normal.

    lane : z of the box; sizes : of the slab; height : of the middle of its upper side, in metres
    """
    half = math.radians(-degrees) / 2
    tilt = (math.cos(half), 0.0, 0.0, math.sin(half))
    downhill, normal = QRotate(np.array([tilt, tilt]), np.eye(3)[:2])
    rise = np.array([0.0, height, 0.0])
    slab = box(sizes, rise - sizes[1] / 2 * normal, orientation=tilt, isFixed=True)
    start = rise + BOX[1] / 2 * normal + [0, 0, lane]
    if height:  # near the upper end
        start = start - (sizes[0] / 2 - BOX[0]) * downhill
    return slab, box(BOX, start, orientation=tilt), downhill, normal


def coulomb(degrees, mu, seconds, parts=1):
    """Distance that a body slides down a slope, integrated in `parts` substeps of a step."""
    angle, count = math.radians(degrees), seconds / H * parts
    pull = G * max(0.0, math.sin(angle) - mu * math.cos(angle))
    return pull * seconds**2 / 2 * (1 + 1 / count)


def slide(degrees, h=H, **options):
    """Distance that a box slides down a slope, minus that by Coulomb's law in as many steps.

    The soft step integrates in substeps, so its law has as many of these.
    """
    slab, mesh, downhill, _ = slide_on(degrees)
    start = mesh.position[0].copy()
    finish(run([slab, mesh], round(SLIDE_SECONDS / h), h, ground=False, mu=MU, **options))
    parts = options.get("substeps", SETTINGS["substeps"].default) if options else H / h
    law = coulomb(degrees, MU, SLIDE_SECONDS, parts)
    return float((mesh.position[0] - start) @ downhill) - law


@panel
def slope(axis):
    """How much faster than Coulomb's law a box goes on a slope, in units of g h."""
    critical = math.degrees(math.atan(MU))
    angles = np.array([5, 10, 15, 20, critical - NEAR, critical, critical + NEAR, 25, 30])
    peaks = []
    for h, colour, mark in zip(STEPS[::2], COLOURS[::2], "so", strict=True):
        speeds = np.array([slide(angle, h) for angle in angles]) / SLIDE_SECONDS
        axis.plot(angles, speeds / (G * h), mark + "-", color=colour)
        axis.annotate(f"h = {h:g} s", (5, 3.1 if h == H else 2.7), color=colour, fontsize=7)
        peaks.append(float(angles[speeds.argmax()]))
    soft = [slide(angle, **SOFT, sleeping=False) for angle in angles]
    speeds = np.array(soft) / SLIDE_SECONDS / (G * H)
    axis.plot(angles, speeds, "^-", color=style.GREEN)
    axis.annotate("soft step", (14, 0.15), color=style.GREEN, fontsize=7)
    axis.axvline(critical, color=style.GREY, linewidth=0.8, linestyle=":")
    axis.annotate(
        "arctan μ", (critical, 3.2), xytext=(3, 0), fontsize=7, textcoords="offset points"
    )
    axis.set(xlabel="slope / °", ylabel="excess speed / gh", ylim=(-0.2, 3.6))
    largest = 1e3 * max(abs(value) for value in soft)
    creeps = [slide(GENTLE, h) for h in STEPS]
    cured = slide(GENTLE, **SOFT, sleeping=False)
    others = {"mu": MU, "angle": GENTLE, "softLargest": largest, "seconds": SLIDE_SECONDS}
    others |= {"peak": min(peaks), "finePeak": max(peaks), "critical": critical, "near": NEAR}
    return row(1, exponent(STEPS, creeps), creeps[0], creeps[-1], cured, **others)


SLIDING = ((25.0, 0.0), (25.0, 0.2), (25.0, 0.3), (30.0, 0.4), (40.0, 0.5))
RAMP, RAMP_SECONDS, RAMP_FRICTION = 25.0, 3.0, (0.0, 0.2, 0.4, 0.6, 0.8)  # of the picture
SLOW = 0.4  # the friction there that a box overcomes, but hardly


@silent
def sliding():
    """Largest deviation of a fast slide from Coulomb's law, and that of a slow one in the picture;
    part of μ j that friction uses; in per cent.

    The latter in the second half of each fast slide, and of the creep of a box that should stay.
    """

    def measure(degrees, mu, seconds=SLIDE_SECONDS):
        slab, mesh, downhill, _ = slide_on(degrees)
        start, late, steps = mesh.position[0].copy(), [], round(seconds / H)
        for step, report in enumerate(run([slab, mesh], steps, ground=False, mu=mu)):
            late += report.contacts if step >= steps // 2 else []
        limit = mu * sum(max(contact.impulse, 0.0) for contact in late)
        used = 100 * sum(np.linalg.norm(one.friction) for one in late) / limit if mu else 100
        law = coulomb(degrees, mu, seconds)
        error = 100 * ((mesh.position[0] - start) @ downhill / law - 1) if law else 0.0
        return abs(float(error)), used

    errors, used = np.transpose([measure(*case) for case in SLIDING])
    slow, _ = measure(RAMP, SLOW, RAMP_SECONDS)
    numbers = {"worst": errors.max(), "slow": slow, "slowFriction": SLOW}
    return numbers | {"used": used.min(), "usedCreeping": measure(GENTLE, MU)[1]}


ROLL_SPEED, ROLL_MU, RADIUS = 20.0, 0.5, 6.0
ROLL_SECONDS = {"early": 4, "middle": 6, "late": 11}


@silent
def rolling():
    """How far a ball thrown without spin is below its rolling speed, in per cent.

    Without facets it would roll at v / (1 + I / m ρ²). Values are means of a second.
    """
    mesh, speeds = body("ball", (0, -shape("ball")[0][:, 1].min(), 0)), []
    throw(mesh, (ROLL_SPEED, 0, 0))
    for _ in run([mesh], round((ROLL_SECONDS["late"] + 0.5) / H), mu=ROLL_MU):
        speeds.append(mesh.linVelocity[0, 0])
    inertia = mesh.IT[0, 0] / (mesh.mass * RADIUS**2)
    numbers = {"seconds": ROLL_SECONDS, "speed": ROLL_SPEED, "radius": RADIUS}
    numbers |= {"vertices": len(mesh.hull.vertices), "inertia": inertia}
    for when, seconds in ROLL_SECONDS.items():
        speed = np.mean(speeds[round((seconds - 0.5) / H) : round((seconds + 0.5) / H)])
        numbers[when] = 100 * (1 - speed * (1 + inertia) / ROLL_SPEED)
    return numbers
