"""Submissions that hang, crash, end the interpreter or escape: they harm nobody but themselves."""

import csv
import os
import re
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest
from oracles import ROOT
from studentVariants import HALF_DONE, HOSTILE, MISTAKES, files_of, write_submission, write_zip

sys.path.insert(0, str(ROOT / "graders"))

import archives
from archives import find_modules, find_submissions, unpack

from rbs.submissions import SubmissionError

START = "    # interpenetration\n"
COLLISIONS = "ResolveCollisionsGrading.py"


def run(script, *arguments):
    return subprocess.run(
        [sys.executable, ROOT / "graders" / script, *map(str, arguments)],
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip


def grade(folder, *options):
    """The collision grader on a folder; returns (its printout, the notes on resolve_collision)."""
    graded = run(COLLISIONS, "--modules", folder, *options)
    assert graded.returncode == 1, graded.stderr
    lines = graded.stdout.splitlines()
    return graded.stdout, [line for line in lines if line.startswith("resolve_collision: ")]


def line_of(folder, text):
    lines = (folder / "RBSFunctions.py").read_text(encoding="utf-8").splitlines()
    return 1 + next(k for k, line in enumerate(lines) if text in line)


def assert_rest_is_graded(printed):
    """Detection and the tensor pass, whatever becomes of resolve_collision."""
    for quantity in ("isCollision", "depth", "intNormal", "intPosition", "rotated inverse inertia"):
        (line,) = [line for line in printed.splitlines() if line.startswith(f"{quantity}  ")]
        cells = re.split(r"\s{3,}", line)
        assert float(cells[1].removesuffix(" differ")) < 1e-9
    assert "FAIL: 9 of 14" in printed


# ---- A single one -------------------------------------------------------------------------------


def test_an_endless_loop_is_stopped_and_its_place_told(tmp_path):
    folder = write_submission(tmp_path / "student", HOSTILE["endless-loop"])
    begin = time.monotonic()
    printed, (note,) = grade(folder, "--time-limit", 2)
    assert time.monotonic() - begin < 2 * 2 + 10  # two parts are stopped
    line = line_of(folder, "while True:")
    assert re.fullmatch(
        rf"resolve_collision: stopped after 2 s, at RBSFunctions.py:({line}|{line + 1})", note
    )
    assert_rest_is_graded(printed)


def test_who_ends_the_interpreter_is_told_so(tmp_path):
    folder = write_submission(tmp_path / "student", HOSTILE["os-exit"])
    printed, notes = grade(folder)
    assert notes == ["resolve_collision: ended the interpreter with exit code 7"]
    assert_rest_is_graded(printed)


def test_who_crashes_the_interpreter_is_told_where(tmp_path):
    crash = "    import ctypes; ctypes.string_at(0)\n"
    folder = write_submission(tmp_path / "student", [(START, crash)])
    printed, (note,) = grade(folder)
    line = line_of(folder, "string_at")
    assert note == (
        f"resolve_collision: crashed the interpreter (SIGSEGV), at RBSFunctions.py:{line}"
    )
    assert_rest_is_graded(printed)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit of the address space")
def test_memory_is_limited(tmp_path):
    folder = write_submission(tmp_path / "student", [(START, "    np.ones(1 << 28)\n")])  # 2 GiB
    printed, (note,) = grade(folder, "--memory-limit", 1024)
    line = line_of(folder, "np.ones(1 << 28)")
    assert note.startswith(f"resolve_collision: RBSFunctions.py:{line}: ")
    assert "MemoryError: Unable to allocate 2.00 GiB" in note
    assert_rest_is_graded(printed)


def test_the_folder_stays_as_it_was_whatever_is_written_into_it(tmp_path):
    """The module writes beside itself, removes itself, and leaves no cache."""
    wreck = (
        "    here = os.path.dirname(os.path.abspath(__file__))\n"
        "    open(os.path.join(here, 'written'), 'w').close()\n"
        "    open('written too', 'w').close()\n"
        "    os.path.exists(__file__) and os.remove(__file__)\n"
    )
    folder = write_submission(tmp_path / "student", [(START, wreck + START)])
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    graded = run(COLLISIONS, "--modules", folder)
    assert graded.returncode == 0, graded.stdout
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="there are no process groups here")
def test_what_is_started_is_ended_too(tmp_path):
    pid = tmp_path / "pid"
    start = (
        "    import subprocess, sys\n"
        f"    if not os.path.exists({str(pid)!r}):\n"
        "        one = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(300)'])\n"
        f"        open({str(pid)!r}, 'w').write(str(one.pid))\n"
    )
    write_submission(tmp_path / "student", [(START, start + START)])
    graded = run(COLLISIONS, "--modules", tmp_path / "student")
    assert graded.returncode == 0, graded.stdout
    for _ in range(100):  # it has been told to end, and is being cleared away
        if not is_running(int(pid.read_text())):
            return
        time.sleep(0.05)
    pytest.fail("it still runs")


def is_running(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


def test_links_are_not_followed(tmp_path):
    folder = write_submission(tmp_path / "student")
    (tmp_path / "secret.py").write_text("raise SystemExit('read')\n")
    (folder / "Quaternion.py").unlink()
    (folder / "Quaternion.py").symlink_to(tmp_path / "secret.py")
    graded = run(COLLISIONS, "--modules", folder)
    assert graded.returncode == 0, graded.stdout
    assert "Quaternion.py is not there: this project's is used" in graded.stdout


# ---- Twelve, and three hostile ones -------------------------------------------------------------


@pytest.fixture(scope="module")
def handed_in(tmp_path_factory):
    """A folder of twelve submissions and three hostile ones, some of them ZIPs."""
    place = tmp_path_factory.mktemp("handed-in")
    edits = {"complete": [], "half-done": HALF_DONE} | MISTAKES | HOSTILE
    for name, edit in edits.items():
        write_submission(place / name, edit)
    zipped = place / "velocity-lost"
    write_zip(place / "velocity-lost.zip", files_of(zipped, "coursework/code/"))
    for path in zipped.iterdir():
        path.unlink()
    zipped.rmdir()
    solution = files_of(place / "complete")
    write_zip(place / "escaping.zip", solution | {"../escaped.txt": "out"})
    return place


def test_hostile_ones_harm_no_other(handed_in, tmp_path):
    before = sorted(path.relative_to(handed_in) for path in handed_in.rglob("*"))
    out = tmp_path / "out"
    graded = run("grade.py", handed_in, "--out", out, "--time-limit", 3, "--jobs", 2)
    assert graded.returncode == 1
    assert graded.stderr == ""
    assert sorted(path.relative_to(handed_in) for path in handed_in.rglob("*")) == before

    with open(out / "grades.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = {"complete", "half-done", "escaping", *MISTAKES, *HOSTILE}
    assert {row["submission"] for row in rows} == names
    passing = {row["submission"] for row in rows} - {
        row["submission"] for row in rows if row["passed"] != row["of"]
    }
    assert passing == {"complete"}
    notes = {(row["submission"], row["grader"]): row["notes"] for row in rows}
    assert notes["escaping", "-"] == (
        "the ZIP is refused: '../escaped.txt' leads out of its folder"
    )
    for name, cause in (("endless-loop", "stopped after 3 s"), ("os-exit", "with exit code 7")):
        assert cause in notes[name, "ResolveCollisionsGrading"]
        assert notes[name, "Constraints"] == notes[name, "integrationGrading"] == ""
    assert "velocity is lost" in notes["velocity-lost", "ResolveCollisionsGrading"]
    assert not list(tmp_path.rglob("escaped.txt"))
    assert len(list(out.glob("*.md"))) == 15
    assert "modules found in coursework/code" in (out / "velocity-lost.md").read_text()


def test_grading_twice_gives_the_same(handed_in, tmp_path):
    names = ("com-not-subtracted", "half-done", "velocity-lost.zip", "escaping.zip")
    written = []
    for jobs in (1, 4):
        out = tmp_path / str(jobs)
        graded = run(
            "grade.py", *(handed_in / name for name in names), "--out", out, "--jobs", jobs
        )
        assert graded.returncode == 1, graded.stderr
        written.append({path.name: path.read_bytes() for path in out.iterdir()})
    assert written[0] == written[1]
    assert len(written[0]) == 5


# ---- Command line of grade.py -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "cause"),
    [
        (["nowhere"], "nowhere: there is no such file or folder"),
        (["empty"], "empty: there is no submission in this folder"),
        (["file.txt"], "file.txt: a submission is a folder or a ZIP"),
        (["student", "--jobs", "0"], "--jobs must lie between 1 and 64, not 0"),
        (["student", "--data", "empty"], "integration.data: cannot be read: No such file"),
        (["student", "--out", "file.txt"], "file.txt: File exists"),
        (["student", "--time-limit", "-1"], "must be a number above 0 and up to 86400, not '-1'"),
    ],
)
def test_wrong_arguments_get_one_line(arguments, cause, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_submission(tmp_path / "student")
    (tmp_path / "empty").mkdir()
    (tmp_path / "file.txt").write_text("text")
    graded = run("grade.py", *arguments)
    assert graded.returncode == 2
    assert graded.stdout == ""
    (line,) = graded.stderr.splitlines()
    assert line.startswith("grade.py: ")
    assert cause in line


def test_texts_of_a_submission_are_made_harmless(tmp_path):
    write_submission(
        tmp_path / "=SUM(1)",
        [(START, "    raise ValueError('<b>|`x`](http://y)\\x1b[2J')\n")],
    )
    graded = run("grade.py", tmp_path / "=SUM(1)", "--out", tmp_path / "out")
    assert graded.returncode == 1, graded.stderr
    sheet = (tmp_path / "out" / "_SUM_1_.md").read_text(encoding="utf-8")
    assert "ValueError: \\<b\\>\\|\\`x\\`\\](http://y) \\[2J" in sheet
    for text in (sheet, graded.stdout, (tmp_path / "out" / "grades.csv").read_text()):
        assert "\x1b" not in text


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_ctrl_c_ends_all_in_one_line(tmp_path):
    for name in ("one", "two", "three"):
        write_submission(tmp_path / "all" / name, HOSTILE["endless-loop"])
    command = [
        sys.executable, ROOT / "graders" / "grade.py", tmp_path / "all", "--out", tmp_path / "out",
        "--jobs", "2",
    ]  # fmt: skip
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    process = subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    begin = time.monotonic()
    while len(list(tmp_path.glob("submission-*/answers.jsonl"))) < 2:
        assert time.monotonic() - begin < 30
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    printed, errors = process.communicate(timeout=20)
    assert (process.returncode, printed, errors) == (130, "", "grade.py: stopped by Ctrl-C\n")
    assert not list(tmp_path.glob("submission-*"))


# ---- Finding and unpacking ----------------------------------------------------------------------


def test_submissions_are_found_and_named(tmp_path):
    write_submission(tmp_path / "all" / "one")
    write_submission(tmp_path / "all" / "two" / "code")
    write_submission(tmp_path / "all" / "Three 3" / "deep" / "down")
    write_zip(tmp_path / "all" / "one.zip", files_of(tmp_path / "all" / "one"))
    (tmp_path / "all" / ".hidden").mkdir()
    (tmp_path / "all" / "notes.txt").write_text("text")
    found = find_submissions([tmp_path / "all", tmp_path / "all" / "two"])
    assert [entry.name for entry in found] == ["Three_3", "one", "one-2", "two", "two-2"]
    assert find_modules(found[0].path) == tmp_path / "all" / "Three 3" / "deep" / "down"
    assert find_modules(found[1].path) == found[1].path
    assert find_modules(found[3].path) == found[3].path / "code"
    with pytest.raises(SubmissionError, match="holds neither RBSFunctions.py nor Quaternion.py"):
        find_modules(tmp_path / "all" / ".hidden")


def member(name, kind=0o100644):
    info = zipfile.ZipInfo(name)
    info.external_attr = kind << 16
    return info


def encrypted(path):
    """Says that it is encrypted: bit 0 of the flags, in both headers."""
    content = bytearray(path.read_bytes())
    content[content.index(b"PK\3\4") + 6] |= 1
    content[content.index(b"PK\1\2") + 8] |= 1
    path.write_bytes(bytes(content))


REFUSED = {
    "up": ([("a/../../x", "1")], "'a/../../x' leads out of its folder"),
    "absolute": ([("/tmp/x", "1")], "'/tmp/x' leads out of its folder"),
    "backslashes": ([("..\\x", "1")], "'../x' leads out of its folder"),
    "drive": ([("C:x", "1")], "'C:x' leads out of its folder"),
    "link": ([(member("x", 0o120777), "/etc/passwd")], "'x' is a link or a device"),
    "device": ([(member("x", 0o020666), "")], "'x' is a link or a device"),
    "twice": ([("x", "1"), ("./X", "2")], "the ZIP holds './X' twice"),
    "file and folder": ([("x", "1"), ("x/y", "2")], "the ZIP cannot be unpacked"),
    "odd name": ([("a\x1bb", "1")], "is no name for a file"),
    "many": ([(f"{k}", "") for k in range(6)], "holds more than 5 files"),
    "large": ([("x", "0" * 600), ("y", "0" * 600)], "unpacks to more than 0 MB"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_zips_that_would_do_harm_are_refused(case, tmp_path, monkeypatch):
    members, cause = REFUSED[case]
    monkeypatch.setattr(archives, "MOST_FILES", 5)
    monkeypatch.setattr(archives, "MOST_BYTES", 1000)
    path, target = tmp_path / "it.zip", tmp_path / "deep" / "target"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members:
            archive.writestr(name, content)
    target.mkdir(parents=True)
    with pytest.raises(SubmissionError, match=re.escape(cause)):
        unpack(path, target)
    outside = [one for one in tmp_path.rglob("*") if one.is_file() and target not in one.parents]
    assert outside == [path]


def test_the_size_is_counted_and_not_believed(tmp_path, monkeypatch):
    """A member that says it has one byte, and has a thousand."""
    monkeypatch.setattr(archives, "MOST_BYTES", 500)
    path = write_zip(tmp_path / "it.zip", {"x": "0" * 1000})
    content = path.read_bytes()
    size = (1000).to_bytes(4, "little")
    assert content.count(size) == 2
    path.write_bytes(content.replace(size, (1).to_bytes(4, "little")))
    (tmp_path / "target").mkdir()
    with pytest.raises(SubmissionError):
        unpack(path, tmp_path / "target")
    assert sum(one.stat().st_size for one in (tmp_path / "target").iterdir()) <= 500


@pytest.mark.parametrize("damage", ["text", "cut", "encrypted", "flipped"])
def test_what_is_no_zip_is_refused(damage, tmp_path):
    path = write_zip(tmp_path / "it.zip", {"x": os.urandom(2000)})
    if damage == "text":
        path.write_text("this is not a ZIP")
    elif damage == "cut":
        path.write_bytes(path.read_bytes()[:1000])
    elif damage == "encrypted":
        encrypted(path)
    else:
        content = bytearray(path.read_bytes())
        content[500] ^= 0xFF
        path.write_bytes(bytes(content))
    (tmp_path / "target").mkdir()
    cause = "'x' is encrypted" if damage == "encrypted" else "this is not a readable ZIP"
    with pytest.raises(SubmissionError, match=cause):
        unpack(path, tmp_path / "target")


def test_a_sound_zip_is_unpacked(tmp_path):
    files = {"a/x.py": "1", "a\\y.py": "2", "__MACOSX/x.py": "3", "b/": ""}
    path = write_zip(tmp_path / "it.zip", files)
    (tmp_path / "target").mkdir()
    unpack(path, tmp_path / "target")
    found = {
        one.relative_to(tmp_path / "target").as_posix(): one.read_text()
        for one in (tmp_path / "target").rglob("*")
        if one.is_file()
    }
    assert found == {"a/x.py": "1", "a/y.py": "2"}
