"""Known mistakes: edits of the coursework's formulas, which lead to a student's numbers.

Each row of the table `mistakes.md` edits formulas of `model`. A hint on an event is given if the
edited formulas do to the bodies what the student's function did, in all such events of the step.
"""

import inspect
import re
from contextlib import suppress
from functools import cache, partial
from itertools import islice
from pathlib import Path
from types import FunctionType
from typing import NamedTuple

import numpy as np

from rbs.glass import model
from rbs.glass.events import Kind
from rbs.glass.terms import STATE_SYMBOLS, computed, terms
from rbs.glass.trace import differs

POSITION = "resolve_position_constraint"
# The formulas that the mistakes in a function are edits of.
FORMULAS = {
    "integrate_timestep": "step integration further_integration",
    "get_rotated_inv_IT": "world_inverse_tensors",
    "resolve_collision": "collide pair_of further_resolution world_inverse_tensors",
    POSITION: "move holds flag_of constrained_points",
    "resolve_velocity_constraint": "stop is_slow flag_of constrained_points world_inverse_tensors",
    "friction": "rub world_inverse_tensors",
}
# Where so many mistakes explain the same events, all are told; where more do, none.
MOST_OF_EVENT = 4
# Events of a step that a mistake is tried on.
MOST_EVENTS = 20


class Mistake(NamedTuple):
    """A row of the table.

    functions : names of those that it can be made in; edits : pairs of texts; text : the hint
    stubOf : names of those whose stub computes this
    """

    functions: list
    edits: tuple
    text: str
    stubOf: tuple = ()


def _rows():
    lines = (Path(__file__).parent / "mistakes.md").read_text(encoding="utf-8").splitlines()
    for line in [line for line in lines if line.startswith("| ")][1:]:
        functions, edits, text = line[2:-2].split(" | ")
        edits = re.findall("`([^`]+)` → `([^`]*)`", edits.replace("⏎", "\n"))
        names = tuple(functions.replace("*", "").split(", "))
        yield Mistake(names, tuple(edits), text, tuple(re.findall(r"\*\*(\w+)", functions)))


@cache
def mistakes_of(function):
    """The mistakes that can be made in a function, in the order in which they are tried."""
    return [one for one in _rows() if function in one.functions]


@cache
def _functions(module):
    space = vars(model) | vars(module)
    return {name: one for name, one in space.items() if inspect.isfunction(one)}


# Both take longer than an edit.
_source = cache(inspect.getsource)
_compiled = cache(partial(compile, filename="mistakes.md", mode="exec"))


def edited(function, edits, module=model, most=(1.0, 1.0)):
    """The functions of `model`, and of a module that uses them, after edits of a function's
    formulas, by name. Raises ValueError if an edit fits none of them, or several.

    most : the largest number, and length, of a student's velocities
    """
    space = vars(model) | vars(module) | dict(zip(("MOST", "SPEED"), most, strict=True))
    functions = _functions(module)
    names = [name for name in FORMULAS[function].split() if name in functions]
    texts = {name: _source(functions[name]) for name in names} if edits else {}
    for old, new in edits:
        (home,) = [name for name, text in texts.items() if old in text]
        texts[home] = texts[home].replace(old, new)
    for name, one in functions.items():
        space[name] = FunctionType(one.__code__, space, name, one.__defaults__)
    for name, text in texts.items():
        if text != _source(functions[name]):
            exec(_compiled(text), space)
    return space


# By the kind of an event: the functions that make it, and the symbols that tell what they did.
MADE_BY = {
    Kind.FLIGHT: {"integrate_timestep": "COM q v ω"},
    Kind.CORRECTION: {"resolve_collision": "COM"},
    Kind.IMPULSE: {"resolve_collision": "v ω"},
    Kind.FRICTION: {"friction": "v ω"},
    Kind.CONSTRAINT: {POSITION: "COM result", "resolve_velocity_constraint": "v ω"},
}


def mistake_in(event, events):
    """Returns the hint on an event that differs from the coursework's formulas, or "".

    events : of the step, by the same functions
    """
    kin = [event, *(one for one in events if one.kind == event.kind and one is not event)]
    found = []
    for function, symbols in MADE_BY.get(event.kind, {}).items():
        # no velocity is corrected where the position was found valid
        alike = (one for one in kin if function == POSITION or not one.given.get("isValid"))
        alike = list(islice(alike, MOST_EVENTS))
        differ = [one for one in alike if not _fits(one, symbols, function, ())]
        if differ and differ[0] is event:
            rows = mistakes_of(function)
            for one in alike:
                rows = [row for row in rows if _fits(one, symbols, function, row.edits)]
            texts = list(dict.fromkeys(row.text for row in rows))
            found += [" - or ".join(texts)] * (0 < len(texts) <= MOST_OF_EVENT)
    return "; ".join(found)


def _fits(event, symbols, function, edits):
    """Whether edited formulas lead to these symbols of both bodies after an event."""
    with suppress(Exception), np.errstate(all="ignore"):  # edits may make no sense here
        after = computed(event, edited(function, edits))
        if "result" in symbols and after["result"] != terms(event)["result"]:
            return False
        for k, state in zip("12" if len(event.after) == 2 else [""], event.after, strict=True):
            for symbol, value in zip(STATE_SYMBOLS, state[:4], strict=True):
                isTold = state.invMass and symbol in symbols.split()
                if isTold and differs(value, after[f"{symbol}{k}′"]):
                    return False
        return True
    return False
