"""Finds submissions in folders, names them, and reads them from folders, ZIPs and tars.

A submission is read once, into memory. Links, pipes and devices are never opened. From the top:
finding submissions; reading them.
"""

import errno
import io
import os
import re
import stat
import tarfile
import unicodedata
import zipfile
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, partial
from hashlib import sha256
from itertools import chain, count
from pathlib import Path

from reference.graderData import DATA_DIRECTORY

from rbs.program.submissions import SUPPLIED, SubmissionError, is_skipped

TARS = (".tar", ".tar.gz", ".tgz")
ARCHIVES = (".zip", *TARS)
# Loose files that are refused by name, because they may be somebody's work.
UNREAD = (".7z", ".rar", ".py", ".pdf")
SCENE_FILES = (".mesh", ".off", ".txt")
# What a marker reads and watches, which is not read here.
DOCUMENTS = (".pdf", ".docx", ".odt", ".mp4", ".mov", ".avi", ".mkv", ".webm", ".gif", ".png")
# The most that a solution needs, in bytes and files. Larger or further files are left out.
LARGEST_FILE = 4 << 20
MOST_BYTES = 64 << 20
MOST_FILES = 2000
# Of a tar, which must be decompressed to be searched, in bytes; and of remarks on other solutions.
LARGEST_TAR, MOST_FOLDERS = 1 << 28, 8
# Bytes of a name, so that "NAME-2.md" is a valid file name, too.
LONGEST_NAME = 80
# Downloads of Moodle, NAME_ID_assignsubmission_file_FILE, and of Canvas, NAME_LATE_ID_ID_FILE.
DOWNLOAD = re.compile(
    r"(.+?)(?:_late)?_(\d+)_(?:\d+|assignsubmission_file)(?:_(.*))?", re.IGNORECASE
)
MODULES = {name.lower(): f"{name}.py" for name in ("RBSFunctions", *SUPPLIED)}
# A module's name, perhaps with what browsers and file managers add.
MODULE = re.compile(r"(\w+?)(?: ?\(\d+\)|[ _-]+(?:copy|\d+))?\.py", re.IGNORECASE)
FUNCTIONS = "RBSFunctions.py"
LOOSE = "a loose {} file is not read: put RBSFunctions.py and what it needs into a folder or a ZIP"


@dataclass
class HandIn:
    """A submission: where it is, and what has been read of it.

    name : unique, and valid as a file name
    loose : pairs (name, path) of loose files, as from Canvas
    files : dict from path, "code/..." or "data/...", to bytes; remarks : list of str
    problem : why it cannot be graded, or ""; digest : differs if anything in it does
    isDisturbed : whether another submission may have changed how it ran
    """

    name: str
    path: Path
    loose: tuple = ()
    files: dict = field(default_factory=dict)
    remarks: list = field(default_factory=list)
    problem: str = ""
    digest: str = ""
    isDisturbed: bool = False


def find_submissions(paths):
    """Returns the list of HandIn in these paths, each a submission or a folder of submissions.

    A submission is an archive, or a folder with RBSFunctions.py in it or in its `code`. In any
    other folder, each archive and each folder is one. Raises SubmissionError.
    """
    found, handIns = [], {}
    for path in map(Path, paths):
        tops = [one for one in (path, path / "code") if one.is_dir()]
        names = [_module(file.name) for one in tops for file in one.iterdir()]
        if _is_archive(path) or FUNCTIONS in names:
            found.append((path, ()))
        elif path.is_dir():
            inside = _inside(path)
            if not inside:
                raise SubmissionError(f"{path}: no submission in this folder")
            found += inside
        else:
            exists = "not a folder, a ZIP or a tar" if path.exists() else "no such file or folder"
            raise SubmissionError(f"{path}: {exists}")
    for path, loose in found:
        stem = _name_of(path)
        names = chain([stem], (f"{stem}-{number}" for number in count(2)))
        name = next(name for name in names if name.lower() not in handIns)
        handIns[name.lower()] = HandIn(name, path, loose)
    return list(handIns.values())


def _inside(folder):
    """The submissions in a folder, in order: (path, loose files)."""
    found, loose = {}, {}
    for path in sorted(folder.iterdir()):
        if is_skipped(path.name):
            continue
        download, ending = DOWNLOAD.fullmatch(path.name), path.suffix.lower()
        key = download.group(1, 2) if download else path
        if path.is_dir() or _is_archive(path):
            found[key if key not in found else path] = path
        elif download and ending in (".py", *DOCUMENTS) and _is_plain(path):
            file = re.sub(r"-\d+(\.\w+)$", r"\1", download[3] or "")  # submitted again
            loose.setdefault(key, []).append((file, path))
        elif ending in UNREAD:
            found[path] = path
    for key, files in loose.items():
        found.setdefault(key, files[0][1])
    return [(path, tuple(loose.get(key, ()))) for key, path in found.items()]


def _is_archive(path):
    return path.name.lower().endswith(ARCHIVES) and path.is_file()


def _name_of(path):
    """The student's name in the name of a download; for other paths, the name without ending."""
    name = path.resolve().name
    name = re.sub(r"(\.tar)?\.\w+$", "", name) if _is_archive(path) else name
    download = DOWNLOAD.fullmatch(name)
    return plain(download[1] if download else name)


def plain(name):
    """Returns a name without characters that a file system refuses."""
    name = unicodedata.normalize("NFC", name)
    name = "".join(c if c.isprintable() and c not in '<>:"/\\|?*' else "_" for c in name)
    kept = name.encode("utf-8", "replace")[:LONGEST_NAME].decode("utf-8", "ignore")
    return kept.strip(" .") or "submission"


def read(handIn):
    try:
        handIn.files, handIn.remarks = _chosen(*_members(handIn))
        if not any(name.startswith("data/") for name in handIn.files):
            handIn.files |= _scene_files()
    except SubmissionError as error:
        handIn.problem = str(error)
    except OSError as error:
        handIn.problem = f"cannot be read: {error.strerror or error}"
    except RuntimeError:
        handIn.problem = "is encrypted, or compressed in an unknown way"
    except Exception as error:  # of any decompressor: a hand-in costs only itself
        handIn.problem = f"is not a ZIP or tar, or is damaged ({type(error).__name__})"
    digest = sha256(handIn.problem.encode())
    for name, content in sorted(handIn.files.items()):
        digest.update(name.encode("utf-8", "replace") + b"\0%d\0" % len(content) + content)
    if handIn.problem:
        with suppress(OSError):
            told = os.stat(handIn.path)
            digest.update(f"{told.st_size} {told.st_mtime_ns}".encode())
    handIn.digest = digest.hexdigest()[:16]


def read_submission(path):
    """Reads a path that is one submission; returns its HandIn. Raises SubmissionError."""
    handIn = HandIn(find_submissions([path])[0].name, Path(path))
    read(handIn)
    if handIn.problem:
        raise SubmissionError(handIn.problem)
    return handIn


@cache
def _scene_files():
    """Scenes and meshes of this project, for submissions without any: no results."""
    paths = [one for one in DATA_DIRECTORY.iterdir() if one.name.endswith(SCENE_FILES)]
    return {f"data/{one.name}": one.read_bytes() for one in sorted(paths)}


def _is_plain(path):
    """Whether a path is a file: no link, pipe or device."""
    try:
        return stat.S_ISREG(os.lstat(path).st_mode)
    except OSError:
        return False


def _open_plain(path):
    """Opens a file for reading. Raises OSError if it is a link, pipe or device."""
    flags = os.O_RDONLY
    for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY"):
        flags |= getattr(os, name, 0)
    number = os.open(path, flags)
    if not stat.S_ISREG(os.fstat(number).st_mode):
        os.close(number)
        raise OSError(errno.EINVAL, "is not a plain file", str(path))
    return os.fdopen(number, "rb")


def read_plain(path, most):
    """Returns the beginning of a file, at most so many bytes; b"" if it cannot be read."""
    with suppress(OSError), _open_plain(path) as file:
        return file.read(most)
    return b""


def _members(handIn):
    """Reads the files of a submission: a dict from (*folders, name) to bytes, and how many files
    are left out. Archives among them are opened, too, if RBSFunctions.py is not among the files.
    """
    loose = [(name, partial(_open_plain, path)) for name, path in handIn.loose]
    if handIn.path not in [path for _name, path in handIn.loose]:
        if not handIn.path.is_dir() and not _is_archive(handIn.path):
            raise SubmissionError(LOOSE.format(handIn.path.suffix))
        loose = chain(_opened(handIn.path), loose)
    found = {}
    lost = _take(loose, (), found)
    if not any(_module(parts[-1]) == FUNCTIONS for parts in found):
        for parts, content in list(found.items()):
            if parts[-1].lower().endswith(ARCHIVES):
                lost += _take(_opened(Path(parts[-1]), io.BytesIO(content)), parts, found)
    return found, lost


def _opened(path, file=None):
    """Yields the files of a folder, or of a ZIP or tar, which may be opened already: a name, and
    a function that opens it.
    """
    if file is None and path.is_dir():
        for root, folders, names in os.walk(path):
            folders[:] = sorted(one for one in folders if not is_skipped(one))
            for one in filter(_is_plain, (Path(root, name) for name in sorted(names))):
                yield one.relative_to(path), partial(_open_plain, one)
    elif path.name.lower().endswith(TARS):
        size = 0
        with tarfile.open(path, fileobj=file) as archive:
            for one in archive:
                size += one.size
                if size > LARGEST_TAR:
                    raise SubmissionError(f"is larger than {LARGEST_TAR >> 20} MB")
                if one.isfile():
                    yield one.name, partial(archive.extractfile, one)
    else:
        with zipfile.ZipFile(file or path) as archive:
            for one in archive.infolist():
                if not one.is_dir() and not stat.S_ISLNK(one.external_attr >> 16):
                    yield one.filename, partial(archive.open, one)


def _take(members, top, found):
    """Reads members below a folder into a dict; returns how many are left out."""
    lost, left = 0, MOST_BYTES - sum(map(len, found.values()))
    for name, opener in members:
        parts = [one for one in str(name).replace("\\", "/").split("/") if one not in ("", ".")]
        isDocument = str(name).lower().endswith(DOCUMENTS)
        if not parts or isDocument or any(map(is_skipped, parts)):  # skips "..", too
            continue
        most = left if parts[-1].lower().endswith(ARCHIVES) else min(LARGEST_FILE, left)
        with opener() as file:
            content = file.read(most + 1)
        if len(content) > most or len(found) >= MOST_FILES and not _module(parts[-1]):
            lost += 1
            continue
        left -= len(content)
        found[(*top, *map(plain, parts))] = content
    return lost


def _module(name):
    """The module whose file has this name, perhaps as RBSFunctions (1).py, or ""."""
    match = MODULE.fullmatch(name)
    return MODULES.get(match[1].lower(), "") if match else ""


def _chosen(members, lost):
    """Chooses the student's modules, the files beside and below them, and data.

    The uppermost RBSFunctions.py is graded, among these the longest. Returns a dict from path,
    "code/..." or "data/...", to bytes, and remarks.
    """
    sizes = {p[:-1]: len(text) for p, text in members.items() if _module(p[-1]) == FUNCTIONS}
    if not sizes:
        unread = [one for one in UNREAD[:2] for parts in members if parts[-1].endswith(one)]
        books = [parts[-1] for parts in members if parts[-1].endswith(".ipynb")]
        more = f"; its {unread[0]} file is not read" if unread else ""
        more = f"; save the functions of {books[0]} as RBSFunctions.py" if books else more
        raise SubmissionError(f"has no RBSFunctions.py{more}")
    top, *others = sorted(sizes, key=lambda folder: (len(folder), -sizes[folder], folder))
    remarks = [f"modules found in {'/'.join(top)}"] if top else []
    shown = ["/".join(one) or "." for one in others[: MOST_FOLDERS - 1]]
    remarks += [f"another RBSFunctions.py, in {one}, is not graded" for one in shown]

    places = ("code", top), ("data", (*top[:-1], "data")), ("data", (*top, "data"))
    files = {
        (place, *parts[len(folder) :]): content
        for place, folder in places  # what is ../data for the student, is read as data
        for parts, content in members.items()
        if parts[: len(folder)] == folder != parts
    }
    names = {parts[1] for parts in files if parts[0] == "code"}
    for parts in list(files):
        right = _module(parts[1]) if parts[0] == "code" and len(parts) == 2 else ""
        if right and right not in names:
            remarks.append(f"{parts[1]} is read as {right}")
            files["code", right] = files.pop(parts)
            names.add(right)
    folders = {parts[:k] for parts in files for k in range(1, len(parts))}
    files = {"/".join(parts): content for parts, content in files.items() if parts not in folders}
    return files, remarks + [f"{lost} files are left out: too many or too large"] * bool(lost)
