"""Claims of the report: measured values beside those that a law predicts, or beside a bound.

`broken` lists the claims that do not hold, which fails the build; `table` writes all to claims.md.
"""

from typing import NamedTuple


class Claim(NamedTuple):
    """A sentence, and what must be true of the numbers.

    where : section; sentence : in the report's words; measured : path in numbers.json
    relation : "=", "<" or ">"; law : path or number; within : largest relative deviation from "="
    """

    where: str
    sentence: str
    measured: str
    relation: str
    law: object
    within: float = 0.0


def law(where, sentence, name, within):
    return Claim(where, sentence, f"{name}.measured", "=", f"{name}.predicted", within)


def slower(sentence, engine, relation, size):
    return Claim("Scale", sentence, f"engines.{engine}", relation, f"engines.soft.{size}")


CLAIMS = [
    Claim(
        "Introduction",
        "the pyramid sinks with the basic step / cm",
        "standing.pyramidBasic",
        ">",
        600,
    ),
    Claim("Introduction", "depths are exact: largest error / size", "depths.worst", "<", 1e-12),
    Claim("Introduction", "many random pairs overlap", "depths.hits", ">", 50),
    Claim("Introduction", "of which none is missed", "depths.missed", "=", 0),
    Claim("Introduction", "a cube in the notch of a concave body is hit", "concave.isHit", "=", 1),
    Claim("Introduction", "though it touches no part of it", "concave.parts", "=", 0),
    law("Movement", "sway grows as g h: exponent of h", "rest.sway", 0.03),
    Claim("Movement", "the same exponent of g", "rest.sway.gravity", "=", 1, 0.03),
    law("Movement", "tilt grows as g h²: exponent of h", "rest.tilt", 0.03),
    Claim("Movement", "exponent of g", "rest.tilt.gravity", "=", 1, 0.03),
    law("Movement", "an elastic box gains height as g h²", "energy", 0.05),
    Claim("Movement", "it rises on: 20 s / m", "energy.early", ">", 2),
    Claim("Movement", "100 s / m", "energy.late", ">", 5),
    Claim("Movement", "with e = ½ the gain ends / cm", "energy.half", "<", 5),
    law("Movement", "overlap after equal steps grows as g h²", "stack", 0.1),
    Claim("Movement", "the order counts: listed from the top / m", "stack.reverse", "<", 1.5),
    Claim("Movement", "and from the ground / m", "stack.coarse", ">", 2),
    law("Movement", "Euler falls g h t / 2 too low / m", "fall", 1e-3),
    Claim("Movement", "with a quarter of the step, a quarter", "fall.fine", "=", 0.049, 1e-3),
    Claim("Movement", "all drops are within the bounds", "bounce.inside", "=", "bounce.drops"),
    law("Movement", "the largest of 41 drops reaches the bound", "bounce", 0.01),
    law("Movement", "cubes that cross: 1 - (d + a) / (2 v h) / %", "tunnel", 0.03),
    Claim("Movement", "drawn shares differ from the law / %", "tunnel.worst", "<", 1.25),
    Claim("Movement", "the least v h that crosses / (d + a)", "tunnel.least", "=", 0.5, 0.0021),
    Claim("Movement", "pulled: 1 - (d + a) / v h", "tunnel.pulledShare", "=", "tunnel.pulled", 0.1),
    Claim("Movement", "with e = 0.8 some are pulled through / %", "tunnel.elastic", ">", 30),
    law("Movement", "L swings by twice its angle to ω / °", "tumble", 1e-3),
    Claim("Movement", "whatever the step / °", "tumble.fine", "=", "tumble.predicted", 1e-3),
    Claim("Movement", "some impulses pull / %", "pulling.share", ">", 10),
    law("Constraints", "a tug takes (k - 1) / s steps", "tugs", 0),
    Claim("Constraints", "at every link, with 1, 4 and 48 sweeps", "tugs.isLaw", "=", 1),
    Claim("Constraints", "the soft step makes 48 sweeps", "tugs.softSweeps", "=", 48),
    Claim("Constraints", "with them, a tug arrives at once", "tugs.equal", "=", 1),
    Claim("Constraints", "in the soft step, too", "tugs.cured", "=", 1),
    Claim(
        "Constraints",
        "the default's visits are as many",
        "tugs.visits",
        "=",
        "tugs.equalVisits",
        0.05,
    ),
    Claim("Constraints", "with its tolerance it takes longer", "tugs.default", ">", 5),
    Claim("Constraints", "with none it does not", "tugs.exact", "=", 1),
    Claim("Constraints", "with one sweep the chain hardly hangs / m", "tugs.sag", ">", 15),
    Claim("Constraints", "below its fall in free flight / m", "tugs.sag", "<", "tugs.free"),
    Claim("Constraints", "with 48 it hangs / cm", "tugs.sagEqual", "<", 10),
    Claim("Constraints", "violations stay where visits run out / cm", "swing.driftBasic", ">", 10),
    Claim("Constraints", "less in the soft step / cm", "swing.driftSoft", "<", 2),
    Claim("Constraints", "a pendulum loses energy: kept / %", "swing.basic", "<", 75),
    Claim("Constraints", "less of it with h/4 / %", "swing.fine", ">", "swing.basic"),
    Claim("Constraints", "none in the soft step / %", "swing.soft", "=", 100, 0.005),
    law("Constraints", "depth below the ground is about as h", "clique", 0.12),
    Claim("Constraints", "without constraints none is below / m", "clique.without", "<", 1e-6),
    Claim("Friction", "friction adds energy: impacts of many", "dissipation.added", "=", 0),
    Claim("Friction", "it reverses the sliding", "dissipation.reversals", "=", 0),
    Claim("Friction", "of so many impacts", "dissipation.hits", ">", 50),
    Claim("Friction", "slides deviate from Coulomb's law / %", "sliding.worst", "<", 5),
    law("Friction", "creep grows as g h: exponent of h", "slope", 0.03),
    Claim("Friction", "the soft step slides as Coulomb has it / mm", "slope.softLargest", "<", 5),
    Claim("Friction", "a ball slows down / %", "rolling.coarse", ">", 20),
    Claim("Friction", "ever more / %", "rolling.coarseLate", ">", 60),
    Claim("Friction", "with finer facets less / %", "rolling.fineLate", "<", 20),
    Claim("Cure", "the box lies still / (°/s)", "rest.sway.cured", "<", 0.01),
    Claim("Cure", "an elastic one gains nothing / m", "energy.cured", "<", 1e-3),
    Claim("Cure", "the stack stands: overlap / m", "stack.cured", "<", 0.01),
    Claim("Cure", "no cube crosses / %", "tunnel.cured", "<", 1e-6),
    Claim("Cure", "the momentum hardly swings / °", "tumble.cured", "<", 1),
    Claim("Cure", "linked bodies hardly enter the ground / m", "clique.cured", "<", 0.01),
    Claim("Cure", "the box stays on the slope / m", "slope.cured", "<", 0.01),
    Claim("Cure", "bounces are no better", "bounce.cured", ">", 0.53),
    Claim("Cure", "but with the basic step and h/6", "bounce.sixth", "<", 0.51),
    Claim("Cure", "small steps alone: still a sixth of the sway", "ablation.small.sway", ">", 1),
    Claim("Cure", "and a sixth of the creep / cm", "ablation.small.creep", ">", 10),
    Claim("Cure", "and the tall stack falls / m", "ablation.small.sink", ">", 20),
    Claim("Cure", "shared contacts alone stop rocking / (°/s)", "ablation.shared.sway", "<", 0.01),
    Claim("Cure", "and creep / cm", "ablation.shared.creep", "<", 0.1),
    Claim("Cure", "but the tall stack sinks / m", "ablation.shared.sink", ">", 1),
    Claim("Cure", "with both it does not / m", "ablation.both.sink", "<", 0.1),
    Claim("Cure", "the stack of twenty stands: sinks / cm", "standing.stackSoft", "<", 10),
    Claim("Cure", "the pyramid stands: sinks / cm", "standing.pyramidSoft", "<", 10),
    Claim("Scale", "one axis tests more pairs", "pairs.ratio", ">", 3),
    Claim("Scale", "grid, batches and loop: largest difference", "bits.difference", "=", 0),
    Claim("Scale", "another order is a metre away after / s", "bits.apart", "<", 4),
    Claim("Scale", "batches hold many pairs", "batches.mean", ">", 10),
    Claim("Scale", "passes made again in a step, on average", "batches.again", "<", 2),
    Claim("Scale", "batches are faster than the loop", "growth.gain", ">", 5),
    Claim("Scale", "not with few bodies / ms", "growth.batchesLeast", ">", "growth.loopLeast"),
    Claim(
        "Scale", "the grid's pairs are no longer the cost", "growth.grid", ">", "growth.halfLoop"
    ),
    *(
        Claim(
            "Scale",
            f"queue and sweep on {name}: largest difference",
            f"visits.{name}.difference",
            "=",
            0,
        )
        for name in ("net", "two_chain", "bridge", "cube")
    ),
    Claim("Scale", "the queue saves visits on the net / %", "visits.net.saved", ">", 30),
    Claim("Scale", "and on the chains / %", "visits.two_chain.saved", ">", 30),
    Claim("Scale", "none on the bridge / %", "visits.bridge.saved", "<", 1),
    Claim("Scale", "none on the cube / %", "visits.cube.saved", "<", 1),
    Claim("Scale", "the net gains less time / %", "schedules.net.gained", "<", "visits.net.saved"),
    Claim("Scale", "so do the chains", "schedules.two_chain.gained", "<", "visits.two_chain.saved"),
    Claim("Scale", "batches are faster on the net", "schedules.net.batchesGain", ">", 3),
    slower("at 1000 at rest, PyBullet is slower", "PyBullet.middle", ">", "middle"),
    slower("and MuJoCo with CG", "MuJoCoCG.middle", ">", "middle"),
    slower("at 5000, so is MuJoCo with CG", "MuJoCoCG.most", ">", "most"),
    slower("at 200, PyBullet is faster", "PyBullet.least", "<", "least"),
    slower("so is MuJoCo with CG", "MuJoCoCG.least", "<", "least"),
    slower("its overlap is not the larger / cm", "PyBullet.middleOverlap", ">", "middleOverlap"),
    slower("nor its speed / (cm/s)", "PyBullet.middleSpeed", ">", "middleSpeed"),
    slower("MuJoCo moves faster / (cm/s)", "MuJoCoCG.middleSpeed", ">", "middleSpeed"),
    Claim("Limits", "a box on a thousandth of it sinks in / cm", "ratios.thousandSoft", ">", 10),
    Claim(
        "Limits", "more than on a hundredth / cm", "ratios.thousandSoft", ">", "ratios.hundredSoft"
    ),
]
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
    return [f"{claim.where}: {' '.join(line(claim, numbers))}" for claim in wrong]


HEAD = """# Claims of the report, and what measures them

Written by `python report/build.py`, which exits with 1 if a claim does not hold.
`python report/build.py --only NAME` measures one again.

| section | claim | measured | law or bound | by | holds |
|---|---|---|---|---|---|
"""


def table(numbers):
    """Returns the text of claims.md."""
    rows = []
    for claim in CLAIMS:
        verdict = "yes" if holds(claim, numbers) else "**no**"
        cells = claim.where, *line(claim, numbers), f"`{claim.measured.split('.')[0]}`", verdict
        rows.append(f"| {' | '.join(cells)} |\n")
    return HEAD + "".join(rows)
