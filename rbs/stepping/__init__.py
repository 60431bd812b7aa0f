"""The step for many bodies: the formulas of RBSFunctions.py on arrays.

`run_timestep` enters these modules by its settings. In reading order:

    settings     table of settings with their bounds and messages
    flight       rotation in free flight
    meshes       what a mesh has beyond the coursework; snapshots of the meshes' state
    bodies       the meshes of a step as a table
    reports      the context of a step, and its report: contacts, counters and timings
    kernels      impulses and corrections on arrays of contacts
    constraints  schedules of distance constraints: sweep, queue, batches
    batches      the step with its contacts in ordered batches
"""
