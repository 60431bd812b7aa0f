"""A class's hand-ins as they really come, and what `grade.py` is to make of each.

python tests/graders/handIns.py FOLDER    writes and grades them, and prints figures
"""

import csv
import io
import os
import re
import signal
import subprocess
import sys
import tarfile
import time
import zipfile
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from oracles import ROOT
from studentVariants import (
    HALF_DONE,
    MISTAKES,
    SKELETON,
    STUDENT,
    files_of,
    write_submission,
    write_zip,
)

RIGHT, WRONG = "all is right", "something is wrong"
SOLUTION = files_of(STUDENT)
TEXT = SOLUTION["RBSFunctions.py"].decode()
QUATERNION = SOLUTION["Quaternion.py"].decode()
START = "    # interpenetration\n"


def edited(*edits):
    """The solution's files after edits of RBSFunctions.py."""
    text = TEXT
    for old, new in edits:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return SOLUTION | {"RBSFunctions.py": text}


def top(*lines):
    return SOLUTION | {"RBSFunctions.py": "\n".join([*lines, TEXT])}


def link(name, target):
    info = zipfile.ZipInfo(name)
    info.external_attr = 0o120777 << 16
    return {info: target}


def tarred(files, mode):
    content = io.BytesIO()
    with tarfile.open(fileobj=content, mode=mode) as archive:
        for name, data in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            archive.addfile(info, io.BytesIO(data))
        out = tarfile.TarInfo("secret")
        out.type, out.linkname = tarfile.SYMTYPE, "/etc/passwd"
        archive.addfile(out)
    return content.getvalue()


def zipped(files):
    content = io.BytesIO()
    write_zip(content, files)
    return content.getvalue()


def encrypted(files):
    """Says that it is encrypted: bit 0 of the flags, in both headers of each file."""
    content = bytearray(zipped(files))
    for mark, offset in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        for found in re.finditer(re.escape(mark), bytes(content)):
            content[found.start() + offset] |= 1
    return bytes(content)


def renamed(text):
    """The same code under other names, in another layout."""
    text = text.replace("velocities", "speeds").replace("total", "weight").replace("# ", "#~ ")
    return re.sub(r"\bn\b", "axis", text).replace("\n\n", "\n")


IN_CODE = {f"code/{name}": text for name, text in SOLUTION.items()}
OURS = {name: (ROOT / name).read_bytes() for name in ("RBSFunctions.py", "GJK.py", "Quaternion.py")}
VIDEO = os.urandom(6 << 20)
LATIN = "AUTHOR = 'Jörg'\n" + TEXT

# From the name of a file or folder to (its content: files of a folder, or bytes; its name in the
# tables; what is to come of it: RIGHT, WRONG or the refusal; a text among the remarks and notes).
HAND_INS = {
    # names and places
    "Müller Anna_10001_assignsubmission_file": (SOLUTION, "Müller Anna", RIGHT, ""),
    "Möller": (edited(*MISTAKES["normal-sign"]), "Möller", WRONG, "the normal has the wrong sign"),
    "王伟.zip": (zipped(SOLUTION), "王伟", RIGHT, ""),
    "O'Brien, Seán.zip": (zipped(IN_CODE), "O'Brien, Seán", RIGHT, "modules found in code"),
    "doejane_LATE_4711_99_cw.zip": (zipped(SOLUTION), "doejane", RIGHT, ""),
    "doejane_4712_98_cw.zip": (zipped(SOLUTION), "doejane-2", RIGHT, ""),
    "roe_5001_77_RBSFunctions-1.py": (SOLUTION["RBSFunctions.py"], "roe", RIGHT, ""),
    "roe_5001_78_Quaternion.py": (SOLUTION["Quaternion.py"], None, "", ""),
    "nested": ({f"a/b/c d/{k}": v for k, v in SOLUTION.items()}, "nested", RIGHT, "in a/b/c d"),
    "moodle zip_7_assignsubmission_file": (
        {"my code.zip": zipped(SOLUTION)},
        "moodle zip",
        RIGHT,
        "modules found in my code.zip",
    ),
    "zip in zip.zip": (zipped({"x/inner.zip": zipped(IN_CODE)}), "zip in zip", RIGHT, "inner.zip"),
    "tar.tar.gz": (tarred(IN_CODE, "w:gz"), "tar", RIGHT, "found in code"),
    "old.tgz": (tarred(SOLUTION, "w:gz"), "old", RIGHT, ""),
    "plain.tar": (tarred(SOLUTION, "w"), "plain", RIGHT, ""),
    "seven.7z": (b"7z\xbc\xaf\x27\x1c", "seven.7z", "a loose .7z file is not read", ""),
    "inner seven_8_assignsubmission_file": (
        {"x.7z": b"7z"},
        "inner seven",
        "holds no RBSFunctions.py; its .7z file",
        "",
    ),
    "loose.py": (b"print(1)\n", "loose.py", "a loose .py file is not read", ""),
    # what is not there, or twice
    "only quaternion": (
        {"Quaternion.py": QUATERNION},
        "only quaternion",
        "holds no RBSFunctions.py",
        "",
    ),
    "no quaternion": (
        {"RBSFunctions.py": TEXT},
        "no quaternion",
        WRONG,
        "there is no Quaternion.py",
    ),
    "own quaternion": (
        {"RBSFunctions.py": QUATERNION + TEXT.replace("from Quat", "#Quat")},
        "own quaternion",
        RIGHT,
        "",
    ),
    "empty": (
        {"Quaternion.py": QUATERNION, "code/RBSFunctions.py": ""},
        "empty",
        WRONG,
        "RBSFunctions.py has no Mesh",
    ),
    "lower": (
        {"rbsfunctions.py": TEXT, "quaternion.PY": QUATERNION},
        "lower",
        RIGHT,
        "rbsfunctions.py is read as RBSFunctions.py",
    ),
    "twice": (
        IN_CODE | {f"old/v1/{k}": b"syntax error" for k in SOLUTION},
        "twice",
        RIGHT,
        "another RBSFunctions.py, in old/v1, is not graded",
    ),
    "skeleton": (edited(*SKELETON), "skeleton", WRONG, "not implemented"),
    "half": (edited(*HALF_DONE), "half", WRONG, "not implemented"),
    # how text is written
    "bom": (SOLUTION | {"RBSFunctions.py": b"\xef\xbb\xbf" + TEXT.encode()}, "bom", RIGHT, ""),
    "crlf": ({k: v.replace(b"\n", b"\r\n") for k, v in SOLUTION.items()}, "crlf", RIGHT, ""),
    "latin": (
        SOLUTION | {"RBSFunctions.py": LATIN.encode("latin-1")},
        "latin",
        WRONG,
        "cannot be imported: RBSFunctions.py",
    ),
    "latin told": (
        SOLUTION | {"RBSFunctions.py": b"# coding: latin-1\n" + LATIN.encode("latin-1")},
        "latin told",
        RIGHT,
        "",
    ),
    "tabs": (SOLUTION | {"RBSFunctions.py": TEXT.replace("    ", "\t")}, "tabs", RIGHT, ""),
    # what lies beside the code
    "video.zip": (
        zipped(IN_CODE | {"code/run.mp4": VIDEO, "report.pdf": b"%PDF"}),
        "video",
        RIGHT,
        "",
    ),
    "with env": (SOLUTION | {f"env/m{k}.py": "1/0" for k in range(2100)}, "with env", RIGHT, ""),
    "mac.zip": (
        zipped(
            IN_CODE
            | {
                "__MACOSX/code/._RBSFunctions.py": b"\0",
                "code/Icon\r": b"",
                "shots/10:30.png": b"",
                ".DS_Store": b"",
            }
        ),
        "mac",
        RIGHT,
        "",
    ),
    "colon.zip": (zipped({f"CW: a/{k}": v for k, v in SOLUTION.items()}), "colon", RIGHT, "CW_ a"),
    "locked.zip": (encrypted(SOLUTION), "locked", "is encrypted", ""),
    "cut.zip": (zipped(SOLUTION)[:3000], "cut", "is no ZIP or tar, or a damaged one", ""),
    "escaping.zip": (
        zipped(
            SOLUTION
            | {"../escaped.py": b"", "/tmp/escaped.py": b""}
            | link("pointer", "/etc/passwd")
        ),
        "escaping",
        RIGHT,
        "",
    ),
    # whose it is
    "copy": (SOLUTION | {"RBSFunctions.py": renamed(TEXT)}, "copy", RIGHT, ""),
    "ours": (OURS, "ours", RIGHT, "100% of RBSFunctions.py is this project's own code"),
    "borrowing": (top("import rbs.geometry.hulls"), "borrowing", RIGHT, "imports this project's"),
    # what runs
    "prints": (edited((START, "    print('x' * 10_000)\n" * 20 + START)), "prints", RIGHT, ""),
    "asks": (edited((START, "    input('depth? ')\n")), "asks", WRONG, "EOFError"),
    "plots": (
        top("import matplotlib.pyplot as plt", "plt.plot([1, 2])", "plt.show()"),
        "plots",
        RIGHT,
        "",
    ),
    "=SUM(1).zip": (
        zipped(edited((START, "    raise ValueError('<b>|`x`\\x1b[2J')\n"))),
        "=SUM(1)",
        WRONG,
        "ValueError: <b>|`x` [2J",
    ),
    # what is hostile
    "exits": (edited((START, "    os._exit(7)\n")), "exits", WRONG, "with exit code 7"),
    "crashes": (
        edited((START, "    import ctypes; ctypes.string_at(0)\n")),
        "crashes",
        WRONG,
        "crashed the interpreter (SIGSEGV), at RBSFunctions.py:",
    ),
    "endless": (
        edited((START, "    while True: pass\n")),
        "endless",
        WRONG,
        "stopped after 4 s, at RBSFunctions.py:",
    ),
    "endless import": (
        top("while True: pass"),
        "endless import",
        WRONG,
        "stopped after 4 s while the modules were imported, at RBSFunctions.py:1",
    ),
}
EXPECTED = {name: (fate, text) for _, name, fate, text in HAND_INS.values() if name}


def write_hand_ins(folder):
    """Writes all of them into a new folder."""
    folder.mkdir(parents=True)
    for name, (content, *_) in HAND_INS.items():
        files = {"": content} if isinstance(content, bytes) else content
        for inner, data in files.items():
            path = folder / name / inner if inner else folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data if isinstance(data, bytes) else data.encode())
    (folder / ".DS_Store").write_text("")
    (folder / "notes.txt").write_text("")


# ---- Grading them -------------------------------------------------------------------------------


def start(*arguments, **options):
    command = [sys.executable, ROOT / "graders" / "grade.py", *map(str, arguments)]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        errors="replace",
        **options,
    )


def rows_in(path):
    """The rows of a CSV file, by the submission's name."""
    rows = {}
    if path.exists():
        with open(path, encoding="utf-8-sig", newline="") as file:
            for row in csv.DictReader(file):
                rows.setdefault(row["submission"].removeprefix("'"), []).append(row)
    return rows


def mismatches(out, expected):
    """Names of those who were not told what they are to be told, and what they were."""
    rows = rows_in(out / "grades.csv")
    assert set(rows) == set(expected)
    found = {}
    for name, (fate, text) in expected.items():
        said = " ".join(f"{row['notes']} {row['remarks']}" for row in rows[name])
        isRefused = rows[name][0]["grader"] == "-"
        isRight = all(row["passed"] == row["of"] for row in rows[name])
        verdict = fate if isRefused and fate in said else RIGHT if isRight else WRONG
        if verdict != fate or text not in said:
            found[name] = said
    return found


def stopped(process, out, count, number):
    """Sends a signal once so many are graded; returns (exit code, what it says, how many are)."""
    while len(rows_in(out / "marks.csv")) < count and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(number)
    errors = process.communicate(timeout=60)[1]
    return process.returncode, errors.strip(), len(rows_in(out / "marks.csv"))


def workers():
    """Numbers of the processes that run a submission here and now."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            words = path.read_bytes().split(b"\0")
            if str(ROOT / "graders" / "isolated" / "worker.py").encode() in words:
                found.append(int(path.parent.name))
    return found


def main():
    folder = Path(sys.argv[1])
    write_hand_ins(folder / "class")
    out, options = folder / "out", ("--time-limit", 4)
    for count, number in ((10, signal.SIGINT), (20, signal.SIGTERM), (30, signal.SIGKILL)):
        process = start(folder / "class", "--out", out, "--resume", *options)
        code, line, graded = stopped(process, out, count, number)
        time.sleep(1.0)
        print(f"{number.name}: exit code {code}, '{line}', {graded} graded, left: {workers()}")
    environment = os.environ | {"PYTHONIOENCODING": "cp1252"}
    begin = time.perf_counter()
    process = start(folder / "class", "--out", out, "--resume", *options, env=environment)
    process.stdout.readline()
    process.stdout.close()  # as `| head -1` does
    print(f"cp1252, closed output: '{process.stderr.read().strip()}', exit code {process.wait()}")
    print(f"as expected: {len(EXPECTED)} but {mismatches(out, EXPECTED)}")
    begin = time.perf_counter()
    process = start(folder / "class", "--out", folder / "again", *options)
    printed = process.communicate()[0]
    print(f"all {len(EXPECTED)} in one go: {time.perf_counter() - begin:.1f} s; {printed[-130:]}")
    same = (out / "grades.csv").read_bytes() == (folder / "again" / "grades.csv").read_bytes()
    print(f"the same grades.csv: {same}")
    write_class(folder / "many", 150)
    begin = time.perf_counter()
    start(folder / "many", "--out", folder / "150").communicate()
    print(f"150, of which a third is wrong: {time.perf_counter() - begin:.1f} s")


def write_class(folder, count):
    """So many folders: solutions, every third with one of the classic mistakes."""
    mistakes = list(MISTAKES)
    for k in range(count):
        write_submission(folder / f"{k:03}", MISTAKES[mistakes[k // 3 % 10]] if k % 3 == 0 else ())


if __name__ == "__main__":
    main()
