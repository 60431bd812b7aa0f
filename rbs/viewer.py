"""The window: what its buttons and keys do.

It is handed what it needs: a simulation or a replay, a function that opens another file, and one
that lists them. How the panels look is `rbs.panel`'s, what is drawn behind them `rbs.drawing`'s.
Polyscope is imported inside the functions that use it, never with this module. From the top:
`show_window`; `Viewer`.
"""

import time
from collections import deque
from pathlib import Path
from statistics import median

import numpy as np

from rbs.bodies import StateError
from rbs.cameras import apply_camera, load_camera, save_camera
from rbs.messages import print_note
from rbs.panel import MARGIN, PANEL_WIDTH, Panel
from rbs.pictureoptions import PictureOptions, video_timing
from rbs.pictures import Video, VideoError, save_picture, start_view
from rbs.simulation import ADVICE_STEP

# Frames and steps over which the milliseconds on screen are a median: half a second's worth.
TIMED_STEPS = 25
# A frame makes the steps that are due, so that a scene plays at its true speed however fast it is
# drawn, but goes on to draw after this many seconds of stepping: a window that is slower than the
# scene plays in slow motion, and still answers to its buttons.
STEPPING_SECONDS = 0.02
# What is due after a pause in drawing, while the window is dragged for instance, is forgotten but
# for this many seconds, so that the scene does not leap.
CATCH_UP_SECONDS = 0.1
# Steps that a plot goes back.
PLOTTED_STEPS = 500
# Smooth edges: after so many frames it is judged whether there is time for them, which there is
# while frames take less than the first of these many seconds without, and the second one with.
TRIAL_FRAMES = 20
FAST_FRAME, SMOOTH_FRAME = 0.018, 0.022
# m/s that a push gives to a body's centre of mass.
DEFAULT_PUSH = 8.0


def show_window(simulation, backend, openFile, listFiles, measure, pictureOptions=None):
    """Opens the window on a simulation or a replay; returns when it is closed.

    openFile, listFiles, measure : see `Viewer`; pictureOptions : `PictureOptions`, or None
    """
    import polyscope as ps

    options = pictureOptions or PictureOptions()
    view = start_view(simulation, backend, options, PANEL_WIDTH + MARGIN)
    ps.set_build_default_gui_panels(False)
    ps.set_open_imgui_window_for_user_callback(False)
    viewer = Viewer(simulation, view, openFile, listFiles, measure)
    panel = Panel(viewer)
    ps.set_user_callback(panel.frame)
    ps.set_files_dropped_callback(panel.dropped)
    try:
        ps.show()
    finally:
        viewer.stop_video()
        ps.clear_user_callback()
        ps.clear_files_dropped_callback()


class Viewer:
    """What the window's buttons and keys do, apart from how they are drawn.

    Attributes: simulation, a simulation or a replay; view, a SceneView; isPlaying; stepsPerFrame,
    or 0 to keep pace with the clock; speed, of a replay, times real time; pushSpeed, m/s; message,
    an error line or ""; saved, a line about the last file that was written; video, the one that is
    being recorded, or None; isMeasuring, whether `history` grows: rows of time and quantities.
    """

    def __init__(self, simulation, view, openFile, listFiles, measure):
        """openFile(path, settings) gives a simulation or a replay, or raises ValueError;
        listFiles(folder) gives a dict of names and paths; measure(simulation) a dict of floats.
        """
        self.simulation = simulation
        self.view = view
        self.isPlaying = False
        self.stepsPerFrame = 0
        self.speed = 1.0
        self.pushSpeed = DEFAULT_PUSH
        self.message = self.saved = ""
        self.video = None
        self.isMeasuring = False
        self.history = deque(maxlen=PLOTTED_STEPS)
        self._openFile, self._listFiles, self._measure = openFile, listFiles, measure
        self._settings = None if self.isReplay else simulation.settings
        self._due = 0.0  # seconds of simulation that playing has fallen behind by
        self._phases = deque(maxlen=TIMED_STEPS)
        self._recentSeconds = deque(maxlen=TIMED_STEPS)
        self._frames = deque(maxlen=TIMED_STEPS)
        self._trial = []  # seconds of the frames by which smooth edges are chosen; None afterwards

    @property
    def isReplay(self):
        """Whether a recording is shown, which can be sought in; else a scene is simulated."""
        return hasattr(self.simulation, "seek")

    def choose_smoothness(self, elapsed):
        """Has edges drawn smoothly where frames stay fast with that; elapsed : since the last one.

        Tried out once, in the first frames that play, without and then with: while nothing moves,
        the scene is not drawn anew.
        """
        if self._trial is None or not self.isPlaying:
            return
        self._trial.append(elapsed)
        if len(self._trial) == TRIAL_FRAMES:
            # The later half: the first frames, and those after a change, take longer.
            isFast = median(self._trial[TRIAL_FRAMES // 2 :]) < FAST_FRAME
            self.view.set_supersampling(isFast)
            if not isFast:
                self._trial = None
        elif len(self._trial) == 2 * TRIAL_FRAMES:
            if median(self._trial[-TRIAL_FRAMES // 2 :]) > SMOOTH_FRAME:
                self.view.set_supersampling(False)
            self._trial = None

    # Time.

    def toggle_play(self):
        """Plays if paused, pauses if playing. A replay that is at its end begins anew."""
        self.isPlaying = not self.isPlaying
        self.message = ""
        if self.isPlaying and self.isReplay:
            first, last = self.simulation.firstStep, self.simulation.lastStep
            if self.simulation.stepCount == (last if self.speed > 0.0 else first):
                self.seek(first if self.speed > 0.0 else last)
                self.isPlaying = True

    def play(self, elapsed):
        """If playing, makes the steps that are due `elapsed` seconds after the last frame."""
        if not self.isPlaying:
            self._due = 0.0
            return
        begin = time.perf_counter()
        if self.isReplay:
            self._play_replay(elapsed)
        elif self.stepsPerFrame:
            for _ in range(self.stepsPerFrame):
                if not self._step():
                    break
        else:
            self._play_in_time(elapsed)
        self._frames.append((elapsed, time.perf_counter() - begin))
        self._show()

    def _play_in_time(self, elapsed):
        timeStep = self.simulation.settings.timeStep
        self._due = min(self._due + elapsed, max(CATCH_UP_SECONDS, timeStep))
        begin = time.perf_counter()
        while self._due >= timeStep:
            self._due -= timeStep
            if not self._step():
                break
            if time.perf_counter() - begin > STEPPING_SECONDS:
                self._due = 0.0

    def _play_replay(self, elapsed):
        simulation = self.simulation
        self._due += min(elapsed, CATCH_UP_SECONDS) * self.speed
        timeStep = simulation.settings.timeStep
        steps = int(self._due / timeStep)  # towards 0
        if self.video is not None:  # no step is passed over in a video
            steps = max(-1, min(1, steps))
            self._due = steps * timeStep
        self._due -= steps * timeStep
        if steps:
            simulation.seek(simulation.stepCount + steps)
            self._film()
        if simulation.stepCount == (simulation.lastStep if steps > 0 else simulation.firstStep):
            self.isPlaying = self.isPlaying and not steps

    def _step(self):
        """One step, if its numbers are sound; else pauses, with a message. Whether it was made."""
        try:
            self.simulation.step()
        except StateError as error:
            self.isPlaying = False
            self.message = str(error)
            return False
        if self.simulation.report is not None:
            self._recentSeconds.append(self.simulation.stepSeconds)
            if self.simulation.stepCount == ADVICE_STEP:
                print_note(self.simulation.advice())
            self._phases.append(self.simulation.report.seconds)
        self._film()
        return True

    def _film(self):
        if self.video is not None:
            try:
                self.video.add(self.simulation)
            except OSError as error:
                self.stop_video()
                self.message = f"cannot write: {error.strerror or error}"

    def _show(self):
        """Draws the present state, and adds it to the plots."""
        if self.isMeasuring:
            self.history.append((self.simulation.time, self._measure(self.simulation)))
        self.view.refresh()

    def step_once(self):
        """A single step: pauses, if playing."""
        self.isPlaying = False
        self.message = ""
        self._step()
        self._show()

    def seek(self, step):
        """Puts a replay to a step, paused."""
        self.isPlaying = False
        self.simulation.seek(step)
        self.history.clear()
        self.view.refresh()

    def reset(self):
        """Back to the start of the scene, paused. The camera stays."""
        self.isPlaying = False
        self.message = ""
        self.simulation.reset()
        self._forget()
        self.view.refresh()

    def _forget(self):
        for memory in (self.history, self._recentSeconds, self._phases, self._frames):
            memory.clear()

    # Files.

    def open(self, path):
        """Changes to another scene or recording, paused. A broken one only leaves its error in
        `message`. The settings go on from scene to scene."""
        self.message = ""
        try:
            if Path(path).suffix == ".json":
                apply_camera(load_camera(path))
                return
            simulation = self._openFile(Path(path), self._settings)
        except ValueError as error:
            self.message = str(error)
            return
        except (OSError, MemoryError) as error:
            self.message = f"{path}: cannot be read ({error or 'there is not enough memory'})"
            return
        self.stop_video()
        self.isPlaying = False
        self.simulation = simulation
        if not self.isReplay:
            self._settings = simulation.settings
        self._forget()
        self.view.rebuild(simulation)

    def files(self):
        """Names and paths of the scenes and recordings beside the current scene."""
        return self._listFiles(self.simulation.scenePath.parent)

    def name(self):
        """What the current scene is called."""
        path = self.simulation.scenePath
        names = [name for name, other in self.files().items() if other == path]
        return names[0] if names else path.stem

    def _out_path(self, stem, ending):
        """A path in out/<scene> that does not exist yet; makes the folder."""
        folder = Path("out") / self.name()
        folder.mkdir(parents=True, exist_ok=True)
        path, number = folder / (stem + ending), 1
        while path.exists():
            number += 1
            path = folder / f"{stem}-{number}{ending}"
        return path

    def _write(self, stem, ending, write):
        """Writes a file of a new name; tells in `saved` or `message` what came of it."""
        self.message = ""
        try:
            path = self._out_path(stem, ending)
            write(path)
        except OSError as error:
            self.message = f"cannot write: {error.strerror or error}"
            return
        self.saved = f"saved {path}"

    def save_picture(self):
        """Writes what is seen, without the panel, as a PNG in out/<scene>."""
        self._write(
            f"picture_{self.simulation.stepCount:06d}", ".png",
            lambda path: save_picture(path, self.view),
        )  # fmt: skip

    def save_camera(self):
        """Writes the camera, for --camera or to be dropped onto the window."""
        self._write("camera", ".json", save_camera)

    def toggle_video(self):
        """Begins a video of what is played from now on, or ends it."""
        if self.video is not None:
            self.stop_video()
            return
        self.message = ""
        try:
            rate, every = video_timing(self.simulation.settings.timeStep)
            self.video = Video(self._out_path("video", ".mp4"), self.view, rate, every)
        except VideoError as error:
            self.message = str(error)
        except OSError as error:
            self.message = f"cannot write: {error.strerror or error}"
        else:
            self.view.set_resizable(False)  # all pictures of a video are of one size
            self._film()

    def stop_video(self):
        """Ends the video, if there is one."""
        if self.video is not None:
            video, self.video = self.video, None
            self.view.set_resizable(True)
            try:
                video.save()
            except OSError as error:
                video.close()
                self.message = f"cannot write: {error.strerror or error}"
            else:
                self.saved = f"saved {video.path}, {video.count} pictures"

    # Bodies.

    def pick_at(self, pixel):
        """Picks the body at a pixel of the window, or none."""
        self.view.pick(*self.view.body_at(pixel))
        self.view.refresh()

    def picked(self):
        """The picked Mesh, or None."""
        return None if self.view.picked is None else self.simulation.meshes[self.view.picked]

    def push(self, direction):
        """Pushes the picked body along a unit direction (3,), at the point that was clicked."""
        mesh = self.picked()
        mesh.push(mesh.mass * self.pushSpeed * np.asarray(direction), self.view.picked_point())
        self.view.refresh()

    def set_fixed(self, isFixed):
        """Fixes or frees the picked body."""
        self.picked().isFixed = isFixed
        self.view.refresh()

    # Numbers.

    def milliseconds(self):
        """Median time of the last steps, or None before the first."""
        return 1e3 * median(self._recentSeconds) if self._recentSeconds else None

    def phase_milliseconds(self):
        """Median time of each phase of the last steps: dict of name and ms, empty before them."""
        names = self._phases[-1] if self._phases else ()
        return {
            name: 1e3 * median(seconds.get(name, 0.0) for seconds in self._phases)
            for name in names
        }  # fmt: skip

    def frame_milliseconds(self):
        """Medians of (a frame while playing, the part of it spent simulating), or None."""
        if not self._frames:
            return None
        return tuple(1e3 * median(column) for column in zip(*self._frames, strict=True))
