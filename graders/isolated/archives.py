"""Finds submissions in folders, names them, and reads them from folders, ZIPs and tars.

Only the folder with RBSFunctions.py and its subfolders are read, and a copy of them is used. Links
are never followed, and no name can lead out of the copy.
"""

import itertools
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

from rbs.program.submissions import SUPPLIED, SubmissionError

TARS = (".tar", ".tar.gz", ".tgz")
ARCHIVES = (".zip", *TARS)
# Loose files that are refused by name, because they may be somebody's work.
UNREAD = (".7z", ".rar", ".py")
# Folders without a solution, in lower case; those that begin with a dot are skipped, too.
SKIPPED = {"__pycache__", "__macosx", "env", "venv", "node_modules", "site-packages"}
# The most that a solution needs, in bytes and files. Larger or further files are left out.
LARGEST_FILE = 4 << 20
MOST_BYTES = 64 << 20
MOST_FILES = 2000
# Characters of a name, so that "NAME-2.md" is a valid file name, too.
LONGEST_NAME = 80
# Downloads of Moodle, NAME_ID_assignsubmission_file_FILE, and of Canvas, NAME_LATE_ID_ID_FILE.
DOWNLOAD = re.compile(
    r"(.+?)(?:_late)?_(\d+)_(?:\d+|assignsubmission_file)(?:_(.*))?", re.IGNORECASE
)
MODULE_FILES = {f"{name}.py".lower(): f"{name}.py" for name in ("RBSFunctions", *SUPPLIED)}
FUNCTIONS = "rbsfunctions.py"
LOOSE = "a loose {} file is not read: put RBSFunctions.py and what it needs into a folder or a ZIP"


@dataclass(frozen=True)
class Entry:
    """A submission: a unique name that any file can have, and a path.

    files : pairs (name, path) if the submission consists of loose files, as from Canvas
    isAnonymous : whether no text may name its folders
    """

    name: str
    path: Path
    files: tuple = ()
    isAnonymous: bool = False


# ---- Finding submissions ------------------------------------------------------------------------


def find_submissions(paths):
    """Returns the list of Entry in these paths, each a submission or a folder of submissions.

    An archive is a submission, and so is a folder with RBSFunctions.py in it or in its `code`. In
    any other folder, each archive and each folder is one. Raises SubmissionError.
    """
    found = []
    for path in map(Path, paths):
        tops = [one for one in (path, path / "code") if one.is_dir()]
        names = [file.name.lower() for one in tops for file in one.iterdir()]
        if _is_archive(path) or FUNCTIONS in names:
            found.append((_name_of(path), path, ()))
        elif path.is_dir():
            inside = _inside(path)
            if not inside:
                raise SubmissionError(f"{path}: no submission in this folder")
            found += inside
        else:
            exists = "not a folder, a ZIP or a tar" if path.exists() else "no such file or folder"
            raise SubmissionError(f"{path}: {exists}")
    entries = {}
    for stem, path, files in found:
        names = itertools.chain([stem], (f"{stem}-{number}" for number in itertools.count(2)))
        name = next(name for name in names if name.lower() not in entries)
        entries[name.lower()] = Entry(name, path, files)
    return list(entries.values())


def find_submission(path):
    """Returns the Entry of a path that is one submission. Raises SubmissionError."""
    return Entry(find_submissions([path])[0].name, Path(path))


def _inside(folder):
    """The submissions in a folder, in order: (name, path, loose files)."""
    found, loose = [], {}
    for path in sorted(folder.iterdir()):
        if _is_skipped(path.name):
            continue
        download, ending = DOWNLOAD.fullmatch(path.name), path.suffix.lower()
        if path.is_dir() or _is_archive(path):
            found.append((_name_of(path), path, ()))
        elif download and ending == ".py":
            file = re.sub(r"-\d+(\.\w+)$", r"\1", download[3] or "")  # submitted again
            loose.setdefault(download.group(1, 2), []).append((file, path))
        elif ending in UNREAD:
            found.append((plain(path.name), path, ()))
    return found + [(plain(who), files[0][1], tuple(files)) for (who, _), files in loose.items()]


def _is_archive(path):
    return path.is_file() and path.name.lower().endswith(ARCHIVES)


def _is_skipped(name):
    return name.startswith(".") or name.lower() in SKIPPED


def _name_of(path):
    """The student's name in the name of a download; for other paths, the name without ending."""
    name = path.resolve().name
    if path.is_file():
        name = re.sub(r"(\.tar)?\.\w+$", "", name)
    download = DOWNLOAD.fullmatch(name)
    return plain(download[1] if download else name)


def plain(name):
    """Returns a name without characters that a file system refuses."""
    name = unicodedata.normalize("NFC", name)
    name = "".join(c if c.isprintable() and c not in '<>:"/\\|?*' else "_" for c in name)
    return name[:LONGEST_NAME].strip(" .") or "submission"


# ---- Reading them -------------------------------------------------------------------------------


@contextmanager
def modules_of(entry):
    """Yields (folder with a copy of the student's modules, remarks), and removes it in the end.

    Raises SubmissionError if RBSFunctions.py is missing, or the submission cannot be read.
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
            raise SubmissionError("is not a ZIP or tar, or is damaged") from None
        except RuntimeError:
            raise SubmissionError("is encrypted, or compressed in an unknown way") from None
        yield folder, remarks


def _members(entry, stack):
    """The files of a submission: a list of (tuple of folders and name, function that opens it).

    Archives among them are opened, too, if RBSFunctions.py is not among the files.
    """
    if entry.files:
        return [((name,), partial(open, path, "rb")) for name, path in entry.files]
    if not entry.path.is_dir() and not _is_archive(entry.path):
        raise SubmissionError(LOOSE.format(entry.path.suffix))
    members = list(_opened(entry.path, stack))
    if not _folders_in(members):
        for parts, opener in members[:]:
            if parts[-1].lower().endswith(ARCHIVES):
                inner = _opened(parts[-1], stack, stack.enter_context(opener()))
                members += [(parts + more, one) for more, one in inner]
    return members


def _opened(path, stack, file=None):
    """Yields the files of a folder, or of a ZIP or tar, which may be opened already."""
    if file is None and path.is_dir():
        found = [(one.relative_to(path), partial(open, one, "rb")) for one in _walked(path)]
    elif str(path).lower().endswith(TARS):
        archive = stack.enter_context(tarfile.open(path, fileobj=file))
        found = ((one.name, partial(archive.extractfile, one)) for one in archive if one.isfile())
    else:
        archive = stack.enter_context(zipfile.ZipFile(file or path))
        files = (one for one in archive.infolist() if not one.is_dir())
        plainFiles = (one for one in files if not stat.S_ISLNK(one.external_attr >> 16))
        found = ((one.filename, partial(archive.open, one)) for one in plainFiles)
    for name, opener in found:
        parts = [one for one in str(name).replace("\\", "/").split("/") if one not in ("", ".")]
        if parts and not any(map(_is_skipped, parts)):  # skips "..", too
            yield tuple(map(plain, parts)), opener


def _walked(folder):
    for root, folders, files in os.walk(folder):
        folders[:] = [one for one in folders if not _is_skipped(one)]
        paths = (Path(root) / name for name in files)
        yield from (path for path in paths if path.is_file() and not path.is_symlink())


def _folders_in(members):
    """The folders with an RBSFunctions.py, the uppermost first."""
    folders = {parts[:-1] for parts, _ in members if parts[-1].lower() == FUNCTIONS}
    return sorted(folders, key=lambda folder: (len(folder), folder))


def _take(members, target, isAnonymous):
    """Copies the student's modules, and the files beside and below them; returns remarks."""
    if not (folders := _folders_in(members)):
        unread = [one for one in UNREAD[:2] for parts, _ in members if parts[-1].endswith(one)]
        more = f"; its {unread[0]} file is not read" if unread else ""
        raise SubmissionError(f"has no RBSFunctions.py{more}")
    top, shown = folders[0], ["/".join(one) or "." for one in folders]
    shown = ["a folder"] * len(folders) if isAnonymous else shown
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
