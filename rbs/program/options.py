"""The command line's options: what there is, which values they take, what goes with what.

From the top: the parser and its groups; which options are given, and whether they go together; the
settings that they give; kinds of values.
"""

import argparse
import re
import sys
from pathlib import Path

from rbs.appearance.colours import COLOURINGS
from rbs.appearance.pictureoptions import (
    FASTEST_VIDEO,
    LOOKS,
    OVERLAYS,
    PICTURE_SIZE,
    PICTURE_SIZES,
    SLOWEST_VIDEO,
    VIDEO_ENDINGS,
    VIDEO_RATE,
)
from rbs.program.catalogue import SCENES
from rbs.recordings.recording import RECORDING_ENDINGS
from rbs.scenes.messages import PROGRAM_NAME, one_line, short
from rbs.scenes.textfiles import plain_float, plain_int
from rbs.stepping.settings import BY_OPTION

# What runs where no scene is named.
DEFAULT_SCENE = "mixed"
# Ten seconds with the default time step: the falls and the settling of every scene in data/.
DEFAULT_STEPS = 500
# Five pictures a second with the default time step.
DEFAULT_EVERY = 10
# The most steps, or visits, that can be asked for: more than there will be time for, and a number
# that floats hold exactly.
MOST_STEPS = 10**15
# What --help begins with, and ends with.
INTRODUCTION = """\
Simulates rigid bodies that fall, collide and bounce, and shows them.

  RigidBodySimulation.py                                  the mixed scene, in a window
  RigidBodySimulation.py tower                            another scene; see the list below
  RigidBodySimulation.py stress --video stress.mp4        a video
  RigidBodySimulation.py bridge --record bridge.h5       a run without a window, recorded
  RigidBodySimulation.py --replay bridge.h5              and looked at again

Where there is no display, a scene runs off-screen: pictures go to out/<scene>, and a summary is
printed."""
SCENE_LIST = "scenes:\n" + "\n".join(
    f"  {group}\n" + "\n".join(f"    {name:<18}{line}" for name, line in lines.items())
    for group, lines in SCENES.items()
)
# An example for each group of options.
PHYSICS_EXAMPLES = "RigidBodySimulation.py stress --friction 0.5 --restitution 0.2"
CONSTRAINT_EXAMPLES = "RigidBodySimulation.py bridge --scheduling queue"
OUTPUT_EXAMPLES = """\
RigidBodySimulation.py stress --screenshots out/stress --every 25
RigidBodySimulation.py bridge --video bridge.mp4 --steps 300"""
RECORDING_EXAMPLES = """\
RigidBodySimulation.py tower --record tower.h5 --stats tower.csv --steps 1000
RigidBodySimulation.py --replay tower.h5
RigidBodySimulation.py --resume tower.h5 --from 500 --friction 0.4"""

# The options that change the settings, under the names that argparse gives them.
SETTING_OPTIONS = {option.replace("-", "_"): one for option, one in BY_OPTION.items()}
WITHOUT_WINDOW = frozenset(
    {"headless", "screenshots", "video", "record", "stats", "plot", "export"}
)
# What does not go with what, and why.
CONFLICTS = {
    "replay": (
        {*SETTING_OPTIONS, "scene", "constraints", "basic", "record", "functions"},
        "a replay simulates nothing; --resume goes on with other settings, and may be recorded",
    ),
    "resume": (
        {"scene", "constraints", "basic"},
        "it goes on with the scene and the settings of the recording",
    ),
    "verify": (
        {*SETTING_OPTIONS, "scene", "constraints", "basic", "steps", "every"}
        | WITHOUT_WINDOW - {"headless"}
        | {"look"},
        "it only compares, and with the scene and the settings of the recording",
    ),
    "video": ({"transparent"}, "videos have no transparency"),
    "no_constraints": ({"constraints"}, "all bodies go free"),
}
# What makes no sense without another option.
COMPANIONS = {
    "every": (
        {"screenshots", "video"},
        "says how often --screenshots or --video draws, which is missing",
    ),
    "fps": ({"video"}, "says how fast --video plays, which is missing"),
    "transparent": ({"screenshots"}, "says how --screenshots draws, which is missing"),
    "our_loop": ({"functions"}, "says how --functions makes its steps, which is missing"),
    "from_step": ({"resume"}, "says where --resume starts, which is missing"),
}


def make_parser():
    """The ArgumentParser of all options; their order is that of --help."""
    parser = OneLineParser(
        prog=PROGRAM_NAME,
        usage=f"{PROGRAM_NAME} [SCENE] [options]",
        description=INTRODUCTION,
        epilog=SCENE_LIST,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
        argument_default=argparse.SUPPRESS,
    )
    parser.add_argument(
        "scene",
        metavar="SCENE",
        nargs="?",
        type=PATH,
        help=f"a scene file, or the name of a scene of data/ (default: {DEFAULT_SCENE})",
    )
    parser.add_argument(
        "--allow-outside-meshes",
        action="store_true",
        help="read meshes that a scene names by an absolute path, by .. or through a symbolic link "
        "out of its folder too (default: only those in its folder, or below)",
    )
    parser.add_argument(
        "--functions",
        metavar="DIR",
        type=PATH,
        help="make the steps with the RBSFunctions.py of this folder, a student's for instance, "
        "which runs with your rights; options that its run_timestep does not know are refused. "
        "graders/compare.py finds the first step and call that differs from this project's",
    )
    parser.add_argument(
        "--our-loop",
        action="store_true",
        help="with --functions: this project's step, with its order and its end of the constraint "
        "visits, around the functions and the Mesh of that folder. The coursework's released "
        "run_timestep drops a corrected velocity and ends early where there are many constraints",
    )

    add_physics_options(parser)
    add_constraint_options(parser)
    add_output_options(parser)
    add_recording_options(parser)
    return parser


def add_physics_options(parser):
    """Contacts, friction, the time step, the broad phase."""
    physics = parser.add_argument_group("simulation", PHYSICS_EXAMPLES)
    physics.add_argument(
        "--basic",
        action="store_true",
        help="the coursework's behaviour, whatever the scene recommends (by default, settings that "
        "a scene recommends, as '# suggests friction 0.5' does, are used unless they are given)",
    )
    for one in BY_OPTION.values():
        if not one.isOfConstraints:
            add_setting(physics, one)


def add_constraint_options(parser):
    """Which constraints there are, and how they are solved."""
    constraints = parser.add_argument_group("constraints", CONSTRAINT_EXAMPLES)
    constraints.add_argument(
        "--constraints",
        metavar="FILE",
        type=PATH,
        help="the constraints between the bodies (default: NAME-constraints.txt beside "
        "NAME-scene.txt, if there is one)",
    )
    for one in BY_OPTION.values():
        if one.isOfConstraints:
            add_setting(constraints, one)


def add_setting(group, one):
    """Adds the option of a Setting; its value is there only where it is given."""
    name = "--" + one.option
    only = "" if one.solver is None else f"with --solver {one.solver}: "
    if one.kind is bool:
        group.add_argument(name, action="store_true", help=only + one.help)
        return
    default = "" if one.default is None else f" (default: {one.default})"
    metavar = {float: "X", int: "N"}.get(one.kind, "NAME")
    group.add_argument(
        name, metavar=metavar, type=setting_type(one), help=only + one.help + default
    )


def setting_type(one):
    """An argparse type of a Setting."""

    def parse(text):
        try:
            return one.parsed(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return parse


def add_output_options(parser):
    """Runs without a window, and what pictures and videos look like."""
    output = parser.add_argument_group("without a window", OUTPUT_EXAMPLES)
    output.add_argument(
        "--headless",
        action="store_true",
        help="simulate without a window and print a summary; needs no display and no OpenGL",
    )
    output.add_argument(
        "--steps",
        metavar="N",
        type=WHOLE_NUMBER,
        help=f"how many steps a run without a window has (default: {DEFAULT_STEPS}, or all that "
        "are recorded)",
    )
    output.add_argument(
        "--screenshots",
        metavar="DIR",
        type=PATH,
        help="draw off-screen into DIR/frame_<step>.png; no window opens",
    )
    output.add_argument(
        "--video",
        metavar="FILE",
        type=option_type(str, checked_video, "path"),
        help="draw off-screen into a video, .mp4 or .gif; no window opens",
    )
    output.add_argument(
        "--every",
        metavar="K",
        type=POSITIVE_NUMBER,
        help=f"one picture each K steps (default: {DEFAULT_EVERY} for --screenshots; for --video, "
        "so that it plays in real time)",
    )
    output.add_argument(
        "--fps",
        metavar="R",
        type=option_type(plain_float, checked_rate, "number"),
        help=f"pictures a second in a video (default: near {VIDEO_RATE:g}, so that it "
        "plays in real time)",
    )
    picture = parser.add_argument_group("picture")
    picture.add_argument(
        "--size",
        metavar="WxH",
        type=option_type(str, checked_size, "size"),
        help=f"in pixels, also of the window (default: {'x'.join(map(str, PICTURE_SIZE))})",
    )
    picture.add_argument(
        "--look",
        metavar="NAME",
        choices=LOOKS,
        help="plain, as the window; or studio, with sky light and soft shadows, seconds a picture: "
        "for --screenshots, --video and the window's Picture button (default: plain)",
    )
    picture.add_argument(
        "--camera",
        metavar="FILE.json",
        type=PATH,
        help="where to look from, as saved from the window (default: all of the scene is seen)",
    )
    picture.add_argument(
        "--colours",
        metavar="NAME",
        choices=COLOURINGS,
        help=f"what bodies are coloured by: {', '.join(COLOURINGS)} (default: body)",
    )
    picture.add_argument(
        "--show",
        metavar="NAME",
        choices=OVERLAYS,
        action="extend",
        nargs="+",
        help=f"what is drawn over them: {', '.join(OVERLAYS)}",
    )
    picture.add_argument(
        "--legend",
        action="store_true",
        help="in pictures and videos, say what the colours and arrows mean, as the window does",
    )
    picture.add_argument(
        "--transparent",
        action="store_true",
        help="with --screenshots: no background and no ground, only bodies and their shadows",
    )


def add_recording_options(parser):
    """Recordings and statistics."""
    recordings = parser.add_argument_group("recordings", RECORDING_EXAMPLES)
    recordings.add_argument(
        "--record",
        metavar="FILE.h5",
        type=option_type(str, checked_recording, "path"),
        help="write the state after every step, and the starting state; no window opens. The file "
        "can be read while it grows, and after a crash",
    )
    source = recordings.add_mutually_exclusive_group()
    source.add_argument(
        "--replay",
        metavar="FILE.h5",
        type=PATH,
        help="show a recording, simulating nothing",
    )
    source.add_argument(
        "--resume",
        metavar="FILE.h5",
        type=PATH,
        help="go on from a recorded state, with the settings of the recording and those that are "
        "given as options",
    )
    source.add_argument(
        "--verify",
        metavar="FILE.h5",
        type=PATH,
        help="simulate once more and compare every state to the last bit; exit code 1, and the "
        "first step that differs, where they are not the same",
    )
    recordings.add_argument(
        "--from",
        dest="from_step",
        metavar="STEP",
        type=WHOLE_NUMBER,
        help="with --resume, the step to go on from (default: the last one)",
    )
    recordings.add_argument(
        "--stats",
        metavar="FILE.csv",
        type=PATH,
        help="write energies, momenta, contacts, violations and times of every step; no window "
        "opens",
    )
    recordings.add_argument(
        "--plot",
        metavar="FILE.png",
        type=PATH,
        help="draw the same numbers over time; needs matplotlib; no window opens",
    )
    recordings.add_argument(
        "--export",
        metavar="FILE.glb",
        type=option_type(str, checked_export, "path"),
        help="write the run as an animated glTF 2.0 file, for Blender and other 3-D programs; "
        "needs pygltflib; no window opens",
    )


class Options(dict):
    """The options that are given, by argparse's names; as attributes, all others are None."""

    __getattr__ = dict.get


def parse_options(arguments=None):
    """The Options of a command line; ends the program with one line where it is wrong."""
    parser = make_parser()
    options = Options(vars(parser.parse_args(arguments)))
    check_options(parser, options)
    return options


def check_options(parser, options):
    """Ends the program with one line where the given options do not go together."""
    given = set(options)
    for dest, (companions, cause) in COMPANIONS.items():
        if dest in given and not given & companions:
            parser.error(f"{option_name(dest)} {cause}")
    if "look" in given and given & WITHOUT_WINDOW and not given & {"screenshots", "video"}:
        parser.error("--look says how pictures look, but this run draws none")
    for mode, (others, cause) in CONFLICTS.items():
        for dest in sorted(given & others if mode in given else ()):
            parser.error(f"{option_name(dest)} does not go with {option_name(mode)}: {cause}")


def option_name(dest):
    """How an option is written on the command line."""
    names = {"from_step": "--from", "scene": "SCENE"}
    return names.get(dest, "--" + dest.replace("_", "-"))


def given_settings(options):
    """The settings that the options give: dict by the fields of `Settings`."""
    return {
        one.name: not one.default if one.kind is bool else options[dest]
        for dest, one in SETTING_OPTIONS.items()
        if dest in options
    }


class OneLineParser(argparse.ArgumentParser):
    """Reports a wrong command line in one line: argparse itself puts the whole usage before it."""

    def parse_args(self, args=None, namespace=None):
        words = sys.argv[1:] if args is None else args
        for word in map(str, words):
            if word.startswith("--") and word.endswith("=--"):  # argparse makes an empty list of it
                self.error(f"argument {word[:-3]}: '--' is not a value")
        return super().parse_args(args, namespace)

    def error(self, message):
        self.exit(2, f"{self.prog}: {one_line(message)} (--help lists the options)\n")


def option_type(convert, check, kind):
    """An argparse type whose errors say what is wrong. check : value -> value, or ValueError"""

    def parse(text):
        try:
            value = convert(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"'{short(text)}' is not a {kind}") from None
        try:
            return check(value)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return parse


def at_least(low, high):
    """A check that numbers are not below `low`, and not above `high`."""

    def check(value):
        if not low <= value <= high:
            bound = f"{low} or more" if value < low else f"{high} or less"
            raise ValueError(f"must be {bound}, not {short(str(value))}")
        return value

    return check


def checked_size(text):
    """(width, height) of "1280x720"; else ValueError."""
    match = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", text)
    size = tuple(map(int, match.groups())) if match else (0, 0)
    low, high = PICTURE_SIZES
    if not low <= min(size) <= max(size) <= high:
        allowed = f"WIDTHxHEIGHT, from {low} to {high} pixels each"
        raise ValueError(f"must be {allowed}, not '{short(text)}'")
    return size


def checked_video(path):
    """The path, if its ending is that of a video; else ValueError."""
    if Path(path).suffix.lower() not in VIDEO_ENDINGS:
        endings = " or ".join(VIDEO_ENDINGS)
        raise ValueError(f"the name of a video must end in {endings}, not '{path}'")
    return path


def checked_export(path):
    """The path, if its ending is .glb; else ValueError."""
    if Path(path).suffix.lower() != ".glb":
        raise ValueError(f"the name of an export must end in .glb, not '{path}'")
    return path


def checked_recording(path):
    """The path, if its ending is that of a recording; else ValueError."""
    if Path(path).suffix not in RECORDING_ENDINGS:
        endings = " or ".join(RECORDING_ENDINGS)
        raise ValueError(f"the name of a recording must end in {endings}, not '{path}'")
    return path


def checked_path(path):
    """The path, if it is one at all; else ValueError."""
    if not path:
        raise ValueError("the name of a file or folder must not be empty")
    return path


def checked_rate(value):
    """Pictures a second, if a video can have as many; else ValueError."""
    if not SLOWEST_VIDEO <= value <= FASTEST_VIDEO:
        raise ValueError(f"must lie between {SLOWEST_VIDEO:g} and {FASTEST_VIDEO:g}, not {value:g}")
    return value


# Kinds of option values, each with its message when it is something else.
WHOLE_NUMBER = option_type(plain_int, at_least(0, MOST_STEPS), "whole number")
POSITIVE_NUMBER = option_type(plain_int, at_least(1, MOST_STEPS), "whole number")
PATH = option_type(str, checked_path, "path")
