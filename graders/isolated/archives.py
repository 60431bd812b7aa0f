"""Finds submissions in folders, names them, and reads them from folders, ZIPs and tars.

Only the folder with RBSFunctions.py, its subfolders and `data` are read, once, into memory. Links,
pipes and devices are never opened. From the top: finding submissions; reading them.
"""

import errno
import itertools
import os
import re
import stat
import tarfile
import unicodedata
import zipfile
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import cache, partial
from hashlib import sha256
from pathlib import Path

from reference.graderData import DATA_DIRECTORY

from rbs.program.submissions import SUPPLIED, SubmissionError, is_skipped

TARS = (".tar", ".tar.gz", ".tgz")
ARCHIVES = (".zip", *TARS)
# Loose files that are refused by name, because they may be somebody's work.
UNREAD = (".7z", ".rar", ".py", ".pdf")
SCENE_FILES = (".mesh", ".off", ".txt")
# What a marker reads and watches, which is not read here.
DOCUMENTS = (".pdf", ".docx", ".odt", ".mp4", ".mov", ".avi", ".mkv", ".webm", ".gif")
# The most that a solution needs, in bytes and files. Larger or further files are left out.
LARGEST_FILE = 4 << 20
MOST_BYTES = 64 << 20
MOST_FILES = 2000
# Of a tar, which must be decompressed to be searched, in bytes; and of folders with solutions.
LARGEST_TAR, MOST_FOLDERS = 1 << 28, 8
# Bytes of a name, so that "NAME-2.md" is a valid file name, too.
LONGEST_NAME = 80
# Downloads of Moodle, NAME_ID_assignsubmission_file_FILE, and of Canvas, NAME_LATE_ID_ID_FILE.
DOWNLOAD = re.compile(
    r"(.+?)(?:_late)?_(\d+)_(?:\d+|assignsubmission_file)(?:_(.*))?", re.IGNORECASE
)
STUDENT_ID = re.compile(r"(?<![^\W_])([a-z]?\d{5,10})(?![^\W_])", re.IGNORECASE)
MODULES = {name.lower(): f"{name}.py" for name in ("RBSFunctions", *SUPPLIED)}
# A module's name, perhaps with what browsers and file managers add.
MODULE = re.compile(r"(\w+?)(?: ?\(\d+\)|[ _-]+(?:copy|\d+))?\.py", re.IGNORECASE)
FUNCTIONS = "RBSFunctions.py"
LOOSE = "a loose {} file is not read: put RBSFunctions.py and what it needs into a folder or a ZIP"


@dataclass(frozen=True)
class Entry:
    """A submission: a path, and a unique name that is valid as a file name.

    files : pairs (name, path) of loose files, as from Canvas
    id : of the student, or ""
    """

    name: str
    path: Path
    files: tuple = ()
    id: str = ""


@dataclass
class HandIn:
    """What has been read of a submission.

    files : dict from path, "code/..." or "data/...", to bytes; remarks : list of str
    problem : why it cannot be graded, or ""; digest : differs if anything in it does
    """

    files: dict = field(default_factory=dict)
    remarks: list = field(default_factory=list)
    problem: str = ""
    digest: str = ""


def find_submissions(paths):
    """Returns the list of Entry in these paths, each a submission or a folder of submissions.

    A submission is an archive, or a folder with RBSFunctions.py in it or in its `code`. In any
    other folder, each archive and each folder is one. Raises SubmissionError.
    """
    found = []
    for path in map(Path, paths):
        tops = [one for one in (path, path / "code") if one.is_dir()]
        names = [_module(file.name) for one in tops for file in one.iterdir()]
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
        download, number = DOWNLOAD.fullmatch(path.stem), STUDENT_ID.search(path.name)
        number = download[2] if download else number[1] if number else ""
        entries[name.lower()] = Entry(name, path, files, number)
    return list(entries.values())


def _inside(folder):
    """The submissions in a folder, in order: (name, path, loose files)."""
    found, loose = {}, {}
    for path in sorted(folder.iterdir()):
        if is_skipped(path.name):
            continue
        download, ending = DOWNLOAD.fullmatch(path.name), path.suffix.lower()
        key = download.group(1, 2) if download else path
        if path.is_dir() or _is_archive(path):
            found[key if key not in found else path] = _name_of(path), path
        elif download and ending in (".py", *DOCUMENTS) and _is_plain(path):
            file = re.sub(r"-\d+(\.\w+)$", r"\1", download[3] or "")  # submitted again
            loose.setdefault(key, []).append((file, path))
        elif ending in UNREAD:
            found[path] = plain(path.name), path
    for key, files in loose.items():
        found.setdefault(key, (plain(key[0]), files[0][1]))
    return [(*one, tuple(loose.get(key, ()))) for key, one in found.items()]


def _is_archive(path):
    return path.name.lower().endswith(ARCHIVES) and path.is_file()


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
    kept = name.encode("utf-8", "replace")[:LONGEST_NAME].decode("utf-8", "ignore")
    return kept.strip(" .") or "submission"


def read_entry(entry):
    """Reads a submission, before any code runs; returns its HandIn."""
    found = HandIn()
    try:
        with ExitStack() as stack:
            members = _members(entry, stack)
            found.files, remarks = _take(members)
            found.remarks += remarks
        if not any(name.startswith("data/") for name in found.files):
            found.files |= _scene_files()
    except SubmissionError as error:
        found.problem = str(error)
    except OSError as error:
        found.problem = f"cannot be read: {error.strerror or error}"
    except RuntimeError:
        found.problem = "is encrypted, or compressed in an unknown way"
    except Exception as error:  # of any decompressor: a hand-in costs only itself
        found.problem = f"is not a ZIP or tar, or is damaged ({type(error).__name__})"
    digest = sha256(found.problem.encode())
    for name, content in sorted(found.files.items()):
        digest.update(name.encode("utf-8", "replace") + b"\0%d\0" % len(content) + content)
    if found.problem:
        with suppress(OSError):
            told = os.stat(entry.path)
            digest.update(f"{told.st_size} {told.st_mtime_ns}".encode())
    found.digest = digest.hexdigest()[:16]
    return found


def read_submission(path):
    """Reads a path that is one submission; returns its HandIn. Raises SubmissionError."""
    handIn = read_entry(Entry(find_submissions([path])[0].name, Path(path)))
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


def _members(entry, stack):
    """The files of a submission: a list of (tuple of folders and name, function that opens it).

    Archives among them are opened, too, if RBSFunctions.py is not among the files.
    """
    loose = [((name,), partial(_open_plain, path)) for name, path in entry.files]
    if loose and loose[0][1].args[0] == entry.path:
        return loose
    if not entry.path.is_dir() and not _is_archive(entry.path):
        raise SubmissionError(LOOSE.format(entry.path.suffix))
    members = [*_opened(entry.path, stack), *loose]
    if not _folders_in(members):
        for parts, opener in members[:]:
            if parts[-1].lower().endswith(ARCHIVES):
                inner = _opened(parts[-1], stack, stack.enter_context(opener()))
                members += [(parts + more, one) for more, one in inner]
    return members


def _opened(path, stack, file=None):
    """Yields the files of a folder, or of a ZIP or tar, which may be opened already."""
    if file is None and path.is_dir():
        found = [(one.relative_to(path), partial(_open_plain, one)) for one in _walked(path)]
    elif str(path).lower().endswith(TARS):
        archive = stack.enter_context(tarfile.open(path, fileobj=file))
        files = filter(tarfile.TarInfo.isfile, _bounded(archive))
        found = ((one.name, partial(archive.extractfile, one)) for one in files)
    else:
        archive = stack.enter_context(zipfile.ZipFile(file or path))
        files = (one for one in archive.infolist() if not one.is_dir())
        plainFiles = (one for one in files if not stat.S_ISLNK(one.external_attr >> 16))
        found = ((one.filename, partial(archive.open, one)) for one in plainFiles)
    for name, opener in found:
        parts = [one for one in str(name).replace("\\", "/").split("/") if one not in ("", ".")]
        if parts and not any(map(is_skipped, parts)):  # skips "..", too
            yield tuple(map(plain, parts)), opener


def _bounded(archive):
    size = 0
    for one in archive:
        size += one.size
        if size > LARGEST_TAR:
            raise SubmissionError(f"is larger than {LARGEST_TAR >> 20} MB")
        yield one


def _walked(folder):
    for root, folders, files in os.walk(folder):
        folders[:] = [one for one in folders if not is_skipped(one)]
        paths = (Path(root) / name for name in files)
        yield from filter(_is_plain, paths)


def _module(name):
    """The module whose file has this name, perhaps as RBSFunctions (1).py, or ""."""
    match = MODULE.fullmatch(name)
    return MODULES.get(match[1].lower(), "") if match else ""


def _folders_in(members):
    """The folders with an RBSFunctions.py: the uppermost first, among these the longest."""
    found = {p[:-1]: opener for p, opener in reversed(members) if _module(p[-1]) == FUNCTIONS}
    folders = sorted(found, key=lambda folder: (len(folder), folder))
    top, sizes = [one for one in folders if len(one) == len(folders[0])], {}
    for folder in top[:MOST_FOLDERS] if len(top) > 1 else ():
        with suppress(OSError, RuntimeError, ValueError), found[folder]() as source:
            sizes[folder] = len(source.read(LARGEST_FILE))
    return sorted(folders, key=lambda folder: (len(folder), -sizes.get(folder, 0), folder))


def _take(members):
    """Reads the student's modules, the files beside and below them, and data.

    Returns a dict from path, "code/..." or "data/...", to bytes, and remarks.
    """
    if not (folders := _folders_in(members)):
        unread = [one for one in UNREAD[:2] for parts, _ in members if parts[-1].endswith(one)]
        books = [parts[-1] for parts, _ in members if parts[-1].endswith(".ipynb")]
        more = f"; its {unread[0]} file is not read" if unread else ""
        more = f"; save the functions of {books[0]} as RBSFunctions.py" if books else more
        raise SubmissionError(f"has no RBSFunctions.py{more}")
    top, shown = folders[0], ["/".join(one) or "." for one in folders]
    remarks = [f"modules found in {shown[0]}"] if top else []
    remarks += [
        f"another RBSFunctions.py, in {one}, is not graded" for one in shown[1:MOST_FOLDERS]
    ]

    wanted = [(("code", *p[len(top) :]), one) for p, one in members if p[: len(top)] == top != p]
    wanted.sort(key=lambda one: len(one[0]))
    names = {parts[1] for parts, _ in wanted}
    for folder in (*top[:-1], "data"), (*top, "data"):  # what is ../data for the student
        inside = [(p, one) for p, one in members if p[: len(folder)] == folder != p]
        wanted += [(("data", *p[len(folder) :]), one) for p, one in inside]
    left, lost, taken, files = MOST_BYTES, len(wanted[MOST_FILES:]), set(), {}
    last, content = None, b""  # a file may be wanted twice, as code and as data
    folders = {parts[:k] for parts, _ in wanted for k in range(1, len(parts))}
    places = {id(opener): k for k, (_, opener) in enumerate(members)}
    # in the archive's order: a compressed tar is unpacked again for each step back
    for parts, opener in sorted(wanted[:MOST_FILES], key=lambda one: places[id(one[1])]):
        right = _module(parts[1]) if parts[0] == "code" and len(parts) == 2 else ""
        if right and right not in names | taken:
            remarks.append(f"{parts[1]} is read as {right}")
            parts = "code", right
            taken.add(right)
        if parts[-1].lower().endswith(DOCUMENTS) or parts in folders:
            continue
        if opener is not last:
            with opener() as source:
                content = source.read(min(LARGEST_FILE, left) + 1)
            last = opener
        if len(content) > min(LARGEST_FILE, left):
            lost += parts[-1].endswith((".py", ".txt", ".mesh", ".off", ".data"))
            continue
        left -= len(content)
        files["/".join(parts)] = content
    return files, remarks + [f"{lost} files are left out: too many or too large"] * bool(lost)
