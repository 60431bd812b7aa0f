"""Claims of the report: measured values beside those that a law predicts, or beside a bound.

`broken` lists the claims that do not hold, which fails the build; `table` writes all to claims.md.
"""

from typing import NamedTuple


class Claim(NamedTuple):
    """A sentence, and what must be true of the numbers.

    section : of the report; sentence : in its words; measured : path in numbers.json
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


# section → claims as (sentence, measured, relation, law, within)
SECTIONS = {
    "Movement": [
        law("sway grows as g h: exponent of h", "rest.sway", 0.03),
        ("the same exponent of g", "rest.sway.gravity", "=", 1, 0.03),
        law("tilt grows as g h²: exponent of h", "rest.tilt", 0.03),
        ("exponent of g", "rest.tilt.gravity", "=", 1, 0.03),
        law("an elastic box gains height as g h²", "energy", 0.05),
        ("it rises on: 20 s / m", "energy.early", ">", 2),
        ("100 s / m", "energy.late", ">", 5),
        ("with e = ½ the gain ends / cm", "energy.half", "<", 5),
        law("overlap after equal steps grows as g h²", "stack", 0.1),
        ("the order counts: listed from the top / m", "stack.reverse", "<", 1.5),
        ("and from the ground / m", "stack.coarse", ">", 2),
        law("Euler falls g h t / 2 too low / m", "fall", 0.001),
        ("with a quarter of the step, a quarter", "fall.fine", "=", 0.049, 0.001),
        ("all drops are within the bounds", "bounce.inside", "=", "bounce.drops"),
        law("the largest of 41 drops reaches the bound", "bounce", 0.01),
        law("cubes that cross: 1 - (d + a) / (2 v h) / %", "tunnel", 0.03),
        ("drawn shares differ from the law / %", "tunnel.worst", "<", 1.25),
        ("the least v h that crosses / (d + a)", "tunnel.least", "=", 0.5, 0.0021),
        ("pulled: 1 - (d + a) / v h", "tunnel.pulledShare", "=", "tunnel.pulled", 0.1),
        ("with e = 0.8 some are pulled through / %", "tunnel.elastic", ">", 30),
        law("L swings by twice its angle to ω / °", "tumble", 0.001),
        ("whatever the step / °", "tumble.fine", "=", "tumble.predicted", 0.001),
    ],
    "Constraints": [
        law("a tug takes (k - 1) / s steps", "tugs", 0),
        ("at every link, with 1, 4 and 48 sweeps", "tugs.isLaw", "=", 1),
        ("the soft step makes 48 sweeps", "tugs.softSweeps", "=", 48),
        ("with them, a tug arrives at once", "tugs.equal", "=", 1),
        ("in the soft step, too", "tugs.cured", "=", 1),
        ("the default's visits are as many", "tugs.visits", "=", "tugs.equalVisits", 0.05),
        ("with its tolerance it takes longer", "tugs.default", ">", 5),
        ("with none it does not", "tugs.exact", "=", 1),
        ("with one sweep the chain hardly hangs / m", "tugs.sag", ">", 15),
        ("below its fall in free flight / m", "tugs.sag", "<", "tugs.free"),
        ("with 48 it hangs / cm", "tugs.sagEqual", "<", 10),
        ("violations stay where visits run out / cm", "drift.worst", ">", 10),
        law("depth below the ground is about as h", "clique", 0.12),
        ("without constraints none is below / m", "clique.without", "<", 1e-06),
    ],
    "Friction": [
        ("slides deviate from Coulomb's law / %", "sliding.worst", "<", 5),
        ("in a slide, friction is at its limit / %", "sliding.used", "=", 100, 1e-9),
        ("in creep it is not / %", "sliding.usedCreeping", "<", 80),
        law("creep grows as g h: exponent of h", "slope", 0.03),
        ("the soft step slides as Coulomb has it / mm", "slope.softLargest", "<", 5),
        ("a ball slows down / %", "rolling.coarse", ">", 60),
        ("with finer facets less / %", "rolling.fine", "<", 20),
    ],
    "Cure": [
        ("the box lies still / (°/s)", "rest.sway.cured", "<", 0.01),
        ("an elastic one gains nothing / m", "energy.cured", "<", 0.001),
        ("the stack stands: overlap / m", "stack.cured", "<", 0.01),
        ("no cube crosses / %", "tunnel.cured", "<", 1e-06),
        ("the momentum hardly swings / °", "tumble.cured", "<", 1),
        ("linked bodies hardly enter the ground / m", "clique.cured", "<", 0.01),
        ("the box stays on the slope / m", "slope.cured", "<", 0.01),
        ("bounces are no better", "bounce.cured", ">", 0.53),
        ("small steps alone: still a sixth of the sway", "ablation.small.sway", ">", 1),
        ("and a sixth of the creep / cm", "ablation.small.creep", ">", 10),
        ("and the tall stack falls / m", "ablation.small.sink", ">", 20),
        ("shared contacts alone stop rocking / (°/s)", "ablation.shared.sway", "<", 0.01),
        ("and creep / cm", "ablation.shared.creep", "<", 0.1),
        ("but the tall stack sinks / m", "ablation.shared.sink", ">", 1),
        ("with both it does not / m", "ablation.both.sink", "<", 0.1),
    ],
    "Scale": [
        ("one axis tests more pairs", "pairs.ratio", ">", 3),
        ("another order is a metre away after / s", "chaos.seconds", "<", 4),
        ("from 20 to 1000 bodies, pairs grow more than bodies", "batches.pairs", ">", 50),
        ("batches less", "batches.batches", "<", 20),
        ("passes made again in a step, on average", "batches.again", "<", 2),
        ("batches are faster than the loop", "growth.gain", ">", 5),
        ("the loop before took longer", "growth.loopBefore", ">", 1.5),
        ("batches as long", "growth.batchesBefore", "=", 1, 0.2),
        ("the soft step less: slower now / %", "growth.softSlower", ">", 0),
        ("not with few bodies / ms", "growth.batchesLeast", ">", "growth.loopLeast"),
        ("with the grid, the loop keeps most of its time / %", "growth.gridShare", ">", 50),
        ("the queue saves visits on the net / %", "visits.net", ">", 30),
        ("and on the chains / %", "visits.two_chain", ">", 30),
        ("none on the bridge / %", "visits.bridge", "<", 1),
        ("none on the cube / %", "visits.cube", "<", 1),
        ("the net gains less time / %", "schedules.net.gained", "<", "visits.net"),
        ("so do the chains", "schedules.two_chain.gained", "<", "visits.two_chain"),
        ("batches are faster on the net", "schedules.net.batchesGain", ">", 3),
        engine("at 1000 at rest, PyBullet is slower", "PyBullet", ">", "middle"),
        engine("and MuJoCo with CG", "MuJoCoCG", ">", "middle"),
        engine("at 200, PyBullet is faster", "PyBullet", "<", "least"),
        engine("so is MuJoCo with CG", "MuJoCoCG", "<", "least"),
        engine("PyBullet's overlap is not the smaller / cm", "PyBullet", ">", "middleOverlap"),
        engine("nor its speed / (cm/s)", "PyBullet", ">", "middleSpeed"),
        engine("MuJoCo moves faster / (cm/s)", "MuJoCoCG", ">", "middleSpeed"),
    ],
    "Limits": [
        ("a box on a thousandth of it sinks in / cm", "ratios.thousand", ">", 10),
        ("more than on a hundredth / cm", "ratios.thousand", ">", "ratios.hundred"),
        ("sleep stops a box that slides / (cm/s)", "sleepers.left", "=", 0),
        ("which else slides on", "sleepers.awake", "=", "sleepers.speed", 0.001),
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
