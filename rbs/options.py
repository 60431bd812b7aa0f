"""The command line's options: what there is, which values they take, what goes with what.

From the top: the parser and its groups; which options were given, and whether they go together; the
settings that they ask for; kinds of values.
"""

import argparse
import re
import sys
from pathlib import Path

from rbs.broadphase import BROAD_PHASES
from rbs.catalogue import SCENES
from rbs.colours import COLOURINGS
from rbs.messages import PROGRAM_NAME, one_line, short
from rbs.pictureoptions import (
    FASTEST_VIDEO,
    OVERLAYS,
    PICTURE_SIZE,
    PICTURE_SIZES,
    SLOWEST_VIDEO,
    VIDEO_ENDINGS,
    VIDEO_RATE,
)
from rbs.recording import RECORDING_ENDINGS
from rbs.schedules import CONSTRAINT_SCHEDULINGS
from rbs.simulation import (
    DEFAULT_RESTITUTION,
    DEFAULT_TIME_STEP,
    LEAST_VISITS,
    MOST_SUBSTEPS,
    SWEEPS,
    Settings,
    at_least,
    checked_friction,
    checked_restitution,
    checked_time_step,
)
from rbs.solverstate import CONTACT_SOLVERS, DEFAULT_SUBSTEPS
from rbs.textfiles import plain_float, plain_int

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

# Options by what they are for, under the names that argparse gives them. First those that change
# the settings, each with the field that it changes; "no_" switches one off.
SETTING_FIELDS = {
    "restitution": "restitution",
    "time_step": "timeStep",
    "closing_only": "closingOnly",
    "friction": "friction",
    "no_constraints": "enforceConstraints",
    "scheduling": "constraintScheduling",
    "max_iterations": "maxIterations",
    "broad_phase": "broadPhase",
    "solver": "contactSolver",
    "substeps": "substeps",
    "no_sleeping": "sleeping",
    "gyroscopic": "gyroscopic",
}
# Those that make run_timestep be called with a parameter that the coursework's may not have, each
# with its name.
STEP_PARAMETERS = {
    name: "mu" if name == "friction" else field
    for name, field in SETTING_FIELDS.items()
    if name not in {"restitution", "time_step", "no_constraints"}
}
WITHOUT_WINDOW = frozenset({"headless", "screenshots", "video", "record", "stats", "plot"})
# What does not go with what, and why.
CONFLICTS = {
    "replay": (
        {*SETTING_FIELDS, "scene", "constraints", "basic", "record", "functions"},
        "a replay simulates nothing; --resume goes on with other settings, and may be recorded",
    ),
    "resume": (
        {"scene", "constraints", "basic"},
        "it goes on with the scene and the settings of the recording",
    ),
    "verify": (
        {*SETTING_FIELDS, "scene", "constraints", "basic", "steps", "every"}
        | WITHOUT_WINDOW - {"headless"},
        "it only compares, and with the scene and the settings of the recording",
    ),
    "video": ({"transparent"}, "videos have no transparency"),
}
# What makes no sense without another option.
COMPANIONS = {
    "every": (
        {"screenshots", "video"},
        "says how often --screenshots or --video draws, which is missing",
    ),
    "fps": ({"video"}, "says how fast --video plays, which is missing"),
    "transparent": ({"screenshots"}, "says how --screenshots draws, which is missing"),
    "substeps": ({"solver", "resume"}, "is of --solver soft-step, which is missing"),
    "no_sleeping": ({"solver", "resume"}, "is of --solver soft-step, which is missing"),
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
    )
    parser.add_argument(
        "scene", metavar="SCENE", nargs="?", type=PATH,
        help=f"a scene file, or the name of a scene of data/ (default: {DEFAULT_SCENE})",
    )  # fmt: skip
    parser.add_argument(
        "--allow-outside-meshes", action="store_true",
        help="read meshes that a scene names by an absolute path, by .. or through a symbolic link "
        "out of its folder too (default: only those in its folder, or below)",
    )  # fmt: skip
    parser.add_argument(
        "--functions", metavar="DIR", type=PATH,
        help="make the steps with the RBSFunctions.py of this folder, a student's for instance, "
        "which runs with your rights; options that its run_timestep does not know are refused",
    )  # fmt: skip

    add_settings_options(parser)
    add_output_options(parser)
    add_recording_options(parser)
    return parser


def add_settings_options(parser):
    """Those that change the settings: what a scene may suggest."""
    add_physics_options(parser)
    add_constraint_options(parser)


def add_physics_options(parser):
    """Contacts, friction, the time step, the broad phase."""
    physics = parser.add_argument_group("simulation", PHYSICS_EXAMPLES)
    physics.add_argument(
        "--basic", action="store_true",
        help="the coursework's behaviour, whatever the scene suggests (default: settings that a "
        "scene suggests, as '# suggests friction 0.5' does, count where no option of this group or "
        "the next is given)",
    )  # fmt: skip
    physics.add_argument(
        "--restitution", metavar="E", type=option_type(plain_float, checked_restitution, "number"),
        default=DEFAULT_RESTITUTION,
        help="how much of their closing speed bodies keep in a collision, from 0 to 1 "
        "(default: %(default)s, so that they bounce and come to rest). With 1, bodies gain energy, "
        "1 to 14 %% in 1500 steps of our scenes; soft-step: none",
    )  # fmt: skip
    physics.add_argument(
        "--time-step", metavar="H", type=option_type(plain_float, checked_time_step, "number"),
        default=DEFAULT_TIME_STEP,
        help="seconds per step (default: %(default)s)",
    )  # fmt: skip
    physics.add_argument(
        "--friction", metavar="MU", type=option_type(plain_float, checked_friction, "number"),
        default=0.0, help="coefficient of friction between bodies and with the ground "
        "(default: %(default)s). A box that spins flat on another is not slowed down: after 4 s "
        "it has 10 of 10 rad/s; soft-step: 0",
    )  # fmt: skip
    physics.add_argument(
        "--closing-only", action="store_true",
        help="leave contacts alone that already separate (default: they receive an impulse too, "
        "as in the coursework); energy is gained and lost as without it",
    )  # fmt: skip

    physics.add_argument(
        "--broad-phase", metavar="NAME", choices=BROAD_PHASES, default="all",
        help="all: every pair in turn; grid: the same motion to the last bit, found through a "
        "uniform grid, for hundreds of bodies (default: %(default)s)",
    )  # fmt: skip
    physics.add_argument(
        "--solver", metavar="NAME", choices=CONTACT_SOLVERS, default="impulse",
        help="impulse: one impulse a contact, one after the other, as in the coursework; "
        "soft-step: all contacts and constraints together, several points each, so that piles rest "
        "(default: %(default)s)",
    )  # fmt: skip
    physics.add_argument(
        "--substeps", metavar="N",
        type=option_type(plain_int, at_least(1, MOST_SUBSTEPS), "whole number"),
        default=DEFAULT_SUBSTEPS,
        help="of the soft-step solver in a step: more are stiffer (default: %(default)s)",
    )  # fmt: skip
    physics.add_argument(
        "--no-sleeping", action="store_true",
        help="with the soft-step solver: work on bodies at rest too (default: they are left out "
        "until something disturbs them)",
    )  # fmt: skip
    physics.add_argument(
        "--gyroscopic", action="store_true",
        help="let bodies that spin tumble, as Euler's equation has it (default: the angular "
        "velocity stays in free flight)",
    )  # fmt: skip


def add_constraint_options(parser):
    """Which constraints there are, and how they are solved."""
    constraints = parser.add_argument_group("constraints", CONSTRAINT_EXAMPLES)
    source = constraints.add_mutually_exclusive_group()
    source.add_argument(
        "--constraints", metavar="FILE", type=PATH,
        help="the constraints between the bodies (default: NAME-constraints.txt beside "
        "NAME-scene.txt, if there is one)",
    )  # fmt: skip
    source.add_argument(
        "--no-constraints", action="store_true",
        help="let all bodies go free (default: constraints come last in a step and may press "
        "bodies into the ground, in the cube scene by 0.74 m; soft-step: 0.01 m)",
    )  # fmt: skip
    constraints.add_argument(
        "--max-iterations", metavar="N", type=WHOLE_NUMBER,
        help=f"constraint visits in a step at most, but at least one of each (default: {SWEEPS} of "
        f"each, and at least {LEAST_VISITS})",
    )  # fmt: skip
    constraints.add_argument(
        "--scheduling", metavar="NAME", choices=CONSTRAINT_SCHEDULINGS, default="sweep",
        help="sweep: in order, over and over; queue: the same result with fewer visits; batches: "
        "in another order, many at once, for hundreds of constraints (default: %(default)s)",
    )  # fmt: skip


def add_output_options(parser):
    """Runs without a window, and what pictures and videos look like."""
    output = parser.add_argument_group("without a window", OUTPUT_EXAMPLES)
    output.add_argument(
        "--headless", action="store_true",
        help="simulate without a window and print a summary; needs no display and no OpenGL",
    )  # fmt: skip
    output.add_argument(
        "--steps", metavar="N", type=WHOLE_NUMBER,
        help=f"how many steps a run without a window has (default: {DEFAULT_STEPS}, or all that "
        "are recorded)",
    )  # fmt: skip
    output.add_argument(
        "--screenshots", metavar="DIR", type=PATH,
        help="draw off-screen into DIR/frame_<step>.png; no window opens",
    )  # fmt: skip
    output.add_argument(
        "--video", metavar="FILE", type=option_type(str, checked_video, "path"),
        help="draw off-screen into a video, .mp4 or .gif; no window opens",
    )  # fmt: skip
    output.add_argument(
        "--every", metavar="K", type=POSITIVE_NUMBER,
        help=f"one picture each K steps (default: {DEFAULT_EVERY} for --screenshots; for --video, "
        "so that it plays in real time)",
    )  # fmt: skip
    output.add_argument(
        "--fps", metavar="R", type=option_type(plain_float, checked_rate, "number"),
        help=f"pictures a second in a video (default: near {VIDEO_RATE:g}, so that it "
        "plays in real time)",
    )  # fmt: skip
    picture = parser.add_argument_group("picture")
    picture.add_argument(
        "--size", metavar="WxH", type=option_type(str, checked_size, "size"),
        default=PICTURE_SIZE, help="in pixels, also of the window (default: "
        f"{'x'.join(map(str, PICTURE_SIZE))})",
    )  # fmt: skip
    picture.add_argument(
        "--camera", metavar="FILE.json", type=PATH,
        help="where to look from, as saved from the window (default: all of the scene is seen)",
    )  # fmt: skip
    picture.add_argument(
        "--colours", metavar="NAME", choices=COLOURINGS, default="body",
        help=f"what bodies are coloured by: {', '.join(COLOURINGS)} "
        "(default: %(default)s)",
    )  # fmt: skip
    picture.add_argument(
        "--show", metavar="NAME", choices=OVERLAYS, action="extend", nargs="+",
        help=f"what is drawn over them: {', '.join(OVERLAYS)}",
    )  # fmt: skip
    picture.add_argument(
        "--legend", action="store_true",
        help="in pictures and videos, say what the colours and arrows mean, as the window does",
    )  # fmt: skip
    picture.add_argument(
        "--transparent", action="store_true",
        help="with --screenshots: no background and no ground, only bodies and their shadows",
    )  # fmt: skip


def add_recording_options(parser):
    """Recordings and statistics."""
    recordings = parser.add_argument_group("recordings", RECORDING_EXAMPLES)
    recordings.add_argument(
        "--record", metavar="FILE.h5", type=option_type(str, checked_recording, "path"),
        help="write the state after every step, and the starting state; no window opens. The file "
        "can be read while it grows, and after a crash",
    )  # fmt: skip
    source = recordings.add_mutually_exclusive_group()
    source.add_argument(
        "--replay", metavar="FILE.h5", type=PATH,
        help="show a recording, simulating nothing",
    )  # fmt: skip
    source.add_argument(
        "--resume", metavar="FILE.h5", type=PATH,
        help="go on from a recorded state, with the settings of the recording and those that are "
        "given as options",
    )  # fmt: skip
    source.add_argument(
        "--verify", metavar="FILE.h5", type=PATH,
        help="simulate once more and compare every state to the last bit; exit code 1, and the "
        "first step that differs, where they are not the same",
    )  # fmt: skip
    recordings.add_argument(
        "--from", dest="from_step", metavar="STEP", type=WHOLE_NUMBER,
        help="with --resume, the step to go on from (default: the last one)",
    )  # fmt: skip
    recordings.add_argument(
        "--stats", metavar="FILE.csv", type=PATH,
        help="write energies, momenta, contacts, violations and times of every step; no window "
        "opens",
    )  # fmt: skip
    recordings.add_argument(
        "--plot", metavar="FILE.png", type=PATH,
        help="draw the same numbers over time; needs matplotlib; no window opens",
    )  # fmt: skip


def given_options(arguments):
    """The set of the options that the command line has, and not only by their defaults."""
    parser = make_parser()
    parser.set_defaults(**dict.fromkeys(vars(parser.parse_args([]))))
    return {name for name, value in vars(parser.parse_args(arguments)).items() if value is not None}


def check_options(parser, options, given):
    """Ends the program with one line where the given options do not go together."""
    for dest, (companions, cause) in COMPANIONS.items():
        if dest in given and not given & companions:
            parser.error(f"{option_name(dest)} {cause}")
    if options.closing_only and options.solver == "soft-step":
        parser.error("--closing-only has no meaning for --solver soft-step: no contact ever pulls")
    for mode, (others, cause) in CONFLICTS.items():
        for dest in sorted(given & others if mode in given else ()):
            parser.error(f"{option_name(dest)} does not go with {option_name(mode)}: {cause}")


def option_name(dest):
    """How an option is written on the command line."""
    names = {"from_step": "--from", "scene": "SCENE"}
    return names.get(dest, "--" + dest.replace("_", "-"))


def follows_suggestions(given):
    """Whether scenes run with what they suggest: unless a setting, --basic or --functions is given.

    given : as `given_options` tells. A student's functions are looked at in the basic behaviour.
    """
    return not given & {*SETTING_FIELDS, "basic", "functions"}


def settings_of(options):
    """The `Settings` that the command line's options ask for."""
    asked = {}
    for name, field in SETTING_FIELDS.items():
        value = getattr(options, name)
        asked[field] = not value if name.startswith("no_") else value
    return Settings(**asked)


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
