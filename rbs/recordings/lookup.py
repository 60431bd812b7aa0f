"""Scenes and recordings by path or name, and those in a folder; opening them in the window."""

import os
from pathlib import Path
from typing import NamedTuple

from rbs.recordings.catalogue import SCENES
from rbs.recordings.recording import Recording, is_recording_name
from rbs.recordings.replay import Replay
from rbs.scenes.messages import InputError, print_note, shown_path
from rbs.scenes.scenefiles import (
    DATA_FOLDER,
    SCENE_ENDING,
    list_scenes,
    scene_name,
    similar_scenes,
)
from rbs.scenes.simulation import SceneSimulation
from rbs.scenes.suggestions import apply_settings, note_recommended, recommended_values
from rbs.stepping.settings import SETTINGS, used_settings

# Heading of the files beside the current scene, in the window's list.
BESIDE = "beside this scene"


class ListedFile(NamedTuple):
    """A file in the window's list: heading, name, a line about it, path."""

    group: str
    name: str
    line: str
    path: Path


def open_file(path, allowOutsideMeshes=False, submitted=None):
    """Opens a scene file as a SceneSimulation, or a recording as a Replay; see `SceneSimulation`.

    Raises SceneError or RecordingError.
    """
    if is_recording_name(path):
        return open_replay(path, submitted)
    return SceneSimulation(path, allowOutsideMeshes=allowOutsideMeshes, submitted=submitted)


def open_replay(path, submitted=None):
    """Opens a recording as a Replay, with a note if a student's functions made it."""
    recording = Recording(path)
    if recording.functions:
        folder = recording.functionsFolder
        print_note(f"{shown_path(path)}: recorded with the functions in {folder}")
    return Replay(recording, submitted)


def find_file(text, folder):
    """Returns the path of a file from what a user typed. Raises InputError if nothing matches.

    text : a path from the current folder or from `folder`, with `~` for home, or the name of a
        scene in `folder` or in data/, tried in this order
    """
    path, folder = Path(os.path.expanduser(text)), Path(folder)
    for place in (path, folder / path, folder / f"{path}{SCENE_ENDING}"):
        if os.path.isfile(place):
            return place
    if path.name == str(text) and not path.suffix:
        ours = DATA_FOLDER / f"{text}{SCENE_ENDING}"
        if ours.is_file():
            return ours
        similar = " or ".join(similar_scenes(text))
        raise InputError(f"No scene '{text}'." + f" Did you mean {similar}?" * bool(similar))
    raise InputError(f"{text} is a folder." if path.is_dir() else f"{text}: no such file")


def list_files(folder):
    """Returns the scenes and recordings in a folder, and the scenes in data/.

    The result is a list of ListedFile, group by group, in which each name occurs once.
    """
    folder, ours = Path(folder), {scene_name(path): path for path in list_scenes(DATA_FOLDER)}
    scenes = list_scenes(folder) if folder.resolve() != DATA_FOLDER.resolve() else []
    listed = {
        scene_name(path): ListedFile(BESIDE, scene_name(path), path.name, path) for path in scenes
    }
    for path in sorted(folder.glob("*")):  # none if the folder has been removed
        if is_recording_name(path):
            listed[path.name] = ListedFile(BESIDE, path.name, "a recording", path)
    for group, lines in [*SCENES.items(), ("other scenes", dict.fromkeys(ours, ""))]:
        for name in filter(ours.__contains__, lines):
            listed.setdefault(name, ListedFile(group, name, lines[name], ours[name]))
    return list(listed.values())


class SceneOpener:
    """Opens files for the window, each scene with the settings that it recommends.

    Settings given on the command line override them in every scene if the solver uses them. A
    student's functions are kept from scene to scene.
    """

    def __init__(self, given=(), isBasic=False, allowOutsideMeshes=False, submitted=None):
        """given, isBasic : see `apply_settings`; allowOutsideMeshes, submitted : see `open_file`"""
        self._given, self._isBasic = dict(given), isBasic
        self._allowOutsideMeshes, self._submitted = allowOutsideMeshes, submitted

    def open(self, text, folder="."):
        """Returns a SceneSimulation or Replay; see `open_file`.

        text, folder : see `find_file`; folder is that of the last scene
        """
        opened = open_file(find_file(text, folder), self._allowOutsideMeshes, self._submitted)
        if opened.isEditable:
            recommended = {} if self._isBasic else recommended_values(opened.source)
            solver = self._given.get("contactSolver", recommended.get("contactSolver"))
            solver = solver or SETTINGS["contactSolver"].default
            apply_settings(opened, used_settings(self._given, solver), self._isBasic)
            note_recommended(opened)
        return opened
