"""Claims of the report, their measurements, and their check against the numbers.

Each sentence of the report that says more than a number ("grows", "more than", "saves nothing") has
a claim here, with a condition on numbers.json. `contradictions` lists the claims that do not hold,
which fail the build. `table` writes all claims to claims.md, with the commands that measure them.
"""

import math
import re
from typing import NamedTuple


class Claim(NamedTuple):
    """A sentence of the report.

    where : page or figure; sentence : in words, with {group.key} for numbers; holds : condition, a
        function of a function that looks numbers up by "group.key", or None if there is no
        condition
    """

    where: str
    sentence: str
    holds: object


def lookup(numbers, path):
    """Returns a number as text, by "group.key" or "group.inner.key"; "nan" if unmeasured."""
    for key in path.split("."):
        numbers = numbers.get(key, {})
    return numbers or "nan"  # no condition on it is true


def value(numbers, path):
    """Parses a number, which may have thin spaces and a proper minus sign; "fallen" is infinite."""
    words = {"\u202f": "", "−": "-", "fallen": "inf"}
    number = lookup(numbers, path)
    for word, replacement in words.items():
        number = number.replace(word, replacement)
    return float(number)


def near(a, b, tolerance):
    return abs(a / b - 1.0) <= tolerance


CLAIMS = [
    Claim(
        "Movement",
        "a box put down flat tilts by {rest.tilt}° and sways with {rest.sway}°/s",
        lambda v: v("rest.tilt") > 0.02 and v("rest.sway") > 1,
    ),
    Claim(
        "Movement",
        "with a step {rest.finer} times finer, the sway is {rest.swayRatio} times "
        "smaller, as h, and the tilt {rest.tiltRatio} times, as h²",
        lambda v: (
            near(v("rest.swayRatio"), v("rest.finer"), 0.25)
            and near(v("rest.tiltRatio"), v("rest.finer") ** 2, 0.35)
        ),
    ),
    Claim(
        "Movement",
        "overlaps grow with the stack: {stack.up4} m for four boxes, {stack.up8} m "
        "for eight; listed from the top {stack.down8} m",
        lambda v: (
            v("stack.up2") < v("stack.up4") < v("stack.up8") < v("stack.up10")
            and v("stack.down8") < 0.8 * v("stack.up8")
        ),
    ),
    Claim(
        "Movement",
        "ten boxes overlap by {stack.up10} m, more than half a box",
        lambda v: v("stack.up10") > v("stack.half"),
    ),
    Claim(
        "Movement",
        "of the impulses in a collapsing heap, {separating.share} % pull",
        lambda v: v("separating.share") > 1,
    ),
    Claim(
        "Movement",
        "in one bounce either error may win: {restitution.keptLeast} to "
        "{restitution.keptMost} of the speed is kept",
        lambda v: v("restitution.keptLeast") < v("constants.e") < v("restitution.keptMost"),
    ),
    Claim(
        "Movement",
        "over many the loss wins: {restitution.most} to {restitution.least} %",
        lambda v: 0 < v("restitution.most") < v("restitution.least"),
    ),
    Claim(
        "Movement",
        "the position is of first order: p = {order.slope}",
        lambda v: abs(v("order.slope") - 1) < 0.02,
    ),
    Claim(
        "Movement",
        "a finer step does not mend the orientation: {order.turnCoarse}° and {order.turnFine}°",
        lambda v: near(v("order.turnFine"), v("order.turnCoarse"), 0.1),
    ),
    Claim(
        "Movement",
        "the angular momentum swings by {gyroscopic.angle}°; with the gyroscopic "
        "term by {gyroscopic.mended}°",
        lambda v: v("gyroscopic.mended") < 0.1 * v("gyroscopic.angle"),
    ),
    Claim(
        "Movement",
        "the least speed that crosses is {tunnelling.range} (d + a)/h in all cases",
        lambda v: 0.45 < v("tunnelling.least") <= v("tunnelling.most") < 0.6,
    ),
    Claim(
        "Constraints",
        "chains stretch more the more links they have: {stretch.at5}, "
        "{stretch.at10}, {stretch.at20} %, and more with one sweep",
        lambda v: (
            v("stretch.at5") < v("stretch.at10") < v("stretch.at20")
            and all(v(f"stretch.one{k}") > 3 * v(f"stretch.at{k}") for k in (5, 10, 20))
        ),
    ),
    Claim(
        "Constraints",
        "constraints push vertices {cliques.deepest} m below the ground, without "
        "them it is {cliques.deepestWithout} m",
        lambda v: v("cliques.deepest") > 0.5 > 3 * v("cliques.deepestWithout"),
    ),
    Claim(
        "Constraints",
        "overlaps of the two chains: {corrections.most} cm after the projection, "
        "{corrections.mostBefore} cm without it",
        lambda v: v("corrections.most") > 3 * v("corrections.mostBefore"),
    ),
    Claim(
        "Constraints",
        "constrained bodies spin more at rest: {cliques.constrained} rad/s, "
        "without constraints {cliques.unconstrained} rad/s",
        lambda v: v("cliques.constrained") > 1.2 * v("cliques.unconstrained"),
    ),
    Claim(
        "Friction",
        "a box stops {stopping.excess} m beyond theory, with a step {stopping.finer} "
        "times finer {stopping.excessFine} m",
        lambda v: 0 < v("stopping.excessFine") < 0.5 * v("stopping.excess"),
    ),
    Claim(
        "Friction",
        "below the friction angle the box creeps {incline.creepLeast} to "
        "{incline.creep} m; half the step makes it {incline.halved} times as much",
        lambda v: v("incline.creepLeast") > 0.1 and 0.3 < v("incline.halved") < 0.7,
    ),
    Claim(
        "Friction",
        "rolling: {rolling.missing1} % below 5/7 with {rolling.vertices1} vertices, "
        "{rolling.missing3} % with {rolling.vertices3}",
        lambda v: v("rolling.missing3") < 0.6 * v("rolling.missing1"),
    ),
    Claim(
        "Scale",
        "of {grid.near} bodies in nine columns, {grid.alongX} are in the range along x "
        "and {grid.partners} overlap",
        lambda v: v("grid.partners") < v("grid.alongX") < v("grid.near") < v("grid.bodies"),
    ),
    Claim(
        "Scale",
        "the floor is a level of its own",
        lambda v: v("grid.levels") == 2 and v("grid.large") == 1,
    ),
    Claim(
        "Scale",
        "candidates grow as N to the {candidates.exponent}, {candidates.share} % of all "
        "pairs at the end",
        lambda v: v("candidates.exponent") < 1.3 and v("candidates.share") < 1,
    ),
    Claim(
        "Scale",
        "one sorted axis gives {candidates.axisRatio} times as many, a tree of centres "
        "{candidates.treeRatio} times",
        lambda v: (
            v("candidates.axisRatio") > 5
            and v("candidates.treeRatio") > 1.5
            and v("candidates.axisExponent") > v("candidates.exponent") + 0.2
        ),
    ),
    Claim(
        "Scale",
        "{batches.pairs} pairs make {batches.batches} batches of {batches.size}",
        lambda v: v("batches.size") > 5,
    ),
    Claim(
        "Scale",
        "grid and loop have the same bits: the difference is {samebits.grid}",
        lambda v: v("samebits.grid") == 0,
    ),
    Claim(
        "Scale",
        "another order is a metre away after {samebits.reversedMetre} s; one bit grows "
        "by {samebits.decades} decades",
        lambda v: (
            v("samebits.reversedMetre") < v("samebits.seconds") and v("samebits.decades") >= 3
        ),
    ),
    Claim(
        "Scale",
        "no step of a collapsing heap is rolled back, the first one of a squeezed heap "
        "takes {batches.drawnPasses} passes, {batches.cost} times the detection",
        lambda v: (
            v("batches.again") == 0 and v("batches.drawnPasses") > 1 and v("batches.drawnNew") > 0
        ),
    ),
    Claim(
        "Scale",
        "the queue saves {schedules.bridge.saved} % of the visits on the bridge, and "
        "{schedules.net.saved} % on the net",
        lambda v: v("schedules.bridge.saved") < 1 and v("schedules.net.saved") > 20,
    ),
    Claim(
        "Scale",
        "batches of constraints are {scheduling.net.batchesFaster} times as fast on the net",
        lambda v: v("scheduling.net.batchesFaster") > 1.5,
    ),
    Claim(
        "Scale",
        "and leave {schedules.bridge.worstRatio} times the violation on the bridge",
        lambda v: v("schedules.bridge.worstRatio") > 1.1,
    ),
    Claim(
        "Scale",
        "the loop takes {scale.loopLooped} ms for {scale.looped} bodies, the grid "
        "{scale.gridLooped}",
        lambda v: v("scale.loopRatio") > 1.5,
    ),
    Claim(
        "Scale",
        "the grid's time grows as N to the {scale.gridExponent}, from several sizes",
        lambda v: v("scale.gridExponent") < 1.6 and v("scale.gridPoints") >= 4,
    ),
    Claim(
        "Scale",
        "with the basic solver a heap still moves with {resting.basicSpeed} mm/s",
        lambda v: v("resting.basicSpeed") > 100,
    ),
    Claim(
        "Scale",
        "with the soft-step solver it rests: {resting.softSpeed} mm/s",
        lambda v: v("resting.softSpeed") < 1,
    ),
    Claim(
        "Table 2",
        "stack and pyramid stand with the soft-step solver, sunk by "
        "{standing.stackSoft} and {standing.pyramidSoft} cm",
        lambda v: v("standing.stackSoft") < 20 and v("standing.pyramidSoft") < 20,
    ),
    Claim(
        "Table 2",
        "what sleeps is cheaper than what is awake: {restTimes.softLate} and "
        "{restTimes.softAwake} ms",
        lambda v: v("restTimes.softLate") < v("restTimes.softAwake"),
    ),
    Claim(
        "Table 2",
        "with the basic solver both end up {standing.stackBasic}",
        lambda v: math.inf == v("standing.stackBasic") == v("standing.pyramidBasic"),
    ),
    Claim(
        "Table 2",
        "tops with MuJoCo have sunk by {standing.stackMujoco} and "
        "{standing.pyramidMujoco} cm, with PyBullet by {standing.stackPybullet} and "
        "{standing.pyramidPybullet} cm",
        None,
    ),
    Claim(
        "Scale",
        "like with like, the grid takes {scale.mujocoCGFrictionRatio} times as long as "
        "MuJoCo (CG) and {scale.pybulletFrictionRatio} times as long as PyBullet with friction, "
        "{scale.mujocoCGSlickRatio} and {scale.pybulletSlickRatio} times without",
        None,
    ),
    Claim(
        "Scale",
        "the soft-step solver has {code.solver} lines, grid and batches {code.grid}",
        lambda v: v("code.solver") > v("code.grid"),
    ),
]

# figure → experiments that draw its panels, by `python report/build.py --only`
FIGURES = [
    ("1", ("picture_stack", "stack", "rest")),
    ("2", ("picture_tunnel", "gyroscopic")),
    ("3", ("picture_cube", "cliques")),
    ("4", ("picture_slope", "stopping", "incline")),
    ("5", ("grid", "candidates", "scale")),
    ("6", ("batches", "queue")),
    ("7", ("picture_pyramid_basic", "picture_pyramid_soft", "resting")),
    ("8", ("picture_heap", "slick")),
    ("Table 1", ("schedules", "scheduling")),
    ("Table 2", ("standing", "resting", "restTimes", "scale")),
]
PATH = re.compile(r"\{([\w.]+)\}")


def holds(claim, numbers):
    """Whether the numbers satisfy a claim; its numbers must exist if it has a condition."""
    if claim.holds is None:
        return True
    return bool(claim.holds(lambda path: value(numbers, path)))


def contradictions(numbers):
    """Returns a line for each claim that the numbers contradict."""
    times = numbers.get("videos", {})
    unseen = [f"videos: {what} is never to be seen" for what in times if times[what] == "never"]
    return unseen + [
        f"{claim.where}: {sentence(claim, numbers)}"
        for claim in CLAIMS
        if not holds(claim, numbers)
    ]


def sentence(claim, numbers):
    return PATH.sub(lambda match: lookup(numbers, match[1]), claim.sentence)


def table(numbers):
    """Returns the text of claims.md."""
    import pictures

    rows = []
    for claim in CLAIMS:
        groups = dict.fromkeys(path.split(".")[0] for path in PATH.findall(claim.sentence))
        groups = groups or {"grid": None}
        names = ", ".join(f"`{group}`" for group in groups)
        verdict = "yes" if holds(claim, numbers) else "**no**"
        rows.append(f"| {claim.where} | {sentence(claim, numbers)} | {names} | {verdict} |")
    facts = [
        f"| {name.removeprefix('picture_').replace('_', ' ')} | {'; '.join(sentences)} |"
        for name, sentences in pictures.CAPTIONS.items()
    ]
    figures = [
        f"| {figure} | {', '.join(f'`{name}`' for name in names)} |" for figure, names in FIGURES
    ]
    return "\n".join(
        [
            "# Claims of the report, and what measures them",
            "",
            "Written by `python report/build.py`, which ends with 1 where a claim does not hold.",
            "`python report/build.py --only NAME` measures one again, `--check` all but the times.",
            "",
            "| where | claim | measured by | holds |",
            "|---|---|---|---|",
            *rows,
            "",
            "## What captions say of the pictures",
            "",
            "Looked at in the very state that is drawn; otherwise nothing is drawn.",
            "",
            "| picture | true of its state |",
            "|---|---|",
            *facts,
            "",
            "## Figures and tables",
            "",
            "| figure | made by `python report/build.py --only` |",
            "|---|---|",
            *figures,
            "",
        ]
    )
