"""Claims of the report, of claims.csv: measured values beside those that a law predicts, or bounds.

`broken` lists the claims that do not hold, which fails the build; `table` writes all to claims.md.
`quoted` writes the times beside compiled engines into a README, so that each stands there as
measured.
"""

import csv
import re
from pathlib import Path
from typing import NamedTuple


class Claim(NamedTuple):
    """A quantity, why it is so, and what must be true of the numbers.

    section : of the report; sentence : the quantity; measured : its path in numbers.json
    relation : "=", "<" or ">"; law : path or number; within : largest relative deviation from "="
    experiment : what tested the cause, and would have refuted it
    """

    section: str
    sentence: str
    measured: str
    relation: str
    law: str
    within: str
    experiment: str


with open(Path(__file__).with_name("claims.csv"), newline="", encoding="utf-8") as file:
    CLAIMS = [Claim(*row) for row in list(csv.reader(file))[1:]]


def value(numbers, path):
    """Looks a number up by "group.key"; NaN, which satisfies no claim, if it was not measured."""
    try:
        return float(path)
    except ValueError:
        pass
    for key in path.split("."):
        numbers = numbers.get(key, {})
    return numbers if isinstance(numbers, float | int) else float("nan")


def holds(claim, numbers):
    measured, reference = value(numbers, claim.measured), value(numbers, claim.law)
    if claim.relation == "=":
        return abs(measured - reference) <= float(claim.within or 0) * abs(reference)
    return measured < reference if claim.relation == "<" else measured > reference


def cells(claim, numbers):
    """Returns the cells of a claim's row, as text."""
    within = f" within {100 * float(claim.within):g} %" if claim.within else ""
    kind = "" if claim.relation == "=" else "bound "
    verdict = "" if holds(claim, numbers) else " **fails**"
    reference = f"{kind}{claim.relation} {value(numbers, claim.law):.4g}{within}{verdict}"
    measured = f"{value(numbers, claim.measured):.4g}", reference, f"`{claim.measured}`"
    return claim.section, claim.sentence, *measured, claim.experiment


def broken(numbers):
    """Returns a line for each claim that does not hold."""
    wrong = [claim for claim in CLAIMS if not holds(claim, numbers)]
    return [f"section {' '.join(cells(claim, numbers)[:4])}" for claim in wrong]


HEAD = """# Claims of the report, and the experiments behind them

Written by `python report/build.py` from `claims.csv`. *Laws* predict without a fitted constant.
*Bounds* are regression tests: the value was measured first, and the bound set beside it. The build
exits with 1 if either fails. `python report/build.py --only NAME` measures a row again; NAME is the
part of its number before the dot. Tests hold that grid, batches and loop give the same bits
(`tests/stepping/test_forms.py`), and queue and sweep (`tests/stepping/test_constraints.py`).

| | quantity | measured | law or bound | number | what tested it, or would have refuted the cause |
|---|---|---|---|---|---|
"""


def table(numbers):
    """Returns the text of claims.md."""
    return HEAD + "".join(f"| {' | '.join(cells(claim, numbers))} |\n" for claim in CLAIMS)


BLOCK = r"<!-- engines: (\w+) -->\n.*?<!-- end -->"


def quoted(numbers, text):
    """Returns the text of a README, in which the blocks of engines.md have these numbers."""
    blocks = Path(__file__).with_name("engines.md").read_text()
    filled = re.sub(r"{([\w.]+)}", lambda key: digits(value(numbers["engines"], key[1])), blocks)
    block = {one[1]: one[0] for one in re.finditer(BLOCK, filled, re.DOTALL)}
    return re.sub(BLOCK, lambda old: block[old[1]], text, flags=re.DOTALL)


def digits(number):
    """Two digits, and all of those before the point."""
    return f"{number:.0f}" if number >= 9.95 else f"{number:#.2g}"
