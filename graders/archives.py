"""Submissions as they are handed in: finding them, unpacking ZIPs safely, finding the modules."""

import os
import re
import stat
import tempfile
import zipfile
import zlib
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from isolation import MOST_BYTES, MOST_FILES, PASSED_OVER

from rbs.submissions import SUBMITTED_MODULES, SubmissionError, brief

ZIP_ENDING = ".zip"
BLOCK_BYTES = 1 << 20


@dataclass(frozen=True)
class Entry:
    """A submission: its name, which no other one has and any file can have, and its path."""

    name: str
    path: Path


# ---- Finding submissions ------------------------------------------------------------------------


def find_submissions(paths):
    """The list of Entry that the paths stand for, each a submission or a folder of submissions.

    A ZIP is a submission, and so is a folder with RBSFunctions.py or Quaternion.py in it or in its
    `code`. Of any other folder, each ZIP and each folder is one. Raises SubmissionError.
    """
    found = []
    for path in map(Path, paths):
        if path.is_file() and path.suffix.lower() == ZIP_ENDING or _is_submission(path):
            found.append(path)
        elif path.is_dir():
            inside = [one for one in sorted(path.iterdir()) if _may_be_submission(one)]
            if not inside:
                raise SubmissionError(f"{path}: there is no submission in this folder")
            found += inside
        elif path.exists():
            raise SubmissionError(f"{path}: a submission is a folder or a ZIP")
        else:
            raise SubmissionError(f"{path}: there is no such file or folder")
    entries = {}
    for path in found:
        stem = path.stem if path.suffix.lower() == ZIP_ENDING else path.resolve().name
        stem = re.sub(r"[^\w.-]+", "_", stem, flags=re.ASCII).strip(".") or "submission"
        name, number = stem, 1
        while name.lower() in entries:
            number += 1
            name = f"{stem}-{number}"
        entries[name.lower()] = Entry(name, path)
    return list(entries.values())


def _is_submission(path):
    return any(
        (path / folder / f"{name}.py").is_file()
        for folder in ("", "code")
        for name in SUBMITTED_MODULES
    )


def _may_be_submission(path):
    if path.name.startswith(".") or path.name in PASSED_OVER:
        return False
    return path.is_dir() or path.suffix.lower() == ZIP_ENDING


@contextmanager
def modules_of(entry):
    """Yields (folder with the modules, its place in the submission or "") while they are needed.

    A ZIP is unpacked for that time. Raises SubmissionError.
    """
    with tempfile.TemporaryDirectory(prefix="unpacked-", ignore_cleanup_errors=True) as place:
        folder = entry.path
        if not folder.is_dir():
            folder = Path(place)
            unpack(entry.path, folder)
        found = find_modules(folder)
        where = "" if found == folder else found.relative_to(folder).as_posix()
        yield found, where


def find_modules(folder):
    """The folder, this one or one below it, that holds the modules: the uppermost, first by name.

    Raises SubmissionError where there is none.
    """
    level = [Path(folder)]
    looked = 0
    while level and looked < MOST_FILES:
        for name in SUBMITTED_MODULES:
            for one in level:
                if (one / f"{name}.py").is_file():
                    return one
        looked += len(level)
        below = (entry for one in level for entry in sorted(os.scandir(one), key=lambda e: e.name))
        level = [
            Path(entry.path)
            for entry in below
            if entry.is_dir(follow_symlinks=False) and entry.name not in PASSED_OVER
        ]
    files = " nor ".join(f"{name}.py" for name in SUBMITTED_MODULES)
    raise SubmissionError(f"holds neither {files}")


# ---- Unpacking ----------------------------------------------------------------------------------


def unpack(path, target):
    """Unpacks a ZIP of unknown origin into a folder; raises SubmissionError.

    Refused as a whole: names that lead out of the folder, links and devices, encryption, two files
    of one name, and more files or bytes than a submission has; the bytes are counted as they come
    out, whatever the archive says about them.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if len(members) > MOST_FILES:
                raise SubmissionError(f"the ZIP holds more than {MOST_FILES} files")
            files = {}
            for member in members:
                parts = checked_parts(member)
                if member.is_dir() or PASSED_OVER & set(parts):
                    continue
                if files.setdefault("/".join(parts).lower(), (member, parts))[0] is not member:
                    raise SubmissionError(f"the ZIP holds '{brief(member.filename, 60)}' twice")
            left = MOST_BYTES
            for member, parts in files.values():
                file = target.joinpath(*parts)
                file.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(member) as source, open(file, "xb") as copy:
                    while block := source.read(BLOCK_BYTES):
                        left -= len(block)
                        if left < 0:
                            raise SubmissionError(
                                f"the ZIP unpacks to more than {MOST_BYTES >> 20} MB"
                            )
                        copy.write(block)
    except SubmissionError:
        raise
    except OSError as error:
        raise SubmissionError(f"the ZIP cannot be unpacked: {error.strerror or error}") from None
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, RuntimeError, KeyError) as error:
        raise SubmissionError(f"this is not a readable ZIP: {error}") from None


def checked_parts(member):
    """The folders and the name of a member of a ZIP; raises SubmissionError unless it is a file,
    or a folder, below the one that it is unpacked to."""
    name = member.filename.replace("\\", "/")
    parts = [part for part in name.split("/") if part not in ("", ".")]
    shown = brief(name, 60)
    if name.startswith("/") or ".." in parts or ":" in name:
        raise SubmissionError(f"the ZIP is refused: '{shown}' leads out of its folder")
    if not parts or not name.isprintable():
        raise SubmissionError(f"the ZIP is refused: '{shown}' is no name for a file")
    kind = stat.S_IFMT(member.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise SubmissionError(f"the ZIP is refused: '{shown}' is a link or a device")
    if member.flag_bits & 1:
        raise SubmissionError(f"the ZIP is refused: '{shown}' is encrypted")
    return parts
