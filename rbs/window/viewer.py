"""The actions of the window's buttons, keys and mouse.

`rbs.window.panel` draws the panels and calls these actions, `rbs.pictures.view` draws the scene
behind them. In this order: time; files; bodies; timings.
"""

import math
import os
import time
from collections import Counter, deque
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import fmean

import numpy as np

from rbs.appearance.camerafiles import load_camera
from rbs.appearance.pictureoptions import video_timing
from rbs.pictures.cameras import apply_camera, save_camera
from rbs.pictures.capture import draw_frame, save_picture
from rbs.pictures.pictureprocess import PictureProcess
from rbs.recordings.encoder import Video
from rbs.recordings.lookup import list_files
from rbs.recordings.page import PageWriter
from rbs.recordings.recording import Recorder, is_recording_name
from rbs.recordings.replay import resume
from rbs.recordings.statistics import step_quantities
from rbs.scenes import changes
from rbs.scenes.files import folder_opener
from rbs.scenes.grabbing import MOST_SHOTS, Grab, shot
from rbs.scenes.messages import InputError, counted, one_line
from rbs.scenes.scenefiles import scene_name
from rbs.scenes.state import Writer
from rbs.stepping.meshes import StateError
from rbs.window.playback import Playback, fitting_speed, speed_name
from RBSFunctions import refresh_vertices

# Frames, and steps, over which timings are averaged: half a second of playing.
TIMED_STEPS = 25
# Number of bodies above which batches are suggested. Up to it, a speed is suggested, and plots grow
# while they are hidden; with more, their quantities take milliseconds. Number of steps in plots.
MANY_BODIES, PLOTTED_STEPS = 100, 500
# States that are kept to go back to: their number, and the number of bodies in all of them, which
# limits their memory to about 200 MB.
MOST_STATES, MOST_KEPT_BODIES = 500, 100_000
# Files that a Viewer may be writing, by attribute: the activity in the timings of a frame, the unit
# of the file's length, and the beginning and end of its name.
FILES = {
    "video": ("filming", "frame", "video", ".mp4"),
    "page": ("filming", "frame", "page", ".html"),
    "recorder": ("recording", "step", "recording", ".h5"),
}
# Messages that are no errors; and the one if the user drags or shoots in a replay.
NOTES = "No earlier step is kept", "This is the first step."
UNCHANGEABLE = 'A recording is read-only; "Continue from here" turns it into a simulation'


class Viewer(Writer):
    """The actions of the window's buttons, keys and mouse, apart from drawing them.

    Attributes
    ----------
    simulation, view : SceneSimulation or Replay; SceneView
    isPlaying, playback : whether it plays; Playback, with the speed
    pushSpeed, grab : m/s; Grab of the dragged body, or None
    message, saved : an error, and a line about the last file written, or ""
    offer : (text, label, function): the button beside the message `text`; or None
    video, page, recorder, picture : files that are being written, or None
    look : one of LOOKS, for pictures
    isMeasuring, history : whether `history`, rows (time, quantities), grows
    moments, place : States that can be gone to, and the number of those before the present one,
        which is itself among them only after going back
    """

    def __init__(self, simulation, view, opener, look="plain"):
        """opener : SceneOpener of the files that the user opens"""
        self.view, self.playback, self.look = view, Playback(), look
        self.isPlaying = self.isMeasuring = False
        self.pushSpeed, self.saved = 8.0, ""
        self.grab = self.offer = self.video = self.page = self.recorder = self.picture = None
        self.history = deque(maxlen=PLOTTED_STEPS)
        self._opener = opener
        # Per step and per frame: the seconds of the whole and of its parts.
        self._steps, self._frames = deque(maxlen=TIMED_STEPS), deque(maxlen=TIMED_STEPS)
        self._spent = Counter()  # seconds of the present frame, by activity
        self._isMoved = False  # whether the dragged body was moved while paused
        self._take_up(simulation)

    @property
    def isReplay(self):
        """Whether a recording is shown instead of a simulation."""
        return not self.simulation.isEditable

    # Time.

    def toggle_play(self):
        """Plays if paused, pauses if playing. A replay at its end starts again."""
        self.isPlaying = not self.isPlaying
        self.message = ""
        if self.isPlaying and self.isReplay:
            ends = self.simulation.firstStep, self.simulation.lastStep
            begin, end = ends[::-1] if self.playback.isBackwards else ends
            if self.simulation.stepCount == end:
                self.seek(begin)
                self.isPlaying = True

    def play(self, elapsed):
        """If playing, makes the steps that are due `elapsed` seconds after the last frame."""
        if not self.isPlaying:
            self.playback.stop()
            if self.recorder is not None:
                with self._reporting("recorder"):
                    self.recorder.flush()
            return
        if self.playback.pace() is not None:  # the first one waited for Play
            self._frames.append({"frame": elapsed, **self._spent})
        self._spent = Counter()
        before, timeStep = self.simulation.time, self.simulation.settings.timeStep
        if not self.isReplay:
            self.playback.advance(elapsed, timeStep, self._step)
        elif self.video is not None or self.playback.speed == math.inf or self.view.showsReport:
            self.playback.advance(elapsed, timeStep, self._step_replay)
        elif count := self.playback.due(elapsed, timeStep, isReplay=True):
            self._step_replay(count)  # jumps to the step that is due
        self.playback.note(elapsed, abs(self.simulation.time - before))
        self._show()

    def _step_replay(self, count=1):
        """Goes `count` recorded steps on, or back; pauses at the end. Returns whether to go on."""
        replay = self.simulation
        with self._timed("reading the recording"):
            replay.seek(replay.stepCount + (-count if self.playback.isBackwards else count))
        if self.view.showsReport:
            with self._timed("making the step again"):
                replay.find_report()
        self.add(replay)
        end = replay.firstStep if self.playback.isBackwards else replay.lastStep
        self.isPlaying = self.isPlaying and replay.stepCount != end
        return self.isPlaying

    def _step(self):
        """Makes one step, or pauses with a message if it fails. Returns whether it was made."""
        simulation = self.simulation
        if self.isReplay:
            simulation.step()
            return True
        self._end_move()
        moment = self._moment()
        if self.grab is not None:
            mesh = simulation.meshes[self.grab.body]
            simulation.change(self.grab.change(mesh, simulation.settings.timeStep))
        try:
            simulation.step()
        except StateError as error:
            self.isPlaying = False
            self.message = str(error)
            return False
        self._keep(moment)
        self._spent["simulating"] += simulation.stepSeconds
        if simulation.report is not None:
            self._steps.append({"step": simulation.stepSeconds, **simulation.report.seconds})
        return True

    def add(self, simulation):
        """Hands the present state to the files that are being written."""
        for name, (activity, *_) in FILES.items():
            if getattr(self, name) is not None:
                with self._timed(activity), self._reporting(name):
                    getattr(self, name).add(simulation)

    def note(self, simulation, change):
        """Records a `Change` made by hand."""
        if self.recorder is not None:
            self.recorder.note(simulation, change)

    @contextmanager
    def _timed(self, name):
        """Adds the seconds of the `with` block to the timings of the present frame."""
        begin = time.perf_counter()
        yield
        self._spent[name] += time.perf_counter() - begin

    def _show(self):
        """Draws the present state and adds it to the plots."""
        if self.isMeasuring or len(self.simulation.meshes) <= MANY_BODIES:
            self.history.append((self.simulation.time, step_quantities(self.simulation)))
        self.view.refresh()

    def step_once(self):
        """Makes a single step, and pauses."""
        self.isPlaying = False
        self.message = ""
        self._step()
        self._show()

    def step_back(self):
        """Goes back by a step, or undoes what was done since, and pauses."""
        simulation = self.simulation
        self.release()
        self.isPlaying = False
        self.message = ""
        if self.isReplay and simulation.stepCount > simulation.firstStep:
            self.seek(simulation.stepCount - 1)
        elif self.place > 0:
            self.seek(self.place - 1)
        else:
            self.message = NOTES[self.isReplay or simulation.stepCount == 0]

    def seek(self, place):
        """Goes to a step of a replay, or to a place in `moments`, and pauses.

        The latter ends a recording, video or page that is being made.
        """
        self.isPlaying = False
        self.release()
        simulation = self.simulation
        if self.isReplay:
            simulation.seek(place)
            self.history.clear()
        else:
            self.stop_files()
            if self.place == len(self.moments):
                self.moments.append(self._moment())
            crossed = (one.settings for one in self.moments[place : self.place] if one.settings)
            vars(simulation.settings).update(vars(next(crossed, simulation.settings)))
            self.place = place
            simulation.restore(self.moments[place])
            while self.history and self.history[-1][0] > simulation.time:
                self.history.pop()
        self.view.refresh()

    def last_place(self):
        """Returns the last place to which `seek` can go."""
        return max(self.place, len(self.moments) - 1)

    def _moment(self):
        """Returns the present State. To go back to it keeps the settings."""
        state = self.simulation.state()
        state.settings = None
        return state

    def _keep(self, moment):
        """Adds the moment before something new to `moments`, in place of later ones."""
        self.moments[self.place :] = [moment]
        del self.moments[: -min(MOST_STATES, 1 + MOST_KEPT_BODIES // len(moment.meshes))]
        self.place = len(self.moments)

    def reset(self):
        """Starts over with the settings of the scene, and pauses."""
        if not self.isReplay:
            self.restore_settings()
        self.restart()

    def restart(self):
        """Starts over with the present settings and camera, and pauses."""
        self._halt()
        self.message = ""
        if not self.isReplay and (self.simulation.stepCount or self.simulation.changes):
            self._keep(self._moment())
        self.simulation.reset()
        self.view.refresh()

    def _halt(self):
        """Pauses, ends files and the drag, and forgets plots and timings."""
        self.isPlaying = False
        self.stop_files()
        self.release()
        for memory in (self.history, self._steps, self._frames):
            memory.clear()

    def restore_settings(self, name=None):
        """Restores the settings with which the scene was opened, or only the one of this name."""
        settings, begun = self.simulation.settings, self.simulation.startSettings
        if settings != begun:
            self._keep(self.simulation.state())
            values = vars(begun) if name is None else {name: getattr(begun, name)}
            vars(settings).update(vars(settings.changed(**values)))
            self.view.refresh()

    # Files.

    def open(self, path):
        """Opens a scene or recording, paused, with its own settings, or a camera; or says why not.

        path : see `find_scene`
        """
        self.message = self.saved = ""
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
        """Takes over a simulation or a replay, and shows advice about it."""
        self.simulation = simulation
        simulation.writers.append(self)
        self.moments, self.place = [], 0
        self.message = simulation.step_advice()
        self._suggest()

    def _suggest(self):
        """Offers the schedule of contacts that is faster for many bodies, or a speed for few."""
        settings, count = self.simulation.settings, len(self.simulation.meshes)
        isSlow = (settings.contactSolver, settings.contactScheduling) == ("impulse", "sequential")
        if count > MANY_BODIES:  # they may be too slow for real time as it is
            if isSlow and not self.isReplay and not self.simulation.submitted:
                text = f'{count} bodies: contacts in "batches" are faster, with identical motion'
                act = partial(settings.change, "contactScheduling", "batches")
                self._offer(text, "Use batches", act)
            return
        height = refresh_vertices(self.simulation.meshes)[:, 1].max(initial=0.0)
        downwards = -settings.acceleration[1]
        fall = math.sqrt(2.0 * height / downwards) if downwards > 0.0 else 1.0
        speed = fitting_speed(fall)
        if speed != 1.0 == self.playback.speed:
            text = f"Gravity looks {'slow' if speed > 1.0 else 'fast'} at 1 ×: a fall from the top"

            def act():
                self.playback.speed, self.isPlaying = speed, True

            self._offer(f"{text} takes {fall:.2g} s", f"Play at {speed_name(speed)}", act)

    def _offer(self, text, label, act):
        """Shows a message with a button, which acts and removes the message."""

        def act_once():
            act()
            self.saved = ""

        self.saved = text
        self.offer = text, label, act_once

    def continue_here(self):
        """Replaces a replay by a simulation that goes on from the present step."""
        self.message = ""
        with self._reporting():
            replay = self.simulation
            simulation = resume(replay.recording, replay.stepCount, submitted=replay.submitted)
            simulation.startSettings = replace(simulation.settings)
            self._show_other(simulation, self.view.show_instead)

    def open_beside(self, way):
        """Opens the next scene in the list, or the one before if `way` is -1."""
        files = [one for one in self.files() if not is_recording_name(one.path)]
        names = [one.name for one in files]
        place = names.index(self.name()) + way if self.name() in names else 0
        self.open(files[place % len(files)].path)

    def files(self):
        """Returns a list of ListedFile: files beside the current scene, and the scenes in data/."""
        return list_files(self.simulation.scenePath.parent)

    def name(self):
        """Returns the name of the current scene."""
        return scene_name(self.simulation.scenePath)

    def _out_path(self, stem, ending):
        """Returns a path in out/<scene> that does not exist yet. Creates the folder."""
        folder = Path("out") / self.name()
        folder.mkdir(parents=True, exist_ok=True)
        path, number = folder / (stem + ending), 1
        while path.exists():
            number += 1
            path = folder / f"{stem}-{number}{ending}"
        return path

    def _tell_saved(self, sizes):
        """Reports files, by path with a text about each, and offers to open their folder."""
        if sizes:
            paths = [Path(path).resolve() for path in sizes]
            self.saved = "\n".join(map("saved {}{}".format, paths, sizes.values()))
            if openFolder := folder_opener(paths[0].parent):
                self._offer(self.saved, "Open folder", openFolder)

    def _write(self, stem, ending, write):
        """Writes a file with a new name, and reports it."""
        self.message = ""
        with self._reporting():
            path = self._out_path(stem, ending)
            write(path)
            self._tell_saved({path: ""})

    @contextmanager
    def _reporting(self, name=None):
        """Reports an error of the `with` block, which ends the writer of this name."""
        try:
            yield
        except (OSError, InputError) as error:
            isTold = isinstance(error, InputError)
            self.message = str(error) if isTold else f"cannot write: {one_line(error)}"
            if name is not None and getattr(self, name) is not None:
                with suppress(OSError):  # reported above
                    getattr(self, name).close()
                setattr(self, name, None)
                self.view.set_resizable(self.video is None)

    def save_picture(self):
        """Saves the view, without panels, as a PNG in out/<scene>."""

        def write(path):
            if self.look == "plain":
                save_picture(path, self.view)
            else:
                self.picture = PictureProcess(path, self.view)

        if self.picture is None:
            self._write(f"picture_{self.simulation.stepCount:06d}", ".png", write)
            self.watch_picture()

    def watch_picture(self):
        """Shows the progress of a studio picture, if one is being drawn."""
        picture = self.picture
        if picture is not None and picture.poll():
            self.saved = f"drawing {picture.path}: {100.0 * picture.fraction:.0f} %"
        elif picture is not None:
            self.picture, self.saved = None, ""
            self.message = picture.error and f"cannot draw the picture: {picture.error}"
            if not picture.error:
                self._tell_saved({picture.path: ""})

    def save_camera(self):
        """Saves the viewpoint, for --camera or to be dropped onto the window."""
        self._write("camera", ".json", save_camera)

    def toggle_file(self, name):
        """Starts writing one of FILES in out/<scene>, or ends it."""
        if getattr(self, name) is not None:
            self.stop_files(name)
            return
        self.message = ""
        timing = video_timing(self.simulation.settings.timeStep)
        film = partial(Video, draw=partial(draw_frame, self.view), rate=timing[0], every=timing[1])
        begin = {"video": film, "page": PageWriter, "recorder": Recorder}[name]
        with self._reporting(name):
            setattr(self, name, begin(self._out_path(*FILES[name][2:])))
            self.view.set_resizable(self.video is None)
            getattr(self, name).add(self.simulation)

    def stop_files(self, *names):
        """Ends those of FILES, or all, that are being written."""
        sizes = {}
        for name in names or FILES:
            if (writer := getattr(self, name)) is not None:
                with self._reporting(name):
                    count = writer.frameCount - 1 if name == "recorder" else writer.count
                    writer.save(self.simulation)
                    sizes[writer.path] = f", {counted(count, FILES[name][1])}"
                setattr(self, name, None)
                self.view.set_resizable(self.video is None)
        self._tell_saved(sizes)

    # Bodies.

    def _act(self, change):
        """Makes a `Change` that can be undone, and draws it."""
        self._end_move()
        self._keep(self._moment())
        self.simulation.change(change)
        self.view.refresh()

    def grab_at(self, pixel):
        """Starts dragging the body at a pixel, by the visible point."""
        self.release()
        body, point = self.view.body_at(pixel)
        if body is None:
            return
        self.message = UNCHANGEABLE if self.isReplay else ""
        if not self.isReplay:
            self.grab = Grab(self.simulation.meshes[body], body, point)
            self._grabPixel, self._grabDistance = pixel, self.view.distance_of(point)

    def drag_to(self, pixel):
        """Moves the target of the spring to a pixel, at the distance where the drag began.

        While paused, the body itself moves.
        """
        if self.grab is not None and (self.isPlaying or pixel != self._grabPixel):
            self._grabPixel = pixel
            self.grab.target = self.view.point_at(pixel, self._grabDistance)
            mesh = self.simulation.meshes[self.grab.body]
            way = self.grab.target - self.grab.point(mesh)
            if not self.isPlaying and way.any():
                if not self._isMoved:
                    self._keep(self._moment())
                mesh.position = mesh.position + way
                self._isMoved = True
                self.view.refresh()

    def _end_move(self):
        """Turns a move made while paused into a single change."""
        if self._isMoved:
            self._isMoved = False
            body = self.grab.body
            self.simulation.change(changes.move(body, self.simulation.meshes[body].position[0]))

    def release(self):
        """Ends the drag. The body keeps its velocity."""
        self._end_move()
        self.grab = None

    def drag_force(self):
        """Returns the mean force of the spring over a step, in newtons; 0 on a fixed body."""
        mesh, timeStep = self.simulation.meshes[self.grab.body], self.simulation.settings.timeStep
        if mesh.isFixed:
            return 0.0
        return math.hypot(*self.grab.change(mesh, timeStep).numbers[:3]) / timeStep

    def shoot(self, pixel):
        """Shoots a ball from the camera towards a pixel."""
        simulation = self.simulation
        self.message = ""
        if self.isReplay:
            self.message = UNCHANGEABLE
        elif simulation.submitted is not None:
            self.message = "no shots with --functions, because they only know the scene's bodies"
        elif len(simulation.meshes) - simulation.sceneCount >= MOST_SHOTS:
            self.message = f"Limit of {MOST_SHOTS} balls reached; R removes them"
        else:
            self._act(shot(simulation.meshes, self.view.size, *self.view.aim(pixel)))

    def pick_at(self, pixel):
        """Selects the body at a pixel, or none."""
        self.view.pick(*self.view.body_at(pixel))
        self.view.refresh()

    def picked(self):
        """Returns the selected Mesh, or None."""
        return None if self.view.picked is None else self.simulation.meshes[self.view.picked]

    def push(self, direction):
        """Pushes the selected body along a unit direction (3,), at the clicked point."""
        impulse = self.picked().mass * self.pushSpeed * np.asarray(direction)
        self._act(changes.push(self.view.picked, impulse, self.view.picked_point()))

    def set_fixed(self, isFixed):
        """Fixes or frees the selected body."""
        self._act(changes.fix(self.view.picked, isFixed))

    # Timings.

    def milliseconds(self):
        """Returns mean milliseconds of the last frames while playing, and of the last steps.

        Each is a dict: of the whole, "frame" or "step"; of its parts; and of the rest.
        """
        means = []
        for rows, rest in ((self._frames, "drawing and waiting"), (self._steps, "other")):
            names = dict.fromkeys(name for row in rows for name in row)
            mean = {name: 1e3 * fmean(row.get(name, 0.0) for row in rows) for name in names}
            if mean:
                whole, *parts = mean.values()
                mean[rest] = whole - sum(parts)
            means.append(mean)
        return means
