"""Remarks on a submission's source: code of this project, and what looks like reaching for the
grader. They are for a person to look at, never a verdict.

Sources are searched as text, in linear time: nothing here parses a student's code.
"""

import re
from functools import cache

from reference import PROJECT_DIRECTORY

# Shorter lines occur in all programs. The share of RBSFunctions.py from which it is a copy.
LEAST_LINE, COPIED = 25, 0.5
LOOK = "a person should look"
# What a solution has no use for, and what a remark calls it.
REACHING = {
    "walks the frames of its callers": r"_getframe|inspect\.(stack|currentframe)|\bf_back\b",
    "lists the objects of the process": r"gc\.get_(objects|referrers)|sys\.modules|__builtins__",
    "ends the process": r"os\._exit|os\.kill|os\.abort|from os import (?!path)",
    "reads /proc": r"/proc\b",
    "imports a computed name": r"(__import__|import_module|run_path|spec_from_file_location)\("
    r"(?!\s*['\"][\w.]+['\"]\s*\))|FileLoader|PathFinder|\b(load|exec|get)_(module|code)\b",
    "runs computed code": r"(?<![\w.])(exec|eval|compile)\(",
    "starts processes": r"\bsubprocess\b|os\.(fork|system|popen|spawn|exec)|\bmultiprocessing\b",
    "searches the disk": r"os\.(walk|scandir|listdir|fwalk)|\.r?glob\(|iterdir|/\*\*|\bi?glob\b"
    r"|\bsite-packages\b|sys\.(executable|\w*prefix)|\bsite\.|\bsys\.path\b(?!\.(append|insert|extend))",
    "reads the graders' data": r"-resolution|integration\.data|\.data['\"]",
    "changes limits or signals": r"\bresource\.|signal\.|faulthandler|\bctypes\b",
}
REACHING = {what: re.compile(pattern) for what, pattern in REACHING.items()}
REACHING |= {
    "imports this project's package rbs": re.compile(
        r"^[ \t]*(import|from)[ \t]+rbs\b", re.MULTILINE
    )
}
# Bytes of a file, and files, that are searched.
MOST_SEARCHED, MOST_FILES = 1 << 18, 100


def origin_remarks(files):
    """Returns remarks on the Python files of a HandIn, a dict from path to bytes."""
    compiled = [name for name in sorted(files) if name.endswith((".pyc", ".so", ".pyd"))]
    remarks = [f"{LOOK}: {name.removeprefix('code/')} is compiled" for name in compiled]
    own = _lines(files.get("code/RBSFunctions.py", b""))
    shared = [one for one in own if one in _our_lines()]
    if len(own) and len(shared) > COPIED * len(own):
        share = len(shared) / len(own)
        remarks.append(f"{share:.0%} of RBSFunctions.py is this project's own code")
    sources = [(path.removeprefix("code/"), path) for path in sorted(files) if path[-3:] == ".py"]
    for name, path in sources[:MOST_FILES]:
        text = re.sub("(?m)^[ \t]*#.*", "", files[path][:MOST_SEARCHED].decode("utf-8", "replace"))
        if str(PROJECT_DIRECTORY) in text:
            remarks.append(f"{LOOK}: {name} names this project's folder")
        if len(files[path]) > MOST_SEARCHED:
            remarks.append(f"{LOOK}: {name} is longer than {MOST_SEARCHED >> 10} KB")
        for what, pattern in REACHING.items():
            if found := pattern.search(text):
                line = 1 + text.count("\n", 0, found.start())
                remarks.append(f"{LOOK}: {name}:{line} {what}")
    return remarks + [f"{LOOK}: {len(sources)} files of Python"] * (len(sources) > MOST_FILES)


def _lines(content):
    text = content[:MOST_SEARCHED].decode("utf-8", "replace")
    return [one.strip() for one in text.splitlines() if len(one.strip()) >= LEAST_LINE]


@cache
def _our_lines():
    return set(_lines((PROJECT_DIRECTORY / "RBSFunctions.py").read_bytes()))
