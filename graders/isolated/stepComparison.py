"""Compares a student's steps with ours; `compare` runs this script within limits.

Each of the student's steps begins with our state. Each call of a function that the coursework asks
for is repeated with ours, on the same input. If all calls agree but the step does not, the step is
repeated in `our_loop`, around the student's functions: the difference is the first call that the
two make in another order, or in another state.
"""

import copy
import faulthandler
import inspect
import itertools
import json
import math
import os
import sys
import time
from functools import partial, wraps
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from reference.graderData import give_up_names
from verdict.bodies import match_inertia

import RBSFunctions
from Quaternion import QRotate
from rbs.glass.beside import repeated_difference
from rbs.program.submissions import SubmissionError, describe
from rbs.program.submittedsteps import SubmittedSteps, our_loop
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.meshes import StateError
from rbs.stepping.settings import GRAVITY, Settings

# The difference, relative to its scale, above which a number counts as another one. The scale is
# the largest length, speed or angular speed in the scene, or the number's own size. Rounding in a
# call stays below 1e-13, and mistakes are seldom below 1e-5. Below this depth, relative to the
# length, rounding decides whether bodies touch.
TOLERANCE = 1e-9
# Quantities of a new mesh, of a state, and of results, each with its scale.
BUILT = {"origVertices": "own", "invMass": "own", "invIT": "own"}
STATE = {"position": "length", "orientation": "own", "linVelocity": "speed", "angVelocity": "spin"}
STATES = (*STATE, "currVertices")  # the last of which the released ground lacks
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
TURN = np.array([[0.5, 0.1, -0.7, 0.5]])
RELEASED = "as in the coursework's released run_timestep; not counted as a difference"
END = "the end of the step"


class Comparison:
    """Steps of a scene by our functions and by a student's, from the same states.

    folder : of the student's modules; ours : SceneSimulation

    problem : the first difference, or ""
    terms : lines of `first_difference` in the step that differs, with all terms of our formula
    largest : the largest relative difference of numbers that agree
    remarks : dict from text to the first step that it is true of
    """

    def __init__(self, folder, ours):
        self.problem, self.remarks, self.largest, self.number = "", {}, 0.0, 1
        self.terms = []
        self.ours = ours
        self.driven = SceneSimulation(ours.source)  # the student's functions move its bodies
        self.driven.settings = ours.settings
        self.steps = self.driven.submitted = SubmittedSteps(folder)
        self.runTimestep = self.steps.run_timestep
        self.ourLoop = partial(our_loop, self.steps.functions)
        self.shadows = [*SceneSimulation(ours.source).meshes, self.driven.groundMesh]
        self.remarks |= dict.fromkeys(self.steps.remarks, 0)
        meshes, ground = self.steps.follow(ours.meshes, ours.source)
        self.theirs = [*meshes, ground]
        self.index = {id(mesh): k for k, mesh in enumerate(self.theirs)}
        self.set_scales()
        for mesh, shadow in zip(meshes, self.shadows, strict=False):
            # in a turned pose, which tells R from its transpose
            before, mesh.orientation = mesh.orientation, TURN.copy()
            self.remarks |= dict.fromkeys(match_inertia(mesh, shadow.IT), 0)
            mesh.orientation = before
            pair = [[getattr(one, name, None) for name in BUILT] for one in (shadow, mesh)]
            self.compare(f"Mesh: {{}} of {shadow.name}", BUILT, *pair, type(mesh).__init__)
        for owner, own in ((type(ground), RBSFunctions.Mesh), (self.steps.functions, RBSFunctions)):
            for name in RETURNED:
                if name in vars(own) and hasattr(owner, name):
                    setattr(owner, name, self.watched(getattr(owner, name), vars(own)[name]))

    def step(self):
        """Steps both simulations; sets `problem` at the first difference."""
        self.set_scales()
        self.number, start = self.ours.stepCount + 1, self.ours.state()
        try:
            events, visits = self.run(start, self.runTimestep)
            theirs = self.driven.state().values()
            self.ours.step()
            rows = zip(self.ours.state().values(), theirs, STATE.values(), strict=True)
            gap = max(self.gap(*row) for row in rows)
            if gap <= TOLERANCE:
                self.largest = max(self.largest, gap)
            elif not self.problem:
                self.explain(events, visits, self.run(start, self.ourLoop, False)[0])
            if self.stale(events[-1][2]):
                self.remark("currVertices, which are drawn, are out of date at the end of a step")
            if self.problem:  # from now on, calls are no longer compared
                with self.ours.undone():
                    self.terms = repeated_difference(self.ours, self.driven, start, showsAll=True)
        except StateError as error:
            self.problem = self.problem or str(error)

    def remark(self, text):
        self.remarks.setdefault(text, self.number)

    def run(self, start, loop, isChecked=True):
        """Makes a step of the student's meshes from a state; returns `(events, visits)`.

        isChecked : whether each call is compared with ours
        events : (label, bodies, all states before it, depth) of each call that moves bodies, and of
            the end; visits : whether each visited constraint was valid
        """
        self.events, self.visits, self.isChecked = [], [], isChecked
        self.steps.run_timestep, self.driven.stepCount = loop, self.number - 1
        self.driven.set_state(start)
        self.driven.step()
        return [*self.events, (END, [], self.states(), math.inf)], self.visits

    def explain(self, events, visits, loopEvents):
        """Finds where the student's run_timestep differs from ours, unless rounding decided."""
        count = max(1, len(self.ours.constraints))
        most = math.ceil(self.ours.max_iterations() / count)
        isEarly = len(visits) == most < self.ours.report.constraintVisits  # quirk 5
        stopsEarly = isEarly and not all(visits[-count:])
        if stopsEarly:
            self.remark(f"run_timestep ends after {most} visits of constraints, {RELEASED}")
        last = "the start of the step", [], events[0][2]
        for event, other in zip(events, loopEvents, strict=False):
            for k, name in itertools.product(range(len(self.ours.meshes)), STATE):
                before, ours, theirs = (one[2][k][name] for one in (last, other, event))
                if self.gap(ours, theirs, STATE[name]) > TOLERANCE:
                    isUnchanged = np.array_equal(before, theirs)
                    if name == "linVelocity" and last[1][1:] == [k] and isUnchanged:  # quirk 4
                        self.remark(f"run_timestep loses a corrected linVelocity, {RELEASED}")
                    else:
                        text = f"run_timestep: after {last[0]}, {name} of {self.shadows[k].name} "
                        text += f"differs{shown(ours, theirs)}{self.stale(last[2])}"
                        self.differs(text, self.runTimestep)
                    return
            if event[0] != other[0]:
                isTie = min(event[3], other[3]) <= TOLERANCE * self.scales["length"]
                if not isTie and not (stopsEarly and event[0] == END):
                    text = f"run_timestep: after {last[0]} comes {event[0]}, in ours {other[0]}"
                    self.differs(text + self.stale(event[2]), self.runTimestep)
                return
            last = event

    def states(self, bodies=None):
        """The states of the student's meshes, or of some: a dict from number to dict of arrays."""
        return {
            k: {name: np.array(getattr(mesh, name)) for name in STATES if hasattr(mesh, name)}
            for k, mesh in enumerate(self.theirs)
            if bodies is None or k in bodies
        }

    def watched(self, function, own):
        """Wraps a function: calls are repeated with our own, and recorded if they move bodies."""
        name, parameters = own.__name__, list(inspect.signature(own).parameters)
        isMove = not RETURNED[name]
        isPosition = name == "resolve_position_constraint"

        @wraps(function)
        def call(*given, **options):
            given += tuple(options.values())
            if self.problem:
                return function(*given)
            bodies = [self.index[id(one)] for one in given if id(one) in self.index]
            if not bodies:  # constraints receive positions, which tell the bodies
                COMs = np.array([mesh.position.ravel() for mesh in self.theirs[:-1]])
                bodies = [int(abs(COMs - one).sum(axis=1).argmin()) for one in given[0]]
            shadows = [self.shadows[k] for k in bodies]
            states = self.states(None if isMove else bodies)
            label = f"{name}({', '.join(mesh.name for mesh in shadows)})"
            isFree = not all(mesh.isFixed for mesh in shadows)
            kept = self.index if self.isChecked else set(map(id, given))
            copies = [one if id(one) in kept else copy.deepcopy(one) for one in given]
            result = function(*given)
            if result is None and len(RETURNED[name]) > 1:
                self.differs(f"{label}: returns nothing", function)
                return result
            if isPosition:
                self.visits.append(bool(result[0]))
            if isFree and (isMove or isPosition and not result[0]):
                depth = abs(np.ravel(given[2])[0]) if name == "resolve_collision" else math.inf
                self.events.append((label, bodies, states if isMove else self.states(), depth))
            if not self.isChecked or self.problem or not isFree and name == "detect_collision":
                return result
            for mesh, k in zip(shadows, bodies, strict=True):
                for one in STATE:
                    setattr(mesh, one, states[k][one].reshape(1, -1))
            known = [self.index.get(id(one)) for one in copies]
            pairs = zip(known, copies, strict=True)
            ours = own(*(one if k is None else self.shadows[k] for k, one in pairs))
            for mesh, k in zip(shadows, bodies if isMove else (), strict=False):
                pair = ([getattr(one, what) for what in STATE] for one in (mesh, self.theirs[k]))
                self.compare(f"{label}: {{}} of {mesh.name}", STATE, *pair, function)
            pair = (ours, result) if len(RETURNED[name]) > 1 else ((ours,), (result,))
            self.compare(f"{label}: {{}}", RETURNED[name], *pair, function)
            if name == "detect_collision":
                self.problem += self.problem and self.stale(states)
            for what, value, before in zip(parameters, given, copies, strict=False):
                if what.startswith("curr") and not np.array_equal(value, before):
                    self.differs(f"{label}: changes its argument {what} in place", function)
            return result

        return call

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
            elif bool(own) != bool(other):
                depth = (ours if own else theirs)[1] if name == "isCollision" else math.inf
                if np.ravel(depth)[0] > TOLERANCE * self.scales["length"]:
                    self.differs(f"{what.format(name)} is {bool(other)}, not {own}", function)
                return
            elif name == "isCollision" and not own:
                return

    def differs(self, text, function):
        """Records the first difference, and the place of the function."""
        code = inspect.unwrap(function).__code__
        place = f"{Path(code.co_filename).name}:{code.co_firstlineno}"
        self.problem = self.problem or f"step {self.number}: {text}; {place}"

    def stale(self, states):
        """Names the meshes whose currVertices do not fit position and orientation; "" if none."""
        names = []
        for k, state in states.items():
            if k == len(self.theirs) - 1:  # the ground
                continue
            shadow = self.shadows[k]
            vertices = QRotate(state["orientation"].reshape(1, 4), shadow.origVertices)
            vertices = vertices + state["position"].reshape(1, 3)
            if self.gap(vertices, state["currVertices"], "length") > TOLERANCE:
                names.append(shadow.name)
        return f"; currVertices of {', '.join(names)} are out of date" if names else ""


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


def main():
    """Compares as the order in JSON says, and writes the answer after each step."""
    order = json.loads(sys.argv[1])
    trace = open(order["trace"], "w")  # stays open as long as the process lives
    faulthandler.dump_traceback_later(order["seconds"], file=trace, exit=True)
    answer = {"steps": 0, "problem": "", "remarks": [], "largest": 0.0}
    give_up_names()
    settings = Settings(timeStep=order["timeStep"], restitution=order["restitution"])
    ours = SceneSimulation(order["scene"], settings, order["constraints"])
    try:
        comparison = Comparison(Path.cwd(), ours)
        while not comparison.problem and ours.stepCount < order["steps"]:
            if ours.stepCount > 0 and time.time() > order["end"]:
                break
            comparison.step()
            answer |= {"steps": ours.stepCount, "problem": comparison.problem}
            answer["terms"] = comparison.terms
            answer["remarks"] = [
                f"from step {k} on: {one}" * (k > 0) or one for one, k in comparison.remarks.items()
            ]
            answer["largest"] = float(comparison.largest)
            Path(order["answer"]).write_text(json.dumps(answer), encoding="utf-8")
    except Exception as error:
        isOwn = isinstance(error, SubmissionError)
        answer["problem"] = str(error) if isOwn else describe(error, Path.cwd())
    Path(order["answer"]).write_text(json.dumps(answer), encoding="utf-8")
    os._exit(0)  # skips exit handlers and threads of the submission


if __name__ == "__main__":
    main()
