"""The settings of a step, each declared once.

Command line, window, recordings and checks all read this table. From the top: `Setting`; the table;
`Settings`, the values that a scene is simulated with; the checks of `run_timestep`.
"""

import math
import reprlib
from dataclasses import asdict, dataclass, make_dataclass

from rbs.geometry.triples import floats, number

BROAD_PHASES = ("all", "grid")
CONSTRAINT_SCHEDULINGS = ("sweep", "queue", "batches")
CONTACT_SOLVERS = ("impulse", "soft-step")
# m, and m/s: the violation of a constraint that is left uncorrected. Invisible on bodies of 5 to
# 20 m. Smaller values take more constraint visits.
CONSTRAINT_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Setting:
    """A setting of a step.

    Attributes
    ----------
    name : the field in `Settings` and in recordings
    parameter : the parameter of `run_timestep`
    default : in the program, and in `run_timestep` unless defaultInStep is given
    kind : float, int, bool, or the tuple of names to choose from
    option : on the command line, without dashes; "no-" switches a bool off; None if it has none
    help : for --help, without the default
    label, tooltip : in the window
    sliderEnds : ends of the slider in the window, or None for a field to type into
    limits, limitsInStep : least and greatest value in the program, and in `run_timestep`. An
        infinite end stands for any finite value
    solver : the only contact solver that uses it, or None for all
    isOfConstraints : whether it affects distance constraints only
    """

    name: str
    parameter: str
    default: object
    kind: type | tuple
    option: str | None
    help: str
    label: str = ""
    tooltip: str = ""
    sliderEnds: tuple | None = None
    limits: tuple = (-math.inf, math.inf)
    limitsInStep: tuple = (-math.inf, math.inf)
    solver: str | None = None
    isOfConstraints: bool = False
    defaultInStep: object = None

    def checked(self, value, limits=None):
        """Returns the value as its kind. Raises ValueError, to be read after the setting's name.

        limits : (least, greatest), by default those of the program
        """
        if isinstance(self.kind, tuple):
            if not isinstance(value, str) or value not in self.kind:
                raise ValueError(f"must be one of {', '.join(self.kind)}, not {value!r}")
            return value
        if self.kind is bool:
            if value not in (True, False):
                raise ValueError(f"must be true or false, not {value!r}")
            return bool(value)
        if self.default is None and value is None:
            return None
        low, high = limits or self.limits
        try:
            found = number(value) if self.kind is float else int(value)
        except (TypeError, ValueError, OverflowError):
            found = math.nan
        if not low <= found <= high or math.isinf(found) or found != value:
            shown = f"{value:g}" if isinstance(value, float) else reprlib.repr(value)
            raise ValueError(f"must be {self._allowed(low, high)}, not {shown}")
        return found

    def _allowed(self, low, high):
        """Returns the values that `checked` allows, in words."""
        what = "a whole number" if self.kind is int else "a finite number"
        if math.isinf(low) and math.isinf(high):
            return what
        return f"{what} of {low:g} or more" if math.isinf(high) else f"{what}, {low:g} to {high:g}"

    def parsed(self, text):
        """Returns the value of a text. Raises ValueError as `checked` does."""
        if not isinstance(self.kind, tuple):
            try:
                # Python also reads 1_000, and digits of other scripts, as numbers.
                text = self.kind(text if text.isascii() and "_" not in text else "no number")
            except ValueError:
                pass
        return self.checked(text)

    def isHeededBy(self, solver):
        """Returns whether the contact solver of this name uses it."""
        return self.solver in (None, solver)


POSITIVE = (0.0, math.inf)
TABLE = (
    Setting(
        "restitution",
        "CRCoeff",
        0.5,
        float,
        "restitution",
        "coefficient of restitution: the fraction of the approach speed that is returned, 0 to 1. "
        "With 1, bodies slowly gain energy, unless --solver soft-step is used",
        "restitution",
        "How bouncy: the fraction of the approach speed that is returned, 0 to 1",
        (0.0, 1.0),
        limits=(0.0, 1.0),
    ),
    Setting(
        "timeStep",
        "timeStep",
        0.02,
        float,
        "time-step",
        "simulated seconds per step",
        "time step (s)",
        "Simulated seconds per step",
        limits=(1e-12, 1e3),
        limitsInStep=POSITIVE,
    ),
    Setting(
        "gravity",
        "gravity",
        9.8,
        float,
        "gravity",
        "acceleration of free fall along −y, in m/s²",
        "gravity (m/s²)",
        "Acceleration of free fall, downwards",
        (0.0, 20.0),
        limits=(0.0, 1000.0),
        defaultInStep=(0.0, -9.8, 0.0),
    ),
    Setting(
        "friction",
        "mu",
        0.0,
        float,
        "friction",
        "coefficient of friction between bodies and with the ground. Only --solver soft-step slows "
        "a box that spins flat on another",
        "friction",
        "Coulomb friction coefficient, between bodies and with the ground",
        (0.0, 1.0),
        limits=POSITIVE,
        limitsInStep=POSITIVE,
    ),
    Setting(
        "contactSolver",
        "contactSolver",
        "impulse",
        CONTACT_SOLVERS,
        "solver",
        "impulse solves one contact after the other, with one impulse each, as in the coursework; "
        "soft-step solves all contacts and constraints together, so that piles rest",
        "solver",
        "impulse: one contact after the other, as in the coursework; soft-step: all together, so "
        "that piles rest",
    ),
    Setting(
        "substeps",
        "substeps",
        8,
        int,
        "substeps",
        "substeps per step. More make contacts stiffer and take longer",
        "substeps",
        "Substeps per step. More make contacts stiffer and take longer",
        (1, 32),
        limits=(1, 1000),
        limitsInStep=(1, math.inf),
        solver="soft-step",
    ),
    Setting(
        "sleeping",
        "sleeping",
        True,
        bool,
        "no-sleeping",
        "simulate bodies at rest too (by default, they sleep until something disturbs them)",
        "sleeping",
        "Skip bodies at rest until something disturbs them",
        solver="soft-step",
    ),
    Setting(
        "broadPhase",
        "broadPhase",
        "all",
        BROAD_PHASES,
        "broad-phase",
        "search for possible contacts: all tests every pair; grid uses a uniform grid, which is "
        "faster with hundreds of bodies. The motion is identical",
        "broad phase",
        "How possible contacts are found. The motion is identical; grid is faster with many bodies",
        solver="impulse",
    ),
    Setting(
        "closingOnly",
        "closingOnly",
        False,
        bool,
        "closing-only",
        "apply no impulse if bodies are already separating (by default, one is applied, as in the "
        "coursework)",
        "approaching contacts only",
        "No impulse if bodies are already separating",
        solver="impulse",
    ),
    Setting(
        "gyroscopic",
        "gyroscopic",
        False,
        bool,
        "gyroscopic",
        "let spinning bodies tumble, following Euler's equations (by default, the angular velocity "
        "is constant in free flight)",
        "gyroscopic torque",
        "Gyroscopic torque: spinning bodies may tumble (Euler's equations)",
    ),
    Setting(
        "enforceConstraints",
        "enforceConstraints",
        True,
        bool,
        "no-constraints",
        "ignore the distance constraints. They are solved last in a step and may press bodies into "
        "the ground, much less so with --solver soft-step",
        "constraints",
        "Enforce the distance constraints",
        isOfConstraints=True,
    ),
    Setting(
        "constraintScheduling",
        "constraintScheduling",
        "sweep",
        CONSTRAINT_SCHEDULINGS,
        "scheduling",
        "sweep visits constraints in order, repeatedly; queue gives the same result with fewer "
        "visits; batches visits many at once in another order, for hundreds of constraints",
        "scheduling",
        "Order in which constraints are visited",
        solver="impulse",
        isOfConstraints=True,
    ),
    Setting(
        "maxIterations",
        "maxIterations",
        None,
        int,
        "max-iterations",
        "most constraint visits per step; each constraint is visited at least once (default: 20 "
        "times the number of constraints, and at least 1000)",
        limits=(0, 10**15),
        solver="impulse",
        isOfConstraints=True,
        defaultInStep=1000,
    ),
    Setting(
        "tolerance",
        "tolerance",
        CONSTRAINT_TOLERANCE,
        float,
        None,
        "",
        limitsInStep=POSITIVE,
        solver="impulse",
        isOfConstraints=True,
    ),
)
# The settings that a user can choose, by field name.
CHOSEN = {one.name: one for one in TABLE if one.option is not None}
BY_PARAMETER = {one.parameter: one for one in TABLE}
BY_OPTION = {one.option: one for one in CHOSEN.values()}


def heeded(values, solver):
    """Returns those of the values, a dict by field of `Settings`, that a contact solver uses."""
    return {name: value for name, value in values.items() if CHOSEN[name].isHeededBy(solver)}


class IgnoredSetting(ValueError):
    """A setting that the contact solver ignores. inOptions : the message in command-line terms."""

    def __init__(self, one, solver):
        super().__init__(f"{one.name} has no effect with contactSolver {solver}")
        self.inOptions = f"--{one.option} has no effect with --solver {solver}"


class _Values:
    """The methods of `Settings`."""

    def __post_init__(self):
        """Checks all values. Raises ValueError, naming the setting."""
        for one in CHOSEN.values():
            try:
                setattr(self, one.name, one.checked(getattr(self, one.name)))
            except ValueError as error:
                raise ValueError(f"{one.name} {error}") from None
        for one in self.ignored():
            raise IgnoredSetting(one, self.contactSolver)

    def __repr__(self):
        values = {name: getattr(self, name) for name in CHOSEN}
        chosen = [f"{n}={v!r}" for n, v in values.items() if v != CHOSEN[n].default]
        return f"Settings({', '.join(chosen)})"

    def ignored(self):
        """Returns the settings that the contact solver ignores although they are not default."""
        return [
            one
            for one in CHOSEN.values()
            if not one.isHeededBy(self.contactSolver) and getattr(self, one.name) != one.default
        ]

    def changed(self, **values):
        """Returns a copy with other values. A new solver resets the settings that it ignores.

        Raises ValueError for an invalid value, or one that the solver ignores.
        """
        solver = values.get("contactSolver", self.contactSolver)
        return Settings(**{**heeded(asdict(self), solver), **values})

    def change(self, name, value):
        """Changes a field in place. Raises ValueError as `changed` does, changing nothing."""
        vars(self).update(vars(self.changed(**{name: value})))

    def arguments(self):
        """Returns a dict of arguments for `run_timestep`, without any that the solver ignores."""
        values = {
            one.parameter: getattr(self, one.name)
            for one in CHOSEN.values()
            if one.isHeededBy(self.contactSolver)
        }
        return values | {"gravity": (0.0, -self.gravity, 0.0)}


Settings = make_dataclass(
    "Settings",
    [(one.name, object, one.default) for one in CHOSEN.values()],
    bases=(_Values,),
    repr=False,
)
Settings.__module__ = __name__
Settings.__doc__ = """The settings that a scene is simulated with. Fields: see TABLE.

    The defaults give the coursework's behaviour.
    """


def check_arguments(arguments):
    """Returns the arguments of `run_timestep` that are settings, by parameter, as their kinds.

    arguments : dict of all its arguments
    Raises ValueError for an invalid value, and for one that the contact solver would ignore.
    """
    checked = {"gravity": _acceleration(arguments["gravity"])}
    for parameter, one in BY_PARAMETER.items():
        if parameter == "gravity":
            continue
        value = arguments[parameter]
        try:
            checked[parameter] = one.checked(value, one.limitsInStep)
        except ValueError as error:
            raise ValueError(f"{parameter} {error}") from None
    solver = checked.get("contactSolver")
    for parameter, value in checked.items():
        one = BY_PARAMETER[parameter]
        if one.solver is None:
            continue
        default = one.default if one.defaultInStep is None else one.defaultInStep
        if not one.isHeededBy(solver) and value != default:
            raise ValueError(f"{parameter} has no effect with contactSolver {solver!r}")
    return checked


def _acceleration(gravity):
    """The argument gravity as a tuple of three floats; raises ValueError."""
    try:
        found = floats(gravity, 3)
    except (TypeError, ValueError):
        found = (math.nan,)
    if not all(abs(one) <= BY_PARAMETER["gravity"].limits[1] for one in found):
        raise ValueError(f"gravity must be three numbers in m/s², not {reprlib.repr(gravity)}")
    return found
