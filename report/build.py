"""Builds the report: `python report/build.py`.

Runs the experiments, draws their plots, renders pictures and videos, measures times, writes every
number in the text to numbers.json, checks the sentences against the numbers (`claims.py`), lists
the claims in claims.md, and typesets report.typ to report.pdf.

    python report/build.py                        everything
    python report/build.py --keep-timings         reuses the times in scale.csv and the other tables
    python report/build.py --only tunnelling      one experiment, its numbers and the PDF
    python report/build.py --check                measures again and compares with numbers.json
    python report/build.py --only scale --sizes 50 200 1000 3000

Exits with 1 if a number contradicts a sentence, a part fails, or the report has too many pages. The
PDF is written in any case.
"""

import argparse
import concurrent.futures
import importlib.util
import io
import json
import os
import subprocess
import sys
import time
from pathlib import Path

# Experiments run in parallel, one per core; more threads in each would only slow them down.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))

import claims
import experiments
import mechanisms
import pictures
import resting
import style
import timings
import videos

FOLDER = Path(__file__).resolve().parent
FIGURES = FOLDER / "figures"
NUMBERS = FOLDER / "numbers.json"
CLAIMS = FOLDER / "claims.md"
TIMED = ("scale", "slick", "scheduling", "restTimes")
assert mechanisms and resting  # these register experiments
REPEATABLE = ("constants", *experiments.EXPERIMENTS, *experiments.SILENT)
# Their numbers of MuJoCo and PyBullet are kept where these are not installed.
BESIDE_PEERS = ("resting", "standing")
VIDEOS = {f"video_{name}": name for name in videos.VIDEOS}
SOURCE = FOLDER / "report.typ"
MOST_PAGES = 3
SIZES = ("9.8", "9.7", "9.6", "9.5", "9.4", "9.3", "9.2")  # font sizes in points
# Approximate seconds of the long experiments.
DURATIONS = {
    "tunnelling": 80,
    "samebits": 75,
    "schedules": 60,
    "candidates": 50,
    "batches": 40,
    "resting": 40,
    "stack": 45,
    "restitution": 40,
    "corrections": 37,
    "stretch": 33,
    "stopping": 31,
    "incline": 50,
    "separating": 25,
    "order": 20,
    "standing": 25,
    "videos": 60,
    "video_resting": 60,
    "video_scale": 50,
    "video_constraints": 40,
}


def run_experiment(name, isDrawn=True):
    """Runs and draws one experiment, picture or video; returns `(numbers, seconds)`.

    Pictures and videos have no numbers: None.
    """
    begin = time.perf_counter()
    numbers = None
    if name == "constants":
        numbers = experiments.constants()
    elif name in experiments.SILENT:
        numbers = experiments.SILENT[name]()
    elif name in experiments.EXPERIMENTS:
        path = FIGURES / f"{name}.svg" if isDrawn else io.BytesIO()
        numbers = style.draw(experiments.EXPERIMENTS[name], path)
    else:  # Polyscope can start only once per process
        script, word = (videos, VIDEOS[name]) if name in VIDEOS else (pictures, name)
        subprocess.run([sys.executable, script.__file__, word], check=True)
    return numbers, time.perf_counter() - begin


def run_experiments(names, isDrawn=True, done=lambda numbers: None):
    """Runs experiments in parallel, the longest first: `(name → numbers, names that failed)`.

    done : function called with `{name: numbers}` of each one
    """
    results, failed = {}, []
    order = sorted(names, key=lambda name: -DURATIONS.get(name, 1))
    with concurrent.futures.ProcessPoolExecutor(os.cpu_count()) as pool:
        jobs = {pool.submit(run_experiment, name, isDrawn): name for name in order}
        for job in concurrent.futures.as_completed(jobs):
            name = jobs[job]
            try:
                numbers, seconds = job.result()
            except (Exception, SystemExit) as error:
                failed.append(name)
                print(f"{name:<22} FAILED: {type(error).__name__}: {error}", flush=True)
                continue
            if numbers is not None:
                results[name] = numbers
                done({name: numbers})
            print(f"{name:<22} {seconds:6.1f} s", flush=True)
    return results, failed


def draw_timings():
    """Draws the figures of the timings and returns their numbers."""
    return {
        "scale": style.draw(timings.scale, FIGURES / "scale.svg"),
        "slick": style.draw(timings.slick, FIGURES / "slick.svg"),
        "scheduling": timings.scheduling(),
        "restTimes": timings.rest_times(),
    }


def load_numbers():
    return json.loads(NUMBERS.read_text()) if NUMBERS.exists() else {}


def has_peers():
    return all(importlib.util.find_spec(name) for name in ("mujoco", "pybullet"))


def save_numbers(numbers):
    """Saves the numbers sorted, one per line, so that differences are readable."""
    kept = load_numbers()
    if not has_peers():
        for name in BESIDE_PEERS:
            if name in numbers:
                numbers[name] = kept.get(name, {}) | numbers[name]
    numbers = {
        name: values for name, values in (kept | numbers).items() if name in (*REPEATABLE, *TIMED)
    }
    numbers["figures"] = {figure: list(names) for figure, names in claims.FIGURES}
    NUMBERS.write_text(json.dumps(numbers, indent=1, sort_keys=True, ensure_ascii=False) + "\n")
    return numbers


def typeset():
    """Writes report.pdf, and a picture of each page in out/report; returns the number of pages.

    The font size is the largest of SIZES that needs no more than MOST_PAGES.
    """
    import typst

    pages = FOLDER.parent / "out" / "report"
    pages.mkdir(parents=True, exist_ok=True)
    for size in SIZES:
        settings = {"root": str(FOLDER), "ignore_system_fonts": True, "sys_inputs": {"size": size}}
        for old in pages.glob("page*.png"):
            old.unlink()
        typst.compile(
            str(SOURCE), output=str(pages / "page{p}.png"), format="png", ppi=150.0, **settings
        )
        count = len(list(pages.glob("page*.png")))
        if count <= MOST_PAGES:
            break
    # the same text gives the same bytes
    typst.compile(str(SOURCE), output=str(FOLDER / "report.pdf"), timestamp=0, **settings)
    print(f"report.pdf: {count} pages in {size} points, pictures of them in {pages}")
    return count


def check():
    """Measures everything that does not depend on time; returns the number of differences.

    Also checks the captions against the states in the pictures.
    """
    kept, wrong = load_numbers(), 0
    for name in pictures.PICTURES:
        pictures.checked(name)
    measured, failed = run_experiments(REPEATABLE, isDrawn=False)
    wrong += len(failed)
    for name, numbers in measured.items():
        old = kept.get(name, {})
        keys = set(numbers) if name in BESIDE_PEERS and not has_peers() else set(numbers) | set(old)
        for key in sorted(keys):
            if old.get(key) != numbers.get(key):
                wrong += 1
                print(f"{name}.{key}: {old.get(key)} in numbers.json, {numbers.get(key)} now")
    contradicted = claims.contradictions(kept)
    print(*contradicted, sep="\n", end="\n" if contradicted else "")
    count = sum(len(kept.get(name, {})) for name in REPEATABLE)
    print(
        f"{count} numbers, {wrong} differ; {len(claims.CLAIMS)} claims, "
        f"{len(contradicted)} contradicted; {len(pictures.PICTURES)} captions true"
    )
    return wrong + len(contradicted)


def measure_times(chosen, options):
    if chosen & {"scale", "slick"}:
        if options.quick:
            timings.measure_scale(timings.QUICK_SIZES, timings.QUICK_WINDOW)
        else:
            timings.measure_scale(options.sizes)
    if "scheduling" in chosen:
        timings.measure_scheduling()
    if "restTimes" in chosen:
        timings.measure_resting()


def main():
    known = {*REPEATABLE, *TIMED, *pictures.PICTURES, *VIDEOS, "text"}
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--only", nargs="+", metavar="NAME", default=None, help=f"of {', '.join(sorted(known))}"
    )
    parser.add_argument("--keep-timings", action="store_true", help="reuse the measured times")
    parser.add_argument(
        "--sizes",
        nargs="+",
        type=int,
        metavar="N",
        default=timings.SIZES,
        help="numbers of bodies in the timed heaps (default: %(default)s)",
    )
    parser.add_argument("--quick", action="store_true", help="time small heaps, early")
    parser.add_argument(
        "--check", action="store_true", help="measure, compare with numbers.json, change nothing"
    )
    options = parser.parse_args()
    if options.check:
        sys.exit(1 if check() else 0)
    chosen = known if options.only is None else set(options.only)
    if not chosen <= known:
        parser.error(f"unknown: {', '.join(sorted(chosen - known))}")

    begin = time.perf_counter()
    FIGURES.mkdir(exist_ok=True)
    names = [name for name in (*REPEATABLE, *pictures.PICTURES, *VIDEOS) if name in chosen]
    _, failed = run_experiments(names, done=save_numbers)
    if not options.keep_timings:
        measure_times(chosen, options)
    numbers = save_numbers(draw_timings() if chosen & set(TIMED) else {})
    CLAIMS.write_text(claims.table(numbers))
    pages = typeset()
    print(f"built in {time.perf_counter() - begin:.0f} s")
    contradicted = claims.contradictions(numbers)
    for line in contradicted:
        print(f"CONTRADICTED {line}")
    if pages > MOST_PAGES:
        print(f"the report has {pages} pages; {MOST_PAGES} are allowed")
    if failed:
        print(f"failed: {', '.join(failed)}")
    sys.exit(1 if contradicted or failed or pages > MOST_PAGES else 0)


if __name__ == "__main__":
    main()
