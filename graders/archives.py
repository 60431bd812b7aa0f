"""Hand-ins as they come: found in a folder, named, and read from folders, ZIPs and tars.

Of a hand-in, only the folder with RBSFunctions.py and what lies below it is taken, as a copy. Links
are never followed, and no name can lead out of the copy.
"""

import os
import re
import stat
import tarfile
import tempfile
import unicodedata
import zipfile
import zlib
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rbs.program.submissions import SUBMITTED_MODULES, SubmissionError

TARS = (".tar", ".tar.gz", ".tgz")
ARCHIVES = (".zip", *TARS)
# Loose files that are refused by name, since they may well be somebody's work.
UNREAD = (".7z", ".rar", ".py")
# Folders that are nobody's solution, in lower case, beside those that begin with a dot.
PASSED_OVER = {"__pycache__", "__macosx", "env", "venv", "node_modules", "site-packages"}
# What a solution needs at most; what is larger, or comes later, is left out.
LARGEST_FILE = 4 << 20
MOST_BYTES = 64 << 20
MOST_FILES = 2000
# Characters of a name, so that "NAME-2.md" is a name for a file, too.
LONGEST_NAME = 80
# Downloads of Moodle, NAME_ID_assignsubmission_file_FILE, and of Canvas, NAME_LATE_ID_ID_FILE.
DOWNLOAD = re.compile(
    r"(.+?)(?:_late)?_(\d+)_(?:\d+|assignsubmission_file)(?:_(.*))?", re.IGNORECASE
)
MODULE_FILES = {f"{name}.py".lower(): f"{name}.py" for name in SUBMITTED_MODULES}
FUNCTIONS = "rbsfunctions.py"


@dataclass(frozen=True)
class Entry:
    """A hand-in: its name, which no other one has and any file can have, and its path.

    files : pairs (name, path) where it is a student's loose files instead, as Canvas gives them
    isAnonymous : whether no text may name a folder of it
    """

    name: str
    path: Path
    files: tuple = ()
    isAnonymous: bool = False


# ---- Finding hand-ins ---------------------------------------------------------------------------


def find_submissions(paths):
    """The list of Entry that the paths stand for, each a hand-in or a folder of hand-ins.

    An archive is a hand-in, and so is a folder with RBSFunctions.py in it or in its `code`. Of any
    other folder, each archive and each folder is one. Raises SubmissionError.
    """
    found = []
    for path in map(Path, paths):
        if _is_archive(path) or _is_submission(path):
            found.append((_name_of(path), path, ()))
        elif path.is_dir():
            inside = _inside(path)
            if not inside:
                raise SubmissionError(f"{path}: there is no submission in this folder")
            found += inside
        elif path.exists():
            raise SubmissionError(f"{path}: a submission is a folder, a ZIP or a tar")
        else:
            raise SubmissionError(f"{path}: there is no such file or folder")
    entries = {}
    for stem, path, files in found:
        name, number = stem, 1
        while name.lower() in entries:
            number += 1
            name = f"{stem}-{number}"
        entries[name.lower()] = Entry(name, path, files)
    return list(entries.values())


def find_submission(path):
    """The Entry of a path that is one hand-in, whatever it holds. Raises SubmissionError."""
    first, *_others = find_submissions([path])
    return Entry(first.name, Path(path))


def _inside(folder):
    """The hand-ins in a folder, in order: (name, path, loose files)."""
    found, loose = [], {}
    for path in sorted(folder.iterdir()):
        if _is_passed_over(path.name):
            continue
        download, ending = DOWNLOAD.fullmatch(path.name), path.suffix.lower()
        if path.is_dir() or _is_archive(path):
            found.append((_name_of(path), path, ()))
        elif download and ending == ".py":
            file = re.sub(r"-\d+(\.\w+)$", r"\1", download[3] or "")  # handed in once more
            loose.setdefault(download.group(1, 2), []).append((file, path))
        elif ending in UNREAD:
            found.append((plain(path.name), path, ()))
    return found + [(plain(who), files[0][1], tuple(files)) for (who, _), files in loose.items()]


def _is_archive(path):
    return path.is_file() and path.name.lower().endswith(ARCHIVES)


def _is_passed_over(name):
    return name.startswith(".") or name.lower() in PASSED_OVER


def _is_submission(path):
    folders = [one for one in (path, path / "code") if one.is_dir()]
    return any(file.name.lower() == FUNCTIONS for one in folders for file in one.iterdir())


def _name_of(path):
    """The student's name where a download has it, or else the file's without its ending."""
    name = path.resolve().name
    if path.is_file():
        name = re.sub(r"(\.tar)?\.\w+$", "", name)
    download = DOWNLOAD.fullmatch(name)
    return plain(download[1] if download else name)


def plain(name):
    """A name as it is, but for what a file system cannot hold."""
    name = unicodedata.normalize("NFC", name)
    name = "".join(c if c.isprintable() and c not in '<>:"/\\|?*' else "_" for c in name)
    return name[:LONGEST_NAME].strip(" .") or "submission"


# ---- Reading them -------------------------------------------------------------------------------


@contextmanager
def modules_of(entry):
    """Yields (folder with a copy of the student's modules, remarks) while they are needed.

    Raises SubmissionError where there is no RBSFunctions.py, or nothing can be read.
    """
    with tempfile.TemporaryDirectory(prefix="submission-", ignore_cleanup_errors=True) as place:
        folder = Path(place).resolve()
        try:
            with ExitStack() as stack:
                remarks = _take(_members(entry, stack), folder, entry.isAnonymous)
        except SubmissionError:
            raise
        except OSError as error:
            raise SubmissionError(f"cannot be read: {error.strerror or error}") from None
        except (zipfile.BadZipFile, tarfile.TarError, zlib.error, EOFError, ValueError):
            raise SubmissionError("is no ZIP or tar, or a damaged one") from None
        except RuntimeError:
            raise SubmissionError("is encrypted, or packed in a way that is not read") from None
        yield folder, remarks


def _members(entry, stack):
    """The files of a hand-in: a list of (tuple of folders and name, function that opens it).

    Where RBSFunctions.py is not among them, the archives that are have been opened, too.
    """
    if entry.files:
        return [((name,), partial(open, path, "rb")) for name, path in entry.files]
    if entry.path.is_dir():
        members = list(_in_folder(entry.path))
    elif _is_archive(entry.path):
        members = list(_in_archive(entry.path.name, open(entry.path, "rb"), stack))
    else:
        raise SubmissionError(
            f"a loose {entry.path.suffix} file is not read: put RBSFunctions.py "
            "and what it needs into a folder, a ZIP or a tar"
        )
    if not any(parts[-1].lower() == FUNCTIONS for parts, _ in members):
        for parts, opener in members[:]:
            if parts[-1].lower().endswith(ARCHIVES):
                inner = _in_archive(parts[-1], opener(), stack)
                members += [(parts + more, one) for more, one in inner]
    return members


def _in_folder(folder):
    for root, folders, files in os.walk(folder):
        folders[:] = [one for one in folders if not _is_passed_over(one)]
        for path in (Path(root) / name for name in files):
            if path.is_file() and not path.is_symlink():
                yield _parts(str(path.relative_to(folder))), partial(open, path, "rb")


def _in_archive(name, file, stack):
    stack.enter_context(file)
    if name.lower().endswith(TARS):
        archive = stack.enter_context(tarfile.open(fileobj=file))
        found = ((one.name, partial(archive.extractfile, one)) for one in archive if one.isfile())
    else:
        archive = stack.enter_context(zipfile.ZipFile(file))
        found = (
            (one.filename, partial(archive.open, one))
            for one in archive.infolist()
            if not one.is_dir() and not stat.S_ISLNK(one.external_attr >> 16)
        )
    for name, opener in found:
        parts = _parts(name)
        if parts and not any(map(_is_passed_over, parts)):  # ".." is passed over, too
            yield parts, opener


def _parts(name):
    parts = name.replace("\\", "/").split("/")
    return tuple(part if part == ".." else plain(part) for part in parts if part not in ("", "."))


def _take(members, target, isAnonymous):
    """Copies the student's modules, and what lies beside and below them; returns remarks."""
    folders = {parts[:-1] for parts, _ in members if parts[-1].lower() == FUNCTIONS}
    if not folders:
        unread = [one for one in UNREAD[:2] for parts, _ in members if parts[-1].endswith(one)]
        more = f"; its {unread[0]} file is not read" if unread else ""
        raise SubmissionError(f"holds no RBSFunctions.py{more}")
    top, *others = sorted(folders, key=lambda folder: (len(folder), folder))
    shown = ["a folder" if isAnonymous else "/".join(one) or "." for one in (top, *others)]
    remarks = [f"modules found in {shown[0]}"] if top else []
    remarks += [f"another RBSFunctions.py, in {one}, is not graded" for one in shown[1:]]

    wanted = [(p[len(top) :], one) for p, one in members if p[: len(top)] == top != p]
    wanted.sort(key=lambda one: len(one[0]))
    names = {parts[0] for parts, _ in wanted}
    left, lost = MOST_BYTES, len(wanted[MOST_FILES:])
    for parts, opener in wanted[:MOST_FILES]:
        right = MODULE_FILES.get(parts[0].lower())
        if len(parts) == 1 and right and right not in names:
            remarks.append(f"{parts[0]} is read as {right}")
            parts = (right,)
        with opener() as source:
            content = source.read(LARGEST_FILE + 1)
        if len(content) > min(LARGEST_FILE, left):
            lost += parts[-1].endswith(".py")
            continue
        left -= len(content)
        path = target.joinpath(*parts)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return remarks + [f"{lost} files are left out: too many or too large"] * bool(lost)
