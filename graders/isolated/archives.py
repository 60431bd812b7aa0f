"""Finds submissions in folders, names them, and reads them from folders and ZIPs.

A submission is read once, into memory. Links, pipes and devices are never opened. From the top:
finding submissions; reading them.
"""

import errno
import os
import re
import stat
import unicodedata
import zipfile
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from pathlib import Path

from rbs.program.submissions import SUPPLIED, SubmissionError, is_skipped
from rbs.scenes.messages import counted

# Files that are not opened, and are named because they may be somebody's work.
UNREAD = (".tar", ".tgz", ".gz", ".7z", ".rar", ".py", ".pdf")
PACKED = (".zip", *UNREAD[:5])
# What a marker reads and watches, which is not read here.
DOCUMENTS = (".pdf", ".docx", ".odt", ".mp4", ".mov", ".avi", ".mkv", ".webm", ".gif", ".png")
# The most that a solution needs, in bytes and files. Larger or further files are left out.
LARGEST_FILE = 4 << 20
MOST_BYTES = 64 << 20
MOST_FILES = 2000
# Bytes of a name, so that "NAME-2.md" is a valid file name, too; names in a remark.
LONGEST_NAME, MOST_NAMES = 80, 8
# Downloads of Moodle, NAME_ID_assignsubmission_file_FILE, and of Canvas, NAME_LATE_ID_ID_FILE.
DOWNLOAD = re.compile(r"(.+?)_(\d+)_(?:\d+|assignsubmission_file)(?:_.*)?", re.IGNORECASE)
LATE = re.compile(r"^late[_ -]+|[_ -]+late(?=[_ -]|$)", re.IGNORECASE)
FUNCTIONS = "RBSFunctions.py"
LOOSE = "a loose {} file is not read: put RBSFunctions.py and what it needs into a folder or a ZIP"


@dataclass
class HandIn:
    """A submission: where it is, and what has been read of it.

    name : unique, and valid as a file name
    files : dict from path, "code/..." or "data/...", to bytes; remarks : list of str
    problem : why it cannot be graded, or ""; digest : differs if anything in it does
    """

    name: str
    path: Path
    files: dict = field(default_factory=dict)
    remarks: list = field(default_factory=list)
    problem: str = ""
    digest: str = ""


def find_submissions(paths):
    """Returns the list of HandIn in these paths, each a submission or a folder of submissions.

    A submission is a ZIP, or a folder with RBSFunctions.py in it or in its `code`, and one more
    submission in it at most; the file stands for its folder. In any other folder, each ZIP and each
    folder is one. Raises SubmissionError.
    """
    found, handIns = [], {}
    for path in map(_without_file, paths):
        path = path.resolve() if path.is_symlink() else path  # the marker's own
        hasCode = _has_code(path) or _has_code(path / "code")
        more = [one for one in path.glob("*") if one.name != "code" and _may_hold_code(one)]
        if _is_zip(path) or hasCode and len(more) < 2:
            found.append(path)
        elif path.is_dir():
            found += (inside := _inside(path))
            if not inside:
                raise SubmissionError(f"{path}: no submission in this folder")
        else:
            exists = "not a folder or a ZIP" if path.exists() else "no such file or folder"
            raise SubmissionError(f"{path}: {exists}")
    for path in found:
        stem, isLate = _name_of(path)
        one, count = HandIn(stem, path), 1
        while (first := handIns.get(one.name.lower())) is not None:
            count += 1
            one.name = f"{stem}-{count}"
            first.remarks.append(f"there is another hand-in of this name, {one.name}")
        one.remarks += ["its name says that it was late"] * isLate
        one.remarks += [f"there is another hand-in of this name, {stem}"] * (count > 1)
        handIns[one.name.lower()] = one
    return list(handIns.values())


def _without_file(path):
    """The path, or the folder of an RBSFunctions.py."""
    isCode = re.fullmatch(r"rbsfunctions.*\.py", Path(path).name.lower()) and Path(path).is_file()
    return Path(path).parent if isCode else Path(path)


def _inside(folder):
    """The submissions in a folder. A file beside somebody's folder or ZIP is none."""
    paths = [one for one in sorted(folder.iterdir()) if not is_skipped(one.name)]
    paths = [one for one in paths if "_assignsubmission_onlinetext" not in one.name]
    read = [one for one in paths if one.is_dir() or _is_zip(one) or one.is_symlink()]
    own = {_student(one) for one in read}
    loose = {_student(one): one for one in reversed(paths) if one.suffix.lower() in UNREAD}
    return read + [path for student, path in loose.items() if student not in own]


def _student(path):
    download = DOWNLOAD.fullmatch(path.name)
    return download.group(1, 2) if download else path


def _has_code(folder, pattern="*.py"):
    return any(one.name.lower().startswith("rbsfunctions") for one in folder.glob(pattern))


def _may_hold_code(path):
    return _is_zip(path) or path.is_dir() and _has_code(path, "**/*.py")


def _is_zip(path):
    return path.suffix.lower() == ".zip" and path.is_file()


def _name_of(path):
    """The student's name in a download's name, or the name without ending; and whether it tells
    that the work is late.
    """
    name = Path(os.path.abspath(path)).name
    name = path.stem if _is_zip(path) else name
    download = DOWNLOAD.fullmatch(name)
    name = download[1] if download else name
    return plain(LATE.sub("", name) or name), bool(LATE.search(name))


def plain(name):
    """Returns a name without characters that a file system refuses."""
    name = unicodedata.normalize("NFC", name)
    name = "".join(c if c.isprintable() and c not in '<>:"/\\|?*' else "_" for c in name)
    kept = name.encode("utf-8", "replace")[:LONGEST_NAME].decode("utf-8", "ignore")
    return kept.strip(" .") or "submission"


def read(handIn):
    try:
        handIn.files, remarks = _chosen(*_members(handIn.path))
        handIn.remarks += remarks
    except SubmissionError as error:
        handIn.problem = str(error)
    except OSError as error:
        handIn.problem = f"cannot be read: {error.strerror or error}"
    except RuntimeError:
        handIn.problem = "is encrypted, or compressed in an unknown way"
    except Exception as error:  # of any decompressor: a hand-in costs only itself
        handIn.problem = f"is not a ZIP, or is damaged ({type(error).__name__})"
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
    found = find_submissions([path])
    some = [one.path.name for one in found if _may_hold_code(one.path)]
    if len(some) > 1:
        told = f"holds {len(some)} submissions; name one, such as {some[0]}"
        raise SubmissionError(f"{path}: {told}")
    handIn = HandIn(found[0].name, _without_file(path).resolve())
    read(handIn)
    if handIn.problem:
        raise SubmissionError(f"{path}: {handIn.problem}")
    return handIn


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


def _opened(path):
    """Yields the files of a folder or a ZIP: a name, and a function that opens it, or None for a
    link, a pipe or a device.
    """
    if path.is_symlink():
        raise SubmissionError(f"is a link, to {os.readlink(path)}")
    if path.is_dir():
        for root, folders, names in os.walk(path):
            folders[:] = sorted(one for one in folders if not is_skipped(one))
            for one in (Path(root, name) for name in sorted(names)):
                isPlain = stat.S_ISREG(os.lstat(one).st_mode)
                yield one.relative_to(path), partial(_open_plain, one) if isPlain else None
    elif _is_zip(path):
        with zipfile.ZipFile(path) as archive:
            for one in archive.infolist():
                isLink = stat.S_ISLNK(one.external_attr >> 16)
                if not one.is_dir():
                    yield one.filename, None if isLink else partial(archive.open, one)
    else:
        raise SubmissionError(LOOSE.format(path.suffix))


def _members(path):
    """Reads the files of a submission: a dict from (*folders, name) to bytes, how many files are
    left out, and a dict from the name to the kind of those that may hold the solution all the same.
    """
    found, lost, left, odd = {}, 0, MOST_BYTES, {}
    for name, opener in _opened(path):
        parts = [one for one in str(name).replace("\\", "/").split("/") if one not in ("", ".")]
        if not parts or any(map(is_skipped, parts)):  # skips "..", too
            continue
        name, ending = "/".join(parts), os.path.splitext(parts[-1])[1].lower()
        isOurs = "rbsfunctions" in parts[-1].lower()
        if opener is None or ending in PACKED:
            odd |= {name: "a link" if opener is None else "packed"} if isOurs or opener else {}
        elif ending not in DOCUMENTS:
            most = min(LARGEST_FILE, left)
            with opener() as file:
                content = file.read(most + 1)
            if len(content) > most or len(found) >= MOST_FILES and not isOurs:
                lost += 1
                continue
            left -= len(content)
            found[tuple(map(plain, parts))] = content
    return found, lost, odd


def _module_in(names, module):
    """The name in a dict to contents that is read as a module: its own, in any case, or else the
    longest with numbers before or after it, as "RBSFunctions (1).py"; of RBSFunctions, with words.
    """
    rest = ".*" if module == FUNCTIONS else r"[a-z]?[\W\d_]*(copy)?[\W\d_]*"
    fits = re.compile(f"{rest}{module[:-3]}{rest}[.]py", re.IGNORECASE).fullmatch
    some = list(filter(fits, names))
    return max(some, key=lambda one: (one.lower() == module.lower(), len(names[one])), default="")


def _chosen(members, lost, odd):
    """Chooses the student's modules, the files beside and below them, and data.

    The uppermost RBSFunctions.py is graded, among these the longest. Returns a dict from path,
    "code/..." or "data/...", to bytes, and remarks.
    """
    folders = {}
    for parts, content in members.items():
        folders.setdefault(parts[:-1], {})[parts[-1]] = content
    named = {folder: _module_in(names, FUNCTIONS) for folder, names in folders.items()}
    some = [folder for folder, name in named.items() if name]
    exact = [folder for folder in some if named[folder].lower() == FUNCTIONS.lower()]
    texts = {"/".join(one): len(content) for one, content in members.items()}
    texts = {one: size for one, size in texts.items() if "rbsfunctions" in one.lower()}
    if not some:
        books = [parts[-1] for parts in members if parts[-1].endswith(".ipynb")]
        told = [f"; {name} is {kind}" for name, kind in odd.items()]
        more = "".join([*told, *(f"; there is {one}" for one in texts)][:MOST_NAMES])
        more = f"; save the functions of {books[0]} as RBSFunctions.py" if books else more
        raise SubmissionError(f"has no RBSFunctions.py{more}")
    size = {folder: len(folders[folder][named[folder]]) for folder in some}
    top = min(exact or some, key=lambda one: (len(one), -size[one], one))
    own = "/".join((*top, named[top]))
    remarks = [f"modules found in {'/'.join(top)}"] if top else []
    better = [one for one, count in texts.items() if one != own and count > size[top]]
    rest = ["/".join((*one, named[one])) for one in exact if one != top]
    told = [f"{one} is not graded" for one in dict.fromkeys(better + rest)]
    told += [f"{name}, {kind}, is not read" for name, kind in odd.items()]
    remarks += [f"a person should look: {one}; graded is {own}" for one in told[:MOST_NAMES]]

    places = ("code", top), ("data", (*top[:-1], "data")), ("data", (*top, "data"))
    files = {
        (place, *parts[len(folder) :]): content
        for place, folder in places  # what is ../data for the student, is read as data
        for parts, content in members.items()
        if parts[: len(folder)] == folder != parts
    }
    for module in (FUNCTIONS, *(f"{one}.py" for one in SUPPLIED)):
        name = _module_in(folders[top], module)
        if name and name != module:
            remarks.append(f"{name} is read as {module}")
            files["code", module] = files["code", name]
    folders = {parts[:k] for parts in files for k in range(1, len(parts))}
    files = {"/".join(parts): content for parts, content in files.items() if parts not in folders}
    left = f"{counted(lost, 'file')} left out: too many or too large"
    return files, remarks + [left] * bool(lost)
