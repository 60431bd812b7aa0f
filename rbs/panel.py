"""The window's panels: how they look, and which of the viewer's functions their buttons call.

From the top: `Panel`, with its keys, mouse and timeline; plots; widgets. It is handed the viewer
whose functions it calls. Polyscope is imported inside the functions that use it.
"""

import math
import time

import numpy as np

from rbs.broadphase import BROAD_PHASES
from rbs.colours import COLOURINGS, PICKED_COLOUR
from rbs.drawing import LAYERS, MOST_BOXES, MOST_TRAILS, TRAIL_LENGTH, VELOCITY_SECONDS
from rbs.pictures import draw_legend
from rbs.schedules import CONSTRAINT_SCHEDULINGS
from rbs.solverstate import CONTACT_SOLVERS

# In pixels. The panel is as high as its content.
MARGIN = 12
PANEL_WIDTH = 330
BUTTON_SIZE = (74, 0)
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
MOST_SUBSTEPS = 32
# m/s: the largest push.
MOST_PUSH = 40.0
# Times real time that a replay is played with, backwards if negative.
MOST_SPEED = 8.0
# RGB and opacity.
ERROR_TEXT = (1.0, 0.45, 0.40, 1.0)
# Settings that are one of some names: label, name in the settings, names to choose from, and what
# it says under the mouse.
CHOICES = [
    ("solver", "contactSolver", CONTACT_SOLVERS, "soft-step: piles rest"),
    ("broad phase", "broadPhase", BROAD_PHASES, "The same motion; grid is faster for many bodies"),
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
# Plots from top to bottom: title, and what is called how in it.
PLOTS = [
    ("energy (J)", {"kinetic": "kineticEnergy", "potential": "potentialEnergy",
                    "total": "totalEnergy"}),
    ("momentum (kg m/s)", {"x": "momentumX", "y": "momentumY", "z": "momentumZ"}),
    ("deepest penetration (m)", {"depth": "deepestPenetration"}),
    ("largest constraint violation (m)", {"violation": "largestViolation"}),
]  # fmt: skip


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
        self.viewer.view.spread_ground()
        self._draw_panel()
        self._draw_side()
        if self.viewer.picked() is not None:
            self._draw_body()
        if self.viewer.isReplay:
            self._draw_timeline()
        now = time.perf_counter()
        self.viewer.choose_smoothness(now - self._lastFrame)
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
        if psim.IsKeyPressed(psim.ImGuiKey_F, False):
            viewer.view.frame_all()

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
        self._draw_choices(CHOICES)
        if settings.contactSolver == "soft-step":
            settings.closingOnly = False  # it has no meaning there
            _, settings.substeps = psim.SliderInt(
                "substeps", settings.substeps, 1, MOST_SUBSTEPS, "%d", clamp
            )
            _, settings.sleeping = psim.Checkbox("sleeping", settings.sleeping)
            psim.SetItemTooltip("Bodies at rest are left out until something disturbs them")
        else:
            _, settings.closingOnly = psim.Checkbox("closing contacts only", settings.closingOnly)
            psim.SetItemTooltip("Contacts that already separate receive no impulse")
        _, settings.gyroscopic = psim.Checkbox("gyroscopic term", settings.gyroscopic)
        psim.SetItemTooltip("Bodies that spin tumble")
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
        if psim.Button("Frame all", BUTTON_SIZE):
            view.frame_all()
        psim.SetItemTooltip("F: points the camera at all bodies")
        psim.SameLine()
        _, view.follows = psim.Checkbox("follow", view.follows)
        psim.SetItemTooltip("The camera goes along with the picked body, or with all")
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
        draw_legend(self.viewer.view.legend())

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
