"""What is run by hand: measurements, campaigns, and faults that the tests must notice.

    python tests/byhand WHAT …

Each WHAT has its own `--help`. tests/README.md has what they print.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import benchmark
import campaigns
import engines
import experiments
import hashes
import mutations

from rbs.scenes.messages import InputError, cause_of
from rbs.stepping.settings import SETTINGS


def parser():
    root = argparse.ArgumentParser(prog="python tests/byhand", description=__doc__.splitlines()[0])
    commands = root.add_subparsers(metavar="WHAT", required=True)

    def command(name, run, text):
        one = commands.add_parser(name, help=text, description=text)
        one.set_defaults(run=run)
        return one.add_argument

    add = command("benchmark", benchmark.main, "milliseconds per step of scenes, by phase")
    add("scenes", metavar="SCENE", nargs="+", help="file, or name of one in data/")
    add("--steps", type=int, default=300, metavar="N")
    add("--from", type=int, default=100, metavar="K", dest="begin", help="measures from step K on")
    known = SETTINGS["constraintScheduling"].kind
    add("--scheduling", nargs="+", choices=known, default=["sweep"])
    text = "with the settings that each scene recommends"
    add("--recommended", action="store_true", help=text)

    add = command("engines", engines.main, "milliseconds per step of a heap, beside other engines")
    add("--sizes", nargs="+", type=int, default=engines.SIZES, metavar="N")
    add("--seed", type=int, default=1)

    text = "compares the steps and other engines with closed forms and independent predictors"
    add = command("experiments", experiments.main, text)
    add("words", metavar="WORD", nargs="*", help="only the rows whose name contains one of these")

    text = "random pairs of hulls against whole-number arithmetic and against Qhull"
    add = command("pairs", campaigns.main, text)
    add("--minutes", type=float, default=2.0)
    add("--case", type=int, help="this one alone")
    add("--seed", type=int, default=1)

    text = "a hash of the state that scenes reach, to compare machines and versions"
    add = command("hashes", hashes.main, text)
    add("folders", metavar="FOLDER", nargs="*", help="500 steps of all scenes in these")

    add = command("mutations", mutations.main, mutations.__doc__.splitlines()[0])
    text = "number of a fault, or a part of its file's path or name (default: all)"
    add("words", metavar="WORD", nargs="*", help=text)
    add("--jobs", metavar="N", type=int, default=1, help="so many at a time")
    return root


if __name__ == "__main__":
    options = parser().parse_args()
    try:
        sys.exit(options.run(options))
    except (InputError, OSError) as error:
        sys.exit(f"python tests/byhand: {cause_of(error)}")
