"""The window: panels, keys and mouse, which call the actions of `Viewer`.

From the top: `show_window`; `Panel`, with keys and mouse; the main column; the readout and the
selected body; the timeline and messages.
"""

import math
import time
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np
import polyscope as ps
import polyscope.imgui as psim

from rbs.appearance.colours import COLOURINGS, PICKED_COLOUR
from rbs.appearance.pictureoptions import LOOKS, PictureOptions
from rbs.pictures.capture import start_view
from rbs.pictures.view import LAYERS
from rbs.scenes.messages import counted
from rbs.stepping.reports import PHASES
from rbs.stepping.settings import SETTINGS, shown
from rbs.window import widgets
from rbs.window.glass import Glass
from rbs.window.layout import ROOMY_HEIGHT, ROOMY_WIDTH, Box, arrange
from rbs.window.marks import draw_help, draw_legend, draw_marks, packed
from rbs.window.playback import SPEEDS, speed_name
from rbs.window.plots import Plots
from rbs.window.viewer import NOTES, Viewer
from rbs.window.widgets import Tooltips, scaled

# Pixels: width of the labels beside fields, of the longest switch in Display, and of the button
# beside a changed setting; indent of the parts of a sum.
LABEL_WIDTH, SWITCH_WIDTH, MARK_WIDTH, INDENT = 128, 150, 18, 18
# Pixels. A shorter movement between pressing and releasing the button counts as a click; a longer
# one turns the camera.
CLICK_PIXELS = 4.0
# Seconds between the clicks of a double-click, each of which takes a frame or two. Until then, no
# panel opens that would move the picture.
DOUBLE_CLICK_SECONDS = 0.6
# Time steps in seconds: change by the buttons + and -; least and greatest one.
TIME_STEP_CHANGE, TIME_STEPS = 0.005, (1e-4, 1.0)
# m/s, the end of the slider for pushes; and seconds that a message is shown.
MOST_PUSH, MESSAGE_SECONDS = 40.0, 20.0
# Most frames per second; the same while idle, to spare the processor; seconds of rest until idle.
FRAME_RATE, IDLE_RATE, IDLE_SECONDS = 60, 5, 0.5
# Shown until one of these has been used.
HINT = "Ctrl + drag throws a body · B shoots · H shows all keys"
# Names of choices in the lists, where the option's own says too little. They fit the least column.
CHOICES = {"impulse": "one by one", "soft-step": "soft step", "all": "all pairs"}
CHOICES |= {"plain": "as shown"}
# The buttons of files, by name: label, label while it is written, tooltip.
SAVED = {
    "video": ("Video", "Stop video", "Film until Stop video (.mp4 in out/)"),
    "page": ("Web page", "Stop page", "Write a page that plays the run (.html in out/)"),
    "recorder": ("Record", "Stop recording", "Record the run and what you do to it (.h5 in out/)"),
}


def show_window(simulation, backend, opener, pictureOptions=None):
    """Opens the window on a SceneSimulation or a Replay. Returns when it is closed.

    backend : see `start_view`; opener : SceneOpener; pictureOptions : PictureOptions, or None
    """
    options = pictureOptions or PictureOptions()
    view = start_view(simulation, backend, replace(options, look="plain"))
    viewer = Viewer(simulation, view, opener, options.look)
    panel = Panel(viewer)
    panel.lay_out()
    if options.camera is None:
        view.frame_all()
    view.set_callback(panel.frame)
    ps.set_files_dropped_callback(panel.dropped)
    try:
        ps.show()
    finally:
        viewer.stop_files()
        view.set_callback(None)
        ps.clear_files_dropped_callback()


class Panel:
    """The window's panels, keys and mouse, which show a Viewer and call its functions.

    Attributes: viewer; isHelpShown; areHidden, whether all panels are; isSideShown, whether the
    readout is, None if the window's width decides; layout, of the last frame; hint, a line for
    beginners, or "".
    """

    def __init__(self, viewer):
        self.viewer, self.glass = viewer, Glass(viewer)
        self._path = ""  # text of the field that opens a file
        self._timeStep = widgets.NumberField()
        self.hint, self.frameRate, self.plots = HINT, FRAME_RATE, Plots()
        self.isHelpShown = self.areHidden = False
        self.isSideShown = self.layout = None
        self._lastFrame = self._lastAction = time.perf_counter()
        self._dropped = self._pressedAt = self._sideLess = None
        self._lastClick = -DOUBLE_CLICK_SECONDS
        ps.set_max_fps(-1)  # with a limit, Polyscope would wait by keeping a core busy
        self._told = None, 0.0  # the message that is shown, and its time
        self._coveredHeight = 0.0  # of the picture, by the hint or a formula at its lower edge

    def dropped(self, paths):
        """Polyscope's callback for files dropped onto the window. Only the last one is opened."""
        self._dropped = paths[-1]

    def frame(self):
        """Polyscope's callback for each frame: keys, panels, and the steps that are due."""
        dropped, self._dropped = self._dropped, None
        if dropped is not None:
            self.viewer.open(dropped)
        self._handle_keys()
        self._handle_mouse()
        self.lay_out()
        self.viewer.view.keep_above_ground()
        self.viewer.view.spread_ground()
        self.viewer.watch_picture()
        self.glass.draw(self.layout.picture)
        text, Tooltips.areHidden = self._message()
        if not self.areHidden:
            self._draw_main()
            if self.layout.side is not None:
                self._draw_side()
            self._draw_timeline()
        hint = "" if self.areHidden or self.viewer.isReplay or self.glass.events else self.hint
        self._draw_message(text, 0)
        self._coveredHeight = self.glass.height + self._draw_message(hint, 1)
        draw_legend(self.viewer.view.legend(), self.layout.picture, self._coveredHeight)
        if self.isHelpShown:
            self.isHelpShown = draw_help(ps.get_window_size())
        self._choose_quality()
        now = time.perf_counter()
        self.viewer.play(now - self._lastFrame)
        draw_marks(self.viewer)  # where the bodies are now
        self._lastFrame = now

    def lay_out(self):
        """Arranges the panels for the window's size, and sets the margins of the view."""
        if self.layout is not None and (self._isClicking or self._pressedAt or self.viewer.grab):
            return  # a click or drag goes on
        width, height = ps.get_window_size()
        hasSide = width >= scaled(ROOMY_WIDTH) if self.isSideShown is None else self.isSideShown
        hasSide = hasSide or self.viewer.picked() not in (None, self._sideLess)
        self.layout = arrange(width, height, hasSide, scaled(1))
        if self.areHidden:
            self.layout = self.layout._replace(picture=Box(0, 0, width, height))
        left, top, wide, high = self.layout.picture
        margins = left, top, width - left - wide, height - top - high + round(self._coveredHeight)
        self.viewer.view.set_margins(margins, (width, height))

    def toggle_side(self):
        """Shows or hides the readout. Another selection shows it again."""
        self.isSideShown = self.layout.side is None
        self._sideLess = None if self.isSideShown else self.viewer.picked()

    def _choose_quality(self):
        """Smooths edges while nothing moves. Waits for the next frame, longer while idle."""
        io, isPlaying, now = psim.GetIO(), self.viewer.isPlaying, time.perf_counter()
        isHeld = any(psim.IsMouseDown(k) for k in range(3))
        isUsed = any(io.MouseDelta) or isHeld or io.MouseWheel or io.WantTextInput
        if isPlaying or isUsed or self._isKeyDown:
            self._lastAction = now
        isMoving = isPlaying or self._isClicking or isHeld and not io.WantCaptureMouse
        self.viewer.view.set_supersampling(not isMoving)  # takes too long between two clicks
        self.frameRate = IDLE_RATE if now - self._lastAction > IDLE_SECONDS else FRAME_RATE
        time.sleep(max(1.0 / self.frameRate - (now - self._lastFrame), 0.0))

    def _handle_keys(self):
        io, viewer = psim.GetIO(), self.viewer
        self._isKeyDown = False
        if io.WantTextInput:  # a field has the focus
            return
        repeating = {"S RightArrow": viewer.step_once, "LeftArrow": viewer.step_back}
        repeating["E"] = partial(self.glass.go, -1 if io.KeyShift else 1)
        acts = repeating | {
            "Z": viewer.step_back if io.KeyCtrl else lambda: None,
            "Space": viewer.toggle_play,
            "R": viewer.reset if io.KeyShift else viewer.restart,
            "LeftBracket": lambda: viewer.open_beside(-1),
            "RightBracket": lambda: viewer.open_beside(1),
            "B": self._shoot,
            "F": viewer.view.frame_all,
            "N": self.toggle_side,
            "Tab": lambda: self._toggle("areHidden"),
            "H F1 Slash" if io.KeyShift else "H F1": lambda: self._toggle("isHelpShown"),
            "Escape": self._escape,
        }
        acts |= {str(k): partial(viewer.view.toggle, name) for k, name in enumerate(LAYERS, 1)}
        for names, act in acts.items():
            keys = [getattr(psim, f"ImGuiKey_{name}") for name in names.split()]
            self._isKeyDown |= any(psim.IsKeyDown(key) for key in keys)
            # a key that is held down repeats its step
            if any(psim.IsKeyPressed(key, names in repeating) for key in keys):
                act()

    def _toggle(self, name):
        setattr(self, name, not getattr(self, name))
        self.hint = ""

    def _escape(self):
        self.isHelpShown = False
        self.glass.close()

    def _shoot(self):
        (left, top, width, height), io = self.layout.picture, psim.GetIO()
        middle = left + 0.5 * width, top + 0.5 * height
        self.viewer.shoot(middle if io.WantCaptureMouse else tuple(io.MousePos))
        self.hint = ""

    def _handle_mouse(self):
        """Selects a body with a click, centres it with another one, and drags one with Ctrl."""
        io, viewer = psim.GetIO(), self.viewer
        mouse = tuple(io.MousePos)
        io.MouseDoubleClickTime = DOUBLE_CLICK_SECONDS
        isDouble = psim.IsMouseDoubleClicked(0) and not io.WantCaptureMouse
        ps.set_do_default_mouse_interaction(not isDouble)  # it would turn to what is there then
        if isDouble:
            viewer.view.centre_picked()  # whatever is there since the first click
        elif psim.IsMouseClicked(0) and not io.WantCaptureMouse:
            if io.KeyCtrl:
                viewer.grab_at(mouse)
                self.hint = self.hint if viewer.grab is None else ""
            else:
                self._pressedAt = mouse
        if viewer.grab is not None:
            if psim.IsMouseDown(0):
                viewer.drag_to(mouse)
            else:
                viewer.release()
        if psim.IsMouseReleased(0) and self._pressedAt is not None:
            if math.dist(self._pressedAt, mouse) < CLICK_PIXELS:
                viewer.pick_at(self._pressedAt)
                self._lastClick = time.perf_counter()
            self._pressedAt = None
        self._isClicking = time.perf_counter() - self._lastClick < DOUBLE_CLICK_SECONDS

    # The main column.

    @contextmanager
    def _column(self, title, box):
        """Draws the `with` block in a column, with room for labels beside its fields."""
        with widgets.panel(title, box[:2], box[2:], box[2:], "NoTitleBar NoBringToFrontOnFocus"):
            psim.PushItemWidth(psim.GetContentRegionAvail()[0] - scaled(LABEL_WIDTH))
            yield
            psim.PopItemWidth()

    def _draw_main(self):
        with self._column("Main", self.layout.main):
            self._draw_controls()
            self._draw_files()
            isRoomy = self.layout.main.height >= scaled(ROOMY_HEIGHT)
            if not self.viewer.isReplay and widgets.draw_section("Simulation", isRoomy):
                self._draw_settings()
            if widgets.draw_section("Display", isRoomy):
                self._draw_display()
            if widgets.draw_section("Save"):
                self._draw_save()

    def _buttons(self, *rows):
        """Draws a row of equally wide buttons (label, function, tooltip)."""
        gap = psim.GetStyle().ItemSpacing[0]
        width = (psim.GetContentRegionAvail()[0] - gap * (len(rows) - 1)) / len(rows)
        for place, (label, act, tooltip) in enumerate(rows):
            if place:
                psim.SameLine()
            if psim.Button(label, (width, 0)):
                act()
            Tooltips.tell(tooltip)

    def _draw_controls(self):
        viewer, playback = self.viewer, self.viewer.playback
        # ### keeps the button's identity when its label changes
        play = "Pause###play" if viewer.isPlaying else "Play###play"
        self._buttons(
            (play, viewer.toggle_play, "Space: play or pause"),
            ("Back", viewer.step_back, "Left or Ctrl + Z: one step back, or undo"),
            ("Step", viewer.step_once, "S or Right: one step forward"),
            ("Reset", viewer.restart, "R: start over, keeping your settings"),
        )
        names, act = {one: speed_name(one) for one in SPEEDS}, partial(setattr, playback, "speed")
        tooltip = "Speed, relative to real time"
        widgets.draw_choice("###speed", playback.speed, SPEEDS, act, tooltip, names)
        pace = playback.pace()
        psim.SameLine()
        psim.Text("paused" if pace is None else f"{pace:.2g} × real time")
        if viewer.isReplay:
            act = partial(setattr, playback, "isBackwards")
            widgets.draw_check("backwards", playback.isBackwards, act, "Play backwards")
        self._buttons(
            ("Help", partial(self._toggle, "isHelpShown"), "H, F1 or ?: keys and mouse actions"),
            ("Readout", self.toggle_side, "N: counts, timings and plots, on the right"),
            ("Frame all", viewer.view.frame_all, "F: fit all bodies in view, except any far away"),
        )

    def _draw_files(self):
        viewer = self.viewer
        tooltip = "Scenes of this project, and files beside this scene. [ or ]: previous or next"
        widgets.draw_choice("scene", viewer.name(), viewer.files, viewer.open, tooltip)
        flags = psim.ImGuiInputTextFlags_EnterReturnsTrue | psim.ImGuiInputTextFlags_AutoSelectAll
        entered, self._path = psim.InputTextWithHint("open", "name or path", self._path, flags)
        Tooltips.tell("Open a scene by path or name, a recording (.h5) or a viewpoint (.json)")
        if entered and self._path.strip():
            viewer.open(self._path.strip())
            self._path = self._path if viewer.message else ""

    def _draw_settings(self):
        """Draws the settings that the solver uses."""
        simulation = self.viewer.simulation
        settings = simulation.settings
        right = psim.GetCursorPosX() + psim.GetContentRegionAvail()[0]
        for one in SETTINGS.values():
            isUsed = one.is_used_by(settings.contactSolver)
            if not one.label or not isUsed or one.isOfConstraints and not simulation.constraints:
                continue
            value, begun = getattr(settings, one.name), getattr(simulation.startSettings, one.name)
            row, last = (one.label, value), (partial(self._set, one.name), one.tooltip)
            if one.name == "timeStep":
                self._timeStep.draw(*row, TIME_STEP_CHANGE, *last)
            elif one.kind is bool:
                widgets.draw_check(*row, *last)
            elif isinstance(value, tuple):
                psim.TextUnformatted(f"{shown(value)}  {one.label}")
            elif one.sliderEnds is None:
                widgets.draw_choice(*row, one.kind, *last, CHOICES)
            else:
                widgets.draw_slider(*row, *one.sliderEnds, *last)
            if value != begun:
                psim.SameLine(right - scaled(MARK_WIDTH))
                if psim.SmallButton(f"×###restore {one.name}"):
                    self.viewer.restore_settings(one.name)
                Tooltips.tell(f"Changed. Click to restore {CHOICES.get(begun, begun)}")
        psim.BeginDisabled(settings == simulation.startSettings)
        tooltip = "Undo all changes of settings. Shift + R also starts over"
        self._buttons(("Restore the scene's settings", self.viewer.restore_settings, tooltip))
        psim.EndDisabled()

    def _set(self, name, value):
        """Changes a setting, as far as its limits allow."""
        wanted, one = value, SETTINGS[name]
        if isinstance(value, int | float):
            low, high = TIME_STEPS if name == "timeStep" else one.limits
            value = min(max(value, low), high)
            if value != wanted:
                self.viewer.message = f"{one.label} is limited to {low:g} to {high:g}"
        self.viewer.simulation.settings.change(name, value)
        self.viewer.view.refresh()

    def _draw_display(self):
        view = self.viewer.view
        tooltip = "What the colours of the bodies show"
        widgets.draw_choice("colours", view.colouring, COLOURINGS, view.colour_by, tooltip)
        second = 0.55 * psim.GetContentRegionAvail()[0]
        for digit, (name, shows) in enumerate(LAYERS.items(), 1):
            act = partial(view.show, name)
            if digit % 2 == 0 and second > scaled(SWITCH_WIDTH):  # in two columns
                psim.SameLine(second)
            widgets.draw_check(name, name in view.shown, act, f"{digit}: {shows}")

    def _draw_save(self):
        viewer = self.viewer
        tooltip = "Save the viewpoint to out/; drop the file here, or pass it to --camera"
        self._buttons(
            ("Picture", viewer.save_picture, "Save this view as a PNG, without panels, to out/"),
            ("Viewpoint", viewer.save_camera, tooltip),
        )
        tooltip = "Look of saved pictures. Studio has sky light and soft shadows; it takes seconds"
        act = partial(setattr, viewer, "look")
        widgets.draw_choice("look", viewer.look, LOOKS, act, tooltip, CHOICES)
        buttons = []
        for name, (begin, end, tooltip) in SAVED.items():
            label = f"{begin if getattr(viewer, name) is None else end}###{name}"
            buttons.append((label, partial(viewer.toggle_file, name), tooltip))
        self._buttons(*buttons[:2])
        psim.BeginDisabled(viewer.isReplay)
        self._buttons(buttons[2])
        psim.EndDisabled()
        if viewer.video is not None:
            psim.TextWrapped(viewer.video.summary(viewer.simulation)[1])
        if viewer.recorder is not None:
            psim.Text(f"recording: {counted(viewer.recorder.frameCount - 1, 'step')}")

    # The readout, on the right.

    def _draw_side(self):
        viewer = self.viewer
        with self._column("Readout", self.layout.side):
            if viewer.picked() is not None:
                self._draw_body()
                psim.Separator()
            self._draw_numbers()
            if widgets.draw_section("Events of a step", True):
                self.glass.draw_list()
            if widgets.draw_section("Timing", True):
                self._draw_milliseconds()
            viewer.isMeasuring = widgets.draw_section("Plots")
            if viewer.isMeasuring:
                self.plots.draw(viewer.history, self.layout.side.height)

    def _draw_numbers(self):
        simulation = self.viewer.simulation
        report, count = simulation.report, len(simulation.meshes)
        fixed = sum(mesh.isFixed for mesh in simulation.meshes)
        kinds = counted(count - fixed, "body") + f", {fixed} fixed" * bool(fixed)
        psim.Text(f"{kinds}\nfloor squares {self.viewer.view.squareSide:g} m")
        psim.Text(f"step {simulation.stepCount}, {simulation.time:.2f} s simulated")
        if report is not None:
            if report.hasSleepers:
                asleep = int(report.isAsleep.sum())
                psim.Text("all " * (asleep + fixed >= count) + f"{counted(asleep, 'body')} asleep")
            psim.Text(counted(report.contactCount, "contact"))
            psim.Text(counted(report.candidatePairs, "candidate pair"))
            if simulation.constraints:
                bounds = counted(len(simulation.constraints), "constraint")
                psim.Text(f"{bounds}, {counted(report.constraintVisits, 'visit')}")

    def _draw_milliseconds(self):
        frame, step = self.viewer.milliseconds()
        names = PHASES | {"gather": "read bodies", "frame": "frame, of which"}
        names["step"] = "step, of which"
        if frame:
            psim.Text(f"{1e3 / frame['frame']:.0f} fps ({frame['frame']:.0f} ms)")
        for means, digits in ((frame, 1), (step, 2)):
            rows = [(f"{ms:.{digits}f}", names.get(name, name)) for name, ms in means.items()]
            widgets.draw_table(rows, INDENT)
        if not frame and not step:
            psim.Text("No data yet: press Play.")

    def _draw_body(self):
        viewer, mesh = self.viewer, self.viewer.picked()
        psim.SeparatorText(f"{mesh.name}, {'fixed' if mesh.isFixed else 'free'}")
        mass = f"{mesh.mass / 1e3:.4g} t" if mesh.mass >= 1e3 else f"{mesh.mass:.4g} kg"
        psim.TextWrapped(f"mass {mass}, density {mesh.density:g} kg/m³")
        widgets.draw_vector("centre (m)", mesh.position[0])
        widgets.draw_vector("velocity (m/s)", mesh.linVelocity[0])
        widgets.draw_vector("angular velocity (rad/s)", mesh.angVelocity[0])
        act, tooltip = partial(setattr, viewer.view, "follows"), "Camera moves with this body"
        widgets.draw_check("camera follows", viewer.view.follows, act, tooltip)
        if widgets.draw_section("Contacts", True):
            self.glass.draw_contacts()
        if viewer.isReplay:
            return
        if psim.Button("Free###fix" if mesh.isFixed else "Fix###fix"):
            viewer.set_fixed(not mesh.isFixed)
        Tooltips.tell("Fix or free this body. A fixed body has infinite mass")
        psim.BeginDisabled(mesh.isFixed)
        act, tooltip = partial(setattr, viewer, "pushSpeed"), "Speed that a push adds"
        widgets.draw_slider("push", viewer.pushSpeed, 0.0, MOST_PUSH, act, tooltip, "%.1f m/s")
        camera = ps.get_view_camera_parameters()
        right = np.array(camera.get_right_dir())
        ways = {"Away": camera.get_look_dir(), "Left": -right, "Right": right, "Up": (0, 1, 0)}
        tooltip = "Push at the point that was clicked"
        self._buttons(*((name, partial(viewer.push, way), tooltip) for name, way in ways.items()))
        psim.EndDisabled()

    # The timeline and messages.

    def _draw_timeline(self):
        viewer, simulation = self.viewer, self.viewer.simulation
        box, flags = self.layout.timeline, "NoTitleBar NoScrollbar NoBringToFrontOnFocus"
        with widgets.panel("Timeline", box[:2], box[2:], box[2:], flags):
            place, ends = viewer.place, (0, viewer.last_place())
            shown = f"step {simulation.stepCount}"
            about = f"{simulation.time:.2f} s. Drag to go back"
            if viewer.isReplay:
                if psim.Button("Continue from here"):
                    viewer.continue_here()
                Tooltips.tell("Continue the simulation from this step, with its settings")
                psim.SameLine()
                place, ends = simulation.stepCount, (simulation.firstStep, simulation.lastStep)
                shown, about = f"step %d of {ends[1]}", f"{simulation.time:.2f} of "
                about += f"{simulation.lastTime:.2f} s. Ctrl-click: type a step"
            psim.SetNextItemWidth(-1.0)
            isClamped = psim.ImGuiSliderFlags_AlwaysClamp
            isMoved, place = psim.SliderInt("###step", place, *ends, shown, isClamped)
            Tooltips.tell(about)
            if viewer.simulation is not simulation:
                return
            if isMoved:
                viewer.seek(place)
            if viewer.isReplay:  # marks before steps at which something was done by hand
                (left, top), (right, _) = psim.GetItemRectMin(), psim.GetItemRectMax()
                perStep = (right - left) / max(ends[1] - ends[0], 1)
                for step in sorted({step for step, _ in simulation.recording.changes}):
                    x = left + perStep * (step - ends[0])
                    mark = (x, top - scaled(5)), (x, top + scaled(5))
                    psim.GetWindowDrawList().AddLine(*mark, packed(PICKED_COLOUR), scaled(2))

    def _message(self):
        """Returns (message, whether it is an error). Messages expire after a while."""
        viewer = self.viewer
        text, now = viewer.message or viewer.saved, time.perf_counter()
        if text != self._told[0]:
            self._told = text, now
        if now - self._told[1] > MESSAGE_SECONDS:
            viewer.message = viewer.saved = ""
        return text, bool(viewer.message)

    def _draw_message(self, text, side):
        """Draws a text, if any, over the upper edge of the picture, side 0, or over the lower one.

        Returns the height that it covers.
        """
        if not text:
            return 0.0
        (left, top, width, height), offer = self.layout.picture, self.viewer.offer
        isOffer = offer is not None and offer[0] == text
        place, sizes = (left, top + side * height), ((width, 0), (width, scaled(200)))
        flags = "NoTitleBar" if isOffer else "NoTitleBar NoInputs"
        with widgets.panel(f"Message {side}", place, *sizes, flags, (0, side), 0.9):
            if isOffer:
                if psim.Button(offer[1]):
                    offer[2]()
                psim.SameLine()
            isPlain = text != self.viewer.message or text in NOTES
            plain = psim.GetStyleColorVec4(psim.ImGuiCol_Text)
            colour = plain if isPlain else widgets.ERROR_TEXT
            psim.PushStyleColor(psim.ImGuiCol_Text, colour)
            psim.TextWrapped(text)
            psim.PopStyleColor()
            return psim.GetWindowHeight()
