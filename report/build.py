"""Builds the report: `python report/build.py`.

Runs the experiments, draws their plots, renders the pictures, measures the times, writes every
number that the text quotes to numbers.json, and typesets report.typ to report.pdf.

    python report/build.py                        all of it
    python report/build.py --keep-timings         with the times of scale.csv and scheduling.csv
    python report/build.py --only tunnelling      one figure, its numbers and the PDF
    python report/build.py --check                measures again, and compares with numbers.json
    python report/build.py --only scale --sizes 50 200 1000 3000
"""

import argparse
import concurrent.futures
import io
import json
import os
import subprocess
import sys
import time
from pathlib import Path

# Two cores do two experiments at a time; more threads in each would only get in their way.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))

import experiments
import pictures
import style
import timings

FOLDER = Path(__file__).resolve().parent
FIGURES = FOLDER / "figures"
NUMBERS = FOLDER / "numbers.json"
TIMED = ("scale", "phases", "scheduling", "peers")
REPEATABLE = ("constants", *experiments.EXPERIMENTS, *experiments.SILENT)
MOST_PAGES = 3


def run_experiment(name, isDrawn=True):
    """`(numbers, seconds)` of one experiment; draws its figure."""
    begin = time.perf_counter()
    if name == "constants":
        numbers = experiments.constants()
    elif name in experiments.SILENT:
        numbers = experiments.SILENT[name]()
    else:
        path = FIGURES / f"{name}.svg" if isDrawn else io.BytesIO()
        numbers = style.draw(experiments.EXPERIMENTS[name], path)
    return numbers, time.perf_counter() - begin


def run_experiments(names, isDrawn=True):
    """Name → numbers, as many at a time as there are cores, the longest first."""
    results = {}
    order = sorted(names, key=lambda name: -DURATIONS.get(name, 1))
    with concurrent.futures.ProcessPoolExecutor(os.cpu_count()) as pool:
        jobs = {pool.submit(run_experiment, name, isDrawn): name for name in order}
        for job in concurrent.futures.as_completed(jobs):
            name = jobs[job]
            results[name], seconds = job.result()
            print(f"{name:<14} {seconds:6.1f} s", flush=True)
    return results


# Seconds, roughly, of those that take long.
DURATIONS = {
    "tunnelling": 80, "samebits": 75, "stack": 45, "restitution": 40, "corrections": 37,
    "stretch": 33, "stopping": 31, "incline": 30, "separating": 25, "order": 20,
}  # fmt: skip


def draw_timings():
    """Figures and numbers of what has been timed."""
    return {
        "scale": style.draw(timings.scale, FIGURES / "scale.svg"),
        "phases": style.draw(timings.phases, FIGURES / "phases.svg"),
        "scheduling": timings.scheduling(),
    }


def load_numbers():
    return json.loads(NUMBERS.read_text()) if NUMBERS.exists() else {}


def save_numbers(numbers):
    """One number a line, sorted, so that a change is seen."""
    NUMBERS.write_text(json.dumps(numbers, indent=1, sort_keys=True, ensure_ascii=False) + "\n")


def typeset():
    """report.pdf and, for the eye, a picture of each page in out/report."""
    import typst

    source = FOLDER / "report.typ"
    settings = {"root": str(FOLDER), "ignore_system_fonts": True}
    # the same text gives the same bytes
    typst.compile(str(source), output=str(FOLDER / "report.pdf"), timestamp=0, **settings)
    pages = FOLDER.parent / "out" / "report"
    pages.mkdir(parents=True, exist_ok=True)
    for old in pages.glob("page*.png"):
        old.unlink()
    typst.compile(str(source), output=str(pages / "page{p}.png"), format="png", ppi=150.0,
                  **settings)  # fmt: skip
    count = len(list(pages.glob("page*.png")))
    if count > MOST_PAGES:
        sys.exit(f"the report has {count} pages; {MOST_PAGES} are allowed")
    print(f"{FOLDER / 'report.pdf'}: {count} pages, pictures of them in {pages}")


def check():
    """Measures again what does not depend on the time; the number of differences."""
    kept, wrong = load_numbers(), 0
    for name, numbers in run_experiments(REPEATABLE, isDrawn=False).items():
        for key in sorted(set(numbers) | set(kept.get(name, {}))):
            old, new = kept.get(name, {}).get(key), numbers.get(key)
            if old != new:
                wrong += 1
                print(f"{name}.{key}: {old} in numbers.json, {new} now")
    count = sum(len(kept.get(name, {})) for name in REPEATABLE)
    print(f"{count} numbers, {wrong} differ")
    return wrong


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", default=None,
                        help=f"of {', '.join([*REPEATABLE, *TIMED, *pictures.PICTURES, 'text'])}")
    parser.add_argument("--keep-timings", action="store_true", help="measure no times")
    parser.add_argument("--sizes", nargs="+", type=int, metavar="N", default=timings.SIZES,
                        help="bodies of the piles that are timed (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="time small piles only")
    parser.add_argument("--check", action="store_true",
                        help="compare what is measured with numbers.json, change nothing")
    options = parser.parse_args()
    if options.check:
        sys.exit(1 if check() else 0)
    known = {*REPEATABLE, *TIMED, *pictures.PICTURES, "text"}
    chosen = set(known if options.only is None else options.only)
    if not chosen <= known:
        parser.error(f"there is no {', '.join(sorted(chosen - known))}")

    begin = time.perf_counter()
    FIGURES.mkdir(exist_ok=True)
    numbers = run_experiments([name for name in REPEATABLE if name in chosen])
    save_numbers(load_numbers() | numbers)
    for name in pictures.PICTURES:
        if name in chosen:  # Polyscope starts once in a process
            subprocess.run([sys.executable, pictures.__file__, name], check=True)
            print(f"{name:<14} drawn", flush=True)
    if not options.keep_timings:
        if chosen & {"scale", "phases"}:
            timings.measure_scale(timings.QUICK_SIZES if options.quick else options.sizes)
        if "scheduling" in chosen:
            timings.measure_scheduling()
    if "peers" in chosen and not options.keep_timings:
        numbers["peers"] = load_numbers().get("peers", {}) | timings.peers()
    if chosen & set(TIMED):
        numbers |= draw_timings()
    save_numbers(load_numbers() | numbers)
    typeset()
    print(f"built in {time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
