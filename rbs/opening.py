"""From names to what they stand for: scenes and recordings opened as the user asks for them.

From the top: any file, for the window; recordings; what lies in a folder.
"""

import os
from pathlib import Path

from rbs.messages import print_error, shown_path
from rbs.recording import Recording
from rbs.replay import Replay, check_bodies
from rbs.scenes import DATA_FOLDER, find_scene, list_scenes, scene_name
from rbs.simulation import Simulation

RECORDING_ENDING = ".npz"


def open_file(path, settings, allowOutsideMeshes=False):
    """The Simulation of a scene file, or the Replay of a recording (.npz), for the window.

    settings : a scene's; None for the usual ones; allowOutsideMeshes : see `load_scene_file`
    raises SceneError or RecordingError
    """
    if path.suffix == RECORDING_ENDING:
        recording = Recording(path)
        scene = load_recorded_scene(recording, allowOutsideMeshes=allowOutsideMeshes)
        return Replay(recording, scene)
    return Simulation(path, settings, allowOutsideMeshes=allowOutsideMeshes)


def open_recording(path, mustBeFinite=True):
    """The Recording; says so in one line where it is one that was interrupted."""
    recording = Recording(path, mustBeFinite)
    if recording.wasInterrupted:
        print_error(
            f"{shown_path(recording.path)}: an interrupted recording, of the steps "
            f"{recording.firstStep} to {recording.lastStep}"
        )
    return recording


def load_recorded_scene(recording, scene=None, constraints=None, allowOutsideMeshes=False):
    """The Simulation of a recording's scene, at the scene's start.

    scene, constraints : where the files are now, or None for where they were
    allowOutsideMeshes : see `load_scene_file`
    raises SceneError, or RecordingError when the bodies are not those of the recording
    """
    if scene is not None:
        scenePath = find_scene(scene)
    else:
        scenePath = find_recorded_file(recording, recording.scene, "SCENE")
    if constraints is None and recording.constraints:
        constraints = find_recorded_file(recording, recording.constraints, "--constraints")
    simulation = Simulation(
        scenePath, constraintPath=constraints, allowOutsideMeshes=allowOutsideMeshes
    )
    if constraints is None:  # the scene had none then, whatever lies beside it now
        simulation.constraints, simulation.constraintPath = [], None
    check_bodies(recording, simulation)
    return simulation


def find_recorded_file(recording, name, option):
    """The path of a file that a recording names; `option` is how the caller could give it.

    It may stand where the recording says, seen from the current folder or from the recording's;
    or, under its own name, beside the recording or in data/.
    """
    if not os.path.isfile(name):
        name = name.replace("\\", "/")  # recorded on Windows
    folder, ownName = recording.path.parent, Path(name).name
    for path in (Path(name), folder / name, folder / ownName, DATA_FOLDER / ownName):
        if os.path.isfile(path):
            return path
    raise recording.error(f"its file {name} is not there any more; say with {option} where it is")


def list_files(folder):
    """Scenes and recordings in a folder: dict of what a person calls them, and their paths."""
    recordings = sorted(Path(folder).glob(f"*{RECORDING_ENDING}"))
    return {scene_name(path): path for path in list_scenes(folder)} | {
        path.name: path for path in recordings
    }
