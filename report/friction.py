"""Section 3: friction beside Coulomb's law, and why a box creeps."""

import math

import numpy as np
import runs
import style
from runs import AWAKE, BOX, G, H, box, experiment, run, throw

from Quaternion import QRotate

PANEL = (3.6, 4.0)
MU, SPEED, SECONDS = 0.4, 10.0, 6.0
SHOWN = (0.2, 0.4, 0.8)


def thrown(mu, **options):
    """Way and angular speed of a flat box thrown along the ground, after each step (n, 2)."""
    mesh, rows = throw(box((0, BOX[1] / 2, 0)), (SPEED, 0, 0)), []
    for _ in run([mesh], round(SECONDS / H), mu=mu, **options):
        rows.append((mesh.position[0, 0], np.linalg.norm(mesh.angVelocity)))
    return np.array(rows)


def stopping(time, mu):
    """Way of a thrown box by Coulomb's law, (n,)."""
    moving = np.minimum(time, SPEED / max(mu * G, 1e-9))
    return SPEED * moving - mu * G * moving**2 / 2


@experiment(PANEL)
def slide(axis):
    """Ways of boxes thrown along the floor, beside Coulomb's law, and their jitter at rest."""
    numbers = {"mu": MU, "speed": SPEED, "law": SPEED**2 / (2 * MU * G)}
    for mu, (colour, mark) in zip(SHOWN, style.LOOKS, strict=True):
        ways = thrown(mu)[:, 0]
        time = H * np.arange(1, len(ways) + 1)
        axis.plot(time, stopping(time, mu), color=colour, linewidth=0.8)
        axis.plot(time, ways, mark, color=colour, markevery=25)
        axis.text(SECONDS, ways[-1] + 1.6, f"μ = {mu:g}", color=colour, ha="right")
    axis.set(xlabel="time / s", ylabel="distance / m", xlim=(0, SECONDS), ylim=(0, 32))
    for name, options in (("basic", {}), ("cured", AWAKE)):
        rows = thrown(MU, **options)
        numbers[name] = rows[-1, 0]
        numbers[f"{name}Jitter"] = math.degrees(math.sqrt((rows[-100:, 1] ** 2).mean()))
    return numbers


GENTLE, CREEP_SECONDS = 10.0, 5.0  # °, less than arctan μ
SWEEPS, ROUGH = 20, 2.0  # over the corners; a large μ


def on_slope():
    """Returns a fixed slab and a box on it, and the directions downhill and up its normal."""
    half = math.radians(-GENTLE) / 2
    tilt = (math.cos(half), 0.0, 0.0, math.sin(half))
    downhill, normal = QRotate(np.array([tilt, tilt]), np.eye(3)[:2])
    slab = box(-10 * normal, (400, 20, 200), orientation=tilt, isFixed=True)
    return slab, box(BOX[1] / 2 * normal, orientation=tilt), downhill, normal


def creep(h=H, mu=MU, **options):
    """Way in m (n,) that a box creeps down a slope on which Coulomb's law holds it (e = 0)."""
    slab, mesh, downhill, _ = on_slope()
    start, steps = mesh.position[0], round(CREEP_SECONDS / h)
    moving = run([slab, mesh], steps, h, 0.0, ground=False, mu=mu, **options)
    return np.array([(mesh.position[0] - start) @ downhill for _ in moving])


def creep_on_corners(**options):
    """The same if each corner that touches gets impulses, see `runs.on_corners`."""
    _, mesh, downhill, normal = on_slope()
    start, steps = mesh.position[0], round(CREEP_SECONDS / H)
    corners = runs.on_corners(mesh, normal, steps, SWEEPS, MU, **options)
    return np.array([(mesh.position[0] - start) @ downhill for _ in corners])


@experiment(PANEL)
def slope(axis):
    """Creep of a box on a slope in cm, with causes removed."""
    ways = {"basic": creep(), "corners": creep_on_corners(), "basicRough": creep(mu=ROUGH)}
    ways["summed"] = creep_on_corners(isSummed=True)
    ways["first"] = creep_on_corners(isSummed=True, isFrictionFirst=True)
    ways |= {"fine": creep(H / 4), "soft": creep(**AWAKE)}
    numbers = {name: 100 * one[-1] for name, one in ways.items()}
    names = {"basic": "basic step", "corners": "four corners", "basicRough": "basic, μ = 2"}
    names |= {"summed": "sum as limit", "first": "friction first"}
    looks = (*style.LOOKS[1::-1], *style.LOOKS[2:], (style.SKY, "x"), (style.BLACK, "v"))
    for (key, name), (colour, mark) in zip(names.items(), looks, strict=True):
        time = H * np.arange(1, len(ways[key]) + 1)
        axis.plot(time, 100 * ways[key], mark + "-", color=colour, markevery=50, label=name)
    axis.set(xlabel="time / s", ylabel="creep / cm", xlim=(0, CREEP_SECONDS), ylim=(-5, 190))
    axis.legend(loc="upper left")
    steps = round(CREEP_SECONDS / H)
    moved = 100 * G * math.sin(math.radians(GENTLE)) * H * H * steps
    return numbers | {"moved": moved, "quarter": numbers["basic"] / 4, "angle": GENTLE}


PLANK, RIDER = (24.0, 2.0, 12.0), (4.0, 2.0, 4.0)


def carried(h=H, **options):
    """Ways over time of a rider on a plank that is thrown along the floor, in m (n, 2)."""
    plank, rider = box((0, 1, 0), PLANK), box((6, 3, 0), RIDER)
    throw(plank, (SPEED, 0, 0))
    ways = []
    for _ in run([plank, rider], round(4.0 / h), h, mu=MU, **options):
        ways.append((plank.position[0, 0], rider.position[0, 0] - 6.0))
    return np.array(ways), plank.mass, rider.mass


def carried_law(time, plank, rider):
    """The same by Coulomb's law: friction takes both to one speed, then stops them together."""
    pull = MU * G
    brake = pull * (1 + 2 * rider / plank)
    meet = SPEED / (brake + pull)
    first = np.minimum(time, meet)
    later = np.clip(time - meet, 0, meet)
    both = pull * meet * later - pull * later**2 / 2
    return np.stack([SPEED * first - brake * first**2 / 2 + both, pull * first**2 / 2 + both], 1)


@experiment()
def carry():
    """A body on a body: ways of a rider and of a thrown plank, beside Coulomb's law."""
    ways, *masses = carried()
    law, soft = carried_law(H * np.arange(1, len(ways) + 1), *masses), carried(**AWAKE)[0]
    fine = carried(H / 4)[0]
    numbers = {}
    for k, name in enumerate(("plank", "rider")):
        due, *ends = (way[-1, k] for way in (law, ways, soft, fine))
        numbers[name] = dict(zip(("basic", "cured", "fine"), ends, strict=True)) | {"law": due}
        excess, _, fineExcess = (100 * (one / due - 1) for one in ends)
        numbers[name] |= {"excess": excess, "fineExcess": fineExcess}
    return numbers
