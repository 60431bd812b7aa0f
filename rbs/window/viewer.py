"""The viewer behind the window's buttons and keys: time, settings and files.

`rbs.window.panel` draws the panels and calls these actions, `rbs.pictures.view` draws the scene.
"""

import os
import time
from collections import deque
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from rbs.appearance.camera import load_camera
from rbs.pictures.viewpoint import apply_camera
from rbs.recordings.replay import resume
from rbs.scenes.messages import one_line
from rbs.scenes.scenefiles import scene_name
from rbs.scenes.settingtexts import TEXTS
from rbs.scenes.simulation import go_beside
from rbs.stepping.meshes import StateError
from rbs.window.hand import Hand
from rbs.window.history import History, Playback, RecordedMoment
from rbs.window.outputs import FOLLOWING, Outputs

# Steps in mean times; seconds between looks at the files of a student, and that their functions
# may take for a step.
TIMED_STEPS, WATCH_SECONDS, FUNCTION_SECONDS = 25, 0.5, 10.0


class Viewer:
    """The actions of the window's buttons and keys, apart from drawing them.

    simulation, view : SceneSimulation or Replay; SceneView
    isPlaying, playback, history : whether it plays; Playback; History
    timings : of the last steps, dicts of seconds by phase
    hand, outputs : Hand, with which the user changes bodies; Outputs, the files that are written
    message : what the user is told, until the next action; or ""
    """

    def __init__(self, simulation, view, opener):
        """opener : SceneOpener of the files that the user opens"""
        self.view, self._opener = view, opener
        self.isPlaying, self.message = False, ""
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
        if self.isPlaying and self.isReplay and not self.history.isAhead:
            self.seek(0)
            self.isPlaying = True

    def play(self, elapsed):
        """If playing, makes the steps that are due `elapsed` seconds after the last frame."""
        playback = self.playback
        if not self.isPlaying:
            playback.stop()
            self.outputs.flush()
            return
        playback.advance(elapsed, self.simulation.settings.timeStep, self._step)
        self.refresh()

    def _step(self):
        """Makes a step, or goes on to what was kept or recorded. Returns whether to go on."""
        simulation, history = self.simulation, self.history
        if history.isAhead and self.hand.grab is None:
            before = history.now
            history.go(history.place + 1)
            self.outputs.go_on(before)
            self.isPlaying = self.isPlaying and (history.isAhead or not self.isReplay)
            return not self.isReplay or self.isPlaying
        if self.isReplay:
            self.message = "This is the last step."
            return False
        self.outputs.check()
        history.make_whole()
        start = self.hand.pull()
        try:
            simulation.step()
        except StateError as error:
            history.go(history.place)
            self.isPlaying, self.message = False, str(error)
            return False
        history.add(isStep=True, start=start)
        self.outputs.moment = history.now
        if simulation.report is not None:
            self.timings.append({"step": simulation.stepSeconds, **simulation.report.seconds})
        return True

    def refresh(self):
        """Draws the present state from the next frame on."""
        if self.view.showsReport:
            self.find_report()
        self.view.refresh()

    def find_report(self):
        """Finds the report of the last step again if it is no longer kept."""
        moment = self.history.now
        if self.simulation.report is None and moment.isStep and not moment.error:
            self.history.remake()

    def leave_event(self):
        """Shows the present state instead of a moment within the last step."""
        self.view.show_event(None)

    @contextmanager
    def changing(self, topic=None, startsOver=False):
        """Does something new in the `with` block, a change of bodies or settings, which can be
        undone. topic, startsOver : see `History.add`
        """
        self.leave_event()
        self.outputs.check()
        self.history.make_whole()
        yield
        self.history.add(topic, startsOver=startsOver)
        self.outputs.moment = self.history.now
        self.refresh()

    # Back and forth.

    def _pause(self):
        self.hand.release()
        self.leave_event()
        self.isPlaying, self.message = False, ""

    def step_once(self):
        """Goes one step forward, to what was kept or else to something new, and pauses."""
        grab = self.hand.grab
        self._pause()
        self.hand.grab = grab
        self._step()
        self.refresh()

    def redo(self):
        """Goes forward to what was undone or kept, and pauses."""
        self._pause()
        before = self.history.now
        if not self.history.redo():
            self.message = "Nothing to redo."
        self.outputs.go_on(before)
        self.refresh()

    def step_back(self):
        """Goes back by a step, or undoes what was done since, and pauses."""
        self._pause()
        if not self.history.undo():
            self.message = "This is the first step."
        self.refresh()

    def seek(self, place):
        """Goes to a place of `history`, and pauses."""
        self._pause()
        if place != self.history.place:
            self.history.go(min(max(place, 0), len(self.history.axis) - 1))
        self.refresh()

    def seek_step(self, step):
        """Goes to a step, or to the nearest one that is kept, and pauses."""
        self.seek(self.history.place_of(step))

    # Starting over, and settings.

    def restart(self, withSettings=False):
        """Starts over, and pauses; with the scene's own settings, or with the present ones.

        A student's functions are loaded again.
        """
        simulation, settings = self.simulation, self.simulation.settings
        self._pause()
        self.timings.clear()
        if self.isReplay:
            return self.seek(0)
        self.outputs.stop(*FOLLOWING)
        isOther = withSettings and settings != simulation.startSettings
        kept = simulation.startSettings if withSettings else replace(settings)
        if self.history.place or simulation.stepCount or isOther:
            with self.changing(startsOver=True):
                simulation.reset()
                vars(simulation.settings).update(vars(kept))
        self.view.viewpoint.come_back()
        self._reload()

    def _reload(self):
        submitted = self.simulation.submitted
        if submitted is not None:
            try:
                self.simulation.submitted = self._opener.submitted = submitted.again()
            except ValueError as error:
                self.message = f"{error}\nThe version loaded before still runs."
            else:
                self.simulation.beside = None
                go_beside(self.simulation)
            self._lastSaved = self._saved_at()

    def _saved_at(self):
        """Returns when the files of a student were saved last, or None without a student."""
        if (submitted := self.simulation.submitted) is None:
            return None
        found = []
        for path in sorted(Path(submitted.folder).glob("*.py")):
            with suppress(OSError):  # of a lock, or of a file that is being replaced
                found.append((path.name, path.stat().st_mtime_ns))
        return found

    def watch(self):
        """Starts over if a student has saved a file."""
        now = time.perf_counter()
        if not self.isReplay and now - self._watched > WATCH_SECONDS:
            self._watched = now
            if self._saved_at() != self._lastSaved:
                self.restart()
                if not self.message:
                    self.message = "Your functions have changed: loaded again, from the first step."

    def set(self, name, value):
        """Changes a setting, which can be undone, or says why not."""
        settings, self.message = self.simulation.settings, ""
        try:
            TEXTS[name].setting.checked(value)
        except ValueError as error:
            self.message = f"{TEXTS[name].label} {error}"
        else:
            if getattr(settings, name) != value:
                with self.changing(name):
                    settings.change(name, value)

    # Opening.

    def open(self, path):
        """Opens a scene or recording, paused, with its own settings, a camera, or a student's
        functions, for the present scene; or says why not. path : see `find_scene`
        """
        self.message = ""
        try:
            ending, scene = Path(path).suffix.lower(), self.simulation.scenePath
            if ending == ".json":
                return apply_camera(load_camera(os.path.expanduser(path)))
            if ending == ".py":
                self._opener.take_functions(Path(path).parent, FUNCTION_SECONDS)
            other = self._opener.open(scene if ending == ".py" else path, scene.parent)
            self._show_other(other, self.view.rebuild)
        except ValueError as error:
            self.message = str(error)
        except (OSError, MemoryError) as error:
            self.message = f"{path}: cannot be read ({one_line(error)})"

    def _show_other(self, simulation, show, earlier=()):
        self._pause()
        self.outputs.stop()
        self._take_up(simulation, earlier)
        show(simulation)

    def _take_up(self, simulation, earlier=()):
        self.simulation, self.playback = simulation, Playback()
        if simulation.submitted is not None:
            simulation.submitted.seconds = FUNCTION_SECONDS
        if self.isReplay:
            steps = range(simulation.firstStep, simulation.lastStep + 1)
            earlier = [RecordedMoment(simulation, step) for step in steps]
        self.history = History(simulation, earlier)
        simulation.writers.append(self.outputs)
        self.timings = deque(maxlen=TIMED_STEPS)
        self._watched, self._lastSaved = time.perf_counter(), self._saved_at()

    def continue_here(self):
        """Replaces a replay by a simulation that goes on from the present step.

        The earlier steps of the recording can still be gone back to.
        """
        self.message = ""
        with self.outputs.reporting():
            replay, earlier = self.simulation, self.history.axis[: self.history.place + 1]
            simulation = resume(replay.recording, replay.stepCount, submitted=replay.submitted)
            simulation.startSettings = replace(simulation.settings)
            self._show_other(simulation, self.view.show_instead, earlier)
            self.history.add()

    @property
    def name(self):
        """The name of the current scene."""
        return one_line(scene_name(self.simulation.scenePath))
