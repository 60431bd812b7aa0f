"""The options of the command line: how each is read, what --help says, and what it goes with."""

import argparse
from dataclasses import dataclass

from rbs import __version__
from rbs.appearance.camera import LOOKS, PICTURE_SIZE, VIDEO_RATE
from rbs.appearance.colours import COLOURINGS
from rbs.pictures.drawing import picture_options
from rbs.pictures.overlays import OVERLAYS
from rbs.program.parsing import OneLineParser, number_type, option_type, path_of
from rbs.recordings.lookup import SCENES
from rbs.recordings.writers import OUTPUTS
from rbs.scenes.files import plain_number
from rbs.scenes.messages import PROGRAM_NAME, short
from rbs.scenes.scene import DEFAULT_STEPS
from rbs.scenes.settingtexts import BY_OPTION

# The scene that runs if none is named.
DEFAULT_SCENE = "heap"
# Steps between screenshots: five pictures per simulated second with the default time step.
DEFAULT_EVERY = 10
# The beginning and the end of --help.
INTRODUCTION = f"""\
Simulates and shows rigid bodies that fall, collide and bounce.

  {PROGRAM_NAME}                                  the {DEFAULT_SCENE} scene, in a window
  {PROGRAM_NAME} tower                            another scene; see the list below
  {PROGRAM_NAME} stress --video stress.mp4        a video
  {PROGRAM_NAME} --replay bridge.h5               a recording

Without a display, the program draws the scene off-screen into out/<scene> and prints a summary."""
SCENE_LIST = "scenes:\n" + "\n".join(
    f"  {group}\n" + "\n".join(f"    {name:<18}{line}" for name, line in lines.items())
    for group, lines in SCENES.items()
)
# What options may need or exclude, besides other options: the window, and all options of a kind.
WINDOW, SETTING, DRAWN, OUTPUT = "the window", "a setting", "what is drawn", "an output"
DRAWINGS = ("--screenshots", "--video")
FROM_FILES = ("SCENE", "--constraints", "--basic")
PATH, POSITIVE_NUMBER = option_type(path_of), number_type(int, 1)


def _traced_step(text):
    """Returns (step, body) of a text like "70:box 3"; for "70", body is None."""
    step, colon, body = text.partition(":")
    return POSITIVE_NUMBER(step), body if colon else None


def _size(text):
    """Returns (width, height) of a text like "1280x720". Raises ValueError."""
    try:
        width, height = map(plain_number, text.split("x"))
    except ValueError:
        raise ValueError(f"'{short(text)}' is not a size, such as 1280x720") from None
    return picture_options({"size": (width, height)}).size


@dataclass
class Option:
    """An option of the command line, whose attribute `dest` of `parse_options` is None by default.

    words : its name, and what stands for its value in --help
    parse : function from text to value, or the names to choose from; a switch has its value here
    kind : SETTING, DRAWN, OUTPUT or ""
    needs : names of options, or WINDOW, one of which it needs
    excludes : names or kinds of options that it cannot be used with; because : why
    """

    words: str
    help: str
    parse: object = PATH
    kind: str = ""
    needs: tuple = ()
    excludes: tuple = ()
    because: str = ""
    dest: str = ""

    def __post_init__(self):
        self.name, _, self.value = self.words.partition(" ")
        self.dest = self.dest or self.name.strip("-").replace("-", "_").lower()

    def add_to(self, group):
        """Adds it to an argparse group."""
        form = {"help": self.help, "action": "store_const", "const": self.parse}
        if self.value:
            kind = "type" if callable(self.parse) else "choices"
            form = {"help": self.help, "metavar": self.value, kind: self.parse}
        if self.name == "--show":
            form["action"] = "append"
        group.add_argument(self.name, dest=self.dest, **form)


def _setting(one):
    """Returns the Option of a SettingText."""
    setting, words, parse = one.setting, f"--{one.option}", option_type(one.parsed)
    text = f"with --solver {setting.solver}: " * bool(setting.solver) + one.help
    if setting.kind is bool:
        parse = not setting.default
    else:
        words += " " + {float: "X", int: "N"}.get(setting.kind, "NAME")
        text += "" if setting.default is None else f" (default: {setting.default})"
    return Option(words, text, parse, SETTING, dest=one.name)


def _output(words, text):
    """Returns the Option of one of OUTPUTS."""
    one = OUTPUTS[words.split()[0].strip("-")]
    return Option(words, text, option_type(one.checked), OUTPUT)


def _drawn(words, text, parse=PATH, dest="", needs=(*DRAWINGS, WINDOW)):
    """Returns the Option of a field of PictureOptions."""
    return Option(words, text, parse, DRAWN, needs, dest=dest)


# All options, by group of --help.
GROUPS = {
    "a student's functions": (
        Option(
            "--functions DIR",
            "run the functions and the methods of Mesh in DIR/RBSFunctions.py, such as a "
            "student's, from this project's run_timestep, and name their first difference from "
            "this project's. They run with your rights",
        ),
    ),
    "simulation": (
        Option("--basic", "ignore the settings that a scene file recommends", True),
        *(_setting(one) for one in BY_OPTION.values() if not one.isOfConstraints),
    ),
    "constraints": (
        Option(
            "--constraints FILE",
            "constraints (default: NAME-constraints.txt beside NAME-scene.txt, if it exists)",
            excludes=("--no-constraints",),
            because="constraints are ignored",
        ),
        *(_setting(one) for one in BY_OPTION.values() if one.isOfConstraints),
    ),
    "without a window": (
        Option("--headless", "simulate and print a summary. Needs no display and no OpenGL", True),
        Option(
            "--steps N",
            f"number of steps (default: {DEFAULT_STEPS}; with --replay, all that are recorded)",
            number_type(int, 0),
        ),
        Option(
            "--trace STEP[:BODY]",
            "print the events of a step with the numbers of each formula; with BODY, a number "
            "(from 0) or a name, only its events",
            option_type(_traced_step),
            OUTPUT,
            excludes=("--replay", "--verify", "--steps", "--every", OUTPUT),
            because="it only prints the events of one step; --resume traces a step of a recording",
        ),
        Option("--screenshots DIR", "draw pictures into DIR/frame_<step>.png", kind=OUTPUT),
        _output("--video FILE", "draw a video, .mp4 or .gif, in real time"),
        Option(
            "--every K",
            f"draw every K-th step (default: {DEFAULT_EVERY} for --screenshots; for --video, "
            f"about {VIDEO_RATE:g} frames per second)",
            POSITIVE_NUMBER,
            needs=DRAWINGS,
        ),
    ),
    "picture": (
        _drawn(
            "--size WxH",
            f"pixels, also of the window (default: {'x'.join(map(str, PICTURE_SIZE))})",
            option_type(_size),
        ),
        _drawn(
            "--look NAME",
            "look of --screenshots and --video: plain, as in the window; or studio, with sky light "
            "and soft shadows, which takes seconds per picture (default: plain)",
            LOOKS,
            needs=DRAWINGS,
        ),
        _drawn("--camera FILE.json", "viewpoint, saved from the window (default: the whole scene)"),
        _drawn(
            "--colours NAME",
            f"quantity that colours show: {', '.join(COLOURINGS)} (default: body)",
            [*COLOURINGS],
            "colouring",
            (*DRAWINGS, "--export", WINDOW),
        ),
        _drawn(
            "--show NAME",
            f"overlay; may be repeated; quote a name with a blank: {', '.join(OVERLAYS)}",
            [*OVERLAYS],
            "overlays",
        ),
    ),
    "recordings": (
        _output("--record FILE.h5", "record the state at the start and after every step"),
        Option(
            "--replay FILE.h5",
            "show a recording",
            excludes=(*FROM_FILES, SETTING, "--record", "--functions", "--resume"),
            because="a replay does not simulate; --resume can change settings and be recorded",
        ),
        Option(
            "--resume FILE.h5",
            "continue from a recorded state, with the recorded settings unless options change them",
            excludes=FROM_FILES,
            because="scene and settings come from the recording",
        ),
        Option(
            "--from STEP",
            "the step that --resume continues from (default: the last one)",
            number_type(int, 0),
            needs=("--resume",),
            dest="from_step",
        ),
        Option(
            "--verify FILE.h5",
            "simulate again, compare all states bit for bit, and name the first step that differs",
            excludes=(*FROM_FILES, SETTING, OUTPUT, DRAWN, "--steps", "--replay", "--resume"),
            because="it only repeats the recording, with its scene and settings",
        ),
        _output("--stats FILE.csv", "write energies, momenta, contacts and times of every step"),
        _output(
            "--export FILE",
            "write the run as an .html page that plays it in any browser (needs k3d), or as an "
            "animated glTF 2.0 file, .glb, for Blender (needs pygltflib)",
        ),
    ),
}
SCENE = Option("SCENE", f"a scene file, or one of the scenes below (default: {DEFAULT_SCENE})")
TABLE = [SCENE, *(one for rows in GROUPS.values() for one in rows)]


def make_parser():
    """Returns the ArgumentParser of all options, in the order of --help."""
    parser = OneLineParser(
        prog=PROGRAM_NAME,
        usage=f"{PROGRAM_NAME} [SCENE] [options]",
        description=INTRODUCTION,
        epilog=SCENE_LIST,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("scene", metavar=SCENE.name, nargs="?", type=SCENE.parse, help=SCENE.help)
    version = f"{PROGRAM_NAME} {__version__}"
    parser.add_argument("--version", action="version", version=version, help="print the version")
    for title, rows in GROUPS.items():
        group = parser.add_argument_group(title)
        for one in rows:
            one.add_to(group)
    return parser


def parse_options(arguments=None):
    """Returns the options of a command line, with an attribute for each, None if it is not given.

    Exits with a one-line message if they are invalid, or cannot be combined.
    """
    parser = make_parser()
    options = parser.parse_args(arguments)
    given = given_options(options)
    names = {one.name for one in given}
    if not is_without_window(options):
        names.add(WINDOW)
    for one in given:
        if one.needs and names.isdisjoint(one.needs):
            parser.error(f"{one.name} needs {' or '.join(one.needs)}")
        for other in given:
            if other is not one and not {other.name, other.kind}.isdisjoint(one.excludes):
                parser.error(f"{other.name} cannot be used with {one.name}: {one.because}")
    return options


def given_options(options):
    """Returns the list of `Option`s that are given."""
    return [one for one in TABLE if getattr(options, one.dest) is not None]


def is_without_window(options):
    """Returns whether the run has no window, because of --headless or an output."""
    return bool(options.headless) or any(one.kind == OUTPUT for one in given_options(options))


def given_values(options, names):
    """Returns those of the `names`, such as SETTINGS, that are given: dict by attribute."""
    values = {name: getattr(options, name, None) for name in names}
    return {name: value for name, value in values.items() if value is not None}
