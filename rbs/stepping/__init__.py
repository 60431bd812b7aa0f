"""The step of many bodies, with the formulas of RBSFunctions.py on arrays.

`run_timestep` hands its meshes over to `grid_step` or `project_constraints`. In reading order:

    settings     the table of settings, their bounds and messages
    bodies       the state of meshes in tables, and what is checked of it
    reports      per-step diagnostics: contacts, counters and timings
    kernels      impulses and corrections, on arrays of contacts
    batches      ordered batches of contacts, with detection and corrections
    gridstep     the step of `broadPhase="grid"`
    constraints  schedules of distance constraints: sweep, queue, batches
"""
