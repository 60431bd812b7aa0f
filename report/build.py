"""Builds the report: `python report/build.py`.

Measures the laws, draws plots and pictures, writes every number of the text to numbers.json, checks
the claims (`claims.py`), lists them in claims.md, and typesets report.typ to report.pdf.

    python report/build.py                everything but times and videos
    python report/build.py --text         typesets with the numbers at hand, in seconds
    python report/build.py --all          times and videos as well
    python report/build.py --only stack   one experiment, picture or video
    python report/build.py --check        measures again and compares with numbers.json

Exits with 1 if a claim does not hold, a part fails, or the report has too many pages or words. The
PDF is written in any case.
"""

import argparse
import concurrent.futures
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

# Experiments run in parallel, one per core; more threads in each would only slow them down.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))

import claims
import cures
import laws
import scaling
import shots
import style

FOLDER = Path(__file__).resolve().parent
FIGURES, NUMBERS = FOLDER / "figures", FOLDER / "numbers.json"
STILLS = [f"still_{name}" for name in shots.STILLS]
VIDEOS = [f"video_{name}" for name in shots.PAIRS]
TIMED = ("growth", "schedules", "engines")
EXPERIMENTS = (*laws.PANELS, *laws.SILENT)
MOST_PAGES, MOST_WORDS = 3, 1600
assert cures and scaling  # they register experiments


def run_part(name, isDrawn=True):
    """Runs one experiment, still or video; returns `(numbers or None, seconds)`."""
    begin, numbers = time.perf_counter(), None
    if name in laws.PANELS:
        path = (FIGURES if isDrawn else FOLDER.parent / "out") / f"{name}.svg"
        path.parent.mkdir(exist_ok=True)
        numbers = style.draw(laws.PANELS[name], path)
    elif name in laws.SILENT:
        numbers = laws.SILENT[name]()
    else:  # Polyscope can start only once per process
        kind, word = name.split("_", 1)
        subprocess.run([sys.executable, shots.__file__, kind, word], check=True)
    return rounded(numbers), time.perf_counter() - begin


def rounded(value):
    """Rounds the floats of nested dicts and lists to six significant digits."""
    if isinstance(value, dict):
        return {key: rounded(one) for key, one in value.items()}
    if isinstance(value, bool | str | list | None):
        return value
    return float(f"{value:.6g}") if isinstance(value, float) else int(value)


def run_parts(names, isDrawn=True):
    """Runs parts in parallel: `(name → numbers, names that failed)`."""
    numbers, failed = {}, []
    with concurrent.futures.ProcessPoolExecutor(os.cpu_count()) as pool:
        jobs = {pool.submit(run_part, name, isDrawn): name for name in names}
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
    r"#formula\(\$.*?\$\)|\$[^$]*\$",
    r"@\w+|#\w[\w.]*(\([^()]*\))?|\.\.(row|part)\([\w.]*|\bto\([\w.]+",
    r"\"[^\"]*\"|\b\w+(\.\w+)*\([^()\[\]]*\)|\d(pt|cm|em)\b",
    r"\b(kind|scope|float|clearance|columns|align|stroke|inset|position|supplement|caption): *\w*"
    r"|\b(top|bottom|auto), |(left|right)(, (left|right))+",
)


def words(text):
    """Number of words of running text in report.typ, with captions and tables."""
    for pattern in CODE:
        flags = re.DOTALL if "formula" in pattern else re.MULTILINE
        text = re.sub(pattern, " ", text, flags=flags)
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


def check(kept):
    """Measures again; prints what differs from the numbers kept, and returns how many do."""
    measured, failed = run_parts([name for name in EXPERIMENTS if name not in TIMED], False)
    different = [name for name, numbers in measured.items() if kept.get(name) != numbers]
    for name in different:
        print(f"{name}: {kept.get(name)} in numbers.json, {measured[name]} now")
    return len(failed) + len(different)


def main():
    known = (*EXPERIMENTS, *STILLS, *VIDEOS)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=known, help=", ".join(known))
    parser.add_argument("--text", action="store_true", help="typeset only")
    parser.add_argument("--all", action="store_true", help="measure times and make videos, too")
    parser.add_argument("--before", metavar="CHECKOUT", help="with --all: its times as well")
    parser.add_argument("--check", action="store_true", help="compare only, change nothing")
    options = parser.parse_args()
    begin, failed = time.perf_counter(), []
    numbers = json.loads(NUMBERS.read_text()) if NUMBERS.exists() else {}
    if options.check:
        sys.exit(1 if check(numbers) or claims.broken(numbers) else 0)
    if options.all:
        before = ["--before", options.before] if options.before else []
        subprocess.run([sys.executable, FOLDER / "timings.py", *before], check=True)
    if not options.text:
        names = options.only or [*EXPERIMENTS, *STILLS, *(VIDEOS if options.all else ())]
        found, failed = run_parts(names)
        numbers = {name: one for name, one in (numbers | found).items() if name in EXPERIMENTS}
        numbers["summary"] = rounded(claims.summary(numbers))
        NUMBERS.write_text(json.dumps(numbers, indent=1, sort_keys=True) + "\n")
    (FOLDER / "claims.md").write_text(claims.table(numbers))
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
