"""The process in which a student's modules are graded; started by `isolation`, not by hand.

Writes a line of JSON for each thing that is done, so that what was done is known however the
process ends.
"""

import faulthandler
import importlib
import json
import os
import sys
from pathlib import Path

from limitedRun import limit


def main():
    order = json.loads(sys.argv[1])
    sys.argv[1:] = []
    limit(order["megabytes"])
    trace = open(order["trace"], "w")  # stays open as long as the process lives
    faulthandler.enable(trace)
    faulthandler.dump_traceback_later(order["seconds"], file=trace)

    import gradingTools  # noqa: F401  puts the project on the path
    from conventions import Bodies
    from trials import Results

    from rbs.submissions import SubmissionError, load_submission

    grader = importlib.import_module(order["grader"]).GRADER
    data = grader.load(Path(order["data"]), order["convention"])
    with open(order["answers"], "w", encoding="utf-8") as answers:

        def tell(kind, value, **more):
            answers.write(json.dumps({"kind": kind, "value": value, **more}) + "\n")
            answers.flush()

        folder = order["folder"]
        os.chdir(folder)
        try:
            submission = load_submission(folder)
        except SubmissionError as error:
            tell("refused", str(error))
            return
        tell("loaded", submission.missing)
        bodies = Bodies(submission.functions, submission.quaternion, data)
        for part in grader.asked(data, withExtras=True):
            if part.name in order["parts"]:
                tell("begun", part.name)
                results = Results(part.shapes, len(data["randomPositions"]), folder)
                try:
                    part.run(bodies, data, part.samples(data), results)
                    tell("results", results.as_json(), part=part.name)
                except Exception as error:  # there may be no memory left even for the results
                    tell("refused", f"gave no results: {type(error).__name__}: {error}")
                    return
        tell("done", None)
    sys.stdout = sys.stderr = None
    os._exit(0)  # whatever the submission has registered for the end, or left running


if __name__ == "__main__":
    main()
