"""The window: its panel, plots and timeline, and what their buttons do.

It is handed what it needs: a simulation or a replay, a function that opens another file, and one
that lists them. What is drawn behind the panel is `RBSDrawing`'s. Polyscope is imported inside the
functions that use it, never with this module.
"""

import math
import time
from collections import deque
from pathlib import Path
from statistics import median

import numpy as np

from RBSDrawing import (
    COLOURINGS,
    FIXED_COLOUR,
    LAYERS,
    LONE_COLOUR,
    MOST_BOXES,
    MOST_TRAILS,
    PICKED_COLOUR,
    TOP_SPEED,
    TRAIL_LENGTH,
    VELOCITY_SECONDS,
    DrawingError,
    Look,
    Video,
    apply_camera,
    colour_of_density,
    load_camera,
    save_camera,
    save_picture,
    start_look,
    video_timing,
    viridis,
)
from RBSFunctions import BROAD_PHASES, CONSTRAINT_SCHEDULINGS, PAIR_ORDERS, StateError

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
# Densities that the legend has room for; of more, it shows only the ends.
LEGEND_LINES = 6
# In pixels. The panel is as high as its content.
MARGIN = 12
PANEL_WIDTH = 330
BUTTON_SIZE = (74, 0)
WIDE_BUTTON_SIZE = (153, 0)
FIELD_WIDTH = 160
SIDE_WIDTH = 330
PLOT_SIZE = (-1.0, 190)
TIMELINE_HEIGHT = 74
SPEED_WIDTH = 150
NUMBER_WIDTH = 56
INDENT = 24
# The mouse moves less than this between pressing and releasing where it picks, and does not turn
# the camera.
CLICK_PIXELS = 4.0

# The sliders' ends. More friction than rubber on dry stone; more steps than a frame has time for.
MOST_FRICTION = 1.0
MOST_STEPS_PER_FRAME = 20
# m/s that a push gives to a body's centre of mass.
DEFAULT_PUSH, MOST_PUSH = 8.0, 40.0
# Times real time that a replay is played with, backwards if negative.
MOST_SPEED = 8.0

ERROR_TEXT = (1.0, 0.45, 0.40, 1.0)

# Settings that are one of some names: label, name in the settings, names to choose from, and what
# it says under the mouse.
CHOICES = [
    ("broad phase", "broadPhase", BROAD_PHASES, "The same motion; grid is faster for many bodies"),
    ("pair order", "pairOrder", PAIR_ORDERS, "In which order contacts are resolved"),
]
CONSTRAINT_CHOICES = [
    ("scheduling", "constraintScheduling", CONSTRAINT_SCHEDULINGS, "In which order they are met"),
]


# Of the switches in the section Look.
TOOLTIPS = {
    "contacts": "Where bodies touch, and the normal, towards the body with the lower number",
    "impulses": "What that body receives along the normal; the longest is the largest of the step",
    "friction impulses": "What it receives across",
    "velocities": f"How far a body comes in {VELOCITY_SECONDS:g} s",
    "bounding boxes": f"Of the first {MOST_BOXES} bodies",
    "grid cells": f"The first {MOST_BOXES} columns of the broad phase that hold a body",
    "trails": f"Where up to {MOST_TRAILS} centres of mass were in the last {TRAIL_LENGTH} pictures",
}


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

    @property
    def isReplay(self):
        return hasattr(self.simulation, "seek")

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
        self._write(f"picture_{self.simulation.stepCount:06d}", ".png", save_picture)

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
        except DrawingError as error:
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
        self.picked().set_fixed(isFixed)
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


class NumberField:
    """A number to be typed into the panel. It takes effect with Enter, or on leaving the field."""

    def __init__(self, label, name, step):
        """name : of a field of the settings; step : what the buttons + and - change it by"""
        self._label = label
        self._name = name
        self._step = step
        self._typed = None
        self.message = ""

    def draw(self, settings):
        """Draws the field; what `settings` refuses stays as it was, and the reason is shown."""
        import polyscope.imgui as psim

        value = getattr(settings, self._name)
        changed, value = psim.InputDouble(self._label, value, self._step, 0.0, "%.4g")
        if changed:
            self._typed = value
        if psim.IsItemDeactivatedAfterEdit() and self._typed is not None:
            self.message = ""
            try:
                settings.change(self._name, self._typed)
            except ValueError as error:
                self.message = str(error)
            self._typed = None
        if self.message:
            draw_error(self.message)


def draw_error(message):
    """A message in the panel that nobody overlooks."""
    import polyscope.imgui as psim

    psim.PushStyleColor(psim.ImGuiCol_Text, ERROR_TEXT)
    psim.TextWrapped(message)
    psim.PopStyleColor()


def draw_table(rows):
    """Rows (number, what it is), the numbers flush right; the first row is the sum of the rest."""
    import polyscope.imgui as psim

    left = psim.GetCursorPosX()
    for place, (number, text) in enumerate(rows):
        end = left + NUMBER_WIDTH + (INDENT if place else 0)
        psim.SetCursorPosX(end - psim.CalcTextSize(number)[0])
        psim.Text(number)
        psim.SameLine(end + MARGIN)
        psim.Text(text)


def draw_choice(label, current, names, tooltip=""):
    """A list to choose one name from; returns the chosen one, or None where nothing was."""
    import polyscope.imgui as psim

    chosen = None
    isOpen = psim.BeginCombo(label, current, psim.ImGuiComboFlags_HeightLarge)
    if tooltip and not isOpen:
        psim.SetItemTooltip(tooltip)
    if isOpen:
        for name in names:
            if psim.Selectable(name, selected=name == current):
                chosen = name
        psim.EndCombo()
    return chosen


class Panel:
    """The window's panels, timeline and keys: shows a Viewer and calls its functions.

    Attributes: viewer; fields, its two NumberFields, restitution and time step; path, what is
    typed into the field that opens a file.
    """

    def __init__(self, viewer):
        self.viewer = viewer
        self.path = ""
        self.fields = [
            NumberField("restitution", "restitution", 0.1),
            NumberField("time step (s)", "timeStep", 0.005),
        ]
        self._lastFrame = time.perf_counter()
        self._dropped = None
        self._pressedAt = None

    def dropped(self, paths):
        """Polyscope's callback for files that are dropped onto the window: the last one counts."""
        self._dropped = paths[-1]

    def frame(self):
        """Polyscope's callback: keys, panel, and the steps that are due."""
        if self._dropped is not None:
            self.viewer.open(self._dropped)
            self._dropped = None
        self._handle_keys()
        self._handle_mouse()
        self._draw_panel()
        self._draw_side()
        if self.viewer.picked() is not None:
            self._draw_body()
        if self.viewer.isReplay:
            self._draw_timeline()
        now = time.perf_counter()
        self.viewer.play(now - self._lastFrame)
        self._lastFrame = now

    def _handle_keys(self):
        import polyscope.imgui as psim

        if psim.GetIO().WantTextInput:  # somebody types into a field
            return
        viewer = self.viewer
        if psim.IsKeyPressed(psim.ImGuiKey_Space, False):
            viewer.toggle_play()
        # A key that is held down steps again and again.
        if psim.IsKeyPressed(psim.ImGuiKey_S) or psim.IsKeyPressed(psim.ImGuiKey_RightArrow):
            viewer.step_once()
        if viewer.isReplay and psim.IsKeyPressed(psim.ImGuiKey_LeftArrow):
            viewer.seek(viewer.simulation.stepCount - 1)
        if psim.IsKeyPressed(psim.ImGuiKey_R, False):
            viewer.reset()

    def _handle_mouse(self):
        """A click that does not drag picks a body."""
        import polyscope.imgui as psim

        io = psim.GetIO()
        if psim.IsMouseClicked(0):
            self._pressedAt = None if io.WantCaptureMouse else tuple(io.MousePos)
        if psim.IsMouseReleased(0) and self._pressedAt is not None:
            if math.dist(self._pressedAt, tuple(io.MousePos)) < CLICK_PIXELS:
                self.viewer.pick_at(self._pressedAt)
            self._pressedAt = None

    # The panel.

    def _draw_panel(self):
        import polyscope as ps
        import polyscope.imgui as psim

        most = ps.get_window_size()[1] - 2 * MARGIN
        psim.SetNextWindowPos((MARGIN, MARGIN), psim.ImGuiCond_Once)
        psim.SetNextWindowSizeConstraints((PANEL_WIDTH, 0), (PANEL_WIDTH, most))
        psim.Begin("Rigid bodies", flags=psim.ImGuiWindowFlags_AlwaysAutoResize)
        psim.PushItemWidth(FIELD_WIDTH)
        self._draw_controls()
        self._draw_files()
        if not self.viewer.isReplay and self._section("Simulation", True):
            self._draw_settings()
        if self._section("Look", False):
            self._draw_look()
        if self._section("Save", False):
            self._draw_save()
        self._draw_legend()
        psim.PopItemWidth()
        psim.End()

    def _section(self, title, isOpen):
        import polyscope.imgui as psim

        return psim.CollapsingHeader(title, psim.ImGuiTreeNodeFlags_DefaultOpen if isOpen else 0)

    def _draw_controls(self):
        import polyscope.imgui as psim

        viewer = self.viewer
        # ### gives the button one identity, whatever it says.
        if psim.Button("Pause###play" if viewer.isPlaying else "Play###play", BUTTON_SIZE):
            viewer.toggle_play()
        psim.SetItemTooltip("Space")
        psim.SameLine()
        if psim.Button("Step", BUTTON_SIZE):
            viewer.step_once()
        psim.SetItemTooltip("S or Right")
        psim.SameLine()
        if psim.Button("Reset", BUTTON_SIZE):
            viewer.reset()
        psim.SetItemTooltip("R")

    def _draw_files(self):
        import polyscope.imgui as psim

        viewer = self.viewer
        files = viewer.files()
        chosen = draw_choice("scene", viewer.name(), files, "Or drop a file onto the window")
        if chosen is not None:
            viewer.open(files[chosen])
        entered, self.path = psim.InputTextWithHint(
            "open", "path of a file", self.path, psim.ImGuiInputTextFlags_EnterReturnsTrue
        )
        psim.SetItemTooltip("A scene, a recording (.npz) or a camera (.json); then Enter")
        if entered and self.path:
            viewer.open(self.path)
        if viewer.message:
            draw_error(viewer.message)

    def _draw_settings(self):
        import polyscope.imgui as psim

        viewer = self.viewer
        settings = viewer.simulation.settings
        for field in self.fields:
            field.draw(settings)
        clamp = psim.ImGuiSliderFlags_AlwaysClamp  # also what is typed in with Ctrl-click
        pace = "%d" if viewer.stepsPerFrame else "real time"
        _, viewer.stepsPerFrame = psim.SliderInt(
            "steps per frame", viewer.stepsPerFrame, 0, MOST_STEPS_PER_FRAME, pace, clamp
        )
        _, settings.friction = psim.SliderFloat(
            "friction", settings.friction, 0.0, MOST_FRICTION, "%.3f", clamp
        )
        _, settings.closingOnly = psim.Checkbox("closing contacts only", settings.closingOnly)
        psim.SetItemTooltip("Contacts that already separate receive no impulse")
        self._draw_choices(CHOICES)
        if viewer.simulation.constraints:
            changed, settings.enforceConstraints = psim.Checkbox(
                "constraints", settings.enforceConstraints
            )
            if changed:
                viewer.view.refresh()
            self._draw_choices(CONSTRAINT_CHOICES)

    def _draw_choices(self, choices):
        settings = self.viewer.simulation.settings
        for label, name, names, tooltip in choices:
            chosen = draw_choice(label, getattr(settings, name), names, tooltip)
            if chosen is not None:
                setattr(settings, name, chosen)

    def _draw_look(self):
        import polyscope.imgui as psim

        view = self.viewer.view
        chosen = draw_choice("colours", view.colouring, COLOURINGS)
        if chosen is not None:
            view.colouring = chosen
            view.refresh()
        # In two columns.
        for number, name in enumerate(LAYERS):
            if number % 2:
                psim.SameLine(PANEL_WIDTH / 2)
            changed, isShown = psim.Checkbox(name, name in view.shown)
            if name in TOOLTIPS:
                psim.SetItemTooltip(TOOLTIPS[name])
            if changed:
                view.show(name, isShown)

    def _draw_numbers(self):
        import polyscope.imgui as psim

        viewer = self.viewer
        simulation = viewer.simulation
        psim.Text(f"{len(simulation.meshes)} bodies; squares of {viewer.view.squareSide:g} m")
        psim.Text(f"step {simulation.stepCount}, {simulation.time:.2f} s simulated")
        report = simulation.report
        if report is not None:
            psim.Text(f"{len(report.contacts)} contacts, {report.candidatePairs} candidate pairs")
            if simulation.constraints:
                bounds = len(simulation.constraints)
                psim.Text(f"{report.constraintVisits} visits of {bounds} bounds")
        if self._section("Milliseconds", True):
            self._draw_milliseconds()

    def _draw_milliseconds(self):
        import polyscope.imgui as psim

        frame, step = self.viewer.frame_milliseconds(), self.viewer.milliseconds()
        if frame is not None:
            whole, simulating = frame
            draw_table([
                (f"{whole:.1f}", f"a frame, {1e3 / whole:.0f} a second; of it"),
                (f"{simulating:.1f}", "simulating"),
                (f"{whole - simulating:.1f}", "drawing, and waiting for it"),
            ])
            psim.Separator()
        if step is not None:
            phases = self.viewer.phase_milliseconds()
            draw_table([
                (f"{step:.2f}", "a step; of it"),
                *((f"{ms:.2f}", name) for name, ms in phases.items()),
            ])

    def _draw_save(self):
        import polyscope.imgui as psim

        viewer = self.viewer
        if psim.Button("Picture", BUTTON_SIZE):
            viewer.save_picture()
        psim.SameLine()
        if psim.Button("Camera", BUTTON_SIZE):
            viewer.save_camera()
        psim.SetItemTooltip("For --camera, or to be dropped onto the window")
        psim.SameLine()
        if psim.Button("Video###video" if viewer.video is None else "End###video", BUTTON_SIZE):
            viewer.toggle_video()
        if viewer.video is not None:
            psim.Text(f"recording, {viewer.video.count} pictures")
        elif viewer.saved:
            psim.TextWrapped(viewer.saved)

    def _draw_legend(self):
        import polyscope.imgui as psim

        psim.Separator()
        view = self.viewer.view
        for text, colour in legend(self.viewer.simulation.meshes, view.colouring):
            psim.ColorButton(text, (*colour, 1.0), psim.ImGuiColorEditFlags_NoTooltip)
            psim.SameLine()
            psim.Text(text)

    # What stands at the sides.

    def _draw_side(self):
        """Numbers and plots, at the upper right."""
        import polyscope as ps
        import polyscope.imgui as psim

        width, height = ps.get_window_size()
        if self.viewer.isReplay:
            height -= TIMELINE_HEIGHT + MARGIN
        corner = (width - MARGIN, MARGIN)
        psim.SetNextWindowPos(corner, psim.ImGuiCond_Once, (1.0, 0.0))
        psim.SetNextWindowSizeConstraints((SIDE_WIDTH, 0), (SIDE_WIDTH, height - 2 * MARGIN))
        psim.Begin("Numbers", flags=psim.ImGuiWindowFlags_AlwaysAutoResize)
        self._draw_numbers()
        self.viewer.isMeasuring = self._section("Plots", False)
        if self.viewer.isMeasuring:
            draw_plots(self.viewer.history)
        psim.End()

    def _draw_body(self):
        """The picked body, at the lower left, beside the panel."""
        import polyscope as ps
        import polyscope.imgui as psim

        viewer, mesh = self.viewer, self.viewer.picked()
        height = ps.get_window_size()[1]
        above = MARGIN + (TIMELINE_HEIGHT + MARGIN if viewer.isReplay else 0)
        corner = (PANEL_WIDTH + 2 * MARGIN, height - above)
        psim.SetNextWindowPos(corner, psim.ImGuiCond_Appearing, (0.0, 1.0))
        psim.SetNextWindowSizeConstraints((SIDE_WIDTH, 0), (SIDE_WIDTH, height))
        psim.Begin("Body", flags=psim.ImGuiWindowFlags_AlwaysAutoResize)
        psim.ColorButton("picked", (*PICKED_COLOUR, 1.0), psim.ImGuiColorEditFlags_NoTooltip)
        psim.SameLine()
        psim.Text(f"{mesh.name}, {'fixed' if mesh.isFixed else 'free'}")
        psim.Text(f"mass      {mesh.mass:.4g} kg, density {mesh.density:g}")
        for name, values, unit in (
            ("position ", mesh.position, "m"),
            ("velocity ", mesh.linVelocity, "m/s"),
            ("spin     ", mesh.angVelocity, "rad/s"),
        ):
            x, y, z = values[0]
            psim.Text(f"{name} {x:8.2f} {y:8.2f} {z:8.2f} {unit}")
        if not viewer.isReplay:
            self._draw_body_buttons()
        psim.End()

    def _draw_body_buttons(self):
        import polyscope as ps
        import polyscope.imgui as psim

        viewer = self.viewer
        if psim.Button("Free###fix" if viewer.picked().isFixed else "Fix###fix", BUTTON_SIZE):
            viewer.set_fixed(not viewer.picked().isFixed)
        psim.SameLine()
        psim.PushItemWidth(FIELD_WIDTH)
        _, viewer.pushSpeed = psim.SliderFloat(
            "push", viewer.pushSpeed, 0.0, MOST_PUSH, "%.1f m/s"
        )
        psim.PopItemWidth()
        camera = ps.get_view_camera_parameters()
        right = np.array(camera.get_right_dir())
        directions = {
            "Away": np.array(camera.get_look_dir()), "Left": -right,
            "Right": right, "Up": np.array([0.0, 1.0, 0.0]),
        }  # fmt: skip
        for name, direction in directions.items():
            if psim.Button(name, BUTTON_SIZE):
                viewer.push(direction)
            psim.SetItemTooltip("An impulse at the point that was clicked")
            if name != "Up":
                psim.SameLine()

    def _draw_timeline(self):
        import polyscope as ps
        import polyscope.imgui as psim

        viewer, replay = self.viewer, self.viewer.simulation
        width, height = ps.get_window_size()
        left = PANEL_WIDTH + 2 * MARGIN
        psim.SetNextWindowPos((left, height - TIMELINE_HEIGHT - MARGIN), psim.ImGuiCond_Always)
        psim.SetNextWindowSize((width - left - MARGIN, TIMELINE_HEIGHT), psim.ImGuiCond_Always)
        psim.Begin("Timeline", flags=psim.ImGuiWindowFlags_NoResize)
        psim.SetNextItemWidth(width - left - SPEED_WIDTH - 10 * MARGIN)
        moved, step = psim.SliderInt(
            "###step", replay.stepCount, replay.firstStep, replay.lastStep, "step %d"
        )
        if moved:
            viewer.seek(step)
        psim.SameLine()
        psim.SetNextItemWidth(SPEED_WIDTH)
        _, viewer.speed = psim.SliderFloat("speed", viewer.speed, -MOST_SPEED, MOST_SPEED, "%.1f x")
        psim.SetItemTooltip("Times real time; negative: backwards")
        psim.End()


# Plots from top to bottom: title, and what is called how in it.
PLOTS = [
    ("energy (J)", {"kinetic": "kineticEnergy", "potential": "potentialEnergy",
                    "total": "totalEnergy"}),
    ("momentum (kg m/s)", {"x": "momentumX", "y": "momentumY", "z": "momentumZ"}),
    ("deepest penetration (m)", {"depth": "deepestPenetration"}),
    ("largest constraint violation (m)", {"violation": "largestViolation"}),
]  # fmt: skip


def draw_plots(history):
    """Time plots of the rows (time in s, dict of quantities); of what is not known, none."""
    import polyscope.imgui as psim
    import polyscope.implot as implot

    if not history:
        psim.Text("They begin with the next step.")
        return
    times = np.array([row[0] for row in history])
    for title, names in PLOTS:
        values = np.array([[row[1][name] for name in names.values()] for row in history])
        if np.all(np.isnan(values)):
            continue
        flags = implot.ImPlotFlags_NoMenus | implot.ImPlotFlags_NoMouseText
        if len(names) == 1:
            flags |= implot.ImPlotFlags_NoLegend
        if implot.BeginPlot(title, PLOT_SIZE, flags):
            fit = implot.ImPlotAxisFlags_AutoFit
            unlabelled = implot.ImPlotAxisFlags_NoLabel
            implot.SetupAxes("", "", fit | unlabelled, fit | unlabelled)
            implot.SetupAxisFormat(implot.ImAxis_Y1, "%.3g")
            outside = implot.ImPlotLegendFlags_Outside | implot.ImPlotLegendFlags_Horizontal
            implot.SetupLegend(implot.ImPlotLocation_South, outside)
            for name, column in zip(names, values.T, strict=True):
                implot.PlotLine(name, times, np.ascontiguousarray(column))
            implot.EndPlot()


def legend(meshes, colouring="density"):
    """What the colours mean: rows (text, (r, g, b)).

    colouring : a name of COLOURINGS. Of densities, all are named, or the ends of too many.
    """
    free = [mesh for mesh in meshes if not mesh.isFixed]
    lines = []
    if colouring == "density":
        densities = sorted({mesh.density for mesh in free})
        if len(densities) > LEGEND_LINES:
            densities = [densities[0], densities[-1]]
        lines = [
            (f"density {density:g}", tuple(colour_of_density(density, densities[0], densities[-1])))
            for density in densities
        ]
    elif colouring == "speed":
        speeds = {"at rest": 0.0, f"{TOP_SPEED / 2:g} m/s": 0.5, f"{TOP_SPEED:g} m/s or more": 1.0}
        lines = [(text, tuple(viridis(place))) for text, place in speeds.items()]
    elif colouring == "contact island":
        lines = [("touches no other free body", LONE_COLOUR)]
    return lines + [("fixed", FIXED_COLOUR)] * (len(free) < len(meshes))


def show_window(simulation, backend, openFile, listFiles, measure, look=None):
    """Opens the window on a simulation or a replay; returns when it is closed.

    openFile, listFiles, measure : see `Viewer`; look : `RBSDrawing.Look`, or None
    """
    import polyscope as ps

    view = start_look(simulation, backend, look or Look(), PANEL_WIDTH + MARGIN)
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
