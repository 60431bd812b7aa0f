"""Compares a student's steps with ours.

Each of the student's steps begins with our state, and is made in a process of its own. If the state
after it is not ours, our step is made once more with the student's functions, each called in that
process. The events of the two are compared, as the window and --trace do. Where they agree, the
difference is that of run_timestep.
"""

import math
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
from worker.steps import BUILT, as_list

import RBSFunctions
from Quaternion import QRotate
from rbs.glass.events import Kind
from rbs.glass.mistakes import mistake_in
from rbs.glass.model import INERTIA_DIVISOR
from rbs.glass.trace import (
    TOLERANCE,
    both,
    first_difference,
    gap,
    heading,
    same,
    state_gaps,
    term_lines,
)
from rbs.program.submissions import CAUSE_LENGTH, FUNCTIONS, METHODS, POSITION, VELOCITY
from rbs.program.submittedsteps import returned
from rbs.scenes.messages import short
from rbs.scenes.scenefiles import scene_rows
from rbs.scenes.simulation import TURN, TURNED_BACK, SceneSimulation, is_turned_back, turned_back
from rbs.stepping.meshes import STATE_WIDTHS
from rbs.stepping.reports import GROUND
from rbs.stepping.settings import CONSTRAINT_TOLERANCE

STATES = *STATE_WIDTHS, "currVertices"
RELEASED = "as in the coursework's released run_timestep; not counted as a difference"
LOSES = f"run_timestep loses a corrected linVelocity, {RELEASED}"
EARLY = f"run_timestep ends before the constraints hold, {RELEASED}"
STALE = "currVertices, which are drawn, are out of date at the end of a step"
# Steps in which a touch of no depth may be decided otherwise: more are no coincidence.
MOST_TIES = 3
# The function that an event, or a symbol of a constraint's formula, is computed by.
COMPUTED_BY = {Kind.FLIGHT: "integrate_timestep", Kind.CONTACT: "detect_collision"}
COMPUTED_BY |= dict.fromkeys((Kind.CORRECTION, Kind.IMPULSE), "resolve_collision")
OF_POSITIONS = {"C", "result", "COM1′", "COM2′"}
UP = (0.0, 1.0, 0.0)


def take_inertia(meshes, found):
    """Gives our meshes the skeleton's inertia if a student's have it; returns remarks.

    The skeleton's tensor is six times too small, which is not the student's work. The student turns
    it to world axes; with this tensor, the way of the release's solution is accepted, too.

    found : of each mesh, the student's invIT, and the tensor in world axes at the orientation TURN
    """
    remarks = []
    for mesh, (inverse, turned) in zip(meshes, found, strict=False):
        if mesh.isFixed or not same(inverse, INERTIA_DIVISOR * mesh.invIT):
            continue
        remarks.append("IT is six times too small, as in the released skeleton; allowed for")
        mesh.IT, mesh.invIT = mesh.IT / INERTIA_DIVISOR, mesh.invIT * INERTIA_DIVISOR
        if is_turned_back(mesh.invIT, turned):
            remarks.append(TURNED_BACK)
            mesh.__class__ = turned_back(type(mesh))
    return list(dict.fromkeys(remarks))


def states_in(meshes):
    return [[np.array(getattr(mesh, name)).tolist() for name in STATES] for mesh in meshes]


class Wrong(Exception):
    """What a call of a student's function did wrong; with the function's name."""

    def __init__(self, text, function):
        super().__init__(text)
        self.function = function


class Calls:
    """A student's functions as `functions` of our step, and their methods as those of our meshes.

    meshes : of our class, which change in place, the last of them the ground
    stale : dict from the meshes whose currVertices a call has left out of date to its function
    """

    def __init__(self, ask, meshes):
        self._ask, self._meshes, self.stale = ask, meshes, {}
        for name in FUNCTIONS:
            setattr(self, name, self._function(name))
        for mesh in meshes[:-1]:
            mesh.__class__ = type("Theirs", (type(mesh),), {k: self._function(k) for k in METHODS})

    def _function(self, name):
        return lambda *given: self._call(name, *given)

    def _call(self, name, *given):
        """Makes a call; moves our meshes as it has moved theirs. Raises Wrong."""
        indices = {id(mesh): k for k, mesh in enumerate(self._meshes)}
        bodies = [indices[id(one)] for one in given if id(one) in indices]
        others = [as_list(one) for one in given if id(one) not in indices]
        before = states_in([self._meshes[k] for k in bodies])
        (told,) = self._ask({"calls": [[name, bodies, before, others]]})["calls"]
        if told["problem"]:
            raise Wrong(short(told["problem"], limit=CAUSE_LENGTH), name)
        if told["changed"]:
            raise Wrong(changed_by(told, self._meshes), name)
        if told["result"] is None and name not in ("integrate_timestep", "resolve_collision"):
            raise Wrong("returns nothing", name)
        if told["hasLists"]:
            raise Wrong("leaves a list in place of an array", name)
        try:
            for k, rows in zip(bodies, told["states"], strict=True):
                self._move(name, self._meshes[k], rows)
            return self._result(name, told["result"])
        except (ValueError, TypeError, IndexError):
            raise Wrong("gives no numbers of the kind and shape of ours", name) from None

    def _move(self, name, mesh, rows):
        """Gives our mesh the state of theirs, and notes out-of-date vertices."""
        for key, row in zip(STATE_WIDTHS, rows, strict=False):
            now = getattr(mesh, key)
            row = np.array(row, float).reshape(now.shape)
            if key == "orientation" and np.sum(row * now) < 0.0:
                row = -row  # the same orientation
            if mesh is not self._meshes[-1] and not mesh.isFixed:
                setattr(mesh, key, row)
            elif not gap(now, row) <= TOLERANCE:
                isNumber = np.isfinite(row).all()
                raise Wrong("moves a body that is fixed" if isNumber else "gives NaN", name)
        if name in ("integrate_timestep", "resolve_collision") and is_stale(mesh, rows):
            self.stale.setdefault(mesh.name, name)

    def _result(self, name, result):
        if name == "get_rotated_inv_IT":
            return np.array(result, float).reshape(3, 3)
        if name == "detect_collision":
            isCollision, *contact = result
            if not np.ravel(isCollision)[0]:
                return False, 0.0, None, None
            depth, normal, point = (np.array(one, float).ravel() for one in contact)
            return True, float(depth[0]), normal.reshape(3), point.reshape(3)
        pairs = {POSITION: 1, VELOCITY: 2}.get(name)
        return pairs and returned(name, result, 1 + pairs)

    def fixed_bodies(self):
        """Resolves the contacts of fixed bodies with the ground, as the released run_timestep does.
        Raises Wrong.
        """
        for mesh in self._meshes[:-1]:
            lowest = mesh.currVertices[np.argmin(mesh.currVertices[:, 1])]
            if mesh.isFixed and lowest[1] <= 0.0:
                self.resolve_collision(mesh, self._meshes[-1], lowest[1], UP, lowest, 0.0)


def changed_by(told, meshes):
    """What an answer says is changed, as text."""
    name, k = told["changed"]
    return f"changes {short(str(name))} of {meshes[k].name}"


def is_stale(mesh, rows):
    """Whether currVertices do not fit position and orientation, in rows of STATES."""
    with suppress(ValueError, TypeError):  # odd numbers
        turn = np.array(rows[1], float).reshape(1, 4)
        now = QRotate(turn, mesh.origVertices) + np.ravel(np.array(rows[0], float))
        return bool(now.size) and gap(now, rows[-1]) > TOLERANCE
    return False


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
        self._ask, ours, options, bodies = ask, self.ours, self._options, []
        rows = scene_rows(ours.source.path, ours.source.scene)
        for (name, density, _isFixed, *pose), mesh in zip(rows, ours.meshes, strict=True):
            shape = [table.tolist() for table in ours.source.shapes[name]]
            bodies.append([name, *shape, density, *(one.tolist() for one in pose), mesh.isFixed])
        built = ask({"bodies": bodies, "turn": TURN.tolist(), "names": STATES})
        self._places, known = built["places"], built["parameters"]
        iterations = ours.settings.max_iterations(len(ours.constraints))
        self._usual = {"maxIterations": iterations, "tolerance": CONSTRAINT_TOLERANCE}
        self._options = {name: one for name, one in self._usual.items() if name in known}
        self._options |= options or {}
        if lacking := [name for name in options or () if name not in known]:
            text = f"run_timestep has no parameter {lacking[0]}, only {', '.join(known)}"
            self.problem = f"step 1: {short(text, limit=CAUSE_LENGTH)}"
        self._found = [[one["invIT"], one["tensor"]] for one in built["meshes"]]
        self.remarks |= dict.fromkeys(take_inertia(ours.meshes, self._found), 0)
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
        settings, rows = self.ours.settings, [list(one) for one in self.ours.constraints]
        step = settings.timeStep, settings.restitution, True, rows
        told = self._ask({"states": start, "step": step, "options": self._options})
        events = []
        self.ours.advance(events.append)
        isWrong = bool(told["problem"] or told["changed"])
        found = math.inf if isWrong else self._gap(self.ours.meshes, told)
        if found <= TOLERANCE:
            self.largest = max(self.largest, found)
        elif isWrong or not self._is_released(start, told):
            self._explain(start, told, events)
        if not self.problem and any(map(is_stale, self.ours.meshes, told["states"])):
            self.remarks.setdefault(STALE, self.number)
        self.steps += not self.problem

    def differs(self, text, function):
        """Records the first difference, and the place of the function."""
        place = short(str(self._places.get(function) or ""), limit=80)
        isNew = place.partition(":")[0] not in text  # an exception names its own place
        text = f"step {self.number}: {function}: {text}" + f"; {place}" * bool(place and isNew)
        self.problem = self.problem or text

    def _copies(self, start):
        """Our meshes and ground in a state, once more."""
        meshes = SceneSimulation(self.ours.source).meshes
        take_inertia(meshes, self._found)
        for mesh, rows in zip(meshes, start, strict=True):
            for name, row in zip(STATE_WIDTHS, rows, strict=False):
                setattr(mesh, name, np.array(row))
        return [*meshes, RBSFunctions.ground()]

    def _run(self, meshes, functions, **options):
        settings = self.ours.settings
        step = settings.timeStep, settings.restitution, True, self.ours.constraints
        given = self._usual | {"functions": functions} | options
        with np.errstate(all="ignore"):
            RBSFunctions.run_timestep(meshes[:-1], meshes[-1], *step, **given)

    def _explain(self, start, told, events):
        """Tells where our step by the student's functions first leaves ours."""
        meshes, theirs, names = self._copies(start), [], self.ours.meshes
        calls, wrong = Calls(self._ask, meshes), None
        try:
            self._run(meshes, calls, observer=theirs.append)
            calls.fixed_bodies()
        except Wrong as found:
            wrong = found
        except (ArithmeticError, ValueError, TypeError) as error:  # of numbers that are not finite
            wrong = Wrong(short(str(error), limit=CAUSE_LENGTH), "run_timestep")
        difference = first_difference(events[: len(theirs)] if wrong else events, theirs, names)
        if difference is None and wrong:
            return self.differs(str(wrong), wrong.function)
        if difference is None:
            if told["problem"]:
                text = short(told["problem"], limit=CAUSE_LENGTH)
                self.problem = f"step {self.number} cannot be made: run_timestep: {text}"
            elif told["changed"]:
                text = f"{changed_by(told, names)}; the functions do not"
                self.differs(text, "run_timestep")
            elif calls.stale:
                mesh, function = next(iter(calls.stale.items()))
                self.differs(f"currVertices of {mesh} are out of date", function)
            elif not self._is_tie(events):
                found = self._gap(self.ours.meshes, told, isTold=True)
                self.differs(f"{found} at the end of the step; the functions agree", "run_timestep")
            return None
        own, other, symbols = difference[:3]
        if symbols:
            self.terms = [heading(own, names), *term_lines(own, other)]
            hint = mistake_in(other, theirs)
            self.terms += [f"hint: {hint}"] * bool(hint)
            text = f"{heading(own, names)} differs in {', '.join(symbols)}"
            return self.differs(text, self._by(own, symbols))
        one = next(one for one in (own, other) if one)
        if one.kind == Kind.CONTACT and GROUND not in one.bodies:
            pair = ", ".join(names[k].name for k in one.bodies)
            isOurs = one is own
            text = f"isCollision of {pair} is {not isOurs}, not {isOurs}"
            if not self._is_tie([one]):
                self.differs(text, "detect_collision")
            return None
        return self.differs(difference.lines(names)[0], "run_timestep")

    def _by(self, event, wrong):
        """The function that has computed these symbols of an event."""
        if event.kind == Kind.CONSTRAINT and OF_POSITIONS & set(wrong):
            return POSITION
        if event.kind in (Kind.IMPULSE, Kind.CONSTRAINT) and set(event.bodies) & set(self._turned):
            return "get_rotated_inv_IT"
        return COMPUTED_BY.get(event.kind, VELOCITY)

    def _is_tie(self, events):
        """Whether rounding has decided about a touch of no depth, which is nobody's mistake."""
        depths = [one.given["depth"] for one in events if one.kind == Kind.CONTACT]
        length = max(1.0, *(np.abs(mesh.currVertices).max() for mesh in self.ours.meshes))
        isTie = min(depths, default=math.inf) <= TOLERANCE * length and self._ties < MOST_TIES
        self._ties += isTie
        return isTie

    def _is_released(self, start, told):
        """Whether slips of the released run_timestep lead to their states (quirks 4 and 5), and
        their function returned what ours returns.
        """
        for slips in ((LOSES,), (EARLY,), (LOSES, EARLY)):
            meshes, calls, found = self._copies(start), [], []
            self._released_step(meshes, slips, calls, found)
            if self._gap(meshes[:-1], told) <= TOLERANCE:
                answers = self._ask({"calls": calls})["calls"] if calls else []
                theirs = [one["result"] or [None] for one in answers]
                if not all(map(same_numbers, found, theirs)):
                    return False
                for text in slips:
                    self.remarks.setdefault(text, self.number)
                return True
        return False

    def _released_step(self, meshes, slips, calls, found):
        """Makes our step with slips of the released run_timestep; lists the calls of the function
        for velocities, and what ours returns.
        """
        edited, options = dict(vars(RBSFunctions)), {}

        def lossy(positions, points, linVelocities, *others):
            right = RBSFunctions.resolve_velocity_constraint
            calls.append([VELOCITY, [], [], as_list((positions, points, linVelocities, *others))])
            wasValid, (first, second), spins = right(positions, points, linVelocities, *others)
            found.append((wasValid, (first, second), spins))
            return wasValid, (first, linVelocities[1] if LOSES in slips else second), spins

        edited["resolve_velocity_constraint"] = lossy
        if EARLY in slips:
            count = max(1, len(self.ours.constraints))
            options["maxIterations"] = math.ceil(self._usual["maxIterations"] / count)
        self._run(meshes, SimpleNamespace(**edited), **options)

    def _gap(self, meshes, told, isTold=False):
        """The largest difference of our states and those of an answer, or the first as text."""
        rows, names = [row[:-1] for row in told["states"]], [mesh.name for mesh in meshes]
        gaps = list(state_gaps(meshes, rows, names))
        if not isTold:
            return max(found.gap for found in gaps)
        return next(found for found in gaps if found.gap > TOLERANCE).told()


def same_numbers(ours, theirs):
    """Whether what two calls of the function for velocities return are the same."""
    return all(gap(one, other) <= TOLERANCE for one, other in zip(ours, theirs, strict=False))


def turned(mesh):
    """The inverse inertia tensor of our mesh in world axes, in the pose that workers tell."""
    before, mesh.orientation = mesh.orientation, TURN.copy()
    tensor, mesh.orientation = mesh.get_rotated_inv_IT(), before
    return tensor
