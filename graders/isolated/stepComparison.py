"""Compares a student's steps with ours.

Each of the student's steps begins with our state, and is made in a process of its own. If the state
after it is not ours, our step is made once more with the student's functions, each called in that
process. The events of the two are compared, as the window and --trace do. Where they agree, the
difference is that of run_timestep.
"""

import copy
import math
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
from verdict.gradeReport import INERTIA_REMARKS
from worker.steps import BUILT, as_list

import RBSFunctions
from Quaternion import QRotate
from rbs.glass.events import Kind
from rbs.glass.mistakes import MADE_BY, mistake_in
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
from rbs.program.submissions import CAUSE_LENGTH, DETECT, FUNCTIONS, TENSOR, VELOCITY
from rbs.program.submittedsteps import Fault, StudentFunctions, state_left
from rbs.scenes.messages import short
from rbs.scenes.scenefiles import scene_rows
from rbs.scenes.simulation import TURNED_BACK, turned_back, turned_tensor
from rbs.stepping.meshes import STATE_WIDTHS
from rbs.stepping.reports import GROUND
from rbs.stepping.settings import CONSTRAINT_TOLERANCE

# What is told of a mesh; no step changes the first three.
TOLD = "isFixed", "invMass", "invIT", *STATE_WIDTHS, "currVertices"
SMALL = f"{INERTIA_REMARKS[False, 0]}; allowed for"
RELEASED = "as in the coursework's released run_timestep; not counted as a difference"
LOSES = f"run_timestep loses a corrected linVelocity, {RELEASED}"
EARLY = f"run_timestep ends before the constraints hold, {RELEASED}"
STALE = "currVertices, which are drawn, are out of date at the end of a step"
# Steps in which a touch of no depth may be decided otherwise: more are no coincidence.
MOST_TIES = 3
# Symbols of a constraint that the first of its functions computes.
OF_POSITIONS = {"C", "result", "COM1′", "COM2′"}
UP = (0.0, 1.0, 0.0)


def states_of(meshes):
    return [[np.array(getattr(mesh, name)).tolist() for name in TOLD] for mesh in meshes]


def gaps_of(meshes, rows):
    """Yields the differences of our meshes, a `StateGap` each, from rows of what is told."""
    names = [mesh.name if len(mesh.faces) else "the ground" for mesh in meshes]
    return state_gaps(meshes, [row[:-1] for row in rows], names, TOLD[:-1])


class IsolatedFunctions(StudentFunctions):
    """A student's functions, each called in the process of a submission.

    ask : see `Comparison.build`; meshes : of ours, the last of them the ground
    stale : dict from the meshes whose currVertices a call has left out of date to its function
    """

    def __init__(self, ask, meshes):
        super().__init__()
        self._ask, self._meshes, self.stale = ask, meshes, {}

    def call(self, name, meshes, *given):
        bodies = [k for one in meshes for k, mesh in enumerate(self._meshes) if mesh is one]
        order = {"function": name, "meshes": bodies, "states": states_of(meshes), "options": {}}
        told = self._ask(order | {"given": [as_list(one) for one in given]})
        if told["problem"]:
            raise Fault(name, short(told["problem"], limit=CAUSE_LENGTH))
        if told["hasLists"]:
            raise Fault(name, "leaves a list in place of an array")
        for mesh, rows in zip(meshes, told["states"], strict=True):
            for found in gaps_of([mesh], [rows]):
                isState = found.name in STATE_WIDTHS
                if isState and not mesh.isFixed:
                    setattr(mesh, found.name, state_left(name, mesh, found.name, found.theirs))
                elif found.gap > TOLERANCE:
                    what = "is fixed" if isState else "no call may change"
                    raise Fault(name, found.told(f", which {what},"))
            if name in ("integrate_timestep", "resolve_collision") and is_stale(mesh, rows):
                self.stale.setdefault(mesh.name, name)
        return told["result"]

    def step(self, meshes, groundMesh, **options):
        """`run_timestep` by their functions. Then resolves the contacts of fixed bodies with the
        ground, as the released one does.
        """
        self.stale = {}
        with self.methods_of(self._meshes):
            RBSFunctions.run_timestep(meshes, groundMesh, functions=self, **options)
        for mesh in filter(lambda one: one.isFixed, meshes):
            lowest = mesh.currVertices[np.argmin(mesh.currVertices[:, 1])]
            if lowest[1] <= 0.0:
                self.resolve_collision(mesh, groundMesh, lowest[1], UP, lowest, 0.0)


def is_stale(mesh, rows):
    """Whether currVertices do not fit position and orientation, in rows of TOLD."""
    told = dict(zip(TOLD, rows, strict=True))
    with suppress(ValueError, TypeError):  # odd numbers
        turn = np.array(told["orientation"], float).reshape(1, 4)
        now = QRotate(turn, mesh.origVertices) + np.ravel(np.array(told["position"], float))
        return bool(now.size) and gap(now, told["currVertices"]) > TOLERANCE
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
        self.ours, self.asked, self._options, self.steps = ours, asked, options or {}, 0
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
        self._ask, ours, bodies = ask, self.ours, []
        rows = scene_rows(ours.source.path, ours.source.scene)
        for (name, density, _isFixed, *pose), mesh in zip(rows, ours.meshes, strict=True):
            shape = [table.tolist() for table in ours.source.shapes[name]]
            bodies.append([name, *shape, density, *(one.tolist() for one in pose), mesh.isFixed])
        built = ask({"bodies": bodies, "names": TOLD})
        self._places, known = built["places"], built["parameters"]
        if lacking := [name for name in self._options if name not in known]:
            text = f"run_timestep has no parameter {lacking[0]}, only {', '.join(known)}"
            self.problem = f"step 1: {short(text, limit=CAUSE_LENGTH)}"
        iterations = ours.settings.max_iterations(len(ours.constraints))
        usual = {"maxIterations": iterations, "tolerance": CONSTRAINT_TOLERANCE}
        self._options = {k: one for k, one in usual.items() if k in known} | self._options
        self._take_inertia([one["invIT"] for one in built["meshes"]])
        for mesh, told in zip(ours.meshes, built["meshes"], strict=True):
            for name in BUILT:
                own = getattr(mesh, name)
                if not same(told[name], own):
                    self.differs(f"{name} of {mesh.name}{both(own, told[name])}", "Mesh")

    def _take_inertia(self, inverses):
        """Gives our meshes the skeleton's inertia if a student's have it.

        The skeleton's tensor is six times too small, which is not the student's work. To turn it to
        world axes is; with this tensor, the way of the release's solution is accepted, too.

        inverses : invIT of the student's meshes
        """
        ours = self.ours
        free = [mesh for mesh in zip(ours.meshes, inverses, strict=True) if not mesh[0].isFixed]
        small = [one for one, inverse in free if same(inverse, INERTIA_DIVISOR * one.invIT)]
        for mesh in small:
            mesh.IT, mesh.invIT = mesh.IT / INERTIA_DIVISOR, mesh.invIT * INERTIA_DIVISOR
        again = self._again = copy.copy(ours)
        self._theirs = IsolatedFunctions(self._ask, [*again.meshes, again.groundMesh])
        self.remarks |= dict.fromkeys([SMALL] if small else [], 0)
        with suppress(Fault):
            if small and self._theirs.is_turned_back(again.meshes):
                self.remarks[TURNED_BACK] = 0
                for mesh in (*ours.meshes, *again.meshes):
                    mesh.__class__ = turned_back(type(mesh))

    def step(self):
        """Makes the same step twice; sets `problem` at the first difference."""
        ours, settings, events = self.ours, self.ours.settings, []
        meshes, rows = [*ours.meshes, ours.groundMesh], [list(one) for one in ours.constraints]
        self._start, self.number = ours.state(), ours.stepCount + 1
        order = {"function": "run_timestep", "meshes": [*range(len(meshes))]}
        order |= {"states": states_of(meshes), "options": self._options}
        step = settings.timeStep, settings.restitution, True, rows
        told = self._ask(order | {"given": step})
        ours.advance(events.append)
        found = math.inf if told["problem"] else self._gap(ours, told)
        if found <= TOLERANCE:
            self.largest = max(self.largest, found)
        elif told["problem"] or not self._is_released(told):
            self._explain(told, events)
        if not self.problem and any(map(is_stale, ours.meshes, told["states"])):
            self.remarks.setdefault(STALE, self.number)
        self.steps += not self.problem

    def differs(self, text, function):
        """Records the first difference, and the place of the function."""
        place = short(str(self._places.get(function) or ""), limit=80)
        isNew = place.partition(":")[0] not in text  # an exception names its own place
        text = f"step {self.number}: {function}: {text}" + f"; {place}" * bool(place and isNew)
        self.problem = self.problem or text

    def _make_again(self, step, **options):
        """Makes our step once more, by a function in place of run_timestep."""
        self._again.set_state(self._start)
        scene = {"constraints": self.ours.constraints, "settings": self.ours.settings}
        with np.errstate(all="ignore"):
            step(self._again.meshes, self._again.groundMesh, **scene, **options)

    def _explain(self, told, events):
        """Tells where our step by the student's functions first leaves ours."""
        try:
            found = self._difference(told, events)
        except Fault as fault:
            found = fault.text, fault.function
        if found is not None:
            self.differs(*found)

    def _difference(self, told, events):
        """What differs, as text, and the function that it is computed by; None if it is a tie."""
        theirs, names, fault = [], self.ours.meshes, None
        try:
            self._make_again(self._theirs.step, observer=theirs.append)
        except (ArithmeticError, ValueError, TypeError) as error:  # also of numbers not finite
            fault = error
        found = first_difference(events[: len(theirs)] if fault else events, theirs, names)
        if found is None:
            if isinstance(fault, Fault):
                raise fault
            if problem := str(fault or "") or told["problem"]:
                return short(problem, limit=CAUSE_LENGTH), "run_timestep"
            if self._theirs.stale:
                mesh, function = next(iter(self._theirs.stale.items()))
                return f"currVertices of {mesh} are out of date", function
            if self._is_tie(events):
                return None
            gaps = gaps_of(names, told["states"][:-1])
            found = next(one for one in gaps if one.gap > TOLERANCE)
            return f"{found.told()} at the end of the step; the functions agree", "run_timestep"
        own, other, symbols = found[:3]
        if symbols:
            self.terms = [heading(own, names), *term_lines(own, other)]
            hint = mistake_in(other, theirs)
            self.terms += [f"hint: {hint}"] * bool(hint)
            text = f"{heading(own, names)} differs in {', '.join(symbols)}"
            return text, self._by(own, symbols)
        one = own or other
        if one.kind == Kind.CONTACT and GROUND not in one.bodies:
            pair = ", ".join(names[k].name for k in one.bodies)
            text = f"isCollision of {pair} is {one is not own}, not {one is own}"
            return None if self._is_tie([one]) else (text, DETECT)
        return found.lines(names)[0], "run_timestep"

    def _by(self, event, wrong):
        """The function that has computed these symbols of an event."""
        functions = list(MADE_BY.get(event.kind, [DETECT]))
        if event.kind == Kind.CONSTRAINT and OF_POSITIONS & set(wrong):
            return functions[0]
        isOfTensors = event.kind in (Kind.IMPULSE, Kind.CONSTRAINT)
        if isOfTensors and not all(map(self._is_turned, event.bodies)):
            return TENSOR
        return functions[-1]

    def _is_turned(self, body):
        """Whether the student's tensor of a body, in world axes, is ours. Raises Fault."""
        if body == GROUND:
            return True
        mesh = self._again.meshes[body]
        right = turned_tensor(mesh)
        with self._theirs.methods_of([mesh]):
            return same(turned_tensor(mesh), right)

    def _is_tie(self, events):
        """Whether rounding has decided about a touch of no depth, which is nobody's mistake."""
        depths = [one.given["depth"] for one in events if one.kind == Kind.CONTACT]
        length = max(1.0, *(np.abs(mesh.currVertices).max() for mesh in self.ours.meshes))
        isTie = min(depths, default=math.inf) <= TOLERANCE * length and self._ties < MOST_TIES
        self._ties += isTie
        return isTie

    def _is_released(self, told):
        """Whether slips of the released run_timestep lead to their states (quirks 4 and 5), and
        their function returned what ours returns.
        """
        for slips in ((LOSES,), (EARLY,), (LOSES, EARLY)):
            calls = self._released_step(slips)
            if self._gap(self._again, told) <= TOLERANCE:
                isReleased = all(self._agrees(*one) for one in calls)
                for text in slips if isReleased else ():
                    self.remarks.setdefault(text, self.number)
                return isReleased
        return False

    def _released_step(self, slips):
        """Makes our step with slips of the released run_timestep; returns the calls of the function
        for velocities: what it is given, and what ours returns.
        """
        edited, options, calls = {k: getattr(RBSFunctions, k) for k in FUNCTIONS}, {}, []

        def lossy(*given):
            wasValid, (first, second), spins = RBSFunctions.resolve_velocity_constraint(*given)
            calls.append((given, (wasValid, (first, second), spins)))
            return wasValid, (first, given[2][1] if LOSES in slips else second), spins

        edited[VELOCITY] = lossy
        if EARLY in slips:
            count = len(self.ours.constraints)
            most = self.ours.settings.max_iterations(count)
            options["maxIterations"] = math.ceil(most / max(1, count))
        self._make_again(RBSFunctions.run_timestep, functions=SimpleNamespace(**edited), **options)
        return calls

    def _agrees(self, given, ours):
        """Whether a call of the student's function for velocities returns what ours returns."""
        with suppress(Fault):
            theirs = self._theirs.resolve_velocity_constraint(*given)
            return all(gap(*both) <= TOLERANCE for both in zip(ours, theirs, strict=True))
        return False

    def _gap(self, simulation, told):
        return max(found.gap for found in gaps_of(simulation.meshes, told["states"][:-1]))
