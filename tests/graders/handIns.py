"""A class's hand-ins as they really come, and the outcome that `grade.py` must report of each."""

import csv
import io
import os
import re
import subprocess
import sys
import zipfile

from oracles import ROOT
from studentVariants import FUNCTIONS, SOLUTION, START, VARIANTS, edited, write_zip, written

RIGHT, WRONG = "all is right", "something is wrong"
LIMIT = 4  # s of processor time
TEXT, QUATERNION = SOLUTION.values()


def with_text(text):
    return SOLUTION | {FUNCTIONS: text}


def top(*lines):
    return with_text("\n".join([*lines, TEXT]))


def link(name, target):
    info = zipfile.ZipInfo(name)
    info.external_attr = 0o120777 << 16
    return {info: target}


def zipped(files):
    content = io.BytesIO()
    write_zip(content, files)
    return content.getvalue()


IN_CODE = {f"code/{name}": text for name, text in SOLUTION.items()}
VIDEO = os.urandom(6 << 20)
LATIN = f"AUTHOR = 'Jörg'\n{TEXT}".encode("latin-1")

# From the name of a file or folder to (its content: files of a folder, or bytes; its name in the
# tables, or None; the expected outcome: RIGHT, WRONG or the refusal; a text in remarks or notes).
HAND_INS = {}


def add(file, content, fate=RIGHT, text="", name=""):
    name = re.sub(r"\.\w+$", "", file) if name == "" else name
    HAND_INS[file] = content, name, fate, text


def add_edited(name, new, fate=WRONG, text=""):
    """Adds the solution with new lines at the start of resolve_collision."""
    add(name, edited((START, new)), fate, text)


# names and places
add("Müller Anna_10001_assignsubmission_file", SOLUTION, name="Müller Anna")
add("Möller", edited(*VARIANTS["normal-sign"]), WRONG, "the normal has the wrong sign")
add("王伟, Seán O'Brien.zip", zipped(IN_CODE), RIGHT, "modules found in code")
add("doejane_4712_98_cw.zip", zipped(SOLUTION), RIGHT, "of this name, doejane-2", name="doejane")
add("doejane_LATE_4711_99_cw.zip", zipped(SOLUTION), RIGHT, "it was late", name="doejane-2")
add("roe_5001_77_RBSFunctions-1.py", TEXT, "a loose .py file is not read", name="roe")
add("Müller Anna_10001_assignsubmission_onlinetext", {"text.html": ""}, name=None)
add("nested", {f"a/b/c d/{k}": v for k, v in SOLUTION.items()}, RIGHT, "in a/b/c d")
add("zip in zip.zip", zipped({"x/inner.zip": zipped(IN_CODE)}), "x/inner.zip is packed")
add("renamed", {"RBSFunctions.py.txt": TEXT}, "there is RBSFunctions.py.txt")
add("linked.zip", zipped(link("RBSFunctions.py", "/etc/passwd")), "RBSFunctions.py is a link")
final = {"RBSFunctions.py": "x = 1\n", "RBSFunctions_final_v2.py": TEXT}
add(
    "final", final, WRONG, "look: RBSFunctions_final_v2.py is not graded; graded is RBSFunctions.py"
)
# missing modules, or several
add("no quaternion", {"RBSFunctions.py": TEXT}, RIGHT, "the coursework supplies it")
add("again", {"RBSFunctions (1).py": TEXT, "Quaternion.py": QUATERNION}, RIGHT, "(1).py is read as")
add("RBSFunctions_c.py", TEXT, "a loose .py file is not read", name="RBSFunctions_c.py")
add("loose.pdf", b"%PDF", "a loose .pdf file is not read", name="loose.pdf")
# what they need
reads = "open('../data/cube-scene.txt').read()"
add("no data.zip", zipped(top(reads)), "to do: hand in ../data/cube-scene.txt, or")
add("numba", top("import numba"), "to do: add the file numba.py, or install")
add("window", top("raise OSError('no Polyscope backends could be initialized')"), "opens a window")
empty = {"Quaternion.py": QUATERNION, "code/RBSFunctions.py": ""}
add("empty", empty, WRONG, "RBSFunctions.py has no Mesh")
twice = IN_CODE | {f"old/v1/{k}": b"syntax error" for k in SOLUTION}
add("twice", twice, RIGHT, "old/v1/RBSFunctions.py is not graded")
add("skeleton", edited(*VARIANTS["skeleton"]), WRONG, "not implemented")
# text encodings
add("utf-16", with_text(TEXT.encode("utf-16")), "to do: save RBSFunctions.py as UTF-8")
add("latin", with_text(LATIN), WRONG, "cannot be imported: RBSFunctions.py")
# other files beside the code
add("video.zip", zipped(IN_CODE | {"code/run.mp4": VIDEO, "report.pdf": b"%PDF"}))
add("with env", SOLUTION | {f"env/m{k}.py": "1/0" for k in range(2100)})
add("cut.zip", zipped(SOLUTION)[:3000], "is not a ZIP, or is damaged (BadZipFile)")
out = {"../escaped.py": b"", "/tmp/escaped.py": b""} | link("pointer", "/etc/passwd")
add("escaping.zip", zipped(SOLUTION | out))
# behaviour when run
formula = edited((START, "    raise ValueError('<b>|`x`\\x1b[2J')\n"))
add("=SUM(1).zip", zipped(formula), WRONG, "ValueError: <b>|`x` [2J")
# hostile
crash = "crashed the interpreter (SIGSEGV), at RBSFunctions.py:"
add_edited("crashes", "    import ctypes; ctypes.string_at(0)\n", WRONG, crash)
stop = f"stopped after {LIMIT} s, at RBSFunctions.py:"
add_edited("endless", "    while True: pass\n", WRONG, stop)
stop = f"stopped after {LIMIT} s while the modules were imported, at RBSFunctions.py:1"
add("endless import", top("while True: pass"), WRONG, stop)

EXPECTED = {name: (fate, text) for _, name, fate, text in HAND_INS.values() if name}


def write_hand_ins(folder):
    files = {".DS_Store": "", "notes.txt": ""}
    for name, (content, *_expected) in HAND_INS.items():
        inside = content if isinstance(content, dict) else {".": content}
        files |= {f"{name}/{inner}".removesuffix("/."): data for inner, data in inside.items()}
    written(folder, files)


def start(*arguments, **options):
    command = [sys.executable, ROOT / "graders" / "grade.py", *map(str, arguments)]
    options |= {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, encoding="utf-8", errors="replace", **options)


def rows_in(path):
    """The rows of a CSV file, by the submission's name."""
    rows = {}
    if path.exists():
        with open(path, encoding="utf-8-sig", newline="") as file:
            for row in csv.DictReader(file):
                rows.setdefault(row["submission"].removeprefix("'"), []).append(row)
    return rows


def mismatches(out):
    """Dict from the name of each whose report lacks what is expected to this report."""
    rows = rows_in(out / "marks.csv")
    assert set(rows) == set(EXPECTED)
    found = {}
    for name, (fate, text) in EXPECTED.items():
        (row,) = rows[name]
        said, isRefused = f"{row['notes']} {row['remarks']}", row["state"] != "graded"
        verdict = fate if isRefused and fate in said else WRONG if row["failed"] else RIGHT
        if verdict != fate or text not in said:
            found[name] = said
    return found


def stopped(process, out, number):
    """Sends a signal; returns (exit code, what it says, how many are graded)."""
    process.send_signal(number)
    errors = process.communicate(timeout=300)[1]
    return process.returncode, errors.strip(), len(rows_in(out / "marks.csv"))
