"""Write grader data with the results of the graders' formulas for the inputs of the project's data.

    python data/scripts/make_reference.py --out DIR [--convention exact|released-2024]

The three files have the keys and shapes of the coursework's own (see `reference.graderData`). The
project's own data hold random states and contacts, and results of the right physics that were
computed with 50 digits: each is the double nearest to the true value. The formulas here, in
doubles, agree with them to 1e-12. `--convention released-2024` reproduces the released quirks.
"""

import argparse
import pickle
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "graders"))

import Constraints
import integrationGrading
import ResolveCollisionsGrading
from reference.graderData import CONVENTIONS, DATA_DIRECTORY, EXACT, RELEASED_2024

from rbs.scenes.messages import cause_of

GRADERS = integrationGrading.GRADER, ResolveCollisionsGrading.GRADER, Constraints.GRADER


def make_reference(directory, convention=EXACT, source=DATA_DIRECTORY):
    """Writes the three files into a folder, which is made if it is missing.

    NumPy 2 writes a module name that NumPy before 1.26 does not know; the old name serves all.
    Protocol 3 stores names as lines without lengths, so one can be replaced.
    """
    directory.mkdir(parents=True, exist_ok=True)
    for grader in GRADERS:
        data, entries = grader.load(source) | {"convention": convention}, {}
        for part in (one for one in grader.parts if not one.isExtra):
            data |= part.model(data | part.inputs(data))
        for key, (kind, *axes) in grader.layout.items():
            array = np.array(data[key], dtype=kind)
            if key.startswith("result") and grader.fileName == "integration.data":
                array[1:] *= convention != RELEASED_2024  # quirk 3
            entries[key] = list(array) if axes[0] == 2 else array
        payload = pickle.dumps(entries, protocol=3)
        payload = payload.replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n")
        (directory / grader.fileName).write_bytes(payload)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder to write to")
    text = "physics behind the results (default: %(default)s)"
    parser.add_argument("--convention", choices=CONVENTIONS, default=EXACT, help=text)
    arguments = parser.parse_args()
    try:
        make_reference(arguments.out, arguments.convention)
    except OSError as problem:
        parser.exit(2, f"{parser.prog}: {cause_of(problem)}\n")
    print(f"wrote three files to {arguments.out}")


if __name__ == "__main__":
    main()
