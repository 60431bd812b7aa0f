"""Measurements of movement, constraints and friction, each beside the law that predicts it.

A function with an axis draws data over their law. All return numbers, `{name: number or text}`, for
numbers.json. Four of a name are a row of the report's table: `predicted` and `measured`, of the
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
from rbs.scenes.scenefiles import find_scene
from rbs.scenes.simulation import SceneSimulation, Settings
from rbs.softstep.step import SolverState
from rbs.stepping.settings import SETTINGS
from RBSFunctions import Mesh, ground as make_ground, run_timestep
from RigidBodySimulation import load_mesh_file

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "data"
G, H, E = (SETTINGS[name].default for name in ("gravity", "timeStep", "restitution"))
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


def body(name, position=(0, 0, 0), orientation=(1, 0, 0, 0), size=1.0, isFixed=False):
    """Returns a `Mesh` of data/<name>.mesh, scaled by one factor or by three."""
    vertices, faces, tets = shape(name)
    return Mesh(name, vertices * size, faces, tets, 1.0, position, orientation, isFixed)


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
    return SceneSimulation(find_scene(name), Settings(**settings))


@lru_cache
def heap_scene(count):
    """Returns the path of a dense heap from make_pile.py, which collapses when released."""
    from benchmarkPiles import make_scene

    return make_scene("heap", count, tempfile.mkdtemp())


def up_axis_tilt(mesh):
    """Angle in degrees between a mesh's own y axis and the vertical."""
    up = QRotate(mesh.orientation, np.array([[0.0, 1.0, 0.0]]))[0]
    return math.degrees(math.acos(min(1.0, up[1])))


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
    return {"h": H, "e": E, "g": G, "box": sizes, "substeps": SETTINGS["substeps"].default}


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
    for gravity, fill in ((G, "full"), (3.7, "none")):
        rows = np.array([rocking(h, gravity) for h in STEPS])
        found[gravity] = rows
        for k, (colour, mark) in enumerate(((style.VERMILION, "s"), (style.BLUE, "o"))):
            axis.loglog(STEPS, rows[:, k], mark, color=colour, fillstyle=fill)
    reference = found[G][-1]
    for power, value, colour in ((1, reference[0], style.VERMILION), (2, reference[1], style.BLUE)):
        for gravity, dash in ((G, "-"), (3.7, "--")):
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
        gravity = exponent((G, 3.7), [values[0], found[3.7][0, k]])
        power = exponent(STEPS, values)
        numbers[name] = row(k + 1, power, values[0], values[-1], cured[k], gravity=gravity)
    return numbers


STACKED, STACK_STEPS = 8, 100


def stacked(count=STACKED):
    return [box(BOX, (0, BOX[1] * (k + 0.5), 0)) for k in range(count)]


@panel
def stack(axis):
    """Deepest overlap in a stack, in units of g h², step by step."""
    ends = []
    for h, colour in zip(STEPS, COLOURS, strict=True):
        meshes, depths = stacked(), []
        for _ in run(meshes, STACK_STEPS, h):
            depths.append(overlap_of(meshes))
        axis.plot(np.array(depths) / (G * h * h), color=colour, label=f"h = {h:g} s")
        ends.append(depths[-1])
    axis.set(xlabel="steps", ylabel="overlap / gh²", xlim=(0, STACK_STEPS))
    axis.legend(loc="upper left")
    soft, meshes = stacked(), stacked()
    finish(run(soft, STACK_STEPS, **SOFT))
    for step, _ in enumerate(run(meshes, 5 * STACK_STEPS), 1):
        out = H * step
        if max(abs(mesh.position[0, [0, 2]]).max() for mesh in meshes) > BOX[2] / 2:
            break
    others = {"count": STACKED, "seconds": STACK_STEPS * H, "out": out}
    return row(2, exponent(STEPS, ends), ends[0], ends[-1], overlap_of(soft), **others)


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

    return row(0.5 * G * H * FALL_SECONDS, below(H), below(H), below(H / 4), below(H, **SOFT))


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
        axis.semilogx(heights, kept, mark, color=colour, markersize=2, label=f"h = {h:g} s")
        axis.semilogx(heights, low, color=colour, linewidth=0.7)
        axis.semilogx(heights, high, color=colour, linewidth=0.7)
    axis.set(xlabel="height / m", ylabel="speed after / before", ylim=(0.35, 0.65))
    axis.legend(loc="upper right")
    near, most = BOUNCE_HEIGHT * np.linspace(0.9, 1.1, 41), []
    for h, options in ((H, {}), (H / 4, {}), (H, SOFT)):
        most.append(max(kept_speed(height, h, **options) for height in near))
    bound = float(envelope(BOUNCE_HEIGHT, H, 1))
    others = {"height": BOUNCE_HEIGHT, "inside": sum(inside), "drops": len(inside)}
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
    """The same fraction by geometry: 1 - (d + a) / (2 v h), or 1 - (d + a) / (v h) once pulled."""
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
        (False, style.VERMILION, "s", "default"),
        (True, style.BLUE, "o", "approaching contacts only"),
    ):
        shares = [crossing_share(r * limit, closingOnly=closingOnly) for r in ratios]
        errors.append(np.abs(shares - crossing_law(ratios * limit, pulls=not closingOnly)).max())
        fine = np.linspace(0.4, 1.5, 500)
        law = crossing_law(fine * limit, pulls=not closingOnly)
        axis.plot(fine, 100 * law, color=colour, linewidth=0.8)
        axis.plot(ratios, 100 * np.array(shares), mark, color=colour, markersize=3, label=label)
    axis.set(xlabel="v h / (d + a)", ylabel="cubes that cross / %", ylim=(-2, 90))
    axis.legend(loc="upper left")
    crossing = [r for r in (0.499, 0.501) if crossing_share(r * limit, phases=500) > 0]
    pulled, others = 1.05 * limit, {"least": crossing[0], "worst": 100 * max(errors)}
    others |= {"pulledAt": pulled, "pulled": 100 * float(crossing_law(pulled))}
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
    return row(law, swing(H), swing(H), swing(H / 4), swing(H, gyroscopic=True))


@silent
def pulling():
    """Share of the impulses in a collapsing heap that pull bodies together."""
    simulation = SceneSimulation(heap_scene(200), Settings(contactScheduling="batches"))
    impulses = []
    for _ in range(300):
        simulation.step()
        impulses += [contact.impulse for contact in simulation.report.contacts]
    return {"share": 100 * float(np.mean(np.array(impulses) < 0)), "bodies": 200}


# --------------------------------------------------------------------------------------------------
# Constraints
# --------------------------------------------------------------------------------------------------

LINKS, ROPE, HANG_SECONDS = 20, 1.0, 2.0


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


def sag(**options):
    """How far the last body of a chain at rest has fallen after HANG_SECONDS."""
    meshes, rows = chain()
    start = meshes[-1].position[0, 1]
    finish(run(meshes, round(HANG_SECONDS / H), ground=False, constraints=rows, **options))
    return start - meshes[-1].position[0, 1]


@panel
def tugs(axis):
    """Step in which a tug reaches each link, for several numbers of sweeps."""
    links = np.arange(1, LINKS + 1)
    isLaw = True
    for sweeps, colour, mark in ((1, style.VERMILION, "s"), (4, style.ORANGE, "^")):
        moved = tug(maxIterations=sweeps * LINKS, tolerance=0.0)
        law = np.maximum(1, np.ceil((LINKS - links) / sweeps))
        isLaw &= bool((moved == law).all())
        label = "1 sweep" if sweeps == 1 else f"{sweeps} sweeps"
        axis.plot(links, law, color=colour, linewidth=0.8)
        axis.plot(links, moved, mark, color=colour, markersize=3, label=label)
    soft = tug(**SOFT, sleeping=False)
    axis.plot(links, soft, "o", color=style.BLUE, markersize=3, label="soft step")
    axis.set(xlabel="link, from the anchor", ylabel="step of the tug", ylim=(0, LINKS + 5))
    axis.legend(loc="upper right")
    one = {"maxIterations": LINKS, "tolerance": 0.0}
    coarse, fine = (int(tug(h, **one)[0]) for h in (H, H / 4))
    others = {"isLaw": isLaw, "links": LINKS, "seconds": HANG_SECONDS}
    others |= {"free": 0.5 * G * HANG_SECONDS**2, "sagSoft": 1e3 * sag(**SOFT)}
    others |= {f"sag{sweeps}": sag(maxIterations=sweeps * LINKS) for sweeps in (1, 16)}
    return row(LINKS - 1, coarse, coarse, fine, int(soft[0]), **others)


def lowest_vertices(simulation):
    """Returns the height of each free body's lowest vertex."""
    return np.array([mesh.lowest_vertex()[1] for mesh in simulation.meshes if not mesh.isFixed])


CLIQUE_SECONDS = 4.0


@silent
def clique():
    """Depth to which constraints press bodies, each linked to all others, into the ground."""

    def depth(h=H, **settings):
        simulation, low = scene("cube", timeStep=h, **settings), 0.0
        for _ in range(round(CLIQUE_SECONDS / h)):
            simulation.step()
            low = min(low, lowest_vertices(simulation).min())
        return -low

    depths = [depth(h) for h in STEPS]
    without = depth(enforceConstraints=False)
    power = exponent(STEPS, depths)
    return row(1, power, depths[0], depths[-1], depth(**SOFT), without=without)


# --------------------------------------------------------------------------------------------------
# Friction
# --------------------------------------------------------------------------------------------------

MU, SLIDE_SECONDS, GENTLE = 0.4, 5.0, 10.0


def slide(degrees, h=H, **options):
    """Distance that a box slides down a slope, minus what Coulomb's law has for so many steps."""
    half = math.radians(-degrees) / 2
    tilt = (math.cos(half), 0.0, 0.0, math.sin(half))
    downhill, normal = QRotate(np.array([tilt, tilt]), np.eye(3)[:2])
    slab = box((400, 20, 200), -10 * normal, orientation=tilt, isFixed=True)
    mesh = box(BOX, BOX[1] / 2 * normal, orientation=tilt)
    start, count = mesh.position[0].copy(), round(SLIDE_SECONDS / h)
    finish(run([slab, mesh], count, h, ground=False, mu=MU, **options))
    angle = math.radians(degrees)
    pull = G * max(0.0, math.sin(angle) - MU * math.cos(angle))
    return float((mesh.position[0] - start) @ downhill) - pull * h * h * count * (count + 1) / 2


@panel
def slope(axis):
    """How much faster than Coulomb's law a box goes on a slope, in units of g h."""
    angles = np.array([5, 10, 15, 20, 22, 25, 30])
    for h, colour, mark in zip(STEPS[::2], COLOURS[::2], "so", strict=True):
        speeds = np.array([slide(angle, h) for angle in angles]) / SLIDE_SECONDS
        axis.plot(angles, speeds / (G * h), mark + "-", color=colour, label=f"h = {h:g} s")
    soft = [slide(angle, **SOFT, sleeping=False) for angle in angles]
    speeds = np.array(soft) / SLIDE_SECONDS / (G * H)
    axis.plot(angles, speeds, "^-", color=style.GREEN, label="soft step")
    critical = math.degrees(math.atan(MU))
    axis.axvline(critical, color=style.GREY, linewidth=0.8, linestyle=":")
    axis.annotate("arctan μ", (critical, 3.2), xytext=(3, 0), textcoords="offset points")
    axis.set(xlabel="slope / °", ylabel="excess speed / gh", ylim=(-0.2, 3.6))
    axis.legend(loc="upper left")
    creeps = [slide(GENTLE, h) for h in STEPS]
    cured = slide(GENTLE, **SOFT, sleeping=False)
    others = {"mu": MU, "critical": critical, "angle": GENTLE, "seconds": SLIDE_SECONDS}
    return row(1, exponent(STEPS, creeps), creeps[0], creeps[-1], cured, **others)


ROLL_SPEED, ROLL_MU, RADIUS = 20.0, 0.5, 6.0


def ball(subdivisions):
    """A ball of 10 · 4ⁿ + 2 vertices on the ground; the first one is data/ball.mesh."""
    sys.path.insert(0, str(DATA / "scripts"))
    from make_data import make_ellipsoid

    points, faces = (np.array(one) for one in make_ellipsoid(*3 * [RADIUS], subdivisions)[:2])
    return Mesh.from_surface("ball", points, faces, 1.0, (0, -points[:, 1].min(), 0))


@silent
def rolling():
    """How far a ball thrown without spin ends below 5/7 of its speed, in per cent."""
    numbers = {}
    for name, subdivisions in (("coarse", 1), ("fine", 3)):
        mesh, speeds = throw(ball(subdivisions), (ROLL_SPEED, 0, 0)), []
        for _ in run([mesh], round(2.75 / H), mu=ROLL_MU):
            speeds.append(mesh.linVelocity[0, 0])
        numbers[name] = 100 * (1 - np.mean(speeds[round(1.75 / H) :]) / (5 / 7 * ROLL_SPEED))
        numbers[f"{name}Vertices"] = len(mesh.hull.vertices)
    return numbers
