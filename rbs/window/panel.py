"""The window: panels, keys and mouse, which call the actions of `Viewer`."""

import math
import sys
import time
import traceback
from functools import partial
from statistics import fmean
from typing import NamedTuple

import numpy as np
import polyscope as ps
import polyscope.imgui as psim

from rbs.appearance.colours import COLOURINGS
from rbs.pictures.backends import fit_window
from rbs.pictures.capture import start_view
from rbs.pictures.overlays import OVERLAYS
from rbs.pictures.viewpoint import FRONT, SIDE, TOP, present_camera
from rbs.recordings.lookup import list_files
from rbs.scenes.files import interrupts_held
from rbs.scenes.messages import counted, measured, one_line, print_error, short, shown_path
from rbs.scenes.settingtexts import TEXTS
from rbs.window import widgets
from rbs.window.glass import Glass
from rbs.window.hand import PUSH_SPEED
from rbs.window.history import SPEEDS
from rbs.window.marks import draw_help, draw_marks
from rbs.window.outputs import RUNNING
from rbs.window.plots import draw_plots
from rbs.window.viewer import Viewer
from rbs.window.widgets import scaled, tell

# Width of the columns as a fraction of the window's, and the least and greatest one in pixels; the
# least to which the readout can be dragged.
COLUMN, LEAST_SIDE = (0.18, 230, 330), 120
# Pixels: height of the bar with the timeline, and of a window with room for all sections.
BAR_HEIGHT, ROOMY_HEIGHT = 38, 640
# Pixels: widths of the labels beside fields, of the list of speeds, and of the buttons beside it.
LABEL_WIDTH, SPEED_WIDTH, BUTTON_WIDTH = 112, 92, 50
# Pixels. A shorter movement between pressing and releasing the button counts as a click; a longer
# one turns the camera.
CLICK_PIXELS = 4.0
# Ends of the sliders of settings, in their units.
SLIDER_ENDS = {"restitution": (0.0, 1.0), "friction": (0.0, 1.0), "gravity": (0.0, 20.0)}
SLIDER_ENDS |= {"timeStep": (0.001, 0.05), "substeps": (1, 32)}
# Most frames per second; the same while idle, to spare the processor; seconds of rest until idle.
FRAME_RATE, IDLE_RATE, IDLE_SECONDS = 60, 5, 0.5
# Fraction of the chosen speed that counts as reached. Beyond real time, no shortfall is shown.
REACHED = 0.9
# Shown in place of the timeline until something has been done.
HINT = "H shows all keys · Ctrl + drag throws a body · B shoots"
# Names in lists of choices where the option's own name says too little; short names of overlays.
CHOICES = {"impulse": "basic step", "soft-step": "soft step", "all": "all pairs"}
CHOICES |= {"sequential": "in order"}
SHORT = {"friction impulses": "friction", "bounding boxes": "boxes", "grid cells": "cells"}
# Settings that change the time of a step, and its motion at most within the constraints' tolerance.
ADVANCED = "broadPhase", "contactScheduling", "constraintScheduling"
# Phases of a step, where their names say too little.
PHASES = {"step": "whole step", "gather": "read bodies", "writeBack": "write back"}
PHASES |= {"contactSolver": "contact solver"}
# Keys that repeat while they are held down.
REPEATING = "S", "RightArrow", "LeftArrow", "E", "Shift+E", "Ctrl+Z", "Ctrl+Shift+Z", "Ctrl+Y"
# A section that is open at first.
OPEN = psim.ImGuiTreeNodeFlags_DefaultOpen


class Box(NamedTuple):
    """A rectangle in pixels: upper left corner, from that of the window, and size."""

    left: int
    top: int
    width: int
    height: int


def show_window(simulation, backend, opener, options):
    """Opens the window on a SceneSimulation or a Replay. Returns when it is closed, and prints the
    files that were written.

    backend : see `start_view`; opener : SceneOpener; options : PictureOptions
    """
    view = start_view(simulation, backend, options)
    viewer = Viewer(simulation, view, opener)
    panel = Panel(viewer)
    fit_window()
    panel.lay_out()
    if options.camera is None:
        view.viewpoint.restart()
    view.set_callback(panel.frame)
    ps.set_files_dropped_callback(panel.dropped)
    try:
        ps.show()
    finally:
        viewer.outputs.stop()
        for path in viewer.outputs.written:
            print_error(f"written: {shown_path(path)}")
        view.set_callback(None)
        ps.clear_files_dropped_callback()


class Panel:
    """The window's panels, keys and mouse, which show a Viewer and call its functions.

    Attributes: viewer; glass; keys, see `_key_table`; isHelpShown, isSideShown, whether help and
    readout are shown; picture, the Box beside the panels in the last frame.
    """

    def __init__(self, viewer):
        self.viewer, self.glass, self.frameRate = viewer, Glass(viewer), FRAME_RATE
        self.isHelpShown = self.isSideShown = self._isKeyDown = self._cameraMoves = False
        self.keys = self._key_table()
        self._acts = {chord: act for chords, _, act in self.keys for chord in chords.split()}
        self.picture = self._dropped = self._pressedAt = self._failed = None
        self._picked, self._reads = None, (None, False, False)  # what the readout has to show
        self._lastFrame = self._lastAction = time.perf_counter()
        self._banner = self._sideWidth = 0  # pixels: covered by a message; width of the readout
        self._lastKey = 0.0
        ps.set_max_fps(-1)  # with a limit, Polyscope would wait by keeping a core busy

    def _key_table(self):
        """Returns the keys: rows (ImGui's names, with modifiers; meaning; function)."""
        viewer, go, toggle = self.viewer, self.glass.go, self._toggle
        frame, event = viewer.view.viewpoint.frame, "event of the last step, with formulas"
        kept = "start over, keeping your settings; reloads a student's functions"
        return [
            ("Space", "play, pause", viewer.toggle_play),
            ("S RightArrow", "one step forward: a kept one, or else a new one", viewer.step_once),
            ("LeftArrow Ctrl+Z", "one step back, or undo a change", viewer.step_back),
            ("Ctrl+Y Ctrl+Shift+Z", "redo", viewer.redo),
            ("E", f"next {event}; begins with the selected body", go),
            ("Shift+E", f"previous {event}", partial(go, -1)),
            ("R", kept, viewer.restart),
            ("Shift+R", "start over, with the scene's own settings", partial(viewer.restart, True)),
            ("B", "shoot a ball at the mouse", self._shoot),
            ("F", "fit the scene in view, or the selected body", frame),
            ("1 Keypad1", "view from the front", partial(frame, FRONT)),
            ("3 Keypad3", "view from the right", partial(frame, SIDE)),
            ("7 Keypad7", "view from above", partial(frame, TOP)),
            ("N", "show or hide the readout", partial(toggle, "isSideShown")),
            ("H", "show or hide this help", partial(toggle, "isHelpShown")),
            ("Escape", "close this help, or the events of a step", self._escape),
        ]

    def dropped(self, paths):
        """Polyscope's callback for files dropped onto the window. Only the last one is opened."""
        self._dropped = paths[-1]

    @interrupts_held()  # Polyscope drops what is raised while it converts ImGui's names
    def frame(self):
        """Polyscope's callback for each frame: keys, panels, and the steps that are due.

        An error in one of these becomes a message; the others go on.
        """
        now, viewer = time.perf_counter(), self.viewer
        elapsed, self._lastFrame = now - self._lastFrame, now
        for part in (
            *(self._open_dropped, self._handle_keys, self._handle_mouse),
            *(self.lay_out, partial(self._move_camera, elapsed), viewer.watch),
            *(lambda: self.glass.draw(self.picture), self._draw_main, self._draw_side),
            *(self._draw_bar, self._draw_message, self._draw_help),
            *(partial(self._choose_quality, now), partial(viewer.play, elapsed)),
            *(partial(draw_marks, viewer), lambda: self.glass.draw_labels(self.picture)),
            *(viewer.view.resize_lines, partial(viewer.outputs.film, elapsed)),
        ):
            try:
                part()
            except Exception as error:
                self._report(error)

    def _report(self, error):
        """Shows an error of this program; the terminal gets its place, once."""
        viewer = self.viewer
        viewer.isPlaying, viewer.view.highlight = False, None
        viewer.message = f"internal error, {type(error).__name__}: {short(error, limit=200)}"
        if (text := traceback.format_exc()) != self._failed:
            self._failed = text
            print(text, end="", file=sys.stderr, flush=True)

    def _open_dropped(self):
        dropped, self._dropped = self._dropped, None
        if dropped is not None:
            self.viewer.open(dropped)

    def lay_out(self):
        """Arranges the panels for the window's size, and tells the camera what they cover."""
        width, height = ps.get_window_size()
        if self.picture is None or not (self._pressedAt or self.viewer.hand.grab):  # no drag
            self._show_news()
            share, least, most = COLUMN
            left = round(min(max(share * width, scaled(least)), scaled(most)))
            self._sideWidth = self._sideWidth or left
            bottom = height - round(scaled(BAR_HEIGHT))
            right = width - self._sideWidth * self.isSideShown
            self.picture = Box(left, 0, right - left, bottom)
        covered = self._banner, self.glass.height
        self.viewer.view.viewpoint.set_picture(self.picture, (width, height), *covered)

    def _show_news(self):
        """Shows the readout when there is something else to read, and hides it after the last."""
        viewer = self.viewer
        beside, isEvent = viewer.simulation.beside, self.glass.events is not None
        reads = viewer.view.picked_mesh, isEvent, bool(beside and beside.difference)
        if reads != self._reads:
            self._reads, self.isSideShown = reads, any(reads)

    def _move_camera(self, elapsed):
        viewpoint, io = self.viewer.view.viewpoint, psim.GetIO()
        viewpoint.keep_above_ground()
        if not io.WantCaptureMouse and (io.MouseWheel or any(map(psim.IsMouseDown, range(3)))):
            viewpoint.stay()
        self._cameraMoves = viewpoint.move(elapsed)
        self.viewer.view.spread_ground()
        self.viewer.view.clear_sight()

    def _choose_quality(self, now):
        """Smooths edges while nothing moves, and in films. Waits for the next frame, longer while
        idle.
        """
        io, isPlaying = psim.GetIO(), self.viewer.isPlaying
        isHeld = any(map(psim.IsMouseDown, range(3)))
        isFilm = "video" in self.viewer.outputs.writers
        isUsed = any(io.MouseDelta) or isHeld or io.MouseWheel or io.WantTextInput
        if isPlaying or isUsed or self._isKeyDown or self._cameraMoves:
            self._lastAction = now
        isMoving = isPlaying or self._cameraMoves or isHeld and not io.WantCaptureMouse
        isMoving |= now - self._lastKey < IDLE_SECONDS
        self.viewer.view.set_supersampling(isFilm or not isMoving)
        ps.set_window_resizable(not isFilm)
        self.frameRate = IDLE_RATE if now - self._lastAction > IDLE_SECONDS else FRAME_RATE
        time.sleep(max(1.0 / self.frameRate - (time.perf_counter() - now), 0.0))

    def _handle_keys(self):
        """Does what keys are for."""
        io, self._isKeyDown = psim.GetIO(), False
        if io.WantTextInput:  # a field has the focus
            return
        # while idle, one frame sees a whole tap, in which Ctrl or Shift may be released first
        held = ""
        for name, isHeld in (("Ctrl", io.KeyCtrl), ("Shift", io.KeyShift)):
            if isHeld or psim.IsKeyReleased(getattr(psim, f"ImGuiMod_{name}")):
                held += f"{name}+"
        for key in dict.fromkeys(chord.rpartition("+")[2] for chord in self._acts):
            chord, code = held + key, getattr(psim, f"ImGuiKey_{key}")
            chord = chord if chord in self._acts else key
            self._isKeyDown |= psim.IsKeyDown(code)
            if psim.IsKeyPressed(code, chord in REPEATING) and chord in self._acts:
                self._lastKey = time.perf_counter() if chord in REPEATING else 0.0
                self._acts[chord]()

    def _toggle(self, name):
        setattr(self, name, not getattr(self, name))

    def _escape(self):
        self.isHelpShown = False
        self.glass.close()

    def _shoot(self):
        (left, top, width, height), io = self.picture, psim.GetIO()
        middle = left + 0.5 * width, top + 0.5 * height
        self.viewer.hand.shoot(middle if io.WantCaptureMouse else tuple(io.MousePos))

    def _handle_mouse(self):
        io, hand = psim.GetIO(), self.viewer.hand
        mouse = tuple(io.MousePos)
        if psim.IsMouseClicked(0) and not io.WantCaptureMouse:
            if io.KeyCtrl:
                hand.grab_at(mouse)
            else:
                self._pressedAt = mouse
        if hand.grab is not None:
            if psim.IsMouseDown(0):
                hand.drag_to(mouse)
            else:
                hand.release()
        if psim.IsMouseReleased(0) and self._pressedAt is not None:
            if math.dist(self._pressedAt, mouse) < CLICK_PIXELS:
                hand.pick_at(self._pressedAt)
            self._pressedAt = None

    # The main column.

    def _draw_main(self):
        size, viewer = (self.picture.left, self.picture.height), self.viewer
        flag = OPEN if size[1] >= scaled(ROOMY_HEIGHT) else 0
        with widgets.panel("Main", (0, 0), size, size, labels=LABEL_WIDTH):
            fit = "F: fit the selected body in view, or the scene without bodies that flew off"
            self._buttons(
                ("Help", partial(self._toggle, "isHelpShown"), "H: keys and mouse actions"),
                ("Readout", partial(self._toggle, "isSideShown"), "N: numbers on the right"),
                ("Frame", viewer.view.viewpoint.frame, fit),
            )
            tooltip = f"{viewer.name}, from {shown_path(viewer.simulation.scenePath)}\n"
            tooltip += "Scenes of this project, and files beside this scene"
            psim.SetNextItemWidth(-psim.CalcTextSize("scene")[0] - scaled(widgets.GAP))
            files = partial(list_files, viewer.simulation.scenePath.parent)
            widgets.draw_choice("scene", viewer.name, files, viewer.open, tooltip)
            self._draw_save()
            if not viewer.isReplay and psim.CollapsingHeader("Simulation", flag):
                self._draw_settings()
            if psim.CollapsingHeader("Display", flag):
                self._draw_display()
            rows = viewer.view.legend()
            if rows and psim.CollapsingHeader("Legend", OPEN):
                for text, colour in rows:
                    widgets.draw_patch(colour, text, psim.TextWrapped)

    def _buttons(self, *rows):
        """Draws buttons that fill a line: rows (label, function, tooltip), and as a fourth the
        writer that a button has started, or None; while there is one, the button is red.
        """
        gap = psim.GetStyle().ItemSpacing[0]
        widths = [psim.CalcTextSize(label)[0] for label, *_ in rows]
        rest = psim.GetContentRegionAvail()[0] - gap * (len(rows) - 1) - sum(widths)
        for place, (label, act, tooltip, *writer) in enumerate(rows):
            if place:
                psim.SameLine()
            with widgets.styled({"Button": widgets.RUNNING} if any(writer) else None):
                if psim.Button(label, (widths[place] + rest / len(rows), 0)):
                    act()
            tell(tooltip)

    def _draw_save(self):
        outputs = self.viewer.outputs
        tooltip = "Save the viewpoint to out/; drop the file here, or pass it to --camera"
        self._buttons(
            ("Picture", outputs.save_picture, "Save this view as a PNG, without panels, to out/"),
            ("Viewpoint", outputs.save_camera, tooltip),
        )
        rows = []
        for name, one in RUNNING.items():
            if name != "recording" or not self.viewer.isReplay:
                tooltip = f"{one.tooltip}, until the next click ({one.ending} in out/)"
                if writer := outputs.writers.get(name):
                    tooltip = f"Stop, and save {writer.path.name}"
                rows.append((one.label, partial(outputs.toggle, name), tooltip, writer))
        self._buttons(*rows)

    def _draw_settings(self):
        simulation, settings = self.viewer.simulation, self.viewer.simulation.settings
        used = [one for one in TEXTS.values() if one.setting.is_used_by(settings.contactSolver)]
        used = [one for one in used if simulation.constraints or not one.isOfConstraints]
        for one in used:
            if one.label and one.name not in ADVANCED:
                self._draw_setting(one)
        advanced = [one for one in used if one.name in ADVANCED]
        if advanced and psim.TreeNode("Advanced"):
            for one in advanced:
                self._draw_setting(one)
            psim.TreePop()

    def _draw_setting(self, one):
        settings, kind = self.viewer.simulation.settings, one.setting.kind
        value = getattr(settings, one.name)
        row, last = (one.label, value), (partial(self.viewer.set, one.name), one.tooltip)
        if kind is bool:
            widgets.draw_check(*row, *last)
        elif isinstance(value, tuple):
            psim.TextUnformatted(f"{one.shown(settings)}  {one.label}")
        elif one.name in SLIDER_ENDS:
            widgets.draw_slider(*row, *SLIDER_ENDS[one.name], *last)
        else:
            widgets.draw_choice(*row, kind, *last, CHOICES)

    def _draw_display(self):
        view = self.viewer.view
        tooltip = "Quantity that the colours of bodies show"
        widgets.draw_choice("colours", view.colouring, COLOURINGS, view.colour_by, tooltip)
        second = 0.5 * psim.GetContentRegionAvail()[0] + psim.GetCursorPosX()
        for k, (name, one) in enumerate(OVERLAYS.items()):
            if k % 2:  # in two columns
                psim.SameLine(second)
            label, act = SHORT.get(name, name), partial(view.show, name)
            widgets.draw_check(label, name in view.shown, act, one.shows)

    # The readout, on the right.

    def _draw_side(self):
        if not self.isSideShown:
            return
        (width, _), viewer, picked = ps.get_window_size(), self.viewer, self.viewer.view.picked_mesh
        viewer.find_report()
        left, _, _, height = self.picture
        ends = (scaled(LEAST_SIDE), height), (width - left - scaled(LEAST_SIDE), height)
        edge, size = (width, 0), (self._sideWidth, height)
        with widgets.panel("Readout", edge, *ends, "", (1, 0), labels=LABEL_WIDTH, size=size):
            self._sideWidth = round(psim.GetWindowWidth())
            if picked is not self._picked:
                self._picked = picked
                psim.SetScrollY(0.0)  # its numbers are at the top
            if picked is not None:
                self._draw_body()
                psim.Separator()
            self._draw_numbers()
            if psim.CollapsingHeader("Times"):
                self._draw_times()
            if psim.CollapsingHeader("Plots") and not draw_plots(viewer.history, viewer.seek):
                self._lastAction = time.perf_counter()  # not idle: some are still unknown
            if psim.CollapsingHeader("Events of a step", OPEN):
                self.glass.draw_list()

    def _draw_numbers(self):
        simulation = self.viewer.simulation
        report, count = simulation.report, len(simulation.meshes)
        fixed = sum(mesh.isFixed for mesh in simulation.meshes)
        lines = [counted(count, "body") + f" ({fixed} fixed)" * bool(fixed)]
        if simulation.settings.ground:
            lines += [f"floor squares {self.viewer.view.squareSide:g} m"]
        lines += [f"step {simulation.stepCount}, {simulation.time:.2f} s simulated"]
        if report is not None:
            if report.hasSleepers:
                lines += [f"{counted(int(report.isAsleep.sum()), 'body')} asleep"]
            lines += [counted(report.contactCount, "contact")]
        if simulation.constraints:
            lines += [counted(len(simulation.constraints), "constraint")]
        psim.TextWrapped("\n".join(lines))

    def _draw_times(self):
        rows, rate = self.viewer.timings, psim.GetIO().Framerate
        psim.Text(f"{rate:.0f} frames per second")
        if rows:
            psim.Text("ms per step, of the last steps:")
        for name in dict.fromkeys(name for row in rows for name in row):
            mean = 1e3 * fmean(row.get(name, 0.0) for row in rows)
            psim.Text(f"{mean:.2f}  {PHASES.get(name, name)}")
        if (report := self.viewer.simulation.report) is not None:
            psim.Text(counted(report.candidatePairs, "candidate pair"))
            if self.viewer.simulation.constraints:
                psim.Text(counted(report.constraintVisits, "visit"))

    def _draw_body(self):
        viewer, view = self.viewer, self.viewer.view
        mesh, hand = view.picked_mesh, viewer.hand
        psim.SeparatorText(f"{mesh.name}, {'fixed' if mesh.isFixed else 'free'}")
        isHeavy = mesh.mass >= 1e3
        mass = measured(mesh.mass / 1e3, "t", 4) if isHeavy else measured(mesh.mass, "kg", 4)
        psim.TextWrapped(f"mass {mass}, density {mesh.density:g} kg/m³")
        for name, row in (
            ("centre (m)", mesh.position),
            ("velocity (m/s)", mesh.linVelocity),
            ("angular velocity (rad/s)", mesh.angVelocity),
        ):
            psim.Text(name)
            widgets.draw_columns([f"{number:.2f}" for number in (row[0].round(2) + 0.0)])
        if not viewer.isReplay:
            self._draw_changes(mesh, hand)
        if psim.CollapsingHeader("Contacts", OPEN):
            self.glass.draw_contacts()

    def _draw_changes(self, mesh, hand):
        if psim.Button("Free###fix" if mesh.isFixed else "Fix###fix"):
            hand.set_fixed(not mesh.isFixed)
        tell("Fix or free this body. A fixed body has infinite mass")
        if mesh.isFixed:
            return
        right, _, ahead = present_camera().axes
        ways = {"away": ahead, "left": -right, "right": right, "up": (0, 1, 0)}
        tooltip = f"Push at the point that was clicked, by {PUSH_SPEED:g} m/s, as you see it"
        psim.SameLine()
        psim.Text("Push it")
        self._buttons(*((name, partial(hand.push, way), tooltip) for name, way in ways.items()))

    # The bar with the timeline, and messages.

    def _draw_bar(self):
        viewer, simulation, playback = self.viewer, self.viewer.simulation, self.viewer.playback
        (width, height), top = ps.get_window_size(), self.picture.height
        size = width, height - top
        with widgets.panel("Bar", (0, top), size, size, "NoScrollbar"):
            play = "Pause###Play" if viewer.isPlaying else "Play###Play"
            for name, act, tooltip in (
                ("Reset", viewer.restart, "R: start over, keeping your settings"),
                ("Back", viewer.step_back, "Left or Ctrl + Z: one step back, or undo"),
                (play, viewer.toggle_play, "Space: play or pause"),
                ("Step", viewer.step_once, "S or Right: one step forward; Ctrl + Y: redo"),
            ):
                if psim.Button(name, (scaled(BUTTON_WIDTH), 0)):
                    act()
                tell(tooltip)
                psim.SameLine()
            names = {one: f"{one:g} ×" for one in SPEEDS} | {math.inf: "unlimited"}
            act = partial(setattr, playback, "speed")
            psim.SetNextItemWidth(scaled(SPEED_WIDTH))
            tooltip = "Speed, relative to real time, if the machine reaches it"
            widgets.draw_choice("###speed", playback.speed, SPEEDS, act, tooltip, names)
            psim.SameLine()
            if (reached := playback.reached) and reached < REACHED * min(playback.speed, 1.0):
                psim.Text(f"{reached:.2g} ×")
                tell("The speed that this machine reaches")
                psim.SameLine()
            if viewer.isReplay:
                if psim.Button("Continue from here"):
                    viewer.continue_here()
                tell("Continue the simulation from this step, with its settings")
                psim.SameLine()
            if viewer.simulation is simulation:
                self._draw_timeline()

    def _draw_timeline(self):
        """Draws the light of files being written, the present step, and the axis of the steps that
        can be gone to, between the numbers of the first and the last.
        """
        viewer, simulation, history = self.viewer, self.viewer.simulation, self.viewer.history
        if writers := viewer.outputs.writers.values():
            widgets.draw_patch(widgets.LIGHT, ", ".join(one.path.name for one in writers))
            tell("\n".join(one.summary() for one in writers))
            psim.SameLine()
        ends = history.axis[0].stepCount, history.axis[-1].stepCount
        left = psim.GetCursorPos()[0]
        psim.Text(f"step {simulation.stepCount}, {simulation.time:.2f} s")
        if len(history.axis) == 1 and not viewer.isReplay:
            psim.SameLine(0.0, 4 * scaled(widgets.GAP))
            return psim.TextDisabled(HINT)
        psim.SameLine(left + psim.CalcTextSize(f"step {ends[1]}0, {ends[1]}.00 s")[0])
        psim.Text(f"{ends[0]}")
        psim.SameLine()
        room = psim.GetContentRegionAvail()[0] - psim.CalcTextSize(f"{ends[1]}")[0]
        psim.SetNextItemWidth(room - scaled(widgets.GAP))
        with widgets.styled({"SliderGrab": widgets.MARK}):
            isMoved, step = psim.SliderInt("###axis", simulation.stepCount, *ends, "")
        if history.gap is not None:
            widgets.draw_gap((np.array(history.gap) - ends[0]) / (ends[1] - ends[0]))
        if isMoved:
            viewer.seek_step(step)
        psim.SameLine()
        psim.Text(f"{ends[1]}")

    def _draw_help(self):
        if self.isHelpShown:
            self.isHelpShown = draw_help(self.keys, ps.get_window_size())

    def _draw_message(self):
        """Draws the message, and notes what it covers."""
        text, (left, top, width, _) = self.viewer.message, self.picture
        self._banner = 0
        if text:
            sizes = (width, 0), (width, scaled(200))
            with widgets.panel("Message", (left, top), *sizes, "NoInputs", alpha=0.9):
                psim.TextWrapped("\n".join(map(one_line, text.splitlines())))
                self._banner = round(psim.GetWindowHeight())
