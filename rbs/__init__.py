"""The packages behind the four modules of the coursework.

A newcomer starts at `run_timestep` in RBSFunctions.py. Data flows one way: files → meshes → steps →
pictures and recordings. A package imports only those above it in this list, and a module only those
above it in its package's list.

    geometry    vectors, convex hulls, and how deep two of them overlap
    stepping    the step of many bodies, on arrays; constraint schedules; settings
    softstep    the contact solver in which piles come to rest
    glass       the events of a step, with the numbers of each formula
    scenes      files, meshes, scenes, and the simulation that steps them
    appearance  what a scene looks like: colours, surfaces, light
    recordings  recordings of runs, replays, statistics, and files for 3-D programs and browsers
    pictures    pictures and videos, drawn with Polyscope
    window      panels, keys and the mouse
    program     command line, and runs without a window

GJK.py builds on geometry; RBSFunctions.py on those down to glass; all packages below, and
RigidBodySimulation.py, use RBSFunctions.py.
"""

__version__ = "0.1.0"
