"""The options of the command line: how each is read, what --help says, and what it goes with.

From the top: the texts around --help; `Option`; the table of all options; the parser; the options
and settings that are given.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass

from rbs import __version__
from rbs.appearance.colours import COLOURINGS
from rbs.appearance.pictureoptions import LOOKS, PICTURE_SIZE, VIDEO_RATE
from rbs.pictures.overlays import OVERLAYS
from rbs.program.parsing import (
    PATH,
    POSITIVE_NUMBER,
    RATE,
    SIZE,
    TRACED_STEP,
    WHOLE_NUMBER,
    OneLineParser,
    path_type,
    setting_type,
)
from rbs.recordings.lookup import SCENES
from rbs.recordings.writers import OUTPUTS
from rbs.scenes.messages import PROGRAM_NAME
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
# The groups of --help, and examples of each.
GROUPS = {
    "options": (),
    "simulation": ("stress --friction 0.5 --restitution 0.2",),
    "constraints": ("bridge --scheduling queue",),
    "without a window": (
        "stress --screenshots out/stress --every 25",
        "bridge --video bridge.mp4 --steps 300",
    ),
    "picture": (),
    "recordings": (
        "tower --record tower.h5 --stats tower.csv --steps 1000",
        "--replay tower.h5",
        "--resume tower.h5 --from 500 --friction 0.4",
    ),
}
OPTIONS, SIMULATION, CONSTRAINTS, RUNS, PICTURES, RECORDINGS = GROUPS
# What options may need or exclude, besides other options: the window, and kinds of options.
WINDOW, SETTING, DRAWN, OUTPUT = "the window", "a setting", "what is drawn", "an output"


@dataclass(frozen=True)
class Option:
    """An option of the command line.

    name : with its dashes; group : of GROUPS; help : its explanation
    value : what stands for its value in --help, or "" for a switch
    parse : function from text to value, an argparse type; choices : the values that there are
    kind : SETTING, DRAWN, OUTPUT or ""
    needs : names of options, or WINDOW, one of which it needs
    excludes : names or kinds of options that it cannot be used with; because : why
    """

    name: str
    group: str
    help: str
    value: str = ""
    parse: Callable = PATH
    choices: tuple = ()
    kind: str = ""
    needs: tuple = ()
    excludes: tuple = ()
    because: str = ""

    @property
    def dest(self):
        """The attribute of `parse_options`."""
        name = self.name.strip("-").replace("-", "_").lower()
        return "from_step" if name == "from" else name

    def add_to(self, group):
        """Adds it to an argparse group. It is None unless it is given."""
        if self.name == "SCENE":
            group.add_argument("scene", metavar="SCENE", nargs="?", type=PATH, help=self.help)
        elif not self.value:
            group.add_argument(self.name, action="store_true", default=None, help=self.help)
        else:
            form = {"choices": self.choices} if self.choices else {}
            form |= {"action": "append"} if self.name == "--show" else {}
            group.add_argument(
                self.name,
                dest=self.dest,
                metavar=self.value,
                type=str if self.choices else self.parse,
                help=self.help,
                **form,
            )


def _setting(one):
    """Returns the Option of a Setting."""
    group = CONSTRAINTS if one.isOfConstraints else SIMULATION
    text = ("" if one.solver is None else f"with --solver {one.solver}: ") + one.help
    if one.kind is bool:
        return Option(f"--{one.option}", group, text, kind=SETTING)
    text += "" if one.default is None else f" (default: {one.default})"
    value = {float: "X", int: "N"}.get(one.kind, "NAME")
    return Option(f"--{one.option}", group, text, value, setting_type(one), kind=SETTING)


def _output(name, value, text, group=RUNS, **rules):
    """Returns the Option of one of OUTPUTS."""
    one = OUTPUTS[name.strip("-")]
    return Option(name, group, text, value, path_type(one.what, one.checked), kind=OUTPUT, **rules)


DRAWINGS = ("--screenshots", "--video")
FROM_FILES = ("SCENE", "--constraints", "--basic")
TABLE = (
    Option(
        "SCENE",
        OPTIONS,
        f"a scene file, or the name of a scene in data/ (default: {DEFAULT_SCENE})",
    ),
    Option(
        "--allow-outside-meshes",
        OPTIONS,
        "also read meshes outside the scene's folder, which the scene names by an absolute path, "
        "by .. or through a symbolic link",
    ),
    Option(
        "--functions",
        OPTIONS,
        "simulate with the RBSFunctions.py in DIR, such as a student's. It runs with your rights. "
        "Options that its run_timestep has no parameter for are refused. graders/compare.py finds "
        "the first step and call that differs from this project's",
        "DIR",
    ),
    Option(
        "--our-loop",
        OPTIONS,
        "with --functions: replace the run_timestep in DIR by this project's loop, and call the "
        "other functions and the Mesh in DIR. The coursework's released run_timestep loses a "
        "corrected velocity, and stops too early if there are many constraints. --broad-phase "
        "selects this loop, too",
        needs=("--functions",),
    ),
    Option(
        "--basic",
        SIMULATION,
        "ignore the settings that a scene file recommends (in lines such as '# suggests friction "
        "0.5'), and start from the coursework's behaviour",
    ),
    Option(
        "--constraints",
        CONSTRAINTS,
        "constraints between the bodies (default: NAME-constraints.txt beside NAME-scene.txt, if "
        "it exists)",
        "FILE",
        excludes=("--no-constraints",),
        because="constraints are ignored",
    ),
    *map(_setting, BY_OPTION.values()),
    Option(
        "--headless",
        RUNS,
        "simulate without a window and print a summary. Needs no display and no OpenGL",
    ),
    Option(
        "--steps",
        RUNS,
        f"number of steps of a run without a window (default: {DEFAULT_STEPS}; with --replay, all "
        "that are recorded)",
        "N",
        WHOLE_NUMBER,
    ),
    Option(
        "--trace",
        RUNS,
        "print what happens in a step, event by event, with the numbers of each formula: free "
        "flight, contacts, corrections, impulses, friction, constraints. With BODY, a number (from "
        "0) or a name, only its events. Two outputs can be compared with diff. With --functions, "
        "this project's loop calls the functions, as with --our-loop",
        "STEP[:BODY]",
        TRACED_STEP,
        kind=OUTPUT,
        excludes=("--replay", "--verify", "--steps", "--every", OUTPUT),
        because="it only prints the events of one step; --resume traces a step of a recording",
    ),
    Option(
        "--screenshots",
        RUNS,
        "draw pictures into DIR/frame_<step>.png, without a window",
        "DIR",
        kind=OUTPUT,
    ),
    _output(
        "--video",
        "FILE",
        "draw a video, .mp4 or .gif, without a window",
        excludes=("--transparent",),
        because="videos cannot be transparent",
    ),
    Option(
        "--every",
        RUNS,
        f"draw every K-th step (default: {DEFAULT_EVERY} for --screenshots; for --video, chosen so "
        "that it plays in real time)",
        "K",
        POSITIVE_NUMBER,
        needs=DRAWINGS,
    ),
    Option(
        "--fps",
        RUNS,
        f"frames per second of a video (default: near {VIDEO_RATE:g}, so that it plays in real "
        "time)",
        "R",
        RATE,
        needs=("--video",),
    ),
    Option(
        "--size",
        PICTURES,
        f"size in pixels, also of the window (default: {'x'.join(map(str, PICTURE_SIZE))})",
        "WxH",
        SIZE,
        kind=DRAWN,
        needs=(*DRAWINGS, WINDOW),
    ),
    Option(
        "--look",
        PICTURES,
        "plain, as in the window; or studio, with sky light and soft shadows, which takes seconds "
        "per picture. Used by --screenshots, --video and the window's Picture button (default: "
        "plain)",
        "NAME",
        choices=LOOKS,
        kind=DRAWN,
        needs=(*DRAWINGS, WINDOW),
    ),
    Option(
        "--camera",
        PICTURES,
        "viewpoint, saved from the window (default: the whole scene is in view)",
        "FILE.json",
        kind=DRAWN,
        needs=(*DRAWINGS, WINDOW),
    ),
    Option(
        "--colours",
        PICTURES,
        "quantity that the bodies' colours show, also in an exported page: "
        f"{', '.join(COLOURINGS)} (default: body)",
        "NAME",
        choices=tuple(COLOURINGS),
        kind=DRAWN,
        needs=(*DRAWINGS, "--export", WINDOW),
    ),
    Option(
        "--show",
        PICTURES,
        f"overlays to draw, one or more: {', '.join(OVERLAYS)}. Put names with a blank in quotes",
        "NAME",
        choices=tuple(OVERLAYS),
        kind=DRAWN,
        needs=(*DRAWINGS, WINDOW),
    ),
    Option(
        "--legend",
        PICTURES,
        "add the window's legend of colours and arrows to pictures and videos",
        kind=DRAWN,
        needs=(*DRAWINGS, WINDOW),
    ),
    Option(
        "--transparent",
        PICTURES,
        "with --screenshots: draw only bodies and their shadows, without background and ground",
        needs=("--screenshots",),
    ),
    _output(
        "--record",
        "FILE.h5",
        "record the state at the start and after every step, without a window. The file can be "
        "read while it grows, and after a crash",
        RECORDINGS,
    ),
    Option(
        "--record-contacts",
        RECORDINGS,
        "with --record: also record the contacts of each step, with point, normal, depth and "
        "impulses, for other programs",
        needs=("--record",),
    ),
    Option(
        "--replay",
        RECORDINGS,
        "show a recording",
        "FILE.h5",
        excludes=(*FROM_FILES, SETTING, "--record", "--functions", "--resume"),
        because="a replay does not simulate; --resume can change settings and be recorded",
    ),
    Option(
        "--resume",
        RECORDINGS,
        "continue from a recorded state, with the recorded settings unless options change them",
        "FILE.h5",
        excludes=FROM_FILES,
        because="scene and settings come from the recording",
    ),
    Option(
        "--verify",
        RECORDINGS,
        "simulate again and compare every state, bit for bit. If one differs, the first step that "
        "differs is named, and the exit code is 1",
        "FILE.h5",
        excludes=(
            *FROM_FILES,
            *("--steps", "--every", "--replay", "--resume"),
            *(SETTING, OUTPUT, DRAWN),
        ),
        because="it only repeats the recording, with its scene and settings",
    ),
    Option(
        "--from",
        RECORDINGS,
        "with --resume: the step to continue from (default: the last one)",
        "STEP",
        WHOLE_NUMBER,
        needs=("--resume",),
    ),
    _output(
        "--stats",
        "FILE.csv",
        "write energies, momenta, contacts, violations and times of every step, without a window",
        RECORDINGS,
    ),
    _output(
        "--plot",
        "FILE.png",
        "plot the same quantities over time, without a window. Needs matplotlib",
        RECORDINGS,
    ),
    _output(
        "--export",
        "FILE",
        "write the run, without a window: as an .html page that plays it in any browser (needs "
        "k3d), or as an animated glTF 2.0 file, .glb, for Blender and other 3-D programs (needs "
        "pygltflib)",
        RECORDINGS,
    ),
)


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
    parser.several = {"--show": OVERLAYS}
    version = f"{PROGRAM_NAME} {__version__}"
    parser.add_argument("--version", action="version", version=version, help="print the version")
    for title, examples in GROUPS.items():
        text = "\n".join(f"{PROGRAM_NAME} {one}" for one in examples) or None
        group = parser if title == OPTIONS else parser.add_argument_group(title, text)
        for one in TABLE:
            if one.group == title:
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
