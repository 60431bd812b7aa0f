"""This project's RBSFunctions under the released graders, with the physics that they expect.

    PYTHONPATH=graders/released:graders/released/ours RBS_PHYSICS=released-2024 python GRADER.py

The environment variable RBS_PHYSICS is the one switch. "exact", the default, is this project's own
physics. "released-2024" gives every `Mesh` the inertia of the coursework's 2024 reference solution
(`physics2024`), which its grader data were made with. It acts on `resolve_collision`,
`resolve_velocity_constraint` and what else asks a Mesh for its tensor. `run_timestep`, which no
grader calls, has the smaller tensor but turns it to world axes the right way round.
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
