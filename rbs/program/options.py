"""The options of the command line, their values, and which of them exclude each other.

From the top: the texts of --help; kinds of values; the options, and which can be combined; the
parser; the options and settings that are given.
"""

import argparse
import re
import sys

from rbs import __version__
from rbs.appearance.colours import COLOURINGS
from rbs.appearance.pictureoptions import (
    FASTEST_VIDEO,
    LOOKS,
    PICTURE_SIZE,
    PICTURE_SIZES,
    SLOWEST_VIDEO,
    VIDEO_ENDINGS,
    VIDEO_RATE,
)
from rbs.pictures.overlays import OVERLAYS
from rbs.program.submissions import parameter
from rbs.recordings.catalogue import SCENES
from rbs.recordings.formats import EXPORT_ENDINGS
from rbs.recordings.recording import RECORDING_ENDINGS
from rbs.scenes.files import check_ending
from rbs.scenes.messages import PROGRAM_NAME, one_line, short
from rbs.scenes.state import DEFAULT_STEPS
from rbs.scenes.textfiles import plain_float, plain_int
from rbs.stepping.settings import BY_OPTION

# The scene that runs if none is named.
DEFAULT_SCENE = "heap"
# Steps between screenshots: five pictures per simulated second with the default time step.
DEFAULT_EVERY = 10
# Largest number of steps, or of visits: more than time allows, and exact as a float.
MOST_STEPS = 10**15
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
# Examples of groups of options.
RUN_EXAMPLES = (
    "stress --screenshots out/stress --every 25",
    "bridge --video bridge.mp4 --steps 300",
)
RECORDING_EXAMPLES = (
    "tower --record tower.h5 --stats tower.csv --steps 1000",
    "--replay tower.h5",
    "--resume tower.h5 --from 500 --friction 0.4",
)
# The options that change no setting: a line as --help shows it, and lines of explanation.
OF_PROGRAM = """
--allow-outside-meshes
    also read meshes outside the scene's folder, which the scene names by an absolute path, by ..
    or through a symbolic link
--functions DIR
    simulate with the RBSFunctions.py in DIR, such as a student's. It runs with your rights. Options
    that its run_timestep has no parameter for are refused. graders/compare.py finds the first step
    and call that differs from this project's
--set NAME=VALUE
    with --functions: a parameter that the run_timestep in DIR has beyond the coursework's; may be
    repeated
--our-loop
    with --functions: replace the run_timestep in DIR by this project's loop, and call the other
    functions and the Mesh in DIR. The coursework's released run_timestep loses a corrected
    velocity, and stops too early if there are many constraints. --broad-phase selects this loop,
    too
"""
OF_SIMULATION = """
--basic
    ignore the settings that a scene file recommends (in lines such as '# suggests friction 0.5'),
    and start from the coursework's behaviour
"""
OF_CONSTRAINTS = """
--constraints FILE
    constraints between the bodies (default: NAME-constraints.txt beside NAME-scene.txt, if it
    exists)
"""
OF_RUNS = f"""
--headless
    simulate without a window and print a summary. Needs no display and no OpenGL
--steps N
    number of steps of a run without a window (default: {DEFAULT_STEPS}; with --replay, all that are
    recorded)
--trace STEP[:BODY]
    print what happens in a step, event by event, with the numbers of each formula: free flight,
    contacts, corrections, impulses, friction, constraints. With BODY, a number (from 0) or a name,
    only its events. Two outputs can be compared with diff. With --functions, this project's loop
    calls the functions, as with --our-loop
--screenshots DIR
    draw pictures into DIR/frame_<step>.png, without a window
--video FILE
    draw a video, .mp4 or .gif, without a window
--every K
    draw every K-th step (default: {DEFAULT_EVERY} for --screenshots; for --video, chosen so that it
    plays in real time)
--fps R
    frames per second of a video (default: near {VIDEO_RATE:g}, so that it plays in real time)
"""
OF_PICTURES = f"""
--size WxH
    size in pixels, also of the window (default: {"x".join(map(str, PICTURE_SIZE))})
--look NAME
    plain, as in the window; or studio, with sky light and soft shadows, which takes seconds per
    picture. Used by --screenshots, --video and the window's Picture button (default: plain)
--camera FILE.json
    viewpoint, saved from the window (default: the whole scene is in view)
--colours NAME
    quantity that the bodies' colours show, also in an exported page: {", ".join(COLOURINGS)}
    (default: body)
--show NAME
    overlays to draw: {", ".join(OVERLAYS)}. Put names with a blank in quotes
--legend
    add the window's legend of colours and arrows to pictures and videos
--transparent
    with --screenshots: draw only bodies and their shadows, without background and ground
"""
OF_RECORDINGS = """
--record FILE.h5
    record the state at the start and after every step, without a window. The file can be read while
    it grows, and after a crash
--record-contacts
    with --record: also record the contacts of each step, with point, normal, depth and impulses,
    for other programs
--replay FILE.h5
    show a recording
--resume FILE.h5
    continue from a recorded state, with the recorded settings unless options change them
--verify FILE.h5
    simulate again and compare every state, bit for bit. If one differs, the first step that differs
    is named, and the exit code is 1
--from STEP
    with --resume: the step to continue from (default: the last one)
--stats FILE.csv
    write energies, momenta, contacts, violations and times of every step, without a window
--plot FILE.png
    plot the same quantities over time, without a window. Needs matplotlib
--export FILE
    write the run, without a window: as an .html page that plays it in any browser (needs k3d), or
    as an animated glTF 2.0 file, .glb, for Blender and other 3-D programs (needs pygltflib)
"""


def option_type(convert, check, kind):
    """Returns an argparse type with clear errors.

    convert : text -> value; check : value -> value; either may raise ValueError; kind : what the
        value is, for the message
    """

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
    """Returns a check that low ≤ number ≤ high."""

    def check(value):
        if not low <= value <= high:
            bound = f"{low} or more" if value < low else f"{high} or less"
            raise ValueError(f"must be {bound}, not {short(str(value))}")
        return value

    return check


def traced_step(text):
    """Returns (step, body) of a text like "70:box 3"; for "70", body is None."""
    step, colon, body = text.partition(":")
    return POSITIVE_NUMBER(step), body if colon else None


def checked_size(text):
    """Returns (width, height) of a text like "1280x720". Raises ValueError."""
    match = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", text)
    size = tuple(map(int, match.groups())) if match else (0, 0)
    low, high = PICTURE_SIZES
    if not low <= min(size) <= max(size) <= high:
        allowed = f"WIDTHxHEIGHT, from {low} to {high} pixels each"
        raise ValueError(f"must be {allowed}, not '{short(text)}'")
    return size


def path_type(kind, *endings):
    """Returns an argparse type: a path with one of these endings, in upper or lower case."""

    def check(path):
        if endings:
            check_ending(path, endings, kind)
        if not path:
            raise ValueError(f"the name of {kind} must not be empty")
        if path == "-":
            raise ValueError(f"must name {kind}; standard input and output cannot be used")
        return path

    return option_type(str, check, "path")


def checked_rate(value):
    """Returns a frame rate that a video can have. Raises ValueError."""
    if not SLOWEST_VIDEO <= value <= FASTEST_VIDEO:
        raise ValueError(f"must lie between {SLOWEST_VIDEO:g} and {FASTEST_VIDEO:g}, not {value:g}")
    return value


# Types of option values.
WHOLE_NUMBER = option_type(plain_int, at_least(0, MOST_STEPS), "whole number")
POSITIVE_NUMBER = option_type(plain_int, at_least(1, MOST_STEPS), "whole number")
PATH = path_type("a file or folder")
# How argparse reads some options. Others with a value take a path; the rest are switches.
FORMS = {
    "--set": {"type": option_type(str, parameter, "parameter"), "action": "append"},
    "--steps": {"type": WHOLE_NUMBER},
    "--trace": {"type": option_type(str, traced_step, "step")},
    "--video": {"type": path_type("a video", *VIDEO_ENDINGS)},
    "--every": {"type": POSITIVE_NUMBER},
    "--fps": {"type": option_type(plain_float, checked_rate, "number")},
    "--size": {"type": option_type(str, checked_size, "size")},
    "--look": {"choices": LOOKS, "type": str},
    "--colours": {"choices": COLOURINGS, "type": str},
    "--show": {"choices": [*OVERLAYS], "type": str, "action": "extend", "nargs": "+"},
    "--record": {"type": path_type("a recording", *RECORDING_ENDINGS)},
    "--from": {"type": WHOLE_NUMBER, "dest": "from_step"},
    "--plot": {"type": path_type("a plot", ".png")},
    "--export": {"type": path_type("an export", *EXPORT_ENDINGS)},
}

# The options that change settings, by their argparse names.
SETTING_OPTIONS = {option.replace("-", "_"): one for option, one in BY_OPTION.items()}
WITHOUT_WINDOW = frozenset(
    {"headless", "trace", "screenshots", "video", "record", "stats", "plot", "export"}
)
# Options of what is drawn.
DRAWN = frozenset({"size", "look", "camera", "colours", "show", "legend"})
# Options that exclude each other, and why.
CONFLICTS = {
    "replay": (
        {*SETTING_OPTIONS, "scene", "constraints", "basic", "record", "functions", "resume"},
        "a replay does not simulate; --resume can change settings and be recorded",
    ),
    "resume": (
        {"scene", "constraints", "basic"},
        "scene and settings come from the recording",
    ),
    "trace": (
        {"replay", "verify", "steps", "every"} | WITHOUT_WINDOW - {"headless", "trace"},
        "it only prints the events of one step; --resume traces a step of a recording",
    ),
    "verify": (
        {*SETTING_OPTIONS, "scene", "constraints", "basic", "steps", "every", "replay", "resume"}
        | WITHOUT_WINDOW - {"headless"}
        | DRAWN,
        "it only repeats the recording, with its scene and settings",
    ),
    "video": ({"transparent"}, "videos cannot be transparent"),
    "no_constraints": ({"constraints"}, "constraints are ignored"),
}
# Options that need one of others.
COMPANIONS = {
    "every": ("screenshots", "video"),
    "fps": ("video",),
    "transparent": ("screenshots",),
    "our_loop": ("functions",),
    "set": ("functions",),
    "from_step": ("resume",),
    "record_contacts": ("record",),
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
        argument_default=argparse.SUPPRESS,
    )
    text = f"a scene file, or the name of a scene in data/ (default: {DEFAULT_SCENE})"
    parser.add_argument("scene", metavar="SCENE", nargs="?", type=PATH, help=text)
    add_options(parser, OF_PROGRAM)
    version = f"{PROGRAM_NAME} {__version__}"
    parser.add_argument("--version", action="version", version=version, help="print the version")
    for title, examples, texts in (
        ("simulation", ["stress --friction 0.5 --restitution 0.2"], OF_SIMULATION),
        ("constraints", ["bridge --scheduling queue"], OF_CONSTRAINTS),
        ("without a window", RUN_EXAMPLES, OF_RUNS),
        ("picture", [], OF_PICTURES),
        ("recordings", RECORDING_EXAMPLES, OF_RECORDINGS),
    ):
        examples = "\n".join(f"{PROGRAM_NAME} {one}" for one in examples) or None
        group = parser.add_argument_group(title, examples)
        add_options(group, texts)
        for one in BY_OPTION.values():
            if title == ("constraints" if one.isOfConstraints else "simulation"):
                add_setting(group, one)
    return parser


def add_options(group, texts):
    """Adds the options of a text, such as OF_RUNS."""
    for block in re.split(r"\n(?=--)", texts.strip()):
        line, _, explanation = block.partition("\n")
        name, _, metavar = line.partition(" ")
        form = {"metavar": metavar, "type": PATH} if metavar else {"action": "store_true"}
        form |= FORMS.get(name, {})
        group.add_argument(name, help=" ".join(explanation.split()), **form)


def add_setting(group, one):
    """Adds the option of a Setting. It has no value unless it is given."""
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
    """Returns the argparse type of a Setting."""

    def parse(text):
        try:
            return one.parsed(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return parse


class Options(dict):
    """The options that are given, by argparse name. As an attribute, an absent one is None."""

    __getattr__ = dict.get


def parse_options(arguments=None):
    """Returns the Options of a command line. Exits with a one-line message if it is invalid."""
    parser = make_parser()
    options = Options(vars(parser.parse_args(arguments)))
    check_options(parser, options)
    return options


def check_options(parser, options):
    """Exits with a one-line message if the given options cannot be combined."""
    given = set(options)
    for dest, companions in COMPANIONS.items():
        if dest in given and not given.intersection(companions):
            names = " or ".join(map(option_name, companions))
            parser.error(f"{option_name(dest)} needs {names}")
    if given & WITHOUT_WINDOW and not given & {"screenshots", "video"}:
        for dest in sorted(given & DRAWN):
            if dest == "colours" and "export" in given:
                continue
            parser.error(f"{option_name(dest)} needs --screenshots or --video, or the window")
    for mode, (others, cause) in CONFLICTS.items():
        for dest in sorted(given & others if mode in given else ()):
            parser.error(f"{option_name(dest)} cannot be used with {option_name(mode)}: {cause}")


def option_name(dest):
    """Returns an option as it is written on the command line."""
    names = {"from_step": "--from", "scene": "SCENE"}
    return names.get(dest, "--" + dest.replace("_", "-"))


def given_settings(options):
    """Returns the settings that are given as options: dict by field of `Settings`."""
    return {
        one.name: not one.default if one.kind is bool else options[dest]
        for dest, one in SETTING_OPTIONS.items()
        if dest in options
    }


class OneLineParser(argparse.ArgumentParser):
    """Reports an invalid command line in one line, without the usage that argparse adds."""

    def parse_args(self, args=None, namespace=None):
        words = [*map(str, sys.argv[1:] if args is None else args)]
        for k in range(len(words) - 1, 0, -1):
            if re.match(r"-[\d.].*,", words[k]):  # a vector, which argparse takes for an option
                words[k - 1 : k + 1] = [f"{words[k - 1]}={words[k]}"]
        for word in words:
            if word.startswith("--") and word.endswith("=--"):  # argparse returns an empty list
                self.error(f"argument {word[:-3]}: '--' is not a value")
        return super().parse_args(words, namespace)

    def error(self, message):
        self.exit(2, f"{self.prog}: {one_line(message)} (--help lists the options)\n")
