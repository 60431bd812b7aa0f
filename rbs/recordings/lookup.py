"""The scenes in data/, those and recordings in a folder, and opening them."""

from pathlib import Path

from rbs.recordings.recording import Recording
from rbs.recordings.replay import Replay
from rbs.scenes.messages import one_line
from rbs.scenes.scenefiles import DATA_FOLDER, find_scene, is_recording, list_scenes, scene_name
from rbs.scenes.settingtexts import apply_settings, note_recommended
from rbs.scenes.simulation import SceneSimulation

# The scenes in data/, in groups, with a line each for --help and the window's list.
SCENES = {
    "falling": {
        "singletet": "one tetrahedron",
        "singlebox": "one box",
        "single_cylinder": "one cylinder",
        "two_cylinder": "two cylinders and a constraint",
        "tet": "25 tetrahedra",
    },
    "many shapes": {
        "mixed": "seven shapes in a tray",
        "tower": "a tower that collapses",
        "stress": "many shapes among fixed posts",
    },
    "constraints": {
        "cube": "eight bodies, each linked to every other",
        "tower_chain": "a tower of linked bodies",
        "two_chain": "two chains",
        "bridge": "a rope bridge, and bodies that fall onto it",
        "chimes": "many short chains and a long one",
        "net": "a net of 400 bodies that catches three others",
        "wrecking_ball": "a ball on a chain that hits a stack",
    },
    "friction": {
        "ramp": "boxes on slopes of 26° and 28°; friction holds one",
        "slide": "boxes sliding to a stop",
        "roll": "a cylinder, a ball and an ellipsoid that roll",
        "tiles": "a box, a ball and a cylinder cross a floor of tiles",
    },
    "standing": {
        "stack": "a stack of 20 boxes",
        "pyramid": "a pyramid of 120 boxes",
        "arch": "an arch of 15 wedges",
        "card_house": "a house of 15 cards",
    },
    "falling over": {
        "dominoes": "ten dominoes; the first one falls",
        "wall": "a brick wall and a wrecking ball",
        "arch_blow": "an arch hit by a ball",
        "cradle": "Newton's cradle",
    },
    "heaps and loads": {
        "heap": "a dense heap of 1000 bodies",
        "pile_200": "a pile of 200 bodies",
        "pile_1000": "a pile of 1000 bodies",
        "loaded_bridge": "a rope bridge under load",
    },
}
# Heading of the files beside the current scene, in the window's list.
BESIDE = "beside this scene"


def list_files(folder):
    """Returns the scenes and recordings in a folder, and the scenes in data/.

    The result is a list of (heading, name, a line about it, path), group by group, in which each
    name occurs once.
    """
    folder, ours = Path(folder), {scene_name(path): path for path in list_scenes(DATA_FOLDER)}
    scenes = list_scenes(folder) if folder.resolve() != DATA_FOLDER.resolve() else []
    named = [(one_line(scene_name(path)), path) for path in scenes]
    listed = {name: (BESIDE, name, "", path) for name, path in named}
    # none if the folder has been removed
    for path in sorted(filter(Path.is_file, folder.glob("*"))):
        if is_recording(path):
            name = one_line(path.name)
            listed[name] = (BESIDE, name, "a recording", path)
    for group, lines in [*SCENES.items(), ("other scenes", dict.fromkeys(ours, ""))]:
        for name in filter(ours.__contains__, lines):
            listed.setdefault(name, (group, name, lines[name], ours[name]))
    return list(listed.values())


class SceneOpener:
    """Opens scenes, each with the settings that it recommends, and recordings.

    Settings given on the command line override them in every scene. A student's functions are kept
    from scene to scene.
    """

    def __init__(self, given=(), isBasic=False, submitted=None, loadFunctions=None):
        """given, isBasic : see `apply_settings`; submitted : see `SceneSimulation`

        loadFunctions : function of a folder and seconds, which returns `submitted`
        """
        self._given, self._isBasic, self.submitted = dict(given), isBasic, submitted
        self._loadFunctions = loadFunctions

    def take_functions(self, folder, seconds):
        """Takes a student's functions, in a folder, from now on; with the basic settings.

        seconds : that they may take. Raises ValueError if they cannot be loaded.
        """
        self.submitted, self._isBasic = self._loadFunctions(folder, seconds), True

    def simulation(self, path, constraintPath=None, isFirst=False):
        """Returns the SceneSimulation of a scene file. Raises SceneError or InputError.

        isFirst : whether a given setting that the solver ignores is an error; see `apply_settings`
        """
        simulation = SceneSimulation(path, None, constraintPath, submitted=self.submitted)
        apply_settings(simulation, self._given, self._isBasic, isFirst)
        return simulation

    def open(self, text, folder="."):
        """Opens a file for the window, as a SceneSimulation or a Replay.

        text, folder : see `find_scene`; folder is that of the last scene

        Raises SceneError or RecordingError.
        """
        path = find_scene(text, folder)
        if is_recording(path):
            return Replay(Recording(path), self.submitted)
        simulation = self.simulation(path)
        note_recommended(simulation)
        return simulation
