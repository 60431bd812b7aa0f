"""The options of the command line: how each is read, what --help says, and what it goes with.

From the top: the texts around --help; `Option`; the table of all options; the parser; the options
and settings that are given.
"""

import argparse
import re

from rbs import __version__
from rbs.appearance.camera import (
    LOOKS,
    PICTURE_SIZE,
    PICTURE_SIZES,
    VIDEO_RATE,
)
from rbs.appearance.colours import COLOURINGS
from rbs.pictures.overlays import OVERLAYS
from rbs.program.parsing import (
    OWN_PARAMETERS,
    PATH,
    POSITIVE_NUMBER,
    WHOLE_NUMBER,
    OneLineParser,
    option_type,
    path_type,
    setting_type,
)
from rbs.recordings.lookup import SCENES
from rbs.recordings.writers import OUTPUTS
from rbs.scenes.messages import PROGRAM_NAME, short
from rbs.scenes.state import DEFAULT_STEPS
from rbs.stepping.settings import BY_OPTION

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
  {PROGRAM_NAME} bridge --record bridge.h5        a recording
  {PROGRAM_NAME} --replay bridge.h5               its replay

Without a display, the program draws the scene off-screen into out/<scene> and prints a summary."""
SCENE_LIST = "scenes:\n" + "\n".join(
    f"  {group}\n" + "\n".join(f"    {name:<18}{line}" for name, line in lines.items())
    for group, lines in SCENES.items()
)
# What options may need or exclude, besides other options: the window, and all options of a kind.
WINDOW, SETTING, DRAWN, OUTPUT = "the window", "a setting", "what is drawn", "an output"
DRAWINGS = ("--screenshots", "--video")
FROM_FILES = ("SCENE", "--constraints", "--basic")


def _traced_step(text):
    """Returns (step, body) of a text like "70:box 3"; for "70", body is None."""
    step, colon, body = text.partition(":")
    return POSITIVE_NUMBER(step), body if colon else None


def _checked_size(text):
    """Returns (width, height) of a text like "1280x720". Raises ValueError."""
    match = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", text)
    size = tuple(map(int, match.groups())) if match else (0, 0)
    low, high = PICTURE_SIZES
    if not low <= min(size) <= max(size) <= high:
        allowed = f"WIDTHxHEIGHT, from {low} to {high} pixels each"
        raise ValueError(f"must be {allowed}, not '{short(text)}'")
    return size


TRACED_STEP = option_type(str, _traced_step, "step")
SIZE = option_type(str, _checked_size, "size")


class Option:
    """An option of the command line.

    name : with its dashes; value : what stands for its value in --help, or "" for a switch
    parse : function from text to value, an argparse type, or the names to choose from
    kind : SETTING, DRAWN, OUTPUT or ""
    needs : names of options, or WINDOW, one of which it needs
    excludes : names or kinds of options that it cannot be used with; because : why
    help : what --help says
    dest : the attribute of `parse_options`
    """

    def __init__(self, words, parse=PATH, kind="", needs=(), excludes=(), because=""):
        """words : name and value, as in --help"""
        self.name, _, self.value = words.partition(" ")
        self.parse, self.kind, self.needs, self.excludes = parse, kind, needs, excludes
        self.because = because
        self.dest = self.name.strip("-").replace("-", "_").lower()
        if self.dest == "from":  # a keyword
            self.dest = "from_step"

    def explained(self, text):
        """Sets the help and returns the option."""
        self.help = text
        return self

    def add_to(self, group):
        """Adds it to an argparse group. It is None unless it is given."""
        form = {"metavar": self.value or None, "help": self.help}
        if self.name == "SCENE":
            group.add_argument(self.dest, nargs="?", type=self.parse, **form | {"metavar": "SCENE"})
        elif not self.value:
            group.add_argument(self.name, action="store_true", default=None, help=self.help)
        else:
            form |= {"type": self.parse} if callable(self.parse) else {"choices": self.parse}
            form |= {"action": "append"} if self.name in SEVERAL else {}
            group.add_argument(self.name, dest=self.dest, **form)


def _setting(one):
    """Returns the Option of a Setting."""
    text = ("" if one.solver is None else f"with --solver {one.solver}: ") + one.help
    words, parse = f"--{one.option}", setting_type(one)
    if one.kind is not bool:
        words += " " + {float: "X", int: "N"}.get(one.kind, "NAME")
        text += "" if one.default is None else f" (default: {one.default})"
    return Option(words, parse, SETTING).explained(text)


def _output(words, **rules):
    """Returns the Option of one of OUTPUTS."""
    one = OUTPUTS[words.split()[0].strip("-")]
    return Option(words, path_type(one.what, one.checked), OUTPUT, **rules)


def _drawn(words, parse=PATH, needs=(*DRAWINGS, WINDOW)):
    """Returns the Option of something that is drawn."""
    return Option(words, parse, DRAWN, needs)


# Options that may have several values.
SEVERAL = {"--show": OVERLAYS}
# All options, by group of --help.
GROUPS = {
    "options": (
        Option("SCENE").explained(
            f"a scene file, or the name of a scene in data/ (default: {DEFAULT_SCENE})"
        ),
        Option("--functions DIR").explained(
            "simulate with the RBSFunctions.py in DIR, such as a student's. It runs with your "
            "rights. Options that its run_timestep has no parameter for are refused. "
            "graders/compare.py finds the first step and call that differs from this project's"
        ),
        Option("--set NAME=VALUE,...", OWN_PARAMETERS, needs=("--functions",)).explained(
            "with --functions: parameters that the run_timestep in DIR has beyond the coursework's"
        ),
        Option("--our-loop", needs=("--functions",)).explained(
            "with --functions: replace the run_timestep in DIR by this project's loop, and call "
            "the other functions and the Mesh in DIR. The coursework's released run_timestep loses "
            "a corrected velocity, and stops too early if there are many constraints. "
            "--broad-phase selects this loop, too"
        ),
    ),
    "simulation": (
        Option("--basic").explained(
            "ignore the settings that a scene file recommends (in lines such as '# suggests "
            "friction 0.5'), and start from the coursework's behaviour"
        ),
        *(_setting(one) for one in BY_OPTION.values() if not one.isOfConstraints),
    ),
    "constraints": (
        Option(
            "--constraints FILE",
            excludes=("--no-constraints",),
            because="constraints are ignored",
        ).explained(
            "constraints between the bodies (default: NAME-constraints.txt beside NAME-scene.txt, "
            "if it exists)"
        ),
        *(_setting(one) for one in BY_OPTION.values() if one.isOfConstraints),
    ),
    "without a window": (
        Option("--headless").explained(
            "simulate without a window and print a summary. Needs no display and no OpenGL"
        ),
        Option("--steps N", WHOLE_NUMBER).explained(
            f"number of steps of a run without a window (default: {DEFAULT_STEPS}; with --replay, "
            "all that are recorded)"
        ),
        Option(
            "--trace STEP[:BODY]",
            TRACED_STEP,
            OUTPUT,
            excludes=("--replay", "--verify", "--steps", "--every", OUTPUT),
            because="it only prints the events of one step; --resume traces a step of a recording",
        ).explained(
            "print what happens in a step, event by event, with the numbers of each formula: free "
            "flight, contacts, corrections, impulses, friction, constraints. With BODY, a number "
            "(from 0) or a name, only its events. Two outputs can be compared with diff. With "
            "--functions, this project's loop calls the functions, as with --our-loop"
        ),
        Option("--screenshots DIR", kind=OUTPUT).explained(
            "draw pictures into DIR/frame_<step>.png, without a window"
        ),
        _output("--video FILE").explained("draw a video, .mp4 or .gif, without a window"),
        Option("--every K", POSITIVE_NUMBER, needs=DRAWINGS).explained(
            f"draw every K-th step (default: {DEFAULT_EVERY} for --screenshots; for --video, "
            f"about {VIDEO_RATE:g} frames per second). A video plays in real time"
        ),
    ),
    "picture": (
        _drawn("--size WxH", SIZE).explained(
            f"size in pixels, also of the window (default: {'x'.join(map(str, PICTURE_SIZE))})"
        ),
        _drawn("--look NAME", LOOKS, DRAWINGS).explained(
            "of --screenshots and --video: plain, as in the window; or studio, with sky light and "
            "soft shadows, which takes seconds per picture (default: plain)"
        ),
        _drawn("--camera FILE.json").explained(
            "viewpoint, saved from the window (default: the whole scene is in view)"
        ),
        _drawn("--colours NAME", [*COLOURINGS], (*DRAWINGS, "--export", WINDOW)).explained(
            "quantity that the bodies' colours show, also in an exported page: "
            f"{', '.join(COLOURINGS)} (default: body)"
        ),
        _drawn("--show NAME", [*OVERLAYS]).explained(
            f"overlays to draw, one or more: {', '.join(OVERLAYS)}. Put names with a blank in "
            "quotes"
        ),
    ),
    "recordings": (
        _output("--record FILE.h5").explained(
            "record the state at the start and after every step, without a window. The file can be "
            "read while it grows, and after a crash"
        ),
        Option(
            "--replay FILE.h5",
            excludes=(*FROM_FILES, SETTING, "--record", "--functions", "--resume"),
            because="a replay does not simulate; --resume can change settings and be recorded",
        ).explained("show a recording"),
        Option(
            "--resume FILE.h5",
            excludes=FROM_FILES,
            because="scene and settings come from the recording",
        ).explained(
            "continue from a recorded state, with the recorded settings unless options change them"
        ),
        Option(
            "--verify FILE.h5",
            excludes=(*FROM_FILES, SETTING, OUTPUT, DRAWN)
            + ("--steps", "--every", "--replay", "--resume"),
            because="it only repeats the recording, with its scene and settings",
        ).explained(
            "simulate again and compare every state, bit for bit. If one differs, the first step "
            "that differs is named, and the exit code is 1"
        ),
        Option("--from STEP", WHOLE_NUMBER, needs=("--resume",)).explained(
            "with --resume: the step to continue from (default: the last one)"
        ),
        _output("--stats FILE.csv").explained(
            "write energies, momenta, contacts, violations and times of every step, without a "
            "window"
        ),
        _output("--export FILE").explained(
            "write the run, without a window: as an .html page that plays it in any browser (needs "
            "k3d), or as an animated glTF 2.0 file, .glb, for Blender and other 3-D programs "
            "(needs pygltflib)"
        ),
    ),
}
TABLE = [one for rows in GROUPS.values() for one in rows]
# Examples of some groups.
EXAMPLES = {
    "simulation": ("stress --friction 0.5 --restitution 0.2",),
    "constraints": ("bridge --scheduling queue",),
    "without a window": (
        "stress --screenshots out/stress --every 25",
        "bridge --video bridge.mp4 --steps 300",
    ),
    "recordings": (
        "tower --record tower.h5 --stats tower.csv --steps 1000",
        "--replay tower.h5",
        "--resume tower.h5 --from 500 --friction 0.4",
    ),
}


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
    parser.several = SEVERAL
    version = f"{PROGRAM_NAME} {__version__}"
    parser.add_argument("--version", action="version", version=version, help="print the version")
    for title, rows in GROUPS.items():
        examples = "\n".join(f"{PROGRAM_NAME} {one}" for one in EXAMPLES.get(title, ()))
        group = parser
        if title != "options":
            group = parser.add_argument_group(title, examples or None)
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
            *others, last = one.needs
            needed = f"{', '.join(others)} or {last}" if others else last
            parser.error(f"{one.name} needs {needed}")
    for one in given:
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


def given_settings(options):
    """Returns the settings that are given as options: dict by field of `Settings`."""
    values = {}
    for option, one in BY_OPTION.items():
        value = getattr(options, option.replace("-", "_"))
        if value is not None:
            values[one.name] = not one.default if one.kind is bool else value
    return values
