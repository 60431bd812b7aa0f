"""Remarks on a submission's source: code of this project, and what looks like reaching for the
grader. They are for a person to look at, never a verdict.

Lines are searched as text, in linear time: nothing here parses a student's code.
"""

import re
from functools import cache

from reference import PROJECT_DIRECTORY

# Shorter lines occur in all programs. The share of RBSFunctions.py from which it is a copy.
LEAST_LINE, COPIED = 25, 0.5
# What a solution has no use for, and what a remark calls it.
REACHING = {
    "walks the frames of its callers": r"_getframe|inspect\.(stack|currentframe)|\bf_back\b",
    "lists the objects of the process": r"gc\.get_(objects|referrers)",
    "ends the process": r"os\._exit|os\.kill|os\.abort",
    "reads /proc": r"/proc\b",
    "imports a computed name": r"(__import__|import_module|run_path|spec_from_file_location)\("
    r"(?!\s*['\"][\w.]+['\"]\s*\))",
    "runs computed code": r"(?<![\w.])(exec|eval|compile)\(",
    "starts processes": r"\bsubprocess\b|os\.(fork|system|popen|spawn|exec)|\bmultiprocessing\b",
    "searches the disk": r"os\.(walk|scandir)|\.rglob\(|/\*\*|glob\.glob|\bsite-packages\b",
    "reads the graders' data": r"-resolution|integration\.data|\.data['\"]",
    "changes limits or signals": r"\bresource\.|signal\.|faulthandler|\bctypes\b",
}
REACHING = {what: re.compile(pattern) for what, pattern in REACHING.items()}
IMPORT = re.compile(r"\s*(import|from)\s+rbs\b")
LONGEST_LINE = 1000


def origin_remarks(files):
    """Returns remarks on the Python files of a HandIn, a dict from path to bytes."""
    remarks, own = [], _lines(files.get("code/RBSFunctions.py", b""))
    shared = [one for one in own if one in _our_lines()]
    if len(own) and len(shared) > COPIED * len(own):
        share = len(shared) / len(own)
        remarks.append(f"{share:.0%} of RBSFunctions.py is this project's own code")
    for path, content in sorted(files.items()):
        if not path.endswith(".py"):
            continue
        name, found = path.removeprefix("code/"), {}
        for number, line in enumerate(content.decode("utf-8", "replace").splitlines(), start=1):
            line = line[:LONGEST_LINE].partition("#")[0]
            if IMPORT.match(line):
                remarks.append(f"{name} imports this project's package rbs")
            if str(PROJECT_DIRECTORY) in line:
                remarks.append(f"{name} names this project's folder")
            for what, pattern in REACHING.items():
                if what not in found and pattern.search(line):
                    found[what] = f"a person should look: {name}:{number} {what}"
        remarks += found.values()
    return list(dict.fromkeys(remarks))


def _lines(content):
    lines = (one.strip() for one in content.decode("utf-8", "replace").splitlines())
    return [one for one in lines if len(one) >= LEAST_LINE and one[0] != "#"]


@cache
def _our_lines():
    return set(_lines((PROJECT_DIRECTORY / "RBSFunctions.py").read_bytes()))
