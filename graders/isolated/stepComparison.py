"""Compares a student's steps with ours.

Each of the student's steps begins with our state, and is made in a process of its own. That tells
each call of a function that the coursework asks for, which is then repeated with ours, on the same
input. If all calls agree but the step does not, the order of the calls and the states before them
are compared with those of our step.
"""

import inspect
import itertools
import math
import sys
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
from worker.steps import BUILT, METHODS, STATE, STATES

import RBSFunctions
from Quaternion import QRotate
from rbs.glass.beside import take_inertia
from rbs.glass.events import SHAPES, BodyState, Event, Kind
from rbs.glass.terms import terms
from rbs.glass.trace import heading, term_lines
from rbs.program.submissions import CAUSE_LENGTH
from rbs.scenes.messages import short
from rbs.scenes.scenefiles import scene_rows
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.reports import GROUND
from rbs.stepping.settings import CONSTRAINT_TOLERANCE, GRAVITY

# The difference, relative to its scale, above which a number counts as another one. The scale is
# the largest length, speed or angular speed in the scene, or the number's own size. Rounding in a
# call stays below 1e-13, and mistakes are seldom below 1e-5. Below this depth, relative to the
# length, rounding decides whether bodies touch.
TOLERANCE = 1e-9
# Quantities of a state, and of results, each with its scale.
SCALES = dict(zip(STATE, ("length", "own", "speed", "spin"), strict=True))
CONTACT = {"depth": "length", "intNormal": "own", "intPosition": "length"}
VELOCITIES = {"correctedLinVelocities": "speed", "correctedAngVelocities": "spin"}
RETURNED = {
    "integrate_timestep": {},
    "resolve_collision": {},  # these two change meshes
    "get_rotated_inv_IT": {"the tensor": "own"},
    "detect_collision": {"isCollision": bool} | CONTACT,
    "resolve_position_constraint": {"positionWasValid": bool, "correctedPositions": "length"},
    "resolve_velocity_constraint": {"velocityWasValid": bool} | VELOCITIES,
}
RELEASED = "as in the coursework's released run_timestep; not counted as a difference"
LOSES = f"run_timestep loses a corrected linVelocity, {RELEASED}"
EARLY = f"run_timestep ends before the constraints hold, {RELEASED}"
# Steps in which a touch of no depth may be decided otherwise: more are no coincidence.
MOST_TIES = 3
MESHES = ("self", "m1", "m2", "m")  # parameters
END = "the end of the step"


def scene_order(source, isFixed, **contact):
    """What `worker.steps.Scene` is given of a SceneSource, besides the options."""
    bodies = []
    rows = scene_rows(source.path, source.scene)
    for (name, density, _isFixed, *pose), fixed in zip(rows, isFixed, strict=True):
        shape = [rows.tolist() for rows in source.shapes[name]]
        bodies.append([name, *shape, density, *(one.tolist() for one in pose), bool(fixed)])
    return {"bodies": bodies, "contact": contact}


def states_in(meshes):
    """The states of our meshes, as orders hold them."""
    return [[np.array(getattr(mesh, name)).tolist() for name in STATES] for mesh in meshes]


class Comparison:
    """Steps of a scene by our functions and by a student's, from the same states.

    ask : function that has `worker.steps` follow an order, and returns the answer
    ours : SceneSimulation; options : of the student's functions, beside the usual ones

    problem : the first difference, or ""
    terms : lines with all terms of our formula, and those of theirs, where the two differ
    largest : the largest relative difference of numbers that agree
    remarks : dict from text to the first step that it is true of
    """

    def __init__(self, ask, ours, options=None):
        self.problem, self.remarks, self.largest, self.number = "", {}, 0.0, 1
        self.terms, self.ours, self._ask, self._visits, self._lists = [], ours, ask, 0, ""
        self._contacts, self._ties = 0, 0
        built = ask(scene_order(ours.source, [mesh.isFixed for mesh in ours.meshes]))
        self._places, known = built["places"], built["parameters"].get("run_timestep", [])
        self._usual = {"maxIterations": ours.max_iterations(), "tolerance": CONSTRAINT_TOLERANCE}
        self._options = {name: one for name, one in self._usual.items() if name in known}
        self._options |= options or {}
        if lacking := [name for name in options or () if name not in known]:
            text = f"run_timestep has no parameter {lacking[0]}, only {', '.join(known)}"
            self.problem = f"step 1: {short(text, limit=CAUSE_LENGTH)}"
        self.shadows = [*SceneSimulation(ours.source).meshes, RBSFunctions.ground()]
        self.set_scales()
        found = [[one["invIT"], one["tensor"]] for one in built["meshes"]]
        for some in (ours.meshes, self.shadows[:-1]):
            self.remarks |= dict.fromkeys(take_inertia(some, found), 0)
        for mesh, told in zip(self.shadows, built["meshes"], strict=False):
            pair = [getattr(mesh, name) for name in BUILT], [told[name] for name in BUILT]
            what = f"Mesh: {{}} of {mesh.name}"
            self.compare(what, dict.fromkeys(BUILT, "own"), *pair, "Mesh")
        self.largest = min(self.largest, TOLERANCE)

    def step(self):
        """Makes the same step twice; sets `problem` at the first difference."""
        self.set_scales()
        self.number, start = self.ours.stepCount + 1, states_in(self.ours.meshes)
        told, self._visits, self._contacts, last = self._made(start, True), 0, 0, {}
        for call in told["calls"]:
            last = self.check(call, last)
            if self.problem:
                return
        if told["problem"]:
            text = short(str(told["problem"]), limit=CAUSE_LENGTH) + self._lists
            self.problem = f"step {self.number} cannot be made: {text}"
            return
        events, before = [], self.ours.state()
        self.ours.advance(events.append)
        after = [told["states"][str(k)] for k in range(len(self.ours.meshes))]
        gap = self.gap_of(states_in(self.ours.meshes), after)
        if gap <= TOLERANCE:
            self.largest = max(self.largest, gap)
        else:
            self.explain(start, after, before, events)
        if not self.problem and self.stale(after):
            self.remark("currVertices, which are drawn, are out of date at the end of a step")

    def _made(self, start, isTold):
        settings, rows = self.ours.settings, [list(one) for one in self.ours.constraints]
        step = settings.timeStep, settings.restitution, True, rows
        order = {"states": start, "step": step, "options": self._options, "isTold": isTold}
        return self._ask(order)

    def remark(self, text):
        self.remarks.setdefault(text, self.number)

    def check(self, call, last):
        """Repeats a call with our function; returns the last visit of a constraint."""
        name, bodies, result = call["name"], call["bodies"], call["result"]
        isMove, isPosition = not RETURNED[name], name == "resolve_position_constraint"
        shadows = [self.shadows[k] for k in bodies]
        isFree = not all(mesh.isFixed for mesh in shadows)
        label = f"{name}({', '.join(mesh.name for mesh in shadows)})"
        if call["lists"] and not self._lists:
            place = short(str(self._places.get(name) or ""), limit=80)
            what = short(str(call["lists"][0]), limit=60)
            self._lists = f"; {name} ({place}) leaves a list in {what}"
        if result is None and len(RETURNED[name]) > 1:
            self.differs(f"{label}: returns nothing", name)
        elif isPosition:
            self._visits += 1
        self._contacts += isFree and name == "resolve_collision"
        if self.problem or (not isFree and name in ("detect_collision", "resolve_collision")):
            return last
        set_states(shadows, [call["before"][str(k)] for k in bodies])
        before, given = states_of(shadows), [arrays(one) for one in call["given"]]
        own = getattr(type(shadows[0]) if name in METHODS else RBSFunctions, name)
        names = [one for one in inspect.signature(own).parameters if one not in MESHES]
        ours = own(*(shadows if isMove or name in METHODS else ()), *given[: len(names)])
        for mesh, k in zip(shadows, bodies if isMove else (), strict=False):
            pair = [getattr(mesh, one) for one in STATE], call["after"][str(k)]
            self.compare(f"{label}: {{}} of {mesh.name}", SCALES, *pair, name)
        if len(RETURNED[name]) < 2:
            ours, result = (ours,), result or (None,)
        self.compare(f"{label}: {{}}", RETURNED[name], ours, result, name)
        if name == "detect_collision" and self.problem:
            self.problem += self.stale([call["before"][str(k)] for k in bodies], bodies)
        for k in call["changed"]:
            if k < len(names) and names[k].startswith("curr"):
                self.differs(f"{label}: changes its argument {names[k]} in place", name)
        if isPosition:
            last = {"points": [np.ravel(one) for one in given[1]], "upper": bool(given[4])}
            last |= {"refValue": float(np.ravel(given[2])[0]), "tolerance": CONSTRAINT_TOLERANCE}
        if self.problem:
            with suppress(ValueError, TypeError, IndexError, KeyError):  # numbers of another shape
                facts = before, states_of(shadows), given, (ours, result), last
                if events := self._events(call, *facts):
                    self.terms = [heading(events[0], self.ours.meshes), *term_lines(*events)]
        return last

    def _events(self, call, before, after, given, results, last):
        """The events of a call, ours and theirs; or (). last : of the constraint"""
        name, ground = call["name"], len(self.shadows) - 1
        bodies = tuple(GROUND if k == ground else k for k in call["bodies"])
        rows = [call["after"][str(k)] for k in call["bodies"]]
        rows = [[np.array(one, float).ravel() for one in some[:4]] for some in rows]
        theirs = [BodyState(*some, *body[4:]) for some, body in zip(rows, before, strict=True)]
        if name == "integrate_timestep":
            facts = {"timeStep": given[0], "gravity": np.array([0.0, GRAVITY, 0.0])}
            return [Event(Kind.FLIGHT, bodies, before, one, facts) for one in (after, theirs)]
        if name == "resolve_collision":
            depth, n, p = (np.array(one, float).ravel() for one in given[:3])
            n = -n if bodies[1] == GROUND or depth[0] < 0.0 else n
            p = p + after[1].position - before[1].position
            facts = {"contact": self._contacts, "depth": abs(float(depth[0])), "normal": n}
            facts |= {"CRCoeff": given[3], "closingOnly": False, "mu": 0.0, "points": (p, p)}
            pairs = zip(after, theirs, strict=True)
            isMoved = all(np.allclose(a.position, b.position) for a, b in pairs)
            moved = [b._replace(position=a.position) for a, b in zip(after, before, strict=True)]
            kind, start = (Kind.IMPULSE, moved) if isMoved else (Kind.CORRECTION, before)
            return [Event(kind, bodies, start, end, facts) for end in (after, theirs)]
        if not name.endswith("constraint"):
            return ()
        isPosition = name.startswith("resolve_position")
        valid = [isPosition and truth(one[0]) for one in results]
        facts = [last | {"constraint": self._visits - 1, "isValid": one} for one in valid]
        own, rows = Event(Kind.CONSTRAINT, bodies, before, before, facts[0]), results[1][1:]
        found, ends = terms(own), []
        for k, body in enumerate(before):
            symbols = {"position": "COM", "linVelocity": "v", "angVelocity": "ω"}
            end = {one: found.get(f"{symbols[one]}{k + 1}′", getattr(body, one)) for one in symbols}
            names = list(symbols)[:1] if isPosition else list(symbols)[1:]
            end |= {one: np.ravel(row[k]) for one, row in zip(names, rows, strict=True)}
            ends.append(body._replace(**end))
        return own, own._replace(after=ends, given=facts[1])

    def _calls(self, start):
        """The student's calls that move bodies, with all states before them, and the end."""
        events = []
        told = self._made(start, "all")
        for call in told["calls"]:
            result = call["result"]
            isVisit = call["name"] == "resolve_position_constraint" and not truth(result[0])
            isFree = not all(self.shadows[k].isFixed for k in call["bodies"])
            if call["all"] and isFree and (isVisit or not RETURNED[call["name"]]):
                names = ", ".join(self.shadows[k].name for k in call["bodies"])
                label, isHit = f"{call['name']}({names})", call["name"] == "resolve_collision"
                depth = abs(np.ravel(call["given"][0])[0]) if isHit else math.inf
                events.append((label, call["bodies"], list(call["all"].values()), depth))
        return [*events, (END, [], list(told["states"].values()), math.inf)]

    def _own_calls(self, events, before):
        """The same of our step. before : the state before it"""
        now = [
            list(rows) for rows in zip(*(before[name] for name in list(before)[:4]), strict=True)
        ]
        names, calls = [mesh.name for mesh in self.shadows], []
        what = {Kind.FLIGHT: "integrate_timestep", Kind.CONTACT: "resolve_collision"}
        what |= {Kind.CONSTRAINT: "resolve_position_constraint"}
        for event in events:
            if event.kind in what and not event.given.get("isValid"):
                label = f"{what[event.kind]}({', '.join(names[b] for b in event.bodies)})"
                depth, rows = event.given.get("depth", math.inf), [list(one) for one in now]
                calls.append((label, list(event.bodies), rows, depth))
            for body, state in zip(event.bodies, event.after, strict=True):
                if body != GROUND:
                    now[body] = list(state[:4])
        return [*calls, (END, [], now, math.inf)]

    def explain(self, start, after, before, events):
        """Finds where the student's run_timestep differs from ours, unless it makes the slips of
        the released one, or rounding decided.

        start, after : states before the step, and theirs after it; before, events : of our step
        """
        for slips in ((LOSES,), (EARLY,), (LOSES, EARLY)):
            if self.gap_of(self._released(start, slips), after) <= TOLERANCE:
                for text in slips:
                    self.remark(text)
                return
        ours, last = self._own_calls(events, before), ("the start of the step", [], start)
        for event, other in zip(self._calls(start), ours, strict=False):
            for k, (i, name) in itertools.product(range(len(self.ours.meshes)), enumerate(STATE)):
                own, theirs = other[2][k][i], event[2][k][i]
                if self.gap(own, theirs, SCALES[name]) > TOLERANCE:
                    text = f"run_timestep: after {last[0]}, {name} of {self.shadows[k].name} "
                    text += f"differs{shown(own, theirs)}{self.stale(last[2])}"
                    return self.differs(text, "run_timestep")
            if event[0] != other[0]:
                isTie = min(event[3], other[3]) <= TOLERANCE * self.scales["length"]
                self._ties += isTie
                if not isTie or self._ties > MOST_TIES:
                    text = f"run_timestep: after {last[0]} comes {event[0]}, in ours {other[0]}"
                    self.differs(text + self.stale(event[2]), "run_timestep")
                return
            last = event
        self.differs("the states at the end of the step differ", "run_timestep")

    def _released(self, start, slips):
        """The states after our step with slips of the released run_timestep (quirks 4 and 5)."""
        meshes, settings, options = self.shadows[:-1], self.ours.settings, dict(self._usual)
        set_states(meshes, start)

        def lossy(positions, points, linVelocities, *others):
            right = RBSFunctions.resolve_velocity_constraint
            wasValid, (first, _second), spins = right(positions, points, linVelocities, *others)
            return wasValid, (first, linVelocities[1]), spins

        taught = dict(vars(RBSFunctions))
        if LOSES in slips:
            taught["resolve_velocity_constraint"] = lossy
        if EARLY in slips:
            count = max(1, len(self.ours.constraints))
            options["maxIterations"] = math.ceil(options["maxIterations"] / count)
        step = settings.timeStep, settings.restitution, True, self.ours.constraints
        functions = SimpleNamespace(**taught)
        RBSFunctions.run_timestep(meshes, self.shadows[-1], *step, functions=functions, **options)
        return states_in(meshes)

    def gap_of(self, ours, theirs):
        """The largest difference of two lists of states."""
        return max(
            self.gap(own, row, SCALES[name])
            for pair in zip(ours, theirs, strict=True)
            for name, own, row in zip(STATE, *pair, strict=False)
        )

    def set_scales(self):
        """Sets the scales of a step's numbers, from our state before it."""
        speed, spin, length = (
            max(np.abs(getattr(mesh, name)).max() for mesh in self.ours.meshes)
            for name in ("linVelocity", "angVelocity", "currVertices")
        )
        radius = min(np.abs(mesh.origVertices).max() for mesh in self.ours.meshes)
        speed = max(abs(GRAVITY) * self.ours.settings.timeStep, speed, spin * radius)
        self.scales = {"length": length, "speed": speed, "spin": speed / radius, "own": 0.0}

    def gap(self, ours, theirs, kind="own"):
        """The largest difference of numbers, relative to their scale."""
        ours, theirs = as_arrays(ours, theirs)
        scale = max(self.scales[kind], np.abs(ours).max(), sys.float_info.min)
        gap = float(np.abs(theirs - ours).max()) / scale
        return math.inf if math.isnan(gap) else gap

    def compare(self, what, kinds, ours, theirs, function):
        """Records the first quantity that differs.

        what : with {} for its name; ours, theirs : values in the order of `kinds`
        """
        for (name, kind), own, other in zip(kinds.items(), ours, theirs, strict=False):
            if kind is not bool:
                gap = self.gap(own, other, kind)
                if gap > TOLERANCE:
                    self.differs(what.format(name) + f" differs{shown(own, other)}", function)
                self.largest = max(self.largest, min(gap, TOLERANCE))
            elif bool(own) != truth(other):
                depth = (ours if own else theirs)[1] if name == "isCollision" else math.inf
                if np.ravel(depth)[0] > TOLERANCE * self.scales["length"]:
                    self.differs(
                        f"{what.format(name)} is {truth(other)}, not {bool(own)}", function
                    )
                return
            elif name == "isCollision" and not own:
                return

    def differs(self, text, function):
        """Records the first difference, and the place of the function."""
        place = short(str(self._places.get(function) or ""), limit=80)
        text = f"step {self.number}: {text}" + f"; {place}" * bool(place)
        self.problem = self.problem or text

    def stale(self, states, bodies=None):
        """Names the meshes whose currVertices do not fit position and orientation; "" if none.

        states : rows of STATES of all meshes, or of these bodies
        """
        names = []
        for k, state in zip(bodies or range(len(self.shadows) - 1), states, strict=False):
            if k == len(self.shadows) - 1 or len(state or ()) < len(STATES):
                continue
            shadow = self.shadows[k]
            position, orientation = (np.array(one, float).reshape(1, -1) for one in state[:2])
            vertices = QRotate(orientation, shadow.origVertices) + position
            if self.gap(vertices, state[4], "length") > TOLERANCE:
                names.append(shadow.name)
        return f"; currVertices of {', '.join(names)} are out of date" if names else ""


def states_of(meshes):
    """The `BodyState` of each of our meshes."""
    columns = ([np.array(getattr(mesh, name), float) for name in SHAPES] for mesh in meshes)
    shapes = list(SHAPES.values())
    return [
        BodyState(*(row.reshape(shape)[()] for row, shape in zip(rows, shapes, strict=True)))
        for rows in columns
    ]


def set_states(meshes, states):
    """Puts our meshes into states of an order or answer."""
    for mesh, rows in zip(meshes, states, strict=True):
        for name, row in zip(STATE, rows, strict=False):
            setattr(mesh, name, np.array(row, float).reshape(1, -1))


def truth(value):
    """A flag that a student's function has returned."""
    return bool(np.ravel(value)[0]) if np.size(value) else False


def arrays(value):
    """Numbers of an answer as an array, others as they are."""
    try:
        return np.array(value, float) if isinstance(value, list) else value
    except (TypeError, ValueError):
        return value


def as_arrays(ours, theirs):
    """Both as arrays of floats; theirs is NaN if it has another shape than ours."""
    ours = np.atleast_1d(np.array(ours, dtype=np.float64))
    try:
        theirs = np.array(theirs, dtype=np.float64).reshape(ours.shape)
    except (TypeError, ValueError):
        theirs = np.full(ours.shape, np.nan)
    isOpposite = ours.shape[-1] == 4 and np.sum(ours * theirs) < 0.0  # the same rotation
    return ours, -theirs if isOpposite else theirs


def shown(ours, theirs):
    """A text with the largest difference, and both rows there; a NaN counts as the largest."""
    ours, theirs = as_arrays(ours, theirs)
    distance = np.abs(theirs - ours)
    at = np.unravel_index(distance.argmax(), ours.shape)
    rows = (np.array2string(one[at[:-1]], precision=4) for one in (ours, theirs))
    return " by {:.1e} (ours {}, theirs {})".format(distance[at], *rows)
