"""A step under glass: what `run_timestep` does, event by event, with the numbers of each formula.

Each module imports only those above it.

    events    what the loop tells an observer: flights, contacts, impulses, visits of constraints
    model     the formulas once more, for many samples, by which the graders compute their results
    terms     the value of each symbol in the formulas of an event, by the model
    trace     the events of a step as a table; the first event in which two steps differ
    mistakes  edits of the model, which explain what a student's function did
"""
