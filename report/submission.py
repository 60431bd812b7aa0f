"""Packs the coursework's ZIP: `python report/submission.py [FILE.zip]`.

    report.pdf, claims.md       results, and the measurements behind them
    videos/                     the videos that the text names
    code/                       the four modules, the modules of rbs/, data/, graders/

The default is out/submission.zip. Identical files give identical bytes. The coursework's own scenes
and grader data are not included.
"""

import argparse
import re
import sys
import zipfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rbs.scenes.files import atomic_write
from rbs.scenes.messages import InputError, cause_of

ROOT = Path(__file__).resolve().parent.parent
# folder of the code → files to include
CODE = {
    ".": ("[GQR]*.py", "LICENSE", "pyproject.toml"),
    "rbs": ("**/*.py", "recordings/player.*"),
    "data": ("*.mesh", "*.off", "*.txt", "*.data", "scripts/*.py"),
    "graders": ("**/*.py", "**/*.md"),
}
# Time of every file in the ZIP, the earliest possible one.
TIME = (1980, 1, 1, 0, 0, 0)


def contents():
    """Returns the files, name in the ZIP → path, in order; raises InputError if one is missing."""
    text = (ROOT / "report/report.typ").read_text()
    names = [f"videos/{name}.mp4" for name in re.findall(r'#film\("(\w+)"\)', text)]
    files = {name: ROOT / "report" / name for name in ("report.pdf", "claims.md", *names)}
    for folder, pattern in ((folder, one) for folder, some in CODE.items() for one in some):
        for path in sorted((ROOT / folder).glob(pattern)) or [ROOT / folder / pattern]:
            files[f"code/{path.relative_to(ROOT).as_posix()}"] = path
    for path in files.values():
        if not path.is_file():
            raise InputError(f"{path}: missing; python report/build.py makes it")
    return dict(sorted(files.items()))


def write(target):
    """Writes the ZIP atomically; returns the number of files."""
    files = contents()
    with atomic_write(target) as partial, zipfile.ZipFile(partial, "w") as archive:
        for name, path in files.items():
            entry = zipfile.ZipInfo(name, TIME)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o100644 << 16
            archive.writestr(entry, path.read_bytes())
    return len(files)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = ROOT / "out/submission.zip"
    parser.add_argument("file", nargs="?", type=Path, default=default, metavar="FILE.zip")
    target = parser.parse_args().file
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        count = write(target)
    except (InputError, OSError) as error:
        sys.exit(f"submission.py: {cause_of(error)}")
    print(f"{target}: {count} files, {target.stat().st_size / 1e6:.1f} MB")
