"""Pictures of scenes that a student's modules simulate, for the sheets of `grade.py`."""

import re
import shutil
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from gradingTools import PROJECT_DIRECTORY
from isolation import copied, run_limited

from rbs.submissions import brief

# A fall, a collision, many of both, and constraints.
SCENES = ("singlebox", "mixed", "tower_chain")
STEPS = 150
EVERY = 50
TIME_STEP = 0.02  # s
SIZE = "320x180"
# The address space that drawing takes, beside what a submission may have: OpenGL in software.
DRAWING_MEGABYTES = 2048


@dataclass
class ScenePictures:
    """What has been drawn of a scene.

    pictures : list of (time in s, path); problem : what went wrong, or ""
    """

    name: str
    pictures: list = field(default_factory=list)
    problem: str = ""


def draw_scene(scene, folder, target, limits):
    """The ScenePictures of a scene that the modules of a folder simulate.

    target : a folder that the pictures are put into. The modules run on a copy, in a process of
    their own, for the time that the limits allow.
    """
    result = ScenePictures(scene)
    with copied(folder) as work, tempfile.TemporaryDirectory(prefix="scenes-") as place:
        frames = Path(place) / "frames"
        said = Path(place) / "said.txt"
        words = [
            str(PROJECT_DIRECTORY / "RigidBodySimulation.py"), scene,
            "--functions", str(work), "--time-step", str(TIME_STEP), "--steps", str(STEPS),
            "--screenshots", str(frames), "--every", str(EVERY), "--size", SIZE,
        ]  # fmt: skip
        with open(said, "wb") as errors:
            code = run_limited(
                words, work, limits.seconds, limits.megabytes + DRAWING_MEGABYTES, errors
            )
        if code is None:
            result.problem = f"stopped after {limits.seconds:g} s"
        elif code != 0:
            lines = said.read_text(encoding="utf-8", errors="replace").strip().splitlines()
            result.problem = f"ended with exit code {code}"
            if lines:
                result.problem = brief(lines[-1]).removeprefix("RigidBodySimulation.py: ")
        target.mkdir(parents=True, exist_ok=True)
        for frame in sorted(frames.glob("frame_*.png")) if frames.is_dir() else ():
            step = int(re.sub(r"\D", "", frame.stem))
            path = target / f"{scene}_{step:04d}.png"
            shutil.copyfile(frame, path)
            result.pictures.append((step * TIME_STEP, path))
    return result
