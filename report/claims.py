"""Claims of the report: measured values beside those that a law predicts, or beside a bound.

`broken` lists the claims that do not hold, which fails the build; `table` writes all to claims.md.
"""

from typing import NamedTuple


class Claim(NamedTuple):
    """A sentence, and what must be true of the numbers.

    section : of the report; sentence : the quantity; measured : its path in numbers.json
    relation : "=", "<" or ">"; law : path or number; within : largest relative deviation from "="
    """

    section: str
    sentence: str
    measured: str
    relation: str
    law: object
    within: float = 0.0


def law(sentence, name, within):
    return sentence, f"{name}.measured", "=", f"{name}.predicted", within


def engine(sentence, name, relation, size):
    return sentence, f"engines.{name}.{size}", relation, f"engines.soft.{size}"


QUEUED = {name: f"schedules.{name}.queue" for name in ("net", "two_chain", "bridge", "cube")}
# section → claims as (sentence, measured, relation, law, within)
SECTIONS = {
    "Movement": [
        law("sway of a box at rest, exponent of h", "rest.sway", 0.03),
        ("sway of a box at rest, exponent of g", "rest.sway.gravity", "=", 1, 0.03),
        law("tilt of a box at rest, exponent of h", "rest.tilt", 0.03),
        ("tilt of a box at rest, exponent of g", "rest.tilt.gravity", "=", 1, 0.03),
        law("height gained by an elastic box, exponent of h", "energy", 0.05),
        ("height gained by an elastic box in 20 s / m", "energy.early", ">", 2),
        ("height gained by an elastic box in 100 s / m", "energy.late", ">", 5),
        law("overlap in a stack after equal steps, exponent of h", "stack", 0.1),
        ("overlap in a stack listed from the top / m", "stack.reverse", "<", 1.5),
        ("overlap in a stack listed from the bottom / m", "stack.coarse", ">", 2),
        law("a fall ends too low by g h t / 2 / m", "fall", 0.001),
        ("a fall with h/4 ends too low by a quarter of it / m", "fall.fine", "=", 0.049, 0.001),
        ("bounces within the bounds, of 120", "bounce.inside", "=", "bounce.drops"),
        law("speed returned by the best of 41 bounces", "bounce", 0.01),
        law("cubes that cross, 1 − (d + a) / 2vh / %", "tunnel", 0.03),
        ("largest error of the shares in Fig. 3d / %", "tunnel.worst", "<", 1.25),
        ("least v h of a cube that crosses, in units of d + a", "tunnel.least", "=", 0.5, 0.0021),
        (
            "cubes that cross in spite of pulling / %",
            "tunnel.pulledShare",
            "=",
            "tunnel.pulled",
            0.1,
        ),
        law("largest turn of the angular momentum / °", "tumble", 0.001),
        (
            "largest turn of the momentum with h/4 / °",
            "tumble.fine",
            "=",
            "tumble.predicted",
            0.001,
        ),
    ],
    "Constraints": [
        law("steps of a tug through the chain", "tugs", 0),
        ("the law holds at every link, with 1, 4 and 48 sweeps", "tugs.isLaw", "=", 1),
        ("sweeps of the soft step", "tugs.softSweeps", "=", 48),
        ("steps of a tug with as many sweeps", "tugs.equal", "=", 1),
        ("steps of a tug in the soft step", "tugs.cured", "=", 1),
        ("visits allowed by default", "tugs.visits", "=", "tugs.equalVisits", 0.05),
        ("steps of a tug by default", "tugs.default", ">", 5),
        ("steps of a tug by default, without tolerance", "tugs.exact", "=", 1),
        ("largest violation on a bridge, when visits run out / cm", "drift.worst", ">", 10),
        ("largest violation on it otherwise / cm", "drift.finished", "<", 0.1001),
        law("depth below the ground, exponent of h", "clique", 0.12),
        ("depth below the ground / m", "clique.coarse", "=", 0.74, 0.03),
        ("depth below the ground without constraints / m", "clique.without", "<", 1e-06),
    ],
    "Friction": [
        ("largest error of a fast slide against Coulomb's law / %", "sliding.worst", "<", 5),
        ("excess of a slow slide over Coulomb's law / %", "sliding.slow", "=", 24, 0.05),
        ("part of μj used by friction in a fast slide / %", "sliding.used", "=", 100, 1e-9),
        ("part of μj used by friction in creep / %", "sliding.usedCreeping", "<", 80),
        law("creep, exponent of h", "slope", 0.03),
        ("creep in 5 s / m", "slope.coarse", "=", 0.8, 0.03),
        ("slope of the largest excess, h = 0.02 s / °", "slope.peak", "=", "slope.critical", 0.001),
        ("the same, h = 0.005 s / °", "slope.finePeak", "=", "slope.critical", 0.001),
        ("largest error of a slide in the soft step / mm", "slope.softLargest", "<", 5),
        ("inertia of a ball of 42 vertices / (m ρ²)", "rolling.inertia", "=", 0.366, 0.001),
        ("speed missing to it after 4 s / %", "rolling.early", ">", 20),
        ("after 6 s, more / %", "rolling.middle", ">", "rolling.early"),
        ("after 11 s, more / %", "rolling.late", ">", "rolling.middle"),
    ],
    "Cure": [
        ("sway of a box at rest / (°/s)", "rest.sway.cured", "<", 0.01),
        ("height gained by an elastic box / m", "energy.cured", "<", 0.001),
        ("overlap in a stack / m", "stack.cured", "<", 0.01),
        ("cubes that cross / %", "tunnel.cured", "<", 1e-06),
        ("largest turn of the angular momentum, gyroscopic / °", "tumble.cured", "<", 1),
        ("depth of linked bodies below the ground / m", "clique.cured", "<", 0.01),
        ("creep / m", "slope.cured", "<", 0.01),
        ("speed returned by the best of 41 bounces", "bounce.cured", ">", 0.53),
        ("small steps alone, sway / (°/s)", "ablation.small.sway", "=", 7.72 / 6, 0.03),
        ("small steps alone, creep / cm", "ablation.small.creep", "=", 80 / 6, 0.03),
        ("small steps alone, sinking of 20 boxes / m", "ablation.small.sink", ">", 50),
        ("shared contacts alone, sway / (°/s)", "ablation.shared.sway", "<", 0.01),
        ("shared contacts alone, creep / cm", "ablation.shared.creep", "<", 0.1),
        ("shared contacts alone, sinking of 20 boxes / m", "ablation.shared.sink", ">", 1),
        ("both, sinking of 20 boxes / m", "ablation.both.sink", "<", 0.1),
        ("speed left in a stack of ten boxes / (cm/s)", "springs.own", "<", 1),
        ("the same, with springs of 1.2 times the frequency", "springs.stiffer", ">", 5),
    ],
    "Scale": [
        ("pairs tested along one axis, per pair tested by the grid", "pairs.ratio", ">", 3),
        ("bodies that the loop moves in real time", "growth.loopRealTime", "<", 150),
        ("bodies that the soft step moves in real time", "growth.softRealTime", ">", 500),
        ("time of the loop, relative to batches, at 1000 bodies", "growth.gain", ">", 5),
        ("time of the loop before, relative to now", "growth.loopBefore", ">", 1.5),
        ("time of the soft step before, relative to now", "growth.softBefore", "<", 0.97),
        (
            "batches at 5 bodies, above the loop / ms",
            "growth.batchesLeast",
            ">",
            "growth.loopLeast",
        ),
        ("visits saved by the queue on the chains / %", "visits.two_chain", ">", 30),
        *(
            (f"time with the queue, relative to the sweep, {name}", path, ">", 0.97)
            for name, path in QUEUED.items()
        ),
        ("time with batches, relative to the sweep, net", "schedules.net.batches", "<", 0.4),
        ("on the chains", "schedules.two_chain.batches", ">", 1.05),
        ("on the cube", "schedules.cube.batches", ">", 1.05),
        engine("PyBullet at 1000 bodies, above the soft step / ms", "PyBullet", ">", "middle"),
        engine("MuJoCo, CG, at 1000 bodies, above the soft step / ms", "MuJoCoCG", ">", "middle"),
        engine("PyBullet at 200 bodies, below the soft step / ms", "PyBullet", "<", "least"),
        engine("MuJoCo, CG, at 200 bodies, below the soft step / ms", "MuJoCoCG", "<", "least"),
        (
            "PyBullet with 12 iterations, below its default / ms",
            "engines.PyBulletLimited.middle",
            "<",
            "engines.PyBullet.middle",
        ),
        (
            "MuJoCo with 12 iterations, below the soft step / ms",
            "engines.MuJoCoCGLimited.middle",
            "<",
            "engines.soft.middle",
        ),
        ("largest overlap in the soft step / cm", "engines.soft.middleOverlap", "<", 20),
        ("largest overlap in PyBullet / cm", "engines.PyBullet.middleOverlap", "<", 20),
        ("largest overlap in MuJoCo / cm", "engines.MuJoCoCG.middleOverlap", "<", 20),
        ("median speed in the soft step / (cm/s)", "engines.soft.middleSpeed", "<", 1),
        ("median speed in PyBullet / (cm/s)", "engines.PyBullet.middleSpeed", "<", 1),
        ("median speed in MuJoCo / (cm/s)", "engines.MuJoCoCG.middleSpeed", ">", 10),
        (
            "largest overlap in PyBullet then / cm",
            "engines.PyBulletLimited.middleOverlap",
            ">",
            "engines.PyBullet.middleOverlap",
        ),
        (
            "largest overlap in MuJoCo then / cm",
            "engines.MuJoCoCGLimited.middleOverlap",
            ">",
            "engines.MuJoCoCG.middleOverlap",
        ),
    ],
    "Limits": [
        ("overlap of a box with one 1000 times lighter / cm", "ratios.thousand", ">", 10),
        ("more than with one 100 times lighter / cm", "ratios.thousand", ">", "ratios.hundred"),
    ],
}
CLAIMS = [Claim(section, *row) for section, rows in SECTIONS.items() for row in rows]
# Paths of the rows whose effect grows as a power of h, and of those whose size is compared as well.
SIZED = ("rest.sway", "rest.tilt", "clique", "slope")
POWERS = (*SIZED, "stack", "energy")


def summary(numbers):
    """The conclusion's numbers, in per cent: largest errors of an exponent and of a size.

    Sizes are compared between h and h / 4: at equal times, or for the stack at equal steps.
    """
    laws = {path: value(numbers, f"{path}.predicted") for path in POWERS}
    exponents = [abs(value(numbers, f"{path}.measured") / laws[path] - 1) for path in POWERS]
    sizes = [
        abs(value(numbers, f"{path}.coarse") / value(numbers, f"{path}.fine") / 4 ** laws[path] - 1)
        for path in SIZED
    ]
    stack = numbers["stack"]
    sizes.append(abs(stack["coarse"] / stack["quarter"] / 4 ** laws["stack"] - 1))
    return {"worst": 100 * max(exponents), "sizes": 100 * max(sizes)}


def value(numbers, path):
    """Looks a number up by "group.key"; NaN, which satisfies no claim, if it was not measured."""
    if not isinstance(path, str):
        return path
    for key in path.split("."):
        numbers = numbers.get(key, {})
    return numbers if isinstance(numbers, float | int) else float("nan")


def holds(claim, numbers):
    measured, reference = value(numbers, claim.measured), value(numbers, claim.law)
    if claim.relation == "=":
        return abs(measured - reference) <= claim.within * abs(reference)
    return measured < reference if claim.relation == "<" else measured > reference


def line(claim, numbers):
    """Returns `(sentence, measured value, relation with law or bound)`, as text."""
    within = f" within {100 * claim.within:g} %" if claim.within else ""
    reference = f"{claim.relation} {value(numbers, claim.law):.4g}{within}"
    return claim.sentence, f"{value(numbers, claim.measured):.4g}", reference


def broken(numbers):
    """Returns a line for each claim that does not hold."""
    wrong = [claim for claim in CLAIMS if not holds(claim, numbers)]
    return [f"{claim.section}: {' '.join(line(claim, numbers))}" for claim in wrong]


HEAD = """# Claims of the report, and what measures them

Written by `python report/build.py`, which exits with 1 if a claim does not hold.
`python report/build.py --only NAME` measures one again. Tests hold the rest: depths are exact
(`tests/geometry/test_gjk.py`), friction only slows the sliding (`tests/stepping/test_friction.py`),
and the same bits come from grid, batches and loop (`tests/geometry/test_broadPhase.py`), and from
queue and sweep (`tests/stepping/test_constraints.py`).

| section | claim | measured | law or bound | by | holds |
|---|---|---|---|---|---|
"""


def table(numbers):
    """Returns the text of claims.md."""
    rows = []
    for claim in CLAIMS:
        verdict = "yes" if holds(claim, numbers) else "**no**"
        cells = claim.section, *line(claim, numbers), f"`{claim.measured.split('.')[0]}`", verdict
        rows.append(f"| {' | '.join(cells)} |\n")
    return HEAD + "".join(rows)
