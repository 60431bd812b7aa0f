"""Settings that a scene file recommends, in a comment that other programs ignore.

    # suggests friction 0.5 restitution 0.2 scheduling queue broad-phase grid

The words are the names of command-line options without dashes.
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
        found = _SUGGESTION.match(line)
        words = iter(found[1].split() if found else ())
        try:
            for word in words:
                if word not in BY_OPTION:
                    known = ", ".join(BY_OPTION)
                    raise ValueError(f"unknown setting '{short(word)}'; known are {known}")
                one = BY_OPTION[word]
                value = not one.default if one.kind is bool else next(words, "")
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
    simulation.recommended = ", ".join(
        one.label if one.kind is bool else f"{one.option} {shown(chosen[name])}"
        for name, one in SETTINGS.items()
        if name in recommended and recommended[name] == chosen[name]
    )
    simulation.startSettings = replace(simulation.settings)


def note_recommended(simulation):
    """Prints a line if a scene uses settings that it recommends."""
    if simulation.recommended:
        path, used = shown_path(simulation.scenePath), simulation.recommended
        print_error(f"using the settings recommended in {path} ({used}); --basic ignores them")
