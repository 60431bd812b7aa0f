"""From names to what they stand for: scenes and recordings opened as the user asks for them.

From the top: any file, for the window, and by what name; recordings; what lies in a folder.
"""

import os
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from rbs.catalogue import SCENES
from rbs.files import content_hash, path_of_name, read_bytes
from rbs.messages import print_error, shown_path
from rbs.recording import Recording
from rbs.replay import Replay, check_bodies
from rbs.scenes import DATA_FOLDER, SCENE_ENDING, find_scene, list_scenes, scene_name
from rbs.simulation import Simulation
from rbs.textfiles import SceneError

RECORDING_ENDING = ".npz"
# The heading of what lies beside the present scene.
BESIDE = "beside this scene"


class ListedFile(NamedTuple):
    """A file that can be chosen: its group, its name in the list, a line about it, its path."""

    group: str
    name: str
    line: str
    path: Path


def open_file(path, settings, allowOutsideMeshes=False):
    """The Simulation of a scene file, or the Replay of a recording (.npz), for the window.

    settings : a scene's; None for the usual ones; allowOutsideMeshes : see `load_scene_file`
    raises SceneError or RecordingError
    """
    path = Path(path)
    if path.suffix == RECORDING_ENDING:
        recording = Recording(path)
        scene = load_recorded_scene(recording, allowOutsideMeshes=allowOutsideMeshes)
        tell_changes(recording, scene)
        return Replay(recording, scene)
    return Simulation(path, settings, allowOutsideMeshes=allowOutsideMeshes)


def find_file(text, folder):
    """The path of what a person has typed: a path, `~` for home, or the name of a scene.

    text : seen from the current folder, then from `folder`, then as the name of a scene there, then
    of one of ours
    raises SceneError where there is nothing of the kind
    """
    path, folder = Path(os.path.expanduser(text)), Path(folder)
    for place in (path, folder / path, folder / f"{path}{SCENE_ENDING}"):
        if os.path.exists(place):
            return place
    if path.name == str(text) and not path.suffix:
        return find_scene(text)
    raise SceneError(text, None, "there is no such file")


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

    Of several places where it may be, that whose files hold what they held then is taken; where
    there is none, the first, and `changed_files` tells what differs.

    scene, constraints : where the files are now, or None for where they were
    allowOutsideMeshes : see `load_scene_file`
    raises SceneError, or RecordingError when the bodies are not those of the recording
    """
    if scene is not None:
        places = [find_scene(scene)]
    else:
        places = recorded_places(recording, recording.scene, "SCENE")
    if constraints is None and recording.constraints:
        constraints = find_constraints_of(recording)
    found, error = None, None
    for place in places:
        try:
            simulation = Simulation(
                place, constraintPath=constraints, allowOutsideMeshes=allowOutsideMeshes
            )
        except SceneError as raised:
            error = error or raised
            continue
        if constraints is None:  # the scene had none then, whatever lies beside it now
            simulation.constraints, simulation.constraintPath = [], None
            simulation.contentHashes["constraints"] = ""
        found = found or simulation
        if not changed_files(recording, simulation):
            found = simulation
            break
    if found is None:
        raise error
    check_bodies(recording, found)
    return found


def tell_changes(recording, simulation):
    """Says in one line which files have changed, where that is no reason to refuse a replay."""
    changed = changed_files(recording, simulation)
    if changed:
        print_error(f"{shown_path(recording.path)}: {changed}")


def changed_files(recording, simulation):
    """Which files of a scene hold something else than when it was recorded, in words; "" if none.

    Of a recording that has no hashes of them nothing is known, which is "" too.
    """
    recorded, ours = recording.contentHashes, simulation.contentHashes
    if recorded is None:
        return ""
    changed = []
    if recorded["scene"] != ours["scene"]:
        changed.append(f"the scene {shown_path(simulation.scenePath)}")
    if recorded["constraints"] != ours["constraints"]:
        path = simulation.constraintPath
        changed.append("the constraints" + (f" {shown_path(path)}" if path else ""))
    folder = simulation.scenePath.parent
    for name, contentHash in ours["meshes"].items():
        if recorded["meshes"].get(name, contentHash) != contentHash:
            changed.append(f"the mesh {shown_path(folder / path_of_name(name))}")
    if not changed and set(recorded["meshes"]) != set(ours["meshes"]):
        changed.append("the list of meshes")
    if not changed:
        return ""
    holds = "holds" if len(changed) == 1 and not changed[0].startswith("the constr") else "hold"
    return f"{' and '.join(changed)} {holds} something else than when it was recorded"


def recorded_places(recording, name, option):
    """Where a file that a recording names may be; `option` is how the caller could say so.

    Beside the recording first: where it says, seen from there, and under its own name; then seen
    from the current folder, and in data/. returns a list of paths of files, not empty
    """
    name = path_of_name(name)
    if not os.path.isfile(name):
        name = name.replace("\\", "/")  # recorded on Windows
    folder, ownName = recording.path.parent, Path(name).name
    places = dict.fromkeys(
        (folder / Path(name).name if os.path.isabs(name) else folder / name, folder / ownName,
         Path(name), DATA_FOLDER / ownName)
    )  # fmt: skip
    found = [path for path in places if os.path.isfile(path)]
    if not found:
        cause = f"its file {name} is not there any more; say with {option} where it is"
        raise recording.error(cause)
    return found


def find_constraints_of(recording):
    """The path of a recording's constraints: the first that holds what it held, or the first."""
    places = recorded_places(recording, recording.constraints, "--constraints")
    if recording.contentHashes is not None:
        for path in places:
            with suppress(OSError):
                if content_hash(read_bytes(path)) == recording.contentHashes["constraints"]:
                    return path
    return places[0]


def list_files(folder):
    """What can be opened from a list: scenes and recordings in a folder, and our own scenes.

    returns a list of ListedFile, group by group; no name is in it twice
    """
    folder = Path(folder)
    listed = []
    if folder.resolve() != DATA_FOLDER.resolve():
        listed = [
            ListedFile(BESIDE, scene_name(path), path.name, path)
            for path in list_scenes(folder)
        ]
    listed += [
        ListedFile(BESIDE, path.name, "a recording", path)
        for path in sorted(folder.glob(f"*{RECORDING_ENDING}"))
    ]
    names = {one.name for one in listed}
    ours = {scene_name(path): path for path in list_scenes(DATA_FOLDER)}
    described = [(group, name, line) for group, lines in SCENES.items()
                 for name, line in lines.items()]  # fmt: skip
    known = {name for _, name, _ in described}
    described += [("others of ours", name, "") for name in ours if name not in known]
    return listed + [
        ListedFile(group, name, line, ours[name])
        for group, name, line in described
        if name in ours and name not in names
    ]
