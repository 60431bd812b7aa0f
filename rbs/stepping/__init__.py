"""The step for many bodies: the formulas of RBSFunctions.py on arrays.

`run_timestep` passes its meshes to `grid_step` or `project_constraints`. In reading order:

    settings     table of settings with their bounds and messages
    bodies       tables of the meshes' state, and checks of it
    reports      per-step diagnostics: contacts, counters and timings
    kernels      impulses and corrections on arrays of contacts
    batches      contacts in ordered batches: detection and position correction
    gridstep     the step of `broadPhase="grid"`
    constraints  schedules of distance constraints: sweep, queue, batches
"""
