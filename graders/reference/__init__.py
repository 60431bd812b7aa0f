"""The graders' data and physics, written apart from the simulation that they judge.

`graderData` reads the data files; `rigidModel` computes every result in plain NumPy, with and
without known mistakes. Importing
any of them lets graders that are started anywhere find the project's modules.
"""

import sys
from pathlib import Path

PROJECT_DIRECTORY = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(PROJECT_DIRECTORY))
