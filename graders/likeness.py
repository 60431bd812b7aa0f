"""How like each other hand-ins are, by the shape of their code: reported, not judged.

Names, numbers, texts, comments, docstrings and imports do not count, nor does the layout: what is
left of a file is the sequence of its syntax tree's nodes, and of that, all runs of so many nodes.
"""

import ast
import itertools
import re
import zlib

from gradingTools import PROJECT_DIRECTORY
from sheets import write_rows

# Nodes in a run. Fewer are found in all programs, more are broken by each small change.
RUN = 12
# Runs below which a file is too short to be told from any other.
FEWEST = 200
# The part of the smaller hand-in's runs that are in the other one, too, above which it is reported.
REPORTED = 0.6
LEFT_OUT = (ast.expr_context, ast.Import, ast.ImportFrom, ast.arguments, ast.alias)


def fingerprint(folder):
    """The runs of a folder's RBSFunctions.py: a frozenset of int, empty if it cannot be read."""
    try:
        tree = ast.parse((folder / "RBSFunctions.py").read_bytes())
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
        return frozenset()
    nodes = [type(node).__name__ for node in _walk(tree)]
    runs = (" ".join(nodes[k : k + RUN]) for k in range(len(nodes) - RUN + 1))
    return frozenset(zlib.crc32(run.encode()) for run in runs)


def _walk(tree):
    """The nodes in the order of the text, without what is left out."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        isText = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if not isText and not isinstance(node, LEFT_OUT):
            yield node
            waiting += reversed(list(ast.iter_child_nodes(node)))


def likeness(one, other):
    """The part, from 0 to 1, of the smaller fingerprint's runs that the other one has, too."""
    return len(one & other) / max(FEWEST, min(len(one), len(other)))


def origin_remarks(folder):
    """What is to be said of a student's modules that are this project's, or use them."""
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
    """likeness.csv: the pairs that are reported, the likest first; returns how many. OSError

    prints : dict from name to fingerprint
    """
    pairs = [(likeness(prints[a], prints[b]), a, b) for a, b in itertools.combinations(prints, 2)]
    pairs = sorted((pair for pair in pairs if pair[0] > REPORTED), key=lambda pair: -pair[0])
    columns = ("submission", "other submission", "likeness in percent")
    rows = [dict(zip(columns, (a, b, f"{100 * x:.0f}"), strict=True)) for x, a, b in pairs]
    write_rows(path, columns, rows)
    return len(pairs)
