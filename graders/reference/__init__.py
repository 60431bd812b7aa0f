"""The graders' data, and the results that submissions are compared with.

`graderData` reads the data files; `rigidModel` computes every result. Graders import
this package first: it makes the project's modules importable, wherever a grader is started.
"""

import sys
from pathlib import Path

PROJECT_DIRECTORY = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(PROJECT_DIRECTORY))

from rbs.scenes.messages import prepare as prepare  # noqa: E402
