"""A student's steps beside ours: the process that `compare` runs within limits, not by hand.

Each step of the student's begins with our state. Every call in it of a function that the coursework
asks for is made by ours too, on the same input. Where all calls agree and the step does not, it is
made again by `basic_step`, our loop around the student's functions: the first call that the two
make in another order, or in another state, is what differs.
"""

import copy
import inspect
import itertools
import json
import math
import os
import sys
from functools import partial, wraps
from pathlib import Path

import gradingTools  # noqa: F401  puts the project on the path
import numpy as np
from released.physics2024 import INERTIA_FACTOR

import RBSFunctions
from Quaternion import QRotate
from rbs.bodies import StateError
from rbs.settings import Settings
from rbs.simulation import Simulation
from rbs.submissions import describe
from rbs.submittedsteps import SubmittedSteps, basic_step

# A number differs where it is further from ours than this part of its scale, the largest length,
# speed or angular speed in the scene. The roundings of a call stay below 1e-13, and mistakes are
# seldom below 1e-5. Of depths below it, rounding decides whether bodies touch: a tie.
TOLERANCE = 1e-9
# The quantities of a new mesh, of a state, and that functions return, each with its kind of scale.
BUILT = {"origVertices": "length", "invMass": "own", "invIT": "own"}
STATE = {"position": "length", "orientation": "unit", "linVelocity": "speed", "angVelocity": "spin"}
COLUMNS = {
    "position": slice(0, 3), "orientation": slice(3, 7), "linVelocity": slice(7, 10),
    "angVelocity": slice(10, 13),
}  # fmt: skip
RETURNED = {
    "bounding_box_collision": {"the answer": "bool"}, "get_rotated_inv_IT": {"the tensor": "own"},
    "detect_collision": {
        "isCollision": "bool", "depth": "length", "intNormal": "unit", "intPosition": "length",
    },
    "resolve_position_constraint": {"positionWasValid": "bool", "correctedPositions": "length"},
    "resolve_velocity_constraint": {
        "velocityWasValid": "bool", "correctedLinVelocities": "speed",
        "correctedAngVelocities": "spin",
    },
}  # fmt: skip
CHANGING = ("integrate_timestep", "resolve_collision")
END = "the end of the step"
RELEASED = ", as in the coursework's released run_timestep: not counted as a difference"


class Comparison:
    """Steps of a scene by our functions and by those of a folder, from the same states.

    problem : the first difference, or ""; remarks : what else there is to say
    largest : difference of numbers that agree, relative to their scales
    """

    def __init__(self, folder, ours):
        self.problem, self.remarks, self.largest = "", [], 0.0
        self.ours, self.driven = ours, Simulation(ours.source)  # the student's functions move these
        self.driven.settings, self.number = ours.settings, 1
        self.steps = self.driven.submitted = SubmittedSteps(folder)
        self.loops = self.steps.run_timestep, partial(basic_step, self.steps.functions)
        self.shadows = [*Simulation(ours.source).meshes, ours.groundMesh]
        self.names = [*(mesh.name for mesh in ours.meshes), "the ground"]
        meshes, ground = self.steps.follow(ours.meshes, ours.source)
        self.theirs = [*meshes, ground]
        self.index = {id(mesh): k for k, mesh in enumerate(self.theirs)}
        self.set_scales()
        for mesh, shadow in zip(meshes, self.shadows, strict=False):
            self.check_built(mesh, shadow)
        for owner, own in ((type(ground), RBSFunctions.Mesh), (self.steps.functions, RBSFunctions)):
            for name in (*CHANGING, *RETURNED):
                if name in vars(own) and hasattr(owner, name):
                    setattr(owner, name, self.watched(name, getattr(owner, name), vars(own)[name]))

    def check_built(self, mesh, shadow):
        """Compares a new mesh with ours; the release's inertia tensor is replaced by ours."""
        released = shadow.invIT / INERTIA_FACTOR
        if released.any() and self.gap("own", released, getattr(mesh, "invIT", None)) <= TOLERANCE:
            mesh.IT, mesh.invIT = shadow.IT.copy(), shadow.invIT.copy()
            self.remark("the release's inertia tensor, six times too small, is replaced by ours")
        for name, kind in BUILT.items():
            ours, theirs = getattr(shadow, name), getattr(mesh, name, None)
            self.compare(f"Mesh: {name} of {shadow.name}", kind, ours, theirs, mesh.__init__)

    # ---- Steps ----------------------------------------------------------------------------------

    def step(self):
        """A step of both; sets `problem` at the first difference."""
        self.set_scales()
        self.number, start = self.ours.stepCount + 1, self.ours.state()
        try:
            events, visits = self.run(start, self.loops[0])
            ends = self.driven.state()
            self.ours.step()
            ours = self.ours.state()
            gaps = [self.gap(kind, ours[name], ends[name]) for name, kind in
                    zip(ours, STATE.values(), strict=True)]  # fmt: skip
            if max(gaps) <= TOLERANCE:
                self.largest = max(self.largest, *gaps)
                if stale := self.stale(*events[-1][2:4]):
                    self.remark(f"after the step,{stale}: pictures are drawn with them")
            elif not self.problem:
                self.explain(events, visits, *self.run(start, self.loops[1]))
        except StateError as error:
            self.problem = self.problem or str(error)

    def run(self, start, loop):
        """Makes a step of the student's from a state; returns `(events, visits)`.

        events : each call that moves bodies, (label, their indices, states and vertices of all
            bodies before it, depth), and at last the end; visits : whether constraints were valid
        """
        self.driven.set_state(start)
        self.steps.run_timestep, self.events, self.visits = loop, [], []
        self.driven.stepCount = self.number - 1
        self.driven.step()
        self.note(END, [])
        return self.events, self.visits

    def note(self, label, bodies, depth=math.inf):
        """Adds an event."""
        vertices = [mesh.currVertices for mesh in self.theirs[:-1]]
        states = self.states(range(len(vertices)))
        self.events.append((label, bodies, states, vertices, depth))

    def explain(self, events, visits, loopEvents, loopVisits):
        """Says what the student's run_timestep does otherwise than our loop, if it does."""
        count = len(self.ours.constraints)
        stopsEarly = (
            count > 0
            and len(visits) == math.ceil(self.ours.max_iterations() / count) < len(loopVisits)
            and not (len(visits) >= count and all(visits[-count:]))
        )
        if stopsEarly:
            self.remark(f"the visits of constraints end after {len(visits)}{RELEASED}")
        for k, (event, other) in enumerate(zip(events, loopEvents, strict=False)):
            last = events[k - 1] if k else ("the start", [], event[2])
            for b, name in itertools.product(range(len(self.shadows) - 1), STATE):
                states = [one[2][b, COLUMNS[name]] for one in (other, event, last)]
                if self.gap(STATE[name], *states[:2]) > TOLERANCE:
                    isLost = name == "linVelocity" and np.array_equal(*states[1:])
                    what = f"after {last[0]}, {name} of {self.names[b]}"
                    if isLost and last[0].startswith("resolve_pos") and b == last[1][1]:
                        return self.remark(f"{what} is lost{RELEASED}")
                    return self.differs(f"{what} differs{told(*states[:2])}", self.loops[0])
            if event[0] != other[0]:
                isTie = min(event[4], other[4]) <= TOLERANCE * self.scales["length"]
                if not isTie and not (stopsEarly and event[0] == END):
                    stale = self.stale(*event[2:4])
                    text = f"after {last[0]} comes {event[0]}, with ours {other[0]}{stale}"
                    self.differs(text, self.loops[0])
                return None
        return None

    # ---- Calls ----------------------------------------------------------------------------------

    def states(self, bodies):
        """Rows of 13 numbers: position, orientation, linVelocity and angVelocity of each."""
        return np.array([
            np.concatenate([np.ravel(getattr(self.theirs[k], name)) for name in STATE])
            for k in bodies
        ])  # fmt: skip

    def watched(self, name, function, own):
        """The function, each call of which our own makes too, and which is noted if bodies move."""

        @wraps(function)
        def call(*given, **options):
            if self.problem:
                return function(*given, **options)
            given += tuple(options.values())
            pair = [self.index[id(one)] for one in given if id(one) in self.index]
            if not pair:  # constraints are told positions: those of the bodies that are there
                COMs = self.states(range(len(self.theirs) - 1))[:, :3]
                pair = [int(abs(COMs - one).sum(axis=1).argmin()) for one in given[0]]
            label = f"{name}({', '.join(self.names[k] for k in pair)})"
            states = self.states(pair)
            copies = [one if id(one) in self.index else copy.deepcopy(one) for one in given]
            isFree = not all(self.shadows[k].isFixed for k in pair)
            if isFree and name in CHANGING:
                depth = math.inf if name == "integrate_timestep" else abs(np.ravel(given[2])[0])
                self.note(label, pair, depth)
            elif name == "resolve_position_constraint":
                self.note(label, pair)
            result = function(*given)
            if name == "resolve_position_constraint":
                self.visits.append(bool(result[0]))
                if result[0] or not isFree:
                    self.events.pop()
            for k, state in zip(pair, states, strict=True):
                for one, columns in COLUMNS.items():
                    setattr(self.shadows[k], one, state[columns].reshape(1, -1))
            ours = [self.shadows[self.index[id(one)]] if id(one) in self.index else one
                    for one in copies]  # fmt: skip
            if not self.problem and (isFree or name != "detect_collision"):
                self.check(name, label + ": ", function, own, pair, given, copies, ours, result)
            return result

        return call

    def check(self, name, label, function, own, pair, given, copies, ours, theirs):
        """Compares what a call returns and leaves with what ours does."""
        if name in ("resolve_position_constraint", "resolve_velocity_constraint"):
            for one, value, was in zip(inspect.signature(own).parameters, given, copies,
                                       strict=False):  # fmt: skip
                if not np.array_equal(value, was):
                    self.differs(f"{label}changes its argument {one} in place", function)
        if name == "bounding_box_collision":  # a box that is too large does no harm
            isCollision, depth, *_ = ours[0].detect_collision(ours[1])
            if isCollision and not theirs and depth > TOLERANCE * self.scales["length"]:
                stale = self.stale(self.states(pair), [self.theirs[k].currVertices for k in pair])
                self.differs(f"{label}{theirs}, though they overlap{stale}", function)
            return
        mine, kinds = own(*ours), RETURNED.get(name)
        if kinds is None:
            for k, (one, kind) in itertools.product(pair, STATE.items()):
                values = getattr(self.shadows[k], one), getattr(self.theirs[k], one)
                self.compare(f"{label}{one} of {self.names[k]}", kind, *values, function)
            return
        if len(kinds) == 1:
            mine, theirs = (mine,), (theirs,)
        if not isinstance(theirs, (tuple, list)) or len(theirs) != len(kinds):
            self.differs(f"{label}returns {type(theirs).__name__}, not {len(kinds)} values", function)
            return
        for (what, kind), a, b in zip(kinds.items(), mine, theirs, strict=True):
            if kind != "bool":
                self.compare(label + what, kind, a, b, function)
            elif bool(a) != bool(b):
                depth = (mine if a else theirs)[1]
                if name == "detect_collision" and np.ravel(depth)[0] <= TOLERANCE * self.scales["length"]:
                    return
                self.differs(f"{label}{what} is {bool(b)}, not {bool(a)}", function)
            elif name == "detect_collision" and not a:
                return

    # ---- Numbers --------------------------------------------------------------------------------

    def set_scales(self):
        meshes, fall = self.ours.meshes, -RBSFunctions.GRAVITY * self.ours.settings.timeStep
        speed, spin, length = (
            max(np.abs(getattr(mesh, name)).max() for mesh in meshes)
            for name in ("linVelocity", "angVelocity", "currVertices")
        )
        radius = min(np.abs(mesh.origVertices).max() for mesh in meshes)
        speed = max(fall, speed, spin * radius)
        self.scales = {"length": length, "speed": speed, "spin": speed / radius, "unit": 1.0}

    def gap(self, kind, ours, theirs):
        """The largest distance of numbers relative to their scale; infinite for what is none."""
        try:
            ours = np.array(ours, dtype=np.float64)
            theirs = np.array(theirs, dtype=np.float64).reshape(ours.shape)
        except (TypeError, ValueError):
            return math.inf
        if ours.shape[-1:] == (4,) and np.sum(ours * theirs) < 0.0:  # the same rotation
            theirs = -theirs
        distance = np.abs(theirs - ours).max(initial=0.0)
        scale = max(self.scales.get(kind, 0.0), np.abs(ours).max(), sys.float_info.min)
        return math.inf if math.isnan(distance) else distance / scale

    def compare(self, what, kind, ours, theirs, function):
        gap = self.gap(kind, ours, theirs)
        if gap > TOLERANCE:
            self.differs(f"{what} differs{told(ours, theirs)}", function)
        self.largest = max(self.largest, min(gap, TOLERANCE))

    def differs(self, text, function):
        """Notes a difference, and where the function begins, if it is the first one."""
        code = inspect.unwrap(function).__code__
        place = f"{Path(code.co_filename).name}:{code.co_firstlineno}"
        self.problem = self.problem or f"step {self.number}: {text}; {place}"

    def remark(self, text):
        """Notes a remark, the first time, with the step that it is first true of."""
        text = text if self.number == 1 else f"step {self.number}: {text}"
        if not any(one.split(": ")[-1] == text.split(": ")[-1] for one in self.remarks):
            self.remarks.append(text)

    def stale(self, states, vertices):
        """Says whose currVertices are not those of the position and orientation; or ""."""
        for k, (state, own) in enumerate(zip(states, vertices, strict=True)):
            rest = self.shadows[k].origVertices
            right = QRotate(state[None, COLUMNS["orientation"]], rest) + state[COLUMNS["position"]]
            if self.gap("length", right, own) > TOLERANCE:
                return f" currVertices of {self.names[k]} are not those of its position"
        return ""


def told(ours, theirs):
    """By how much numbers differ, and the row of them where they do most."""
    ours = np.atleast_1d(np.array(ours, dtype=np.float64))
    try:
        theirs = np.array(theirs, dtype=np.float64).reshape(ours.shape)
    except (TypeError, ValueError):
        return f": theirs is no array of the shape {ours.shape}"
    distance = np.abs(theirs - ours)
    at = np.unravel_index(np.argmax(distance), ours.shape)  # of a NaN, where there is one
    rows = (np.array2string(one[at[:-1]], precision=4) for one in (ours, theirs))
    return " by {:.1e} (ours {}, theirs {})".format(distance[at], *rows)


def main():
    order = json.loads(sys.argv[1])
    answer = {"step": 0, "problem": "", "remarks": [], "largest": 0.0}

    def tell(**changes):
        answer.update(changes)
        Path(order["answer"]).write_text(json.dumps(answer), encoding="utf-8")

    folder = os.getcwd()
    settings = Settings(timeStep=order["timeStep"], restitution=order["restitution"])
    ours = Simulation(order["scene"], settings, order["constraints"])
    try:
        comparison = Comparison(folder, ours)
    except Exception as error:
        tell(problem=describe(error, folder))
    else:
        while not comparison.problem and ours.stepCount < order["steps"]:
            tell(step=ours.stepCount + 1)
            comparison.step()
        tell(**{name: getattr(comparison, name) for name in ("problem", "remarks", "largest")})
    os._exit(0)  # whatever the submission has registered for the end, or left running


if __name__ == "__main__":
    main()
