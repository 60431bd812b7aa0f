"""Measures the likeness of submissions by the shape of their code. Pairs are listed, not judged.

Of a file, the functions that the coursework asks for are compared, and those that they call; all
others are the skeleton's. They are reduced to the sequence of their syntax tree's nodes, without
names, numbers, texts, comments, docstrings and imports. Runs of consecutive nodes are compared.
"""

import ast
import itertools
import re
import zlib

from reference.graderData import PROJECT_DIRECTORY

from classwork.sheets import write_rows

# Nodes in a run. Shorter runs occur in all programs; longer ones are broken by each small change.
RUN = 12
# Runs of the shortest file that can be told from others.
FEWEST = 200
ASKED = """resolve_velocity_constraint resolve_position_constraint resolve_collision
get_rotated_inv_IT integrate_timestep""".split()
# The likeness from which a pair is listed.
REPORTED = 0.6
LEFT_OUT = (ast.expr_context, ast.Import, ast.ImportFrom, ast.arguments, ast.alias)
COLUMNS = ("submission", "other submission", "likeness in percent")


def fingerprint(folder):
    """Returns the runs of a folder's RBSFunctions.py as a frozenset of int, empty if unreadable."""
    try:
        tree = ast.parse((folder / "RBSFunctions.py").read_bytes())
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
        return frozenset()
    known = {one.name: one for one in ast.walk(tree) if isinstance(one, ast.FunctionDef)}
    names = [name for name in ASKED if name in known]
    for name in names:  # which grows
        called = (getattr(one, "attr", getattr(one, "id", "")) for one in ast.walk(known[name]))
        names += [one for one in dict.fromkeys(called) if one in known and one not in names]
    nodes = [type(node).__name__ for name in names for node in _walk(known[name])]
    runs = (" ".join(nodes[k : k + RUN]) for k in range(len(nodes) - RUN + 1))
    return frozenset(zlib.crc32(run.encode()) for run in runs)


def _walk(tree):
    """Yields the nodes in the order of the text, without those that are left out."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        isText = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if not isText and not isinstance(node, LEFT_OUT):
            yield node
            waiting += reversed(list(ast.iter_child_nodes(node)))


def likeness(one, other):
    """The fraction of the smaller fingerprint's runs that the other one has, too."""
    return len(one & other) / max(FEWEST, min(len(one), len(other)))


def origin_remarks(folder):
    """Returns remarks if a student's modules copy, import or name this project."""
    same = likeness(fingerprint(folder), fingerprint(PROJECT_DIRECTORY))
    remarks = [f"{same:.0%} of RBSFunctions.py is this project's own code"] * (same > REPORTED)
    for path in sorted(folder.rglob("*.py")):
        text, name = path.read_bytes(), path.relative_to(folder).as_posix()
        if re.search(rb"^\s*(import|from)\s+rbs\b", text, re.MULTILINE):
            remarks.append(f"{name} imports this project's package rbs")
        if str(PROJECT_DIRECTORY).encode() in text:
            remarks.append(f"{name} names this project's folder")
    return remarks


def write_likeness(path, prints):
    """Writes likeness.csv, the most alike pairs first; returns how many. Raises OSError.

    prints : dict from name to fingerprint
    """
    pairs = [(likeness(prints[a], prints[b]), a, b) for a, b in itertools.combinations(prints, 2)]
    pairs = sorted((pair for pair in pairs if pair[0] > REPORTED), key=lambda pair: -pair[0])
    rows = [(a, b, f"{100 * x:.0f}") for x, a, b in pairs]
    write_rows(path, COLUMNS, [dict(zip(COLUMNS, row, strict=True)) for row in rows])
    return len(pairs)
