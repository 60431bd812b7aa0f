"""Settings that a scene file suggests, in a comment that other programs pass over.

    # suggests friction 0.5 restitution 0.2 scheduling queue broad-phase grid

The words are the names of the command line's options that change the settings, without the dashes.
From the top: reading a scene's suggestions; how a scene is opened that may have some.
"""

from dataclasses import fields, replace

from rbs.messages import print_note, short, shown_path
from rbs.opening import find_file, open_file
from rbs.options import SETTING_FIELDS, OneLineParser, add_settings_options, settings_of
from rbs.scenelines import suggestion_lines
from rbs.simulation import Settings, Simulation
from rbs.textfiles import SceneError

# The words that may be suggested, each with the name that argparse gives its option.
SUGGESTIONS = {name.replace("_", "-"): name for name in SETTING_FIELDS}


class SuggestionParser(OneLineParser):
    """Raises ValueError for what the command line would refuse."""

    def error(self, message):
        raise ValueError(message.removeprefix("argument --"))


def suggested_settings(source):
    """What a SceneSource suggests: (Settings, words), the words in one line, "" if there are none.

    raises SceneError that names file and line where a suggestion is none
    """
    parser = SuggestionParser(add_help=False, allow_abbrev=False)
    add_settings_options(parser)
    arguments, words = [], []
    for lineNumber, line in suggestion_lines(source.scene):
        arguments += _arguments_of(source.path, lineNumber, line)
        words += line
        try:
            settings = settings_of(parser.parse_args(arguments))
        except ValueError as error:
            raise SceneError(source.path, lineNumber, f"suggested settings: {error}") from None
    if not words:
        return Settings(), ""
    return settings, " ".join(words)


def _arguments_of(path, lineNumber, words):
    """The words as the command line has them."""
    arguments, isValue = [], False
    for word in words:
        if word in SUGGESTIONS:
            arguments.append("--" + word)
            isValue = True
        elif isValue and not word.startswith("--"):
            arguments.append(word)
            isValue = False
        else:
            raise SceneError(
                path, lineNumber,
                f"'{short(word)}' cannot be suggested; what can: {', '.join(SUGGESTIONS)}",
            )  # fmt: skip
    return arguments


class SceneOpener:
    """Opens files for the window, each scene with the settings that it suggests.

    What has been changed by hand goes on from scene to scene, as far as the solver knows it; all
    else is as the scene suggests.
    """

    def __init__(self, settings, follows, allowOutsideMeshes=False):
        """settings : what the window begins with; follows : whether suggestions are used at all"""
        self._begun = replace(settings)
        self._follows = follows
        self._allowOutsideMeshes = allowOutsideMeshes

    def __call__(self, text, settings, folder="."):
        """The Simulation or Replay; see `open_file`.

        text : a path, or what a person has typed, see `find_file`; folder : of the last scene;
        settings : those of the last scene, or None where there was none
        """
        path = find_file(text, folder)
        opened = open_file(path, settings, self._allowOutsideMeshes)
        if isinstance(opened, Simulation) and self._follows:
            begun, words = suggested_settings(opened.source)
            byHand = {} if settings is None else {
                field.name: getattr(settings, field.name)
                for field in fields(settings)
                if getattr(settings, field.name) != getattr(self._begun, field.name)
            }  # fmt: skip
            if byHand.get("contactSolver", begun.contactSolver) == "soft-step":
                byHand["closingOnly"] = False  # it has no meaning there, and would be refused
            self._begun = begun
            opened.settings, opened.suggestion = replace(begun, **byHand), words
            opened.startSettings = replace(begun)
            tell_suggestion(opened)
        return opened


def tell_suggestion(simulation):
    """Says in one line that a scene runs with what it suggests, if it does."""
    if getattr(simulation, "suggestion", ""):
        path = shown_path(simulation.scenePath)
        print_note(f"{path} suggests {simulation.suggestion}; --basic does without")
