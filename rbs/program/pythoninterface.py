"""The Python interface: `Simulation`, with recordings and pictures, for programs and notebooks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from Quaternion import QConj, QRotate
from rbs.geometry.triples import ZERO
from rbs.program.results import Results
from rbs.recordings.recording import Recording
from rbs.recordings.replay import Replay, resume, verify
from rbs.recordings.writers import OUTPUTS
from rbs.scenes.messages import check_kind, counted
from rbs.scenes.scenefiles import SceneSource, find_scene
from rbs.scenes.settingtexts import apply_settings
from rbs.scenes.simulation import SceneSimulation, index_of
from rbs.scenes.state import COLUMNS, rows_of
from rbs.stepping.meshes import checked_count, checked_numbers
from rbs.stepping.settings import Settings
from RBSFunctions import Mesh

if TYPE_CHECKING:
    from typing import Self  # since Python 3.11

# A Mesh of a simulation, or its index.
Body = Mesh | int


class Simulation(Results, SceneSimulation):
    """A scene that is simulated from Python.

    scene : a scene file, or the name of one of our scenes; `from_meshes` takes meshes instead
    settings : by default, those that the scene recommends; given ones replace them all
    constraintPath : by default, the constraint file that belongs to the scene by its name, if any
    recommended : False ignores what the scene recommends

    Attributes: meshes, a new list once bodies were added or removed; constraints, rows [m1, v1, m2,
    v2, refValue, upper]; settings, which may be changed between steps by `settings.change(name,
    value)`; recommended, the recommended settings that are used; stepCount and time in s, since the
    start; report, of the last step, or None.

    Values assigned to a body, such as `mesh.linVelocity`, act from the next step on, and are
    recorded. That step refuses a name that a Mesh does not have, because a check of each assignment
    would slow all steps.

    The methods below take a body as a Mesh of `meshes`, or its index, and act before the next step.
    They raise ValueError if the body is not in the simulation, or a number is wrong.
    """

    def __init__(
        self,
        scene: str | Path,
        settings: Settings | None = None,
        constraintPath: str | Path | None = None,
        recommended: bool = True,
    ) -> None:
        check_kind("settings", settings, Settings | None, "Settings")
        if not isinstance(scene, SceneSource):
            what = "a path or a name (from_meshes takes meshes)"
            check_kind("scene", scene, str | PurePath, what)
            check_kind("constraintPath", constraintPath, str | PurePath | None, "a path")
            scene = SceneSource.of_files(find_scene(scene), constraintPath)
        super().__init__(scene, settings)
        if settings is None:
            apply_settings(self, {}, not recommended)

    def push(self, body: Body, impulse: ArrayLike, point: ArrayLike | None = None) -> None:
        """Applies an impulse (3,) in N s at a point (3,), in world axes.

        By default, the point is the centre of mass.
        """
        mesh = self._mesh(body)
        mesh.push(impulse, mesh.position if point is None else point)

    def move(self, body: Body, position: ArrayLike, orientation: ArrayLike | None = None) -> None:
        """Moves a body's centre of mass to a position (3,).

        orientation : quaternion (4,) from rest to world; by default, the body is not turned
        """
        mesh, position = self._mesh(body), checked_numbers("position", position, 3, 1)
        if orientation is not None:
            orientation = checked_numbers("orientation", orientation, 4, 1)
            if not orientation.any():
                raise ValueError("orientation must not be zero")
            mesh.orientation = orientation
        mesh.position = position

    def set_velocity(self, body: Body, linear: ArrayLike, angular: ArrayLike = ZERO) -> None:
        """Gives a body a velocity (3,), in m/s at its centre of mass, and an angular one, in rad/s.

        A fixed body moves on with it, like a conveyor or a gripper, and nothing slows it down.
        """
        mesh, linear = self._mesh(body), checked_numbers("linear", linear, 3, 1)
        mesh.angVelocity = checked_numbers("angular", angular, 3, 1)
        mesh.linVelocity = linear

    def fix(self, body: Body, isFixed: bool = True) -> None:
        """Fixes a body, or frees it."""
        self._mesh(body).isFixed = isFixed

    def set_force(
        self, body: Body | Sequence[Body], force: ArrayLike, torque: ArrayLike = ZERO
    ) -> None:
        """Lets a force (3,) in N at the centre of mass, and a torque (3,) in N m, act on a body.

        Both are in world axes, act from the next step on, and replace earlier ones. A body under a
        force does not fall asleep. Of several bodies, such as all of `meshes`, force and torque are
        (n, 3), or (3,) for each.
        """
        bodies = body if isinstance(body, Sequence | np.ndarray | range) else [body]
        place, loads = {id(mesh): mesh for mesh in self.meshes}, []
        some = [place.get(id(one)) or self._mesh(one) for one in bodies]
        for name, rows in (("force", force), ("torque", torque)):
            rows = [rows] * len(some) if np.ndim(rows) == 1 else rows
            loads.append(checked_numbers(name, rows, 3, len(some)))
        for mesh, *load in zip(some, *loads, strict=True):
            mesh.load = load

    def constrain(
        self,
        body1: Body,
        point1: ArrayLike,
        body2: Body,
        point2: ArrayLike,
        lower: float | None = None,
        upper: float | None = None,
    ) -> None:
        """Links two bodies, which still collide, by a bounded distance, from the next step on.

        point1, point2 : (3,), in world axes at the body's present pose, or the index of a vertex
        lower, upper : bounds of the distance, in m, by default the present distance: a rod. A rope
            has the lower bound 0; a joint, both bounds 0 and one point.

        Raises ValueError for a point outside its body, or not 0 ≤ lower ≤ upper.
        """
        bodies, ends, rests = [index_of(one, self.meshes) for one in (body1, body2)], [], []
        if bodies[0] == bodies[1]:
            raise ValueError("a body cannot be linked to itself")
        for index, point in zip(bodies, (point1, point2), strict=True):
            mesh = self.meshes[index]
            if np.ndim(point) == 0:
                vertex = checked_count(point, "a vertex", 0, len(mesh.origVertices) - 1)
                ends.append(mesh.currVertices[vertex])
                rests.append(mesh.origVertices[vertex])
            else:
                ends.append(checked_numbers("a point", point, 3, 1)[0])
                rest = QRotate(QConj(mesh.orientation), ends[-1] - mesh.position)
                rests.append(mesh.own_point(rest))
        distance = math.dist(*ends)
        bounds = (distance if one is None else one for one in (lower, upper))
        lower, upper = (checked_numbers("a bound", one, 1, 1).item() for one in bounds)
        if not 0.0 <= lower <= upper:
            raise ValueError(f"the bounds must be 0 ≤ lower ≤ upper, not {lower} and {upper}")
        v1, v2 = (self.meshes[b].vertex_at(rest) for b, rest in zip(bodies, rests, strict=True))
        row = bodies[0], v1, bodies[1], v2
        self.constraints = [*self.constraints, [*row, lower, False], [*row, upper, True]]

    def _mesh(self, body):
        return self.meshes[index_of(body, self.meshes)]

    @contextmanager
    def record(self, path: str | Path) -> Iterator[Self]:
        """Returns a context in which the present state, each step, and all changes, by methods or
        by assignment, are recorded.

        The program replays, resumes and verifies the file; `open` opens it.

        Raises OSError if the file cannot be written, ValueError if its name does not end in .h5 or
        .hdf5.
        """
        with self._written(OUTPUTS["record"].start(path)):
            yield self

    def rollout(self, count: int) -> dict[str, np.ndarray]:
        """Makes `count` steps; returns the n bodies' states after each of them.

        A dict of positions (count, n, 3), orientations (count, n, 4), linVelocities and
        angVelocities (count, n, 3).
        """
        rows = [rows_of(self.run(1).meshes) for _ in range(checked_count(count, "count"))]
        rows = np.array([rows_of(self.meshes), *rows])[1:]  # of this shape, also without steps
        return {name: rows[..., one] for name, one in COLUMNS.items()}

    @classmethod
    def resume(cls, path: str | Path, step: int | None = None) -> Self:
        """Returns a simulation that continues a recording with the same bits.

        step : after which one, by default the last. Raises RecordingError if it is not recorded.
        """
        with Recording(path) as recording:
            step = recording.lastStep if step is None else checked_count(step, "step")
            return resume(recording, step, cls(recording.source, Settings()))

    @staticmethod
    def verify(path: str | Path) -> str:
        """Simulates a recording again; returns its first difference in a few words, or "".

        Raises RecordingError if the file cannot be read.
        """
        with Recording(path) as recording:
            return verify(recording)

    @staticmethod
    def open(path: str | Path) -> OpenedRecording:
        """Opens a recording; returns an `OpenedRecording`, at its first step.

        Raises RecordingError if it cannot be read.
        """
        return OpenedRecording(Recording(path))


class OpenedRecording(Results, Replay):
    """A recording that is opened from Python.

    It has the attributes of a `Simulation`, and what can be made of one: `picture`, `video`,
    `export`, `stats`, `show`. `seek(step)` goes to any step from `firstStep` to `lastStep`, `step`
    to the next one; `contacts()` lists its contacts.
    """

    def __repr__(self):
        name, bodies = self.recording.path.name, counted(len(self.meshes), "body")
        steps = f"steps {self.firstStep} to {self.lastStep}, at step {self.stepCount}"
        return f"OpenedRecording({name!r}, {bodies}, {steps}, {self.time:g} s)"

    def seek(self, step: int) -> None:
        """Puts the bodies into their state after a step. Raises ValueError if there is none."""
        super().seek(checked_count(step, "step", self.firstStep, self.lastStep))
