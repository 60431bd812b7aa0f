"""Known mistakes: edits of the coursework's formulas, which lead to a student's numbers.

Each row of the table `mistakes.md` edits formulas of `model`. A hint on an event is given if the
edited formulas do to the bodies what the student's function did, in all such events of the step.
"""

import inspect
import re
from collections import namedtuple
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import NamedTuple

import numpy as np

from rbs.glass import model
from rbs.glass.events import Kind
from rbs.glass.trace import TOLERANCE
from rbs.stepping.reports import GROUND

# The formulas that the mistakes in a function are edits of.
FORMULAS = {
    "integrate_timestep": "step integration further_integration",
    "get_rotated_inv_IT": "world_inverse_tensors",
    "resolve_collision": "collide pair_of world_inverse_tensors",
    "resolve_position_constraint": "move holds position_flag constrained_points",
    "resolve_velocity_constraint": "stop is_slow velocity_flag constrained_points "
    "world_inverse_tensors",
    "friction": "rub world_inverse_tensors",
}
# Where so many mistakes explain the same numbers, all are told; where more do, none. An event alone
# tells less than many samples.
MOST_ALIKE = 2
MOST_OF_EVENT = 3
# Events of a step that a mistake is tried on.
MOST_EVENTS = 20


class Mistake(NamedTuple):
    """A row of the table.

    functions : names of those that it can be made in; edits : pairs of texts; text : the hint
    """

    functions: list
    edits: tuple
    text: str


def _rows():
    lines = (Path(__file__).parent / "mistakes.md").read_text(encoding="utf-8").splitlines()
    for line in [line for line in lines if line.startswith("| ")][1:]:
        functions, edits, text = line[2:-2].split(" | ")
        edits = re.findall("`([^`]+)` → `([^`]*)`", edits.replace("⏎", "\n"))
        yield Mistake(tuple(functions.split(", ")), tuple(edits), text)


@cache
def mistakes_of(function):
    """The mistakes that can be made in a function, in the order in which they are tried; the first
    is what its stub computes.
    """
    return [one for one in _rows() if function in one.functions]


@cache
def _functions(module):
    space = vars(model) | vars(module)
    return {name: one for name, one in space.items() if inspect.isfunction(one)}


@cache
def _source(function):
    return inspect.getsource(function)


@cache
def _compiled(text):
    return compile(text, "mistakes.md", "exec")


def edited(function, edits, module=model):
    """The functions of `model`, and of a module that uses them, after edits of a function's
    formulas, by name. Raises ValueError if an edit fits none of them, or several.
    """
    space = vars(model) | vars(module)
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


# Of a body, as `model.world_inverse_tensors` needs it.
Body = namedtuple("Body", "mass centre tensor")


def mistake_in(event, events):
    """Returns the hint on an event that differs from the coursework's formulas, or "".

    events : of the step, by the same functions
    """
    if event.kind not in _AFTER:
        return ""
    alike = [one for one in events if one.kind == event.kind and not one.given.get("isValid")]
    alike = [event, *(one for one in alike[:MOST_EVENTS] if one is not event)]
    found = []
    for function, computed, names in _AFTER[event.kind]:
        differ = [one for one in alike if not _fits(computed, one, names, function, ())]
        if differ and differ[0] is event:
            rows = [
                row
                for row in mistakes_of(function)
                if all(_fits(computed, one, names, function, row.edits) for one in alike)
            ]
            texts = list(dict.fromkeys(row.text for row in rows))
            found += [" - or ".join(texts)] * (0 < len(texts) <= MOST_OF_EVENT)
    return "; ".join(found)


def _fits(computed, event, names, function, edits):
    """Whether formulas lead to an event's states: these attributes of all its bodies."""
    with suppress(Exception), np.errstate(all="ignore"):  # edits may make no sense here
        space = edited(function, edits)
        for state, rows in zip(event.after, computed(space, event, event.given), strict=True):
            for name, row in zip(names, rows, strict=True):
                value = getattr(state, name)
                gap = np.abs(np.ravel(row) - value).max()
                if state.invMass and not gap <= TOLERANCE * max(1.0, np.abs(value).max()):
                    return False
        return True
    return False


def _pair(space, event):
    """The Pair of an event's bodies."""
    columns = []
    for state in event.before:
        q, T = state.orientation[None], np.zeros((1, 3, 3))
        if state.invMass:
            body = Body(1.0 / state.invMass, np.zeros(3), np.linalg.inv(state.invIT))
            T = space["world_inverse_tensors"](body, q)
        rows = state.position[None], q, state.linVelocity[None], state.angVelocity[None]
        columns.append((*rows, float(state.invMass), T))
    return model.Pair(*zip(*columns, strict=True))


def _flight(space, event, given):
    (state,), h = event.before, np.array([[given["timeStep"]]])
    space["GRAVITY"] = np.array(given["gravity"], float)[None]
    rows = [getattr(state, name)[None] for name in MOTION]
    return [space["step"](*rows, h, 1, 1.0 / state.invMass)]


def _collided(space, event, given, depth):
    sign = -1.0 if event.bodies[1] == GROUND else 1.0  # the coursework passes -d and -n there
    contact = np.array([sign * depth]), sign * given["normal"][None], given["points"][1][None]
    return space["collide"](_pair(space, event), *contact, given["CRCoeff"])


def _correction(space, event, given):
    return [one[:1] for one in _collided(space, event, given, given["depth"])]


def _impulse(space, event, given):
    return [one[1:] for one in _collided(space, event, given, 0.0)]


def _friction(space, event, given):
    contact = given["normal"][None], given["points"][1][None], given["mu"]
    return space["rub"](_pair(space, event), *contact, np.array([given["impulse"]]))


def _ends(given):
    return [np.reshape(one, (1, 3)) for one in given["points"]]


def _moved(space, event, given):
    link = np.array([given["refValue"]]), given["upper"], given["tolerance"], []
    return zip(space["move"](_pair(space, event), *_ends(given), *link)[1], strict=True)


def _stopped(space, event, given):
    pair = _pair(space, event)
    Jv, linear, angular = space["stop"](pair, *_ends(given))
    isKept = space["is_slow"](Jv, given["tolerance"])
    found = zip(pair.v, pair.w, linear, angular, strict=True)
    return [(v, w) if isKept else (newV, newW) for v, w, newV, newW in found]


MOTION = "position", "orientation", "linVelocity", "angVelocity"
# By the kind of an event: the function, how the states after it are computed, and which of them.
_AFTER = {
    Kind.FLIGHT: [("integrate_timestep", _flight, MOTION)],
    Kind.CORRECTION: [("resolve_collision", _correction, MOTION[:1])],
    Kind.IMPULSE: [("resolve_collision", _impulse, MOTION[2:])],
    Kind.FRICTION: [("friction", _friction, MOTION[2:])],
    Kind.CONSTRAINT: [
        ("resolve_position_constraint", _moved, MOTION[:1]),
        ("resolve_velocity_constraint", _stopped, MOTION[2:]),
    ],
}
