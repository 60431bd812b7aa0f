"""This project's RBSFunctions for the released graders, with the physics that they expect.

    PYTHONPATH=graders/released:graders/released/ours RBS_PHYSICS=released-2024 python GRADER.py

The environment variable RBS_PHYSICS is "exact", this project's own physics and the default, or
"released-2024", which gives every `Mesh` the inertia of the coursework's 2024 reference solution
(`physics2024`), behind its grader data. It affects every function that asks a Mesh for its tensor.
`run_timestep`, which no grader calls, turns the smaller tensor to world axes the right way round.
"""

import os

from physics2024 import released_class
from projectModules import our_module

_ours = our_module("RBSFunctions")
globals().update({name: value for name, value in vars(_ours).items() if name[:2] != "__"})

PHYSICS = os.environ.get("RBS_PHYSICS", "exact")
if PHYSICS == "released-2024":
    Mesh = released_class(_ours.Mesh)
elif PHYSICS != "exact":
    raise SystemExit(f"RBS_PHYSICS must be exact or released-2024, not {PHYSICS!r}")
