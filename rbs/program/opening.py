"""From names to what they stand for: scenes and recordings opened as the user asks for them.

From the top: any file, for the window, and by what name; what lies in a folder.
"""

import os
from pathlib import Path
from typing import NamedTuple

from rbs.program.catalogue import SCENES
from rbs.recordings.recording import RECORDING_ENDINGS, Recording
from rbs.recordings.replay import Replay
from rbs.scenes.messages import print_note, shown_path
from rbs.scenes.scenefiles import DATA_FOLDER, SCENE_ENDING, find_scene, list_scenes, scene_name
from rbs.scenes.simulation import Simulation
from rbs.scenes.textfiles import SceneError

# The heading of what lies beside the present scene.
BESIDE = "beside this scene"


class ListedFile(NamedTuple):
    """A file that can be chosen: its group, its name in the list, a line about it, its path."""

    group: str
    name: str
    line: str
    path: Path


def open_file(path, allowOutsideMeshes=False):
    """The Simulation of a scene file, or the Replay of a recording, for the window.

    allowOutsideMeshes : see `load_scene_file`; raises SceneError or RecordingError
    """
    if Path(path).suffix in RECORDING_ENDINGS:
        return open_replay(path)
    return Simulation(path, allowOutsideMeshes=allowOutsideMeshes)


def open_replay(path):
    """The Replay of a recording; says so if a student's functions made it."""
    recording = Recording(path)
    if recording.functions:
        folder = recording.functionsFolder
        print_note(f"{shown_path(path)}: recorded with the functions in {folder}, not with ours")
    return Replay(recording)


def find_file(text, folder):
    """The path of what a person has typed: a path, `~` for home, or the name of a scene.

    text : seen from the current folder, then from `folder`, then as the name of a scene there, then
    of one of ours
    raises SceneError where there is nothing of the kind
    """
    path, folder = Path(os.path.expanduser(text)), Path(folder)
    for place in (path, folder / path, folder / f"{path}{SCENE_ENDING}"):
        if os.path.isfile(place):
            return place
    if path.name == str(text) and not path.suffix:
        return find_scene(text)
    raise SceneError(text, None, "there is no such file")


def list_files(folder):
    """What can be opened from a list: scenes and recordings in a folder, and our own scenes.

    returns a list of ListedFile, group by group; no name is in it twice
    """
    folder = Path(folder)
    listed = []
    if folder.resolve() != DATA_FOLDER.resolve():
        listed = [
            ListedFile(BESIDE, scene_name(path), path.name, path) for path in list_scenes(folder)
        ]
    listed += [
        ListedFile(BESIDE, path.name, "a recording", path)
        for path in sorted(folder.iterdir())
        if path.suffix in RECORDING_ENDINGS
    ]
    names = {one.name for one in listed}
    ours = {scene_name(path): path for path in list_scenes(DATA_FOLDER)}
    described = [
        (group, name, line) for group, lines in SCENES.items() for name, line in lines.items()
    ]
    known = {name for _, name, _ in described}
    described += [("others of ours", name, "") for name in ours if name not in known]
    return listed + [
        ListedFile(group, name, line, ours[name])
        for group, name, line in described
        if name in ours and name not in names
    ]
