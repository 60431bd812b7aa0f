"""Settings that a scene file recommends, in a comment that other programs ignore.

    # suggests friction 0.5 restitution 0.2 scheduling queue broad-phase grid

The words are the names of command-line options without dashes. From the top: reading a scene's
recommendations; applying them.
"""

import re
from dataclasses import replace

from rbs.scenes.messages import InputError, print_error, short, shown_path
from rbs.scenes.textfiles import SceneError
from rbs.stepping.settings import (
    BY_OPTION,
    SETTINGS,
    IgnoredSetting,
    Settings,
    shown,
    used_settings,
)

# A comment line that recommends settings: "# suggests friction 0.5".
_SUGGESTION = re.compile(r"\s*#+\s*suggests\s+(.*)")


def recommended_values(source):
    """Returns the settings that a SceneSource recommends: dict from field to value.

    Raises SceneError, with file and line, if a recommendation is invalid.
    """
    values = {}
    for lineNumber, line in enumerate(source.scene.splitlines(), start=1):
        try:
            if found := _SUGGESTION.match(line):
                values |= _values_of(found[1].split())
                Settings(**values)
        except ValueError as error:
            raise SceneError(source.path, lineNumber, f"recommended settings: {error}") from None
    return values


def _values_of(words):
    """Returns the settings that the words of a line recommend. Raises ValueError."""
    values, words = {}, list(words)
    while words:
        word = words.pop(0)
        if word not in BY_OPTION:
            known = ", ".join(BY_OPTION)
            raise ValueError(f"unknown setting '{short(word)}'; known are {known}")
        one = BY_OPTION[word]
        if one.kind is bool:
            values[one.name] = not one.default
        elif not words:
            raise ValueError(f"{word} has no value")
        else:
            try:
                values[one.name] = one.parsed(words.pop(0))
            except ValueError as error:
                raise ValueError(f"{word} {error}") from None
    return values


def described(values):
    """Returns settings, a dict by field, as text."""
    return ", ".join(
        one.label if one.kind is bool else f"{one.option} {shown(values[name])}"
        for name, one in SETTINGS.items()
        if name in values
    )


def apply_settings(simulation, given, isBasic=False, isStrict=True):
    """Gives a simulation the settings that its scene recommends, overridden by those given.

    given : dict of values by field
    isBasic : whether recommendations are ignored
    isStrict : whether a given setting that the solver ignores is an error; if not, it is left out

    Raises SceneError if a recommendation is invalid, InputError for such an error.
    """
    recommended = {} if isBasic else recommended_values(simulation.source)
    if not isStrict:
        chosen = {"contactSolver": Settings().contactSolver} | recommended | given
        given = used_settings(given, chosen["contactSolver"])
    try:
        simulation.settings = Settings(**recommended).changed(**given)
    except IgnoredSetting as error:
        cause = error.inOptions
        if "contactSolver" in recommended and "contactSolver" not in given:
            cause += f", which {shown_path(simulation.scenePath)} recommends; --basic ignores that"
        raise InputError(cause) from None
    chosen = vars(simulation.settings)
    used = {name: value for name, value in recommended.items() if chosen[name] == value}
    simulation.recommended = described(used)
    simulation.startSettings = replace(simulation.settings)


def note_recommended(simulation):
    """Prints a line if a scene uses settings that it recommends, and if its step is too long."""
    if simulation.recommended:
        path = shown_path(simulation.scenePath)
        print_error(
            f"using the settings recommended in {path} ({simulation.recommended}); --basic "
            "ignores them"
        )
    print_error(simulation.step_advice())
