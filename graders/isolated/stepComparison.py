"""Compares a student's steps with ours.

Each of the student's steps begins with our state, and is made in a process of its own. If the state
after it is not ours, the step is made once more, and the process tells each call. The events that
they amount to are compared with those of our step, as the window and --trace do.
"""

import itertools
import math
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
from worker.steps import BUILT, STATE, STATES, TURN

import RBSFunctions
from Quaternion import QRotate
from rbs.glass.beside import same, take_inertia
from rbs.glass.events import Kind, Watch
from rbs.glass.mistakes import mistake_in
from rbs.glass.trace import (
    TOLERANCE,
    both,
    first_difference,
    gap,
    heading,
    state_gaps,
    term_lines,
)
from rbs.program.submissions import CAUSE_LENGTH
from rbs.scenes.messages import short
from rbs.scenes.scenefiles import scene_rows
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.reports import GROUND
from rbs.stepping.settings import CONSTRAINT_TOLERANCE, GRAVITY

RELEASED = "as in the coursework's released run_timestep; not counted as a difference"
LOSES = f"run_timestep loses a corrected linVelocity, {RELEASED}"
EARLY = f"run_timestep ends before the constraints hold, {RELEASED}"
STALE = "currVertices, which are drawn, are out of date at the end of a step"
# Steps in which a touch of no depth may be decided otherwise: more are no coincidence.
MOST_TIES = 3
# The function that an event, or a symbol of a constraint's formula, is computed by.
COMPUTED_BY = {Kind.FLIGHT: "integrate_timestep", Kind.CONTACT: "detect_collision"}
COMPUTED_BY |= dict.fromkeys((Kind.CORRECTION, Kind.IMPULSE), "resolve_collision")
POSITION, VELOCITY = "resolve_position_constraint", "resolve_velocity_constraint"
USE_VERTICES = "detect_collision", "resolve_collision"
ARGUMENTS = {"p1", "p2", "refValue"}
OF_POSITIONS = {"C", "result", "COM1′", "COM2′"}


def scene_order(source, isFixed):
    """What `worker.steps.Scene` is given of a SceneSource, besides the options."""
    bodies = []
    rows = scene_rows(source.path, source.scene)
    for (name, density, _isFixed, *pose), fixed in zip(rows, isFixed, strict=True):
        shape = [rows.tolist() for rows in source.shapes[name]]
        bodies.append([name, *shape, density, *(one.tolist() for one in pose), bool(fixed)])
    return {"bodies": bodies}


def states_in(meshes):
    return [[np.array(getattr(mesh, name)).tolist() for name in STATES] for mesh in meshes]


class Comparison:
    """Steps of a scene by our functions and by a student's, from the same states.

    ours : SceneSimulation; asked : how many steps; options : of the student's functions, beside
        the usual ones

    steps : how many agree; problem : the first difference, or another failure, or ""
    terms : lines with all terms of our formula, and those of theirs, where the two differ
    largest : the largest relative difference of numbers that agree
    remarks : dict from text to the first step that it is true of
    """

    def __init__(self, ours, asked, options=None):
        self.problem, self.remarks, self.largest, self.number = "", {}, 0.0, 1
        self.ours, self.asked, self._options, self.steps = ours, asked, options, 0
        self.terms, self._ties = [], 0

    @property
    def isOver(self):
        return bool(self.problem) or self.steps >= self.asked

    @property
    def share(self):
        return self.steps / self.asked

    def told(self):
        return [f"from step {k} on: {one}" * (k > 0) or one for one, k in self.remarks.items()]

    def build(self, ask):
        """Has the student's bodies built. ask : function that has `worker.steps` follow an order,
        and returns the answer
        """
        self._ask, ours, options = ask, self.ours, self._options
        built = ask(scene_order(ours.source, [mesh.isFixed for mesh in ours.meshes]))
        self._places, known = built["places"], built["parameters"].get("run_timestep", [])
        iterations = ours.settings.max_iterations(len(ours.constraints))
        self._usual = {"maxIterations": iterations, "tolerance": CONSTRAINT_TOLERANCE}
        self._options = {name: one for name, one in self._usual.items() if name in known}
        self._options |= options or {}
        if lacking := [name for name in options or () if name not in known]:
            text = f"run_timestep has no parameter {lacking[0]}, only {', '.join(known)}"
            self.problem = f"step 1: {short(text, limit=CAUSE_LENGTH)}"
        self.shadows = [*SceneSimulation(ours.source).meshes, RBSFunctions.ground()]
        found = [[one["invIT"], one["tensor"]] for one in built["meshes"]]
        for some in (ours.meshes, self.shadows[:-1]):
            self.remarks |= dict.fromkeys(take_inertia(some, found), 0)
        self._turned = []  # bodies whose tensor is turned to world axes in another way
        for k, (mesh, told) in enumerate(zip(ours.meshes, built["meshes"], strict=True)):
            for name in BUILT:
                own = getattr(mesh, name)
                if not same(told[name], own):
                    self.differs(f"{name} of {mesh.name}{both(own, told[name])}", "Mesh")
            if not same(told["tensor"], turned(mesh)):
                self._turned.append(k)

    def step(self):
        """Makes the same step twice; sets `problem` at the first difference."""
        self.number, start = self.ours.stepCount + 1, states_in(self.ours.meshes)
        told, events = self._made(start, False), []
        self.ours.advance(events.append)
        if not told["problem"]:
            found = self._gap(self.ours.meshes, told)
            if found > TOLERANCE and not self._is_released(start, told):
                self._explain(start, self._made(start, True), events)
            elif found <= TOLERANCE:
                self.largest = max(self.largest, found)
            if not self.problem and self._stale(told["states"]):
                self.remarks.setdefault(STALE, self.number)
            self.steps += not self.problem
        else:
            calls = self._made(start, True)["calls"]
            lists = (
                f"; {one['name']} leaves a list in {one['lists'][0]}, at {place}"
                for one in calls
                if one["lists"]
                for place in [self._places.get(one["name"])]
            )
            nothing = [one["name"] for one in calls[-1:] if one["result"] is None]
            text = told["problem"] + next(lists, "")
            if nothing and nothing[0] in ("detect_collision", POSITION, VELOCITY):
                text = f"{nothing[0]} returns nothing: {text}"
            self.problem = f"step {self.number} cannot be made: {short(text, limit=CAUSE_LENGTH)}"

    def _made(self, start, isTold):
        settings, rows = self.ours.settings, [list(one) for one in self.ours.constraints]
        step = settings.timeStep, settings.restitution, True, rows
        order = {"states": start, "step": step, "options": self._options, "isTold": isTold}
        return self._ask(order)

    def differs(self, text, function):
        """Records the first difference, and the place of the function."""
        place = short(str(self._places.get(function) or ""), limit=80)
        text = f"step {self.number}: {function}: {text}" + f"; {place}" * bool(place)
        self.problem = self.problem or text

    def _explain(self, start, told, events):
        retold, names, odd = Retold(self.ours, self.shadows, start), self.ours.meshes, ""
        for call in told["calls"]:
            try:
                retold.follow(call)
            except (ValueError, TypeError, IndexError):
                odd = call["name"]
                break
        theirs = retold.finish()
        if odd == "integrate_timestep":
            return self.differs("gives no numbers of the kind and shape of ours", odd)
        if retold.moved:
            return self.differs("moves two bodies that are fixed", "resolve_collision")
        using = [one["before"] for one in told["calls"] if one["name"] in USE_VERTICES]
        stale = self._stale(*using) or self._stale(told["states"])
        difference = first_difference(events, theirs, names)
        if difference is None:
            return self.differs(f"the states at the end of the step{stale}", "run_timestep")
        own, other, wrong = difference[:3]
        if other is None and odd:
            return self.differs("gives no numbers of the kind and shape of ours", odd)
        if wrong:
            self.terms = [heading(own, names), *term_lines(own, other)]
            hint = mistake_in(other, theirs)
            self.terms += [f"hint: {hint}"] * bool(hint)
            text = f"{heading(own, names)} differs in {', '.join(wrong)}"
            return self.differs(text + stale * (own.kind == Kind.CONTACT), self._by(own, wrong))
        if difference.state is not None:
            return self.differs(difference.lines(names)[0] + stale, "run_timestep")
        return self._explain_order(difference, events, told["calls"], stale)

    def _by(self, event, wrong):
        """The function that has computed these symbols of an event."""
        isGround = event.kind == Kind.CONTACT and GROUND in event.bodies
        if isGround or ARGUMENTS & set(wrong):
            return "run_timestep"
        if event.kind == Kind.CONSTRAINT and OF_POSITIONS & set(wrong):
            return POSITION
        if event.kind in (Kind.IMPULSE, Kind.CONSTRAINT) and set(event.bodies) & set(self._turned):
            return "get_rotated_inv_IT"
        return COMPUTED_BY.get(event.kind, VELOCITY)

    def _explain_order(self, difference, ours, calls, stale):
        """Tells which event comes in place of ours, unless rounding decided about a touch."""
        own, other, *_none = difference
        depths = [one.given["depth"] for one in (own, other) if one and one.kind == Kind.CONTACT]
        length = max(1.0, *(np.abs(mesh.currVertices).max() for mesh in self.ours.meshes))
        if min(depths, default=math.inf) <= TOLERANCE * length and self._ties < MOST_TIES:
            self._ties += 1
            return
        hits = [one.bodies for one in ours if one.kind == Kind.CONTACT]
        for event in (own, other):
            if event and event.kind == Kind.CONTACT and GROUND not in event.bodies:
                flags = [
                    truth(one["result"][0])
                    for one in calls
                    if one["result"]
                    and (one["name"], one["bodies"]) == ("detect_collision", [*event.bodies])
                ]
                isOurs = event.bodies in hits
                if flags and isOurs not in flags:
                    names = ", ".join(self.ours.meshes[k].name for k in event.bodies)
                    text = f"isCollision of {names} is {not isOurs}, not {isOurs}{stale}"
                    return self.differs(text, "detect_collision")
        self.differs(difference.lines(self.ours.meshes)[0] + stale, "run_timestep")

    def _is_released(self, start, told):
        """Whether slips of the released run_timestep lead to their states (quirks 4 and 5)."""
        for slips in ((LOSES,), (EARLY,), (LOSES, EARLY)):
            put(self.shadows, range(len(start)), start)
            self._released_step(slips)
            if self._gap(self.shadows[:-1], told) <= TOLERANCE:
                for text in slips:
                    self.remarks.setdefault(text, self.number)
                return True
        return False

    def _released_step(self, slips):
        """Makes our step with slips of the released run_timestep."""
        settings, options = self.ours.settings, dict(self._usual)

        def lossy(positions, points, linVelocities, *others):
            right = RBSFunctions.resolve_velocity_constraint
            wasValid, (first, _second), spins = right(positions, points, linVelocities, *others)
            return wasValid, (first, linVelocities[1]), spins

        edited = dict(vars(RBSFunctions))
        if LOSES in slips:
            edited["resolve_velocity_constraint"] = lossy
        if EARLY in slips:
            count = max(1, len(self.ours.constraints))
            options["maxIterations"] = math.ceil(options["maxIterations"] / count)
        step = settings.timeStep, settings.restitution, True, self.ours.constraints
        functions = SimpleNamespace(**edited)
        scene = self.shadows[:-1], self.shadows[-1]
        RBSFunctions.run_timestep(*scene, *step, functions=functions, **options)

    def _gap(self, meshes, told):
        """The largest difference of our states and those of an answer."""
        rows = (row[: len(STATE)] for row in told["states"].values())
        return max(found for found, *_which in state_gaps(zip(meshes, rows, strict=True)))

    def _stale(self, *tables):
        """Names the meshes whose currVertices do not fit position and orientation; "" if none."""
        names = {}
        rows = itertools.chain(*(states.items() for states in tables))
        for k, (position, orientation, *_velocities, vertices) in rows:
            shadow = self.shadows[int(k)]
            with suppress(ValueError, TypeError):  # odd numbers
                turn = np.array(orientation, float).reshape(1, 4)
                now = QRotate(turn, shadow.origVertices) + np.ravel(np.array(position, float))
                if now.size and gap(now, vertices) > TOLERANCE:
                    names[shadow.name] = None
        return f"; currVertices of {', '.join(names)} are out of date" if names else ""


class Retold:
    """The events that a student's calls amount to, by what they did to the bodies.

    ours : SceneSimulation; shadows : its meshes once more, and the ground; start : their states
    moved : whether a call has moved two bodies that are fixed
    """

    def __init__(self, ours, shadows, start):
        self._shadows, self._events, self._visits, self._visit = shadows, [], 0, None
        self._count, self._hasFlown, self.moved = max(1, len(ours.constraints)), False, False
        columns = zip(STATE, zip(*(rows[:4] for rows in start), strict=True), strict=True)
        self._signs = [np.ravel(rows[1]) for rows in start]
        put(shadows, range(len(start)), start)
        step = {"meshes": shadows[:-1], "groundMesh": shadows[-1], "mu": 0.0}
        step |= {"timeStep": ours.settings.timeStep, "CRCoeff": ours.settings.restitution}
        step |= {"gravity": (0.0, GRAVITY, 0.0), "tolerance": CONSTRAINT_TOLERANCE}
        step["start"] = {name: np.array([*map(np.ravel, rows)]).T for name, rows in columns}
        self._watch = Watch(self._events.append, SimpleNamespace(**step))

    def follow(self, call):
        """Takes over a call. Raises ValueError, TypeError or IndexError if its numbers are odd."""
        name, bodies = call["name"], call["bodies"]
        if name == "integrate_timestep":
            return self._put(bodies, call["after"])
        self._report_flights()
        if name == "get_rotated_inv_IT":
            return None
        if name == VELOCITY and self._visit:
            for k, *velocities in zip(bodies, *call["result"][1:], strict=True):
                put(self._shadows, [k], [velocities], STATE[2:])
        self._report_visit()
        if all(self._shadows[k].isFixed for k in bodies):
            pairs = (zip(call["before"][k], call["after"][k], strict=False) for k in call["after"])
            isMoved = any(gap(*one) > TOLERANCE for one in itertools.chain(*pairs))
            self.moved |= isMoved and name == "resolve_collision"
            return None
        self._put(bodies, call["before"])
        pair = [GROUND if k == len(self._signs) else k for k in bodies]
        if name == "resolve_collision":
            self._watch.report_contact(*pair, *(np.array(one, float) for one in call["given"][:3]))
            self._put(bodies, call["after"])
            self._watch.report_response()
        elif name == POSITION:
            before, (wasValid, positions) = self._watch.states(*pair), call["result"]
            points, refValue, upper = (call["given"][k] for k in (1, 2, 4))
            ends = zip(points, before, strict=True)
            arms = [np.subtract(np.ravel(point), one.position) for point, one in ends]
            link = {"index": self._visits % self._count, "body1": pair[0], "body2": pair[1]}
            link |= {"refValue": float(np.ravel(refValue)[0]), "upper": truth(upper)}
            link = SimpleNamespace(**link, arm1=arms[0], arm2=arms[1])
            put(self._shadows, bodies, [[one] for one in positions])
            visit = link, link, before, truth(wasValid)
            self._visit, self._visits = visit, self._visits + 1
        return None

    def finish(self):
        self._report_flights()
        self._report_visit()
        return self._events

    def _report_flights(self):
        if not self._hasFlown:
            self._watch.report_flights()
        self._hasFlown = True

    def _report_visit(self):
        if self._visit:
            self._watch.report_visit(*self._visit)
        self._visit = None

    def _put(self, bodies, states):
        put(self._shadows, bodies, states.values())
        for k in bodies:  # q and -q are the same orientation
            if k < len(self._signs) and self._shadows[k].orientation @ self._signs[k] < 0.0:
                self._shadows[k].orientation = -self._shadows[k].orientation


def put(meshes, bodies, states, names=STATE):
    for k, rows in zip(bodies, states, strict=True):
        for name, row in zip(names, rows, strict=False):
            setattr(meshes[k], name, np.array(row, float).reshape(1, -1))


def turned(mesh):
    """The inverse inertia tensor of our mesh in world axes, in the pose that workers tell."""
    before, mesh.orientation = mesh.orientation, TURN.copy()
    tensor, mesh.orientation = mesh.get_rotated_inv_IT(), before
    return tensor


def truth(value):
    return bool(np.ravel(value)[0]) if np.size(value) else False
