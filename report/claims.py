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
    law("Movement", "sway grows as g h: exponent of h", "rest.sway", 0.03),
    Claim("Movement", "the same exponent of g", "rest.sway.gravity", "=", 1, 0.03),
    law("Movement", "tilt grows as g h²: exponent of h", "rest.tilt", 0.03),
    Claim("Movement", "exponent of g", "rest.tilt.gravity", "=", 1, 0.03),
    law("Movement", "overlap after equal steps grows as g h²", "stack", 0.1),
    law("Movement", "Euler falls g h t / 2 too low / m", "fall", 1e-3),
    Claim("Movement", "with a quarter of the step, a quarter", "fall.fine", "=", 0.049, 1e-3),
    Claim("Movement", "all drops are within the bounds", "bounce.inside", "=", "bounce.drops"),
    law("Movement", "cubes that cross: 1 - (d + a) / (2 v h) / %", "tunnel", 0.03),
    Claim("Movement", "drawn shares differ from the law / %", "tunnel.worst", "<", 1.25),
    Claim("Movement", "the least v h that crosses / (d + a)", "tunnel.least", "=", 0.5, 0.0021),
    Claim("Movement", "pulled: 1 - (d + a) / v h", "tunnel.pulledShare", "=", "tunnel.pulled", 0.1),
    law("Movement", "L swings by twice its angle to ω / °", "tumble", 1e-3),
    Claim("Movement", "whatever the step / °", "tumble.fine", "=", "tumble.predicted", 1e-3),
    Claim("Movement", "some impulses pull / %", "pulling.share", ">", 10),
    law("Constraints", "a tug takes (k - 1) / s steps", "tugs", 0),
    Claim("Constraints", "at every link, with 1 and 4 sweeps", "tugs.isLaw", "=", 1),
    Claim("Constraints", "with one sweep the chain hardly hangs / m", "tugs.sag1", ">", 15),
    Claim("Constraints", "below its fall in free flight / m", "tugs.sag1", "<", "tugs.free"),
    Claim("Constraints", "with the soft step it hangs: sag / mm", "tugs.sagSoft", "<", 10),
    law("Constraints", "depth below the ground is about as h", "clique", 0.12),
    Claim("Constraints", "without constraints none is below / m", "clique.without", "<", 1e-6),
    law("Friction", "creep grows as g h: exponent of h", "slope", 0.03),
    Claim("Friction", "facets cost speed / %", "rolling.coarse", ">", "rolling.fine"),
    Claim("Cure", "the box lies still / (°/s)", "rest.sway.cured", "<", 0.01),
    Claim("Cure", "the stack stands: overlap / m", "stack.cured", "<", 0.01),
    Claim("Cure", "no cube crosses / %", "tunnel.cured", "<", 1e-6),
    Claim("Cure", "the momentum hardly swings / °", "tumble.cured", "<", 1),
    Claim("Cure", "no vertex is pressed into the ground / m", "clique.cured", "<", 0.01),
    Claim("Cure", "the box stays on the slope / m", "slope.cured", "<", 0.01),
    Claim("Cure", "the stack of twenty stands: sinks / cm", "standing.stackSoft", "<", 10),
    Claim("Cure", "the pyramid stands: sinks / cm", "standing.pyramidSoft", "<", 10),
    Claim("Cure", "with the basic step the stack collapses / cm", "standing.stackBasic", ">", 600),
    Claim("Cure", "and the pyramid / cm", "standing.pyramidBasic", ">", 600),
    Claim("Scale", "one axis tests more pairs, at the start", "pairs.startRatio", ">", 5),
    Claim("Scale", "and in the collapsing heap", "pairs.ratio", ">", 3),
    Claim("Scale", "grid and loop: largest difference", "bits.difference", "=", 0),
    Claim("Scale", "batches hold many pairs", "batches.mean", ">", 10),
    Claim("Scale", "few pairs are processed again / %", "batches.again", "<", 10),
    Claim("Scale", "queue and sweep: largest difference", "schedules.net.difference", "=", 0),
    Claim("Scale", "the queue saves visits on the net / %", "schedules.net.saved", ">", 30),
    Claim("Scale", "and on the chains / %", "schedules.two_chain.saved", ">", 30),
    Claim("Scale", "none on the bridge / %", "schedules.bridge.saved", "<", 1),
    Claim("Scale", "batches are faster on the net", "choice.batchesNet", ">", 3),
    Claim("Scale", "the grid is faster than the loop", "choice.gain", ">", 5),
    slower("at 1000 at rest, PyBullet is slower", "PyBullet.middle", ">", "middle"),
    slower("and MuJoCo with CG", "MuJoCoCG.middle", ">", "middle"),
    slower("at 5000, so is MuJoCo with CG", "MuJoCoCG.most", ">", "most"),
    slower("at 200, PyBullet is faster", "PyBullet.least", "<", "least"),
    Claim("Scale", "facets take most time / %", "parts.find_facets", ">", "parts.find_contacts"),
]


def summary(numbers):
    """The conclusion's numbers: largest deviation of a law, in per cent, and the slower engine."""
    found = [
        abs(value(numbers, claim.measured) / value(numbers, claim.law) - 1)
        for claim in CLAIMS
        if claim.measured.endswith(".measured")
    ]
    peers = value(numbers, "engines.PyBullet.middle") / value(numbers, "engines.soft.middle")
    return {"worst": 100 * max(found), "peers": peers, "stack": 1e3 * numbers["stack"]["cured"]}


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
