"""The README's table of limits has the numbers that limits.py measures."""

import re

from limits import NAMES, WAYS, depth_below_ground, row_of
from oracles import ROOT

README = "".join(path.read_text("utf-8") for path in (ROOT / "README.md", ROOT / "tests/README.md"))


def test_readme_has_what_is_measured():
    """Repeats the rows that take seconds."""
    rows = {name: re.findall(rf"^\| {name} \| .* \|$", README, re.MULTILINE) for name in NAMES}
    assert {len(found) for found in rows.values()} == {1}
    assert all(row.count(" | ") == len(WAYS) for (row,) in rows.values())
    assert row_of("spin") == rows["spin"][0]
    # By the time it has landed; the deepest of all steps is reached then.
    deepest = depth_below_ground(150).split(",")[0]
    assert rows["ground"][0].split(" | ")[1].startswith(deepest) and deepest != "0.00 m"
