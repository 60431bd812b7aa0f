"""The viewer behind the window's buttons and keys: time, settings and files.

`rbs.window.panel` draws the panels and calls these actions, `rbs.pictures.view` draws the scene.
"""

import os
import time
from collections import deque
from dataclasses import replace
from pathlib import Path

from rbs.appearance.camera import load_camera
from rbs.pictures.viewpoint import apply_camera
from rbs.recordings.lookup import list_files
from rbs.recordings.replay import resume
from rbs.recordings.statistics import step_quantities
from rbs.scenes.messages import one_line
from rbs.scenes.scenefiles import scene_name
from rbs.stepping.meshes import StateError
from rbs.stepping.settings import SETTINGS
from rbs.window.hand import Hand
from rbs.window.history import History, Playback
from rbs.window.outputs import Outputs

# Steps in plots and in mean times; seconds between looks at the files of a student.
PLOTTED_STEPS, TIMED_STEPS, WATCH_SECONDS = 500, 25, 0.5


class Viewer:
    """The actions of the window's buttons and keys, apart from drawing them.

    simulation, view : SceneSimulation or Replay; SceneView
    isPlaying, playback, history : whether it plays; Playback; History
    timings : of the last steps, dicts of seconds by phase
    hand, outputs : Hand, with which the user changes bodies; Outputs, the files that are written
    message : what the user is told, until the next action; or ""
    isMeasuring, plotted : whether `plotted`, dict of step and (time, quantities), grows
    """

    def __init__(self, simulation, view, opener):
        """opener : SceneOpener of the files that the user opens"""
        self.view, self._opener = view, opener
        self.isPlaying, self.isMeasuring, self.message = False, False, ""
        self.hand, self.outputs = Hand(self), Outputs(self)
        self._take_up(simulation)

    @property
    def isReplay(self):
        """Whether a recording is shown instead of a simulation."""
        return not self.simulation.isEditable

    # Playing.

    def toggle_play(self):
        """Plays if paused, pauses if playing. A replay at its end starts again."""
        self.isPlaying, self.message = not self.isPlaying, ""
        self.leave_event()
        if self.isPlaying and self.isReplay:
            if self.simulation.stepCount == self.simulation.lastStep:
                self.seek(self.simulation.firstStep)
                self.isPlaying = True

    def play(self, elapsed):
        """If playing, makes the steps that are due `elapsed` seconds after the last frame."""
        playback = self.playback
        if not self.isPlaying:
            playback.stop()
            self.outputs.flush()
            return
        playback.advance(elapsed, self.simulation.settings.timeStep, self._step)
        self._show()

    def _step(self):
        """Makes a step, or goes on to what was kept or recorded. Returns whether to go on."""
        simulation, history = self.simulation, self.history
        if self.isReplay:
            simulation.step()
            self.isPlaying = self.isPlaying and simulation.stepCount != simulation.lastStep
            return self.isPlaying
        self.hand.end_move()
        if history.isAhead and self.hand.grab is None:
            self._go_forward()
            return True
        history.keep()
        if self.hand.grab is not None:
            self.hand.pull()
            history.keep()
        try:
            simulation.step()
        except StateError as error:
            history.forget()
            self.isPlaying, self.message = False, str(error)
            return False
        if simulation.report is not None:
            self.timings.append({"step": simulation.stepSeconds, **simulation.report.seconds})
        return True

    def _go_forward(self):
        """Goes to the next moment that was kept, and hands it to the files being written."""
        before = self.simulation.stepCount
        self.history.go(self.history.place + 1)
        if self.simulation.stepCount - before not in (0, 1):  # a start over, or a gap
            self.outputs.stop()
        if self.simulation.stepCount > before:
            self.outputs.add(self.simulation)
        else:
            self.outputs.before(self.simulation)

    def _show(self):
        simulation, rows = self.simulation, self.plotted
        if self.isMeasuring and simulation.stepCount not in rows:
            rows[simulation.stepCount] = simulation.time, step_quantities(simulation)
            if len(rows) > PLOTTED_STEPS:
                del rows[next(iter(rows))]
        self.view.refresh()

    def leave_event(self):
        """Shows the present state instead of a moment within the last step."""
        if self.view.highlight is not None:
            self.view.show_event(None)

    def begin(self, topic=None):
        """Prepares for something new, which can be undone: a change of bodies or of settings.

        topic : see `History.keep`
        """
        self.leave_event()
        self.history.keep(topic)
        now = self.simulation.stepCount
        self.plotted = {step: row for step, row in self.plotted.items() if step <= now}

    # Back and forth.

    def _pause(self):
        self.hand.end_move()
        self.leave_event()
        self.isPlaying, self.message = False, ""

    def step_once(self):
        """Goes one step forward, to what was kept or else to something new, and pauses."""
        self._pause()
        self._step()
        self._show()

    def redo(self):
        """Goes forward to what was kept, and pauses."""
        if not self.isReplay and not self.history.isAhead:
            self._pause()
            self.message = "Nothing to redo."
        else:
            self.step_once()

    def step_back(self):
        """Goes back by a step, or undoes what was done since, and pauses."""
        self._pause()
        self.hand.release()
        simulation = self.simulation
        if self.isReplay and simulation.stepCount > simulation.firstStep:
            self.seek(simulation.stepCount - 1)
        elif not self.isReplay and self.history.place > 0:
            self.seek(self.history.place - 1)
        else:
            self.message = "This is the first step."

    def seek(self, place):
        """Goes to a step of a replay, or to a place of `history`, and pauses.

        The latter ends a recording, video or page that is being made.
        """
        self._pause()
        self.hand.release()
        if self.isReplay:
            self.simulation.seek(place)
        elif place != self.history.place:
            self.outputs.stop()
            self.history.go(place)
        self.view.refresh()

    def seek_step(self, step):
        """Goes to a step, if it can be gone to. Returns whether it can."""
        place = step if self.isReplay else self.history.place_of(step)
        if place is None:
            self.message = f"Step {step} is no longer kept; R starts over"
        else:
            self.seek(place)
        return place is not None

    # Starting over, and settings.

    def restart(self, withSettings=False):
        """Starts over, and pauses; with the scene's own settings, or with the present ones.

        A student's functions are loaded again.
        """
        simulation, settings = self.simulation, self.simulation.settings
        self._halt()
        if not self.isReplay:
            isOther = withSettings and settings != simulation.startSettings
            if self.history.place or simulation.stepCount or isOther:
                self.begin()
            kept = simulation.startSettings if withSettings else replace(settings)
            simulation.reset()
            vars(simulation.settings).update(vars(kept))
            self._reload()
        else:
            simulation.reset()
        self.plotted = {}
        self.view.refresh()

    def _reload(self):
        submitted = self.simulation.submitted
        if submitted is not None:
            try:
                self.simulation.submitted = self._opener.submitted = submitted.again()
            except ValueError as error:
                self.message = str(error)
            else:
                self.simulation.beside = None
                self.simulation.go_beside()
            self._lastSaved = self._saved_at()

    def _saved_at(self):
        """Returns when the files of a student were saved last, or None without a student."""
        if (submitted := self.simulation.submitted) is None:
            return None
        paths = Path(submitted.folder).glob("*.py")
        return [(path.name, path.stat().st_mtime_ns) for path in sorted(paths)]

    def watch(self):
        """Starts over if a student has saved a file."""
        now = time.perf_counter()
        if not self.isReplay and now - self._watched > WATCH_SECONDS:
            self._watched = now
            if self._saved_at() != self._lastSaved:
                self.restart()
                if not self.message:
                    self.message = "Your functions have changed: loaded again, from the first step."

    def _halt(self):
        self._pause()
        self.hand.release()
        self.outputs.stop()
        self.timings.clear()

    def set(self, name, value):
        """Changes a setting, which can be undone, or says why not."""
        settings, self.message = self.simulation.settings, ""
        try:
            SETTINGS[name].checked(value)
        except ValueError as error:
            self.message = f"{SETTINGS[name].label} {error}"
        else:
            if getattr(settings, name) != value:
                self.begin(name)
                settings.change(name, value)
                self.view.refresh()

    # Opening.

    def open(self, path):
        """Opens a scene or recording, paused, with its own settings, or a camera; or says why not.

        path : see `find_scene`
        """
        self.message = ""
        try:
            if Path(path).suffix.lower() == ".json":
                apply_camera(load_camera(os.path.expanduser(path)))
            else:
                other = self._opener.open(path, self.simulation.scenePath.parent)
                self._show_other(other, self.view.rebuild)
        except ValueError as error:
            self.message = str(error)
        except (OSError, MemoryError) as error:
            self.message = f"{path}: cannot be read ({one_line(error)})"

    def _show_other(self, simulation, show):
        self._halt()
        self._take_up(simulation)
        show(simulation)

    def _take_up(self, simulation):
        self.simulation = simulation
        self.playback, self.history = Playback(), History(simulation)
        simulation.writers += self.history, self.outputs
        self.timings, self.plotted = deque(maxlen=TIMED_STEPS), {}
        self._watched, self._lastSaved = time.perf_counter(), self._saved_at()

    def continue_here(self):
        """Replaces a replay by a simulation that goes on from the present step."""
        self.message = ""
        with self.outputs.reporting():
            replay = self.simulation
            simulation = resume(replay.recording, replay.stepCount, submitted=replay.submitted)
            simulation.startSettings = replace(simulation.settings)
            self._show_other(simulation, self.view.show_instead)

    def files(self):
        """Returns a list of ListedFile: files beside the current scene, and the scenes in data/."""
        return list_files(self.simulation.scenePath.parent)

    def name(self):
        """Returns the name of the current scene."""
        return scene_name(self.simulation.scenePath)
