"""The settings of a step, each declared once.

Command line, window, recordings and `run_timestep` all read them; rbs/scenes/settingtexts.py has
their words. From the top: `Setting`, which a field of `Settings` carries; `Settings`; arguments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Literal, get_args, get_type_hints

import numpy as np

from rbs.geometry.triples import floats, number, shown_value

# m, and m/s: the violation of a constraint that is left uncorrected. Invisible on bodies of 5 to
# 20 m. With smaller values, more constraint visits are made.
CONSTRAINT_TOLERANCE = 1e-3
# Most constraint visits in a step of the coursework.
CONSTRAINT_VISITS = 1000
# Sweeps over all constraints of a scene: enough for a pull to pass along a chain several times.
SWEEPS = 20
# Gravitational acceleration along y, in m/s², and as a vector.
GRAVITY = -9.8
EARTH = (0.0, GRAVITY, 0.0)
# Least and greatest value of a setting.
POSITIVE, ANY = (0.0, math.inf), (-math.inf, math.inf)


def as_numbers(value):
    """Returns a value as an array of floats. Raises TypeError, ValueError or OverflowError if it is
    not made of numbers, also for a bool or a text among them.
    """
    array = value if isinstance(value, np.ndarray) else np.asarray(value, dtype=object)
    some = {type(one): one for one in array.flat} if array.dtype == object else {0: array}
    if not {np.asarray(one).dtype.kind for one in some.values()} <= {*"iufO"}:
        raise TypeError
    return np.asarray(value, dtype=np.float64)


class Setting:
    """What belongs to a field of `Settings` besides its name, type and default.

    kind : type, or the tuple of names to choose from
    limits : least and greatest value; an infinite end stands for any finite value
    parameter : of `run_timestep`; limitsInStep, defaultInStep : there, by default as in the program
    solver : the only contact solver that uses it, or None for all
    """

    solver = None

    def __init__(self, one, hint):
        """one, hint : a field of the dataclass, and its type"""
        names = get_args(hint) if isinstance(one.default, str) else ()
        kinds = [kind for kind in get_args(hint) or (hint,) if kind is not type(None)]
        self.name = self.parameter = one.name
        self.kind, self.default, self.defaultInStep = names or kinds[0], one.default, one.default
        vars(self).update(one.metadata)

    def checked(self, value, inStep=False):
        """Returns the value as its kind. Raises ValueError, to be read after the setting's name.

        inStep : whether it is an argument of `run_timestep`
        """
        low, high = self.limitsInStep if inStep else self.limits
        value = value.item() if isinstance(value, np.generic) else value
        if self.default is None and value is None:
            return None
        if isinstance(self.kind, tuple):
            found, isFine = value, value in self.kind
        elif self.kind is bool:
            found, isFine = bool(value), value in (True, False)
        else:
            try:
                given = value if type(value) is float else number(as_numbers(value))
                found = self.kind(given)
            except (TypeError, ValueError, OverflowError):
                given = found = math.nan
            isFine = low <= found <= high and math.isfinite(found) and found == given
        if not isFine:
            raise ValueError(f"must be {self.values(low, high)}, not {shown_value(value)}")
        return found

    def values(self, low, high):
        """Returns what values the setting may have, in words."""
        if self.kind not in (int, float):
            return "true or false" if self.kind is bool else f"one of {', '.join(self.kind)}"
        what = "a whole number" if self.kind is int else "a finite number"
        if high < math.inf:
            return f"{what}, {low:g} to {high:g}"
        return what + f" of {low:g} or more" * (low > -math.inf)

    def is_used_by(self, solver):
        """Returns whether the contact solver of this name uses the setting."""
        return self.solver in (None, solver)


class Gravity(Setting):
    """A number ≥ 0, along −y, or x, y, z, in m/s². In a step, it is a vector; otherwise, a vector
    along −y becomes a number.
    """

    def checked(self, value, inStep=False):
        isVector = isinstance(value, list | tuple | np.ndarray) and np.ndim(value) > 0
        if not (isVector or inStep):
            try:
                return super().checked(value)
            except ValueError as error:
                remedy = "a number g acts along -y; for another direction, give a vector x,y,z"
                raise ValueError(f"{error}; {remedy}") from None
        try:
            x, y, z = found = floats(as_numbers(value), 3)
        except (TypeError, ValueError, OverflowError):
            found = (math.nan,)
        if not all(abs(one) <= self.limits[1] for one in found):
            raise ValueError(f"must be three numbers in m/s², not {shown_value(value)}")
        return found if inStep or x or z or y > 0.0 else -y + 0.0


def used_settings(values, solver):
    """Returns those of the values, a dict by field of `Settings`, that a contact solver uses."""
    return {name: value for name, value in values.items() if SETTINGS[name].is_used_by(solver)}


class IgnoredSetting(ValueError):
    """A setting that the contact solver ignores. name, solver : their names"""

    def __init__(self, name, solver):
        super().__init__(f"{name} has no effect with contactSolver {solver!r}")
        self.name, self.solver = name, solver


def setting(default, limits=ANY, kind=Setting, **others) -> Any:
    """Returns a field of `Settings` with a default, and what else a `Setting` has."""
    others = {"limits": limits, "limitsInStep": limits, "of": kind, **others}
    return field(default=default, metadata=others)


@dataclass(repr=False)
class Settings:
    """The settings of a simulation. The defaults give the coursework's behaviour.

    restitution : part of the approach speed that is returned
    friction : coefficient between bodies and with the ground; timeStep : s
    gravity : m/s², along −y, or a vector x, y, z; ground : whether there is one
    contactSolver : "impulse", the coursework's, one by one, or "soft-step", all together
    substeps : of a soft step; sleeping : whether it skips bodies at rest
    broadPhase : how pairs are found, in all pairs or by a grid, with identical motion
    contactScheduling : one contact after the other, or in batches, with identical motion
    gyroscopic : whether spinning bodies tumble; else the angular velocity is constant in flight
    enforceConstraints : whether they act; linkedBodiesCollide : whether linked bodies collide
    constraintScheduling : order of visits: all in turn, a queue with the same result, or batches
    maxIterations : most constraint visits in a step; by default 20 for each constraint, or 1000
    tolerance : m, and m/s: violation of a constraint that is left

    A value that is invalid, or that the contact solver ignores, raises ValueError.
    """

    restitution: float = setting(0.5, (0.0, 1.0), parameter="CRCoeff", limitsInStep=ANY)
    friction: float = setting(0.0, POSITIVE, parameter="mu")
    timeStep: float = setting(0.02, (1e-12, 1e3), limitsInStep=POSITIVE)
    gravity: float | tuple = setting(-GRAVITY, (0.0, 1e6), Gravity, defaultInStep=EARTH)
    ground: bool = setting(True)
    contactSolver: Literal["impulse", "soft-step"] = setting("impulse")
    substeps: int = setting(6, (1, 1000), solver="soft-step")
    sleeping: bool = setting(True, solver="soft-step")
    broadPhase: Literal["all", "grid"] = setting("all", solver="impulse")
    contactScheduling: Literal["sequential", "batches"] = setting("sequential", solver="impulse")
    gyroscopic: bool = setting(False)
    enforceConstraints: bool = setting(True)
    linkedBodiesCollide: bool = setting(True)
    constraintScheduling: Literal["sweep", "queue", "batches"] = setting("sweep", solver="impulse")
    maxIterations: int | None = setting(
        None, (0, 10**15), defaultInStep=CONSTRAINT_VISITS, solver="impulse"
    )
    tolerance: float = setting(CONSTRAINT_TOLERANCE, POSITIVE, solver="impulse")

    if not TYPE_CHECKING:  # for a type checker, it would allow every name

        def __setattr__(self, name, value):
            """Sets a field. Raises AttributeError or ValueError, naming it."""
            check_setting(name, AttributeError)
            try:
                super().__setattr__(name, SETTINGS[name].checked(value))
            except ValueError as error:
                raise ValueError(f"{name} {error}") from None

    def __post_init__(self):
        """Raises IgnoredSetting if the solver ignores a value."""
        for name, one in SETTINGS.items():
            if not one.is_used_by(self.contactSolver) and getattr(self, name) != one.default:
                raise IgnoredSetting(name, self.contactSolver)

    def __repr__(self):
        chosen = [f"{n}={v!r}" for n, v in vars(self).items() if v != SETTINGS[n].default]
        return f"Settings({', '.join(chosen)})"

    def changed(self, **values: Any) -> Settings:
        """Returns a copy with other values. A new solver resets the settings that it ignores.

        Raises ValueError for an invalid value, or one that the solver ignores.
        """
        for name in values:
            check_setting(name, ValueError)
        solver = values.get("contactSolver", self.contactSolver)
        return Settings(**{**used_settings(vars(self), solver), **values})

    def change(self, name: str, value: Any) -> None:
        """Changes a field in place. Raises ValueError as `changed` does, changing nothing."""
        vars(self).update(vars(self.changed(**{name: value})))

    @property
    def acceleration(self) -> tuple:
        """Acceleration of free fall (x, y, z) in m/s²."""
        return self.gravity if isinstance(self.gravity, tuple) else (0.0, -self.gravity, 0.0)

    def max_iterations(self, constraintCount: int) -> int:
        """Returns the most constraint visits of a step: maxIterations, or its default."""
        if self.maxIterations is not None:
            return self.maxIterations
        return max(CONSTRAINT_VISITS, SWEEPS * constraintCount)

    def arguments(self, constraintCount: int = 0) -> dict[str, Any]:
        """Returns a dict of arguments for `run_timestep`, without any that the solver ignores."""
        values = used_settings(vars(self), self.contactSolver)
        used = {SETTINGS[name].parameter: value for name, value in values.items()}
        used["gravity"] = self.acceleration
        if "maxIterations" in used:
            used["maxIterations"] = self.max_iterations(constraintCount)
        return used


_hints = get_type_hints(Settings)
# By field, and by parameter of `run_timestep`.
SETTINGS = {f.name: f.metadata["of"](f, _hints[f.name]) for f in fields(Settings)}
BY_PARAMETER = {one.parameter: one for one in SETTINGS.values()}
DEFAULTS_IN_STEP = {one.parameter: one.defaultInStep for one in SETTINGS.values()}


def check_setting(name, Error):
    """Raises an Error, which names the nearest setting, unless there is one of this name."""
    if name not in SETTINGS:
        near = get_close_matches(str(name), [*SETTINGS, *BY_PARAMETER], 1)
        meant = SETTINGS.get(*near) or BY_PARAMETER.get(*near) if near else None
        told = f"did you mean {meant.name}?" if meant else f"there are {', '.join(SETTINGS)}"
        raise Error(f"there is no setting {shown_value(name)}; {told}")


def step_arguments(settings, given, constraintCount=0):
    """Returns the settings of a step by parameter of `run_timestep`: a dict.

    settings : Settings or None; given : dict of arguments; those that are not None replace theirs

    Raises TypeError for an unknown one; ValueError for what is invalid or the solver would ignore.
    """
    given = {name: value for name, value in given.items() if value is not None}
    values = DEFAULTS_IN_STEP.copy()
    if settings is None:
        for name in ("timeStep", "CRCoeff"):
            if name not in given:
                raise TypeError(f"run_timestep needs {name}, or settings")
    elif not isinstance(settings, Settings):
        raise TypeError(f"settings must be Settings, not {shown_value(settings)}")
    else:
        values |= settings.arguments(constraintCount)
    solver = given.get("contactSolver", values["contactSolver"])
    for name, value in given.items():
        if name not in BY_PARAMETER:
            raise TypeError(f"run_timestep has no parameter {name}")
        one = BY_PARAMETER[name]
        try:
            values[name] = value = one.checked(value, inStep=True)
        except ValueError as error:
            raise ValueError(f"{name} {error}") from None
        if not one.is_used_by(solver) and value != one.defaultInStep:
            raise IgnoredSetting(one.name, solver)
    return values
