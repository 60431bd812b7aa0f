"""A step under glass: what `run_timestep` does, event by event, with the numbers of each formula.

Each module imports only those above it.

    events  what the loop tells an observer: free flight, contacts, impulses, visits of constraints
    terms   the formulas of an event, and each symbol's value, computed a second time
    trace   the events of a step as a table; the first event and quantity in which two steps differ
    model, mistakes  the formulas once more, on arrays; mistakes that explain what an event did
    beside  our run beside a student's, from the same start
"""
