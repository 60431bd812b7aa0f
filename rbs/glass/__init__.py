"""A step under glass: what `run_timestep` does, event by event, with the numbers of each formula.

Each module imports only those above it.

    events    what the loop tells an observer: flights, contacts, impulses, visits of constraints
    terms     the formulas of an event, and each symbol's value, computed a second time
    trace     the events of a step as a table; the first event in which two steps differ
    model     the formulas once more, for many samples, by which the graders compute their results
    mistakes  edits of these, which explain what a student's function did
    beside    our run beside a student's, from the same start
"""
