"""Builds the report: `python report/build.py`.

Measures, draws plots, pictures and videos, writes every number of the text to numbers.json, checks
the claims of claims.csv, lists them in claims.md, and typesets report.typ to report.pdf.

    python report/build.py                everything, in 40 minutes on two cores
    python report/build.py --quick        without times and videos, in six minutes
    python report/build.py --text         typesets with the numbers at hand, in seconds
    python report/build.py --only stack   one experiment, still_NAME or video_NAME

Exits with 1 if a claim does not hold, a part fails, or the report has too many pages or words. The
PDF is written in any case.
"""

from rbs.scenes.messages import prepare

if __name__ == "__main__":
    prepare()

import argparse
import concurrent.futures
import importlib
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

# Experiments run in parallel, one per core; more threads in each would only slow them down.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import claims
import runs
import shots
import style

for section in ("basic", "links", "friction", "scale", "cure"):
    importlib.import_module(section)  # registers its experiments
FOLDER = Path(__file__).resolve().parent
FIGURES, NUMBERS = FOLDER / "figures", FOLDER / "numbers.json"
QUOTING = FOLDER.parent / "README.md", FOLDER.parent / "tests/README.md"
EXPERIMENTS = runs.EXPERIMENTS
TIMED = [name for name, one in EXPERIMENTS.items() if one.isTimed]
STEADY = [name for name in EXPERIMENTS if name not in TIMED]
MOST_PAGES, MOST_WORDS = 3, 1500


def run_part(name, isDrawn=True):
    """Runs one experiment, still or video; returns `(numbers or None, seconds)`."""
    begin, numbers = time.perf_counter(), None
    if name in EXPERIMENTS:
        folder = FIGURES if isDrawn else FOLDER.parent / "out"
        folder.mkdir(exist_ok=True)
        numbers = style.measure(EXPERIMENTS[name], folder / f"{name}.svg")
    else:  # Polyscope can start only once per process
        subprocess.run([sys.executable, shots.__file__, name], check=True)
    return rounded(numbers), time.perf_counter() - begin


def rounded(value):
    """Rounds the numbers of nested dicts to six significant digits."""
    if isinstance(value, dict):
        return {key: rounded(one) for key, one in value.items()}
    if isinstance(value, bool | str | None):
        return value
    return int(value) if float(value).is_integer() else float(f"{value:.6g}")


def run_parts(names, isDrawn=True):
    """Runs parts, those that measure time one by one: `(name → numbers, names that failed)`."""
    numbers, failed = {}, []
    timed = [name for name in names if name in TIMED]
    for some, workers in ((timed, 1), ([n for n in names if n not in timed], os.cpu_count())):
        with concurrent.futures.ProcessPoolExecutor(workers) as pool:
            jobs = {pool.submit(run_part, name, isDrawn): name for name in some}
            for job in concurrent.futures.as_completed(jobs):
                name = jobs[job]
                try:
                    found, seconds = job.result()
                except (Exception, SystemExit) as error:
                    failed.append(name)
                    print(f"{name:<16} FAILED: {type(error).__name__}: {error}", flush=True)
                    continue
                if found is not None:
                    numbers[name] = found
                print(f"{name:<16} {seconds:6.1f} s", flush=True)
    return numbers, failed


# What the text has besides words: comments, settings, formulas, references, table code, units.
CODE = (
    r"//[^\n]*|^#(let|import|show|set)[^\n]*",
    r"\$[^$]*\$",
    r"@\w+|#\w[\w.]*(\([^()]*\))?|\.\.\w+\([\w.]*",
    r"\"[^\"]*\"|\b\w+(\.\w+)*\([^()\[\]]*\)|\d(pt|cm|em)\b",
    r"\b(kind|scope|float|clearance|columns|align|stroke|inset|position|supplement|caption): *\w*"
    r"|\b(top|bottom|auto), |(left|right)(, (left|right))+",
)


def words(text):
    """Number of words of running text in report.typ, with captions and tables."""
    for pattern in CODE:
        text = re.sub(pattern, " ", text, flags=re.MULTILINE)
    return len(re.findall(r"[A-Za-z’'-]{2,}", text))


def typeset():
    """Writes report.pdf, and a picture of each page in out/report; returns the number of pages."""
    import typst

    pages = FOLDER.parent / "out" / "report"
    pages.mkdir(parents=True, exist_ok=True)
    for old in pages.glob("page*.png"):
        old.unlink()
    settings = {"root": str(FOLDER), "ignore_system_fonts": True}
    source = str(FOLDER / "report.typ")
    typst.compile(source, output=str(pages / "page{p}.png"), format="png", ppi=150.0, **settings)
    # the same text gives the same bytes
    typst.compile(source, output=str(FOLDER / "report.pdf"), timestamp=0, **settings)
    return len(list(pages.glob("page*.png")))


def main():
    known = (*EXPERIMENTS, *shots.STILLS, *shots.VIDEOS)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=known, help=", ".join(known))
    parser.add_argument("--text", action="store_true", help="typeset only")
    parser.add_argument("--quick", action="store_true", help="leave out times and videos")
    options = parser.parse_args()
    begin, failed = time.perf_counter(), []
    numbers = json.loads(NUMBERS.read_text()) if NUMBERS.exists() else {}
    if not options.text:
        names = options.only or [*STEADY, *shots.STILLS] if options.quick or options.only else known
        found, failed = run_parts(names)
        numbers = {name: one for name, one in (numbers | found).items() if name in EXPERIMENTS}
        NUMBERS.write_text(json.dumps(numbers, indent=1, sort_keys=True) + "\n")
    (FOLDER / "claims.md").write_text(claims.table(numbers))
    for readme in QUOTING:
        readme.write_text(claims.quoted(numbers, readme.read_text()))
    pages, count = typeset(), words((FOLDER / "report.typ").read_text())
    print(f"report.pdf: {pages} pages, {count} words, in {time.perf_counter() - begin:.0f} s")
    wrong = [f"CONTRADICTED {claim}" for claim in claims.broken(numbers)]
    wrong += [f"FAILED {name}" for name in failed]
    if pages > MOST_PAGES or count > MOST_WORDS:
        wrong.append(f"at most {MOST_PAGES} pages and {MOST_WORDS} words are allowed")
    print(*wrong, sep="\n")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
