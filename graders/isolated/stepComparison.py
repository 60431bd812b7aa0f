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

import numpy as np
from worker.steps import BUILT, METHODS, STATE, STATES

import RBSFunctions
from Quaternion import QRotate
from rbs.glass.beside import TURN, take_inertia
from rbs.glass.events import SHAPES, BodyState, Event, Kind
from rbs.glass.trace import heading, term_lines
from rbs.glass.terms import terms
from rbs.program.submissions import brief
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
        self.terms, self.ours, self._ask, self._visits, self._lists = [], ours, ask, [], ""
        built = ask(scene_order(ours.source, [mesh.isFixed for mesh in ours.meshes]))
        self._places, known = built["places"], built["parameters"].get("run_timestep", [])
        usual = {"maxIterations": ours.max_iterations(), "tolerance": CONSTRAINT_TOLERANCE}
        self._options = {name: one for name, one in usual.items() if name in known} | (
            options or {}
        )
        if lacking := [name for name in options or () if name not in known]:
            text = f"run_timestep has no parameter {lacking[0]}, only {', '.join(known)}"
            self.problem = f"step 1: {brief(text)}"
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
        told, self._visits, self._contacts, last = self._made(start, True), [], 0, {}
        for call in told["calls"]:
            last = self.check(call, last)
            if self.problem:
                return
        if told["problem"]:
            text = brief(str(told["problem"])) + self._lists
            self.problem = f"step {self.number} cannot be made: {text}"
            return
        events, before = [], self.ours.state()
        self.ours.advance(events.append)
        after = [told["states"][str(k)] for k in range(len(self.ours.meshes))]
        gaps = [
            self.gap(getattr(mesh, name), row, SCALES[name])
            for mesh, rows in zip(self.ours.meshes, after, strict=True)
            for name, row in zip(STATE, rows, strict=False)
        ]
        if max(gaps) <= TOLERANCE:
            self.largest = max(self.largest, *gaps)
        else:
            self.explain(self._calls(start), self._own_calls(events, before), gaps, after)
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
        label = f"{name}({', '.join(mesh.name for mesh in shadows)})"
        if call["lists"] and not self._lists:
            place = brief(str(self._places.get(name) or ""), 80)
            self._lists = f"; {name} ({place}) leaves a list in {brief(str(call['lists'][0]), 60)}"
        if result is None and len(RETURNED[name]) > 1:
            return self.differs(f"{label}: returns nothing", name)
        if isPosition:
            self._visits.append(bool(truth(result[0])))
        isFree = not all(mesh.isFixed for mesh in shadows)
        if name == "resolve_collision" and isFree:
            self._contacts += 1
        if self.problem or (not isFree and name in ("detect_collision", "resolve_collision")):
            return last
        for mesh, k in zip(shadows, bodies, strict=True):
            for one, row in zip(STATE, call["before"][str(k)], strict=False):
                setattr(mesh, one, np.array(row, float).reshape(1, -1))
        before, given = states_of(shadows), [arrays(one) for one in call["given"]]
        own = getattr(type(shadows[0]) if name in METHODS else RBSFunctions, name)
        names = [
            one for one in inspect.signature(own).parameters if one not in ("self", "m1", "m2", "m")
        ]
        ours = own(*(shadows if isMove or name in METHODS else ()), *given[: len(names)])
        for mesh, k in zip(shadows, bodies if isMove else (), strict=False):
            pair = [getattr(mesh, one) for one in STATE], call["after"][str(k)]
            self.compare(f"{label}: {{}} of {mesh.name}", SCALES, *pair, name)
        if len(RETURNED[name]) < 2:
            ours, result = (ours,), result or (None,)
        self.compare(f"{label}: {{}}", RETURNED[name], ours, result, name)
        if name == "detect_collision":
            self.problem += self.problem and self.stale(
                [call["before"].get(str(k)) for k in bodies], bodies
            )
        for k in call["changed"]:
            if k < len(names) and names[k].startswith("curr"):
                self.differs(f"{label}: changes its argument {names[k]} in place", name)
        if isPosition:
            last = {
                "points": [np.ravel(one) for one in given[1]],
                "refValue": float(np.ravel(given[2])[0]),
            }
            last |= {"upper": bool(given[4]), "tolerance": CONSTRAINT_TOLERANCE}
        if self.problem:
            self.terms = self.terms_of(call, before, shadows, given, (ours, result), last)
        return last

    def terms_of(self, call, before, shadows, given, results, last):
        """Lines with the terms of our formula for a call, and those of theirs."""
        name, bodies = (
            call["name"],
            tuple(GROUND if k == len(self.shadows) - 1 else k for k in call["bodies"]),
        )

        def told(k, body):
            rows = dict(zip(STATE, call["after"][str(k)], strict=False))
            rows = [np.array(rows[one], float).ravel() for one in STATE]
            return BodyState(*rows, *body[4:])

        try:
            after, pair = (
                states_of(shadows),
                [told(*one) for one in zip(call["bodies"], before, strict=True)],
            )
            if name == "integrate_timestep":
                facts = {"timeStep": given[0], "gravity": np.array([0.0, GRAVITY, 0.0])}
                events = [Event(Kind.FLIGHT, bodies, before, one, facts) for one in (after, pair)]
            elif name == "resolve_collision":
                depth, n, p = (np.array(one, float).ravel() for one in given[:3])
                n = -n if bodies[1] == GROUND or depth[0] < 0.0 else n
                facts = {"contact": self._contacts, "depth": abs(float(depth[0])), "normal": n}
                facts |= {"CRCoeff": given[3], "closingOnly": False, "mu": 0.0}
                events = []
                for end in (after, pair):
                    moved = [
                        b._replace(position=a.position) for a, b in zip(end, before, strict=True)
                    ]
                    point = p + after[1].position - before[1].position
                    facts = facts | {"points": (point, point)}
                    kind = (
                        Kind.IMPULSE
                        if np.allclose(end[0].position, after[0].position)
                        and np.allclose(end[1].position, after[1].position)
                        else Kind.CORRECTION
                    )
                    events.append(
                        Event(kind, bodies, moved if kind == Kind.IMPULSE else before, end, facts)
                    )
                if events[1].kind == Kind.CORRECTION:
                    events[0] = events[0]._replace(kind=Kind.CORRECTION, before=before)
            elif name.endswith("constraint"):
                isValid = [bool(truth(one[0])) for one in results]
                facts = [
                    last | {"constraint": max(0, len(self._visits) - 1), "isValid": one}
                    for one in isValid
                ]
                facts = (
                    facts
                    if name.startswith("resolve_position")
                    else [last | {"constraint": 0, "isValid": False}] * 2
                )
                own = Event(Kind.CONSTRAINT, bodies, before, before, facts[0])
                found, ends = terms(own), []
                for k, body in enumerate(before):
                    end = {
                        one: found.get(f"{symbol}{k + 1}′", getattr(body, one))
                        for one, symbol in zip(STATE, ("COM", "", "v", "ω"), strict=True)
                    }
                    rows = results[1][1:]
                    if name.startswith("resolve_position"):
                        end["position"] = np.ravel(rows[0][k])
                    else:
                        end["linVelocity"], end["angVelocity"] = (
                            np.ravel(rows[0][k]),
                            np.ravel(rows[1][k]),
                        )
                    ends.append(
                        body._replace(**{one: np.array(row, float) for one, row in end.items()})
                    )
                events = [own, own._replace(after=ends, given=facts[1])]
            else:
                return []
            return [heading(events[0], self.ours.meshes), *term_lines(*events)]
        except (ValueError, TypeError, IndexError, KeyError):  # numbers of another shape
            return []

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

    def explain(self, events, ours, gaps, after):
        """Finds where the student's run_timestep differs from ours, unless rounding decided."""
        count = max(1, len(self.ours.constraints))
        most = math.ceil(self.ours.max_iterations() / count)
        isEarly = len(self._visits) == most < self.ours.report.constraintVisits  # quirk 5
        stopsEarly = isEarly and not all(self._visits[-count:])
        if stopsEarly:
            self.remark(f"run_timestep ends after {most} visits of constraints, {RELEASED}")
        last = "the start of the step", [], events[0][2]
        for event, other in zip(events, ours, strict=False):
            for k, (i, name) in itertools.product(range(len(self.ours.meshes)), enumerate(STATE)):
                before, own, theirs = (one[2][k][i] for one in (last, other, event))
                if self.gap(own, theirs, SCALES[name]) > TOLERANCE:
                    isUnchanged = before == theirs
                    if name == "linVelocity" and last[1][1:] == [k] and isUnchanged:  # quirk 4
                        self.remark(f"run_timestep loses a corrected linVelocity, {RELEASED}")
                    else:
                        text = f"run_timestep: after {last[0]}, {name} of {self.shadows[k].name} "
                        text += f"differs{shown(own, theirs)}{self.stale(last[2])}"
                        self.differs(text, "run_timestep")
                    return
            if event[0] != other[0]:
                isTie = min(event[3], other[3]) <= TOLERANCE * self.scales["length"]
                if not isTie and not (stopsEarly and event[0] == END):
                    text = f"run_timestep: after {last[0]} comes {event[0]}, in ours {other[0]}"
                    self.differs(text + self.stale(event[2]), "run_timestep")
                return
            last = event

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
        place = brief(str(self._places.get(function) or ""), 80)
        text = f"step {self.number}: {text}" + f"; {place}" * bool(place)
        self.problem = self.problem or text
        return {}

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
