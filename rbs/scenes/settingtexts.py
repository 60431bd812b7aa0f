"""The settings in words: options, --help, labels, and the settings that a scene file recommends.

Recommendations stand in a comment of the scene file, which other programs ignore. The words are the
names of command-line options without dashes:

    # suggests friction 0.5 restitution 0.2 scheduling queue broad-phase grid
"""

import re
from contextlib import suppress
from dataclasses import replace

from rbs.scenes.files import SceneError, plain_number
from rbs.scenes.messages import InputError, print_error, short, shown_path
from rbs.stepping.settings import SETTINGS, IgnoredSetting, Settings, used_settings


class SettingText:
    """What users read of a setting.

    help : text of --help
    option : on the command line, without dashes; "no-" switches a bool off; None if it has none
    label : in the window, by default the option without "no-"; "" if it is not there
    tooltip : of the window, by default the first sentence of help
    isOfConstraints : whether it affects distance constraints only
    name, setting : the field of `Settings`, and its `Setting`
    """

    def __init__(self, name, help, option="", label=None, tooltip="", isOfConstraints=False):
        """option : by default the name, with hyphens"""
        self.name, self.setting, self.help = name, SETTINGS[name], help
        self.isOfConstraints = isOfConstraints
        hyphened = re.sub("[A-Z]", lambda letter: "-" + letter[0].lower(), name)
        self.option = hyphened if option == "" else option
        plain = (self.option or "").removeprefix("no-").replace("-", " ")
        self.label = plain if label is None else label
        tooltip = tooltip or help.partition(". ")[0]
        self.tooltip = tooltip[:1].upper() + tooltip[1:]

    def parsed(self, text):
        """Returns the value of a text. Raises ValueError as `Setting.checked` does of the text."""
        if self.setting.kind in (float, int):
            with suppress(ValueError):
                found = [plain_number(word, self.setting.kind) for word in text.split(",")]
                return self.setting.checked(found if len(found) > 1 else found[0])
        return self.setting.checked(text)

    def shown(self, settings):
        """Returns the value in some `Settings` as text, as on the command line."""
        value = getattr(settings, self.name)
        if isinstance(value, tuple):
            return ",".join(f"{one:g}" for one in value)
        return f"{value:g}" if isinstance(value, float) else str(value)


# By field of `Settings`, in the order of --help.
TEXTS = {
    one.name: one
    for one in (
        SettingText(
            "restitution",
            "how bouncy: the fraction of the approach speed that is returned, 0 to 1. With 1, "
            "bodies slowly gain energy, unless --solver soft-step is used",
        ),
        SettingText(
            "friction",
            "coefficient of friction between bodies and with the ground. Only --solver soft-step "
            "slows a box that spins flat on another",
        ),
        SettingText("timeStep", "simulated seconds per step", label="time step (s)"),
        SettingText(
            "gravity",
            "acceleration of free fall along −y, in m/s², 0 or more; or three numbers, its x,y,z",
            label="gravity (m/s²)",
            tooltip="acceleration of free fall along −y",
        ),
        SettingText(
            "ground",
            "leave out the ground y = 0",
            "no-ground",
            tooltip="let bodies collide with the ground y = 0",
        ),
        SettingText(
            "contactSolver",
            "way to solve contacts: impulse, one by one, as in the coursework; soft-step, all "
            "together. Piles rest only with soft-step",
            "solver",
        ),
        SettingText(
            "substeps", "substeps per step; with more, contacts are stiffer and a step takes longer"
        ),
        SettingText(
            "sleeping",
            "simulate bodies at rest too. By default, they sleep until something disturbs them",
            "no-sleeping",
            tooltip="skip bodies at rest until something disturbs them",
        ),
        SettingText(
            "broadPhase",
            "way to find possible contacts; grid is faster with many bodies, with identical "
            "motion. all tests every pair; grid uses a uniform grid",
        ),
        SettingText(
            "contactScheduling",
            "way to resolve contacts; batches is faster with hundreds of bodies, with identical "
            "motion. sequential resolves one contact after the other; batches resolves contacts "
            "that share no movable body together, on arrays, and finds them by the grid",
            "contacts",
            "contact schedule",
        ),
        SettingText(
            "gyroscopic",
            "let spinning bodies tumble, following Euler's equations. By default, the angular "
            "velocity is constant in free flight",
            label="gyroscopic torque",
        ),
        SettingText(
            "enforceConstraints",
            "ignore the distance constraints. They are solved last in a step and may press bodies "
            "into the ground, much less so with --solver soft-step",
            "no-constraints",
            tooltip="enforce the distance constraints",
            isOfConstraints=True,
        ),
        SettingText(
            "linkedBodiesCollide",
            "let bodies that a constraint links pass through each other. By default, they collide, "
            "which stiffens chains whose bodies touch",
            "no-linked-collisions",
            "linked bodies collide",
            "let bodies that a constraint links collide with each other",
            isOfConstraints=True,
        ),
        SettingText(
            "constraintScheduling",
            "order in which constraints are visited. sweep visits all of them, repeatedly; queue "
            "gives the same result with fewer visits; batches visits many at once in another "
            "order, for hundreds of constraints",
            "scheduling",
            isOfConstraints=True,
        ),
        SettingText(
            "maxIterations",
            "maximum number of constraint visits per step; each constraint is visited at least "
            "once (default: 20 times the number of constraints, and at least 1000)",
            label="",
            isOfConstraints=True,
        ),
        SettingText(
            "tolerance",
            "length by which a constraint may be violated before it is corrected, and speed at "
            "which its distance may then still change",
            None,
            "",
            isOfConstraints=True,
        ),
    )
}
# Those that a user can choose, by option.
BY_OPTION = {one.option: one for one in TEXTS.values() if one.option is not None}


def changed_settings(settings, given, remark=""):
    """`Settings.changed` by options. Raises InputError for one that the contact solver ignores.

    given : dict of values by field; remark : end of the error's message
    """
    try:
        return settings.changed(**given)
    except IgnoredSetting as error:
        option = f"--{TEXTS[error.name].option}"
        told = f"{option} has no effect with --solver {error.solver}{remark}"
        raise InputError(told) from None


# A comment line that recommends settings: "# suggests friction 0.5".
_SUGGESTION = re.compile(r"\s*#+\s*suggests\s+(.*)")


def recommended_values(source):
    """Returns the settings that a SceneSource recommends: dict from field to value.

    Raises SceneError, with file and line, if a recommendation is invalid.
    """
    values = {}
    for lineNumber, line in enumerate(source.scene.splitlines(), start=1):
        found = _SUGGESTION.match(line)
        words = iter(found[1].split() if found else ())
        try:
            for word in words:
                if word not in BY_OPTION:
                    known = ", ".join(BY_OPTION)
                    raise ValueError(f"unknown setting '{short(word)}'; known are {known}")
                one = BY_OPTION[word]
                if one.name in values:
                    raise ValueError(f"{word} is recommended twice")
                isSwitch = one.setting.kind is bool
                value = not one.setting.default if isSwitch else next(words, "")
                try:
                    values[one.name] = one.parsed(value)
                except ValueError as error:
                    raise ValueError(f"{word} {error}") from None
            Settings(**values)
        except ValueError as error:
            raise SceneError(source.path, lineNumber, f"recommended settings: {error}") from None
    return values


def apply_settings(simulation, given, isBasic=False, isStrict=True):
    """Gives a simulation the settings that its scene recommends, overridden by those given.

    given : dict of values by field
    isBasic : whether recommendations are ignored
    isStrict : whether a given setting that the solver ignores is an error; if not, it is left out

    Raises SceneError if a recommendation is invalid, InputError if a given setting is ignored.
    """
    recommended = {} if isBasic else recommended_values(simulation.source)
    if not isStrict:
        chosen = {"contactSolver": Settings().contactSolver} | recommended | given
        given = used_settings(given, chosen["contactSolver"])
    remark = ""
    if "contactSolver" in recommended and "contactSolver" not in given:
        remark = f", which {shown_path(simulation.scenePath)} recommends; --basic ignores that"
    simulation.settings = chosen = changed_settings(Settings(**recommended), given, remark)
    simulation.recommended = ", ".join(
        one.label if one.setting.kind is bool else f"{one.option} {one.shown(chosen)}"
        for name, one in TEXTS.items()
        if name in recommended and recommended[name] == getattr(chosen, name)
    )
    simulation.startSettings = replace(chosen)


def note_recommended(simulation):
    """Prints a line if a scene uses settings that it recommends."""
    if simulation.recommended:
        path, used = shown_path(simulation.scenePath), simulation.recommended
        print_error(f"using the settings recommended in {path} ({used}); --basic ignores them")
