"""Submissions that hang, crash, end the interpreter or escape: they harm nobody but themselves."""

import os
import re
import signal
import sys
from pathlib import Path

import pytest
from handIns import start, stopped
from isolated import archives
from isolated.archives import HandIn, find_submissions, read, read_submission
from program import wait_for
from studentVariants import HOSTILE, SOLUTION, START, write_submission, write_zip

COLLISIONS = "ResolveCollisionsGrading.py"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit of the address space")
def test_memory_is_limited(tmp_path, run):
    folder = write_submission(tmp_path / "student", [(START, "    np.ones(1 << 28)\n")])  # 2 GiB
    graded = run(COLLISIONS, "--modules", folder, "--memory-limit", 1024)
    assert graded.returncode == 1
    assert "MemoryError: Unable to allocate 2.00 GiB" in graded.stdout
    assert re.search("rotated inverse inertia +[0-9.e-]+ .*[0-9]\n", graded.stdout)  # the rest


WRECK = """    import subprocess
    assert not {{'DISPLAY', 'WAYLAND_DISPLAY'}} & set(os.environ)
    assert os.environ['MPLBACKEND'] == 'Agg'
    assert {isUser} or os.getuid() >= 30000
    open(os.path.join(os.path.dirname(os.path.abspath(__file__)), 'written'), 'w').close()
    if os.path.exists(__file__):
        os.remove(__file__)
        subprocess.Popen(['sleep', '{seconds}'])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_its_files_and_processes_do_no_harm(tmp_path, run, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    seconds = f"298.{os.getpid()}"
    folder = write_submission(
        tmp_path / "student",
        [(START, WRECK.format(seconds=seconds, isUser=os.getuid() > 0) + START)],
    )
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    graded = run(COLLISIONS, "--modules", folder)
    assert graded.returncode == 0, graded.stdout
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    lines = [read_process(f"{one.name}/cmdline") for one in Path("/proc").glob("[0-9]*")]
    assert not [line for line in lines if seconds in line]


def read_process(path):
    """Returns the text of a file in /proc, empty if its process has ended."""
    try:
        return Path("/proc", path).read_text(errors="replace")
    except OSError:
        return ""


def is_running(pid):
    return read_process(f"{pid}/stat").rpartition(")")[2].split()[:1] not in ([], ["Z"])


def workers_of(pid):
    paths = Path(f"/proc/{pid}/task").glob("*/children")
    children = [int(word) for path in paths for word in read_process(path).split()]
    return [one for one in children if "worker/main.py" in read_process(f"{one}/cmdline")]


BAD = {
    "grade.py file.txt": "file.txt: not a folder or a ZIP",
    "grade.py student --out file.txt": "file.txt: a file, not a folder",
    "compare.py student nosuch": "no such scene or file; RigidBodySimulation.py --help lists",
    "integrationGrading.py --modules empty": "empty: no submission in this folder",
    "Constraints.py --modules noted.zip": "noted.zip: has no RBSFunctions.py; save the functions",
    "compare.py student mixed --constraints no.txt": "no.txt: ",
    "compare.py student mixed --set 3": "argument --set: '3' is not NAME=VALUE",
    "compare.py student mixed --restitution 2": "a finite number, 0 to 1, not '2' (",
    "Constraints.py --memory-limit 64": "--memory-limit: must be 256 or more, not 64 ",
    "integrationGrading.py --time-limit 0": "--time-limit: must be 0.1 or more, not 0 ",
    "grade.py student empty --results r.json": "--results is of one submission, not of 2",
    "compare.py student student": "student: a folder, not a file",
    "compare.py . mixed": ".: holds 3 submissions; name one, such as noted.zip",
    "compare.py unloadable mixed": "No module named 'numba'; to do: add the file numba.py, or",
}


@pytest.mark.parametrize("command", BAD)
def test_wrong_arguments_get_one_line(command, tmp_path, run):
    write_submission(tmp_path / "student")
    write_submission(tmp_path / "unloadable", [("import os\n", "import numba\n")])
    (tmp_path / "empty").mkdir()
    write_zip(tmp_path / "noted.zip", {"cw.ipynb": ""})
    (tmp_path / "file.txt").write_text("text")
    graded = run(*command.split(), cwd=tmp_path)
    assert (graded.returncode, graded.stdout) == (2, "")
    (line,) = graded.stderr.splitlines()
    assert line.startswith(f"{command.split()[0]}: ") and BAD[command] in line


def test_what_cannot_be_imported_comes_first(tmp_path, run):
    write_submission(tmp_path / "student", [("import os\n", "import os as\n")])
    graded = run("Constraints.py", "--modules", "student/RBSFunctions.py", cwd=tmp_path)
    assert graded.returncode == 1 and "SyntaxError" in graded.stdout
    (line,) = [line for line in graded.stdout.splitlines() if line.startswith("Next: ")]
    assert line.endswith("keeps RBSFunctions.py from being imported")


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_signal_ends_all_in_one_line(tmp_path):
    for name in ("one", "two", "three"):
        write_submission(tmp_path / "all" / name, HOSTILE["endless-loop"])
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    process = start(tmp_path / "all", "--out", tmp_path / "out", "--jobs", 2, env=environment)
    found = wait_for(lambda: len(some := workers_of(process.pid)) == 2 and some)
    said = "grade.py: stopped with 0 of 3 graded; --resume continues"
    assert stopped(process, tmp_path / "out", signal.SIGINT) == (130, said, 0)
    wait_for(lambda: not any(map(is_running, found)))
    assert not list(tmp_path.glob("running-*"))


def taken(path):
    """What is read of a submission: (dict from path to text, remarks)."""
    read(handIn := HandIn("it", path))
    code = {k.removeprefix("code/"): v for k, v in handIn.files.items() if k[:5] == "code/"}
    return {name: content.decode() for name, content in code.items()}, handIn.remarks


LOST = "1 file left out: too many or too large"
CASES = {
    "up": ({"a/../../x.py": "1", "../y.py": "2"}, {}, []),
    "absolute": ({"/tmp/x.py": "1", "C:\\y.py": "2"}, {"tmp/x.py": "1", "C_/y.py": "2"}, []),
    "twice": ({"x.py": "1", "./x.py": "2"}, {"x.py": "2"}, []),
    "many": ({f"a/{k}.py": "" for k in range(4)}, {f"a/{k}.py": "" for k in range(3)}, [LOST]),
    "large": ({"x.py": "0" * 600}, {}, [LOST]),
    "in all": ({"x.py": "0" * 450, "y.py": "0" * 451}, {"x.py": "0" * 450}, [LOST]),
}


@pytest.mark.parametrize("case", CASES)
def test_only_what_is_needed_and_harmless_is_read_from_a_zip(case, tmp_path, monkeypatch):
    members, expected, remarks = CASES[case]
    monkeypatch.setattr(archives, "MOST_FILES", 4)
    monkeypatch.setattr(archives, "LARGEST_FILE", 500)
    monkeypatch.setattr(archives, "MOST_BYTES", 900)
    write_zip(tmp_path / "it.zip", {"RBSFunctions.py": ""} | members)
    assert taken(tmp_path / "it.zip") == ({"RBSFunctions.py": ""} | expected, remarks)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [tmp_path / "it.zip"]


def test_links_are_not_followed(tmp_path):
    folder = write_submission(tmp_path / "student")
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "secret.py").write_text("read")
    (folder / "linked.py").symlink_to(tmp_path / "secret" / "secret.py")
    (folder / "linked").symlink_to(tmp_path / "secret")
    assert set(taken(folder)[0]) == set(SOLUTION)
    (tmp_path / "copier").symlink_to(folder)  # one's own link to a submission is
    for path in (tmp_path / "copier", folder / "RBSFunctions.py"):
        assert set(read_submission(path).files) == {f"code/{one}" for one in SOLUTION}
    found = {one.name: one for one in find_submissions([tmp_path])}
    for one in found.values():
        read(one)
    assert found["copier"].problem.startswith("is a link") and not found["student"].problem
