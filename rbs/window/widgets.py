"""Widgets of the window's panels: tooltips, fields, lists, tables of numbers."""

import math
from contextlib import contextmanager
from functools import reduce
from operator import or_
from textwrap import fill

import polyscope as ps
import polyscope.imgui as psim

# Colour of error messages: RGB and opacity.
ERROR_TEXT = (1.0, 0.45, 0.40, 1.0)
# Pixels, of a list with a description beside each name: indent of these, width, height.
LINE_INDENT, LIST_WIDTH, LIST_HEIGHT = 140, 560, 460
# Pixels: width of a number in a table, and the gap beside it.
NUMBER_WIDTH, GAP = 64, 8
# Pixels around the text of a widget: few enough for the settings and Display, both open, at a
# height of 720. Colour of panels, RGB. Pixels, beside which lists have room for their names.
PADDING, PANEL_COLOUR, SCROLLBAR_WIDTH = (6, 2), (0.17, 0.18, 0.19), 10
# Characters in a line of a tooltip, at most.
TOOLTIP_WIDTH = 60


def scaled(pixels):
    """Converts pixels of an ordinary monitor to pixels of this one."""
    return pixels * ps.get_ui_scale()


@contextmanager
def panel(title, place, least, most, flags="", pivot=(0.0, 0.0), alpha=1.0):
    """Draws the widgets of the `with` block in a panel, as large as they need within limits.

    place : pixel of the panel's point `pivot`, (0, 0) to (1, 1); least, most : (width, height)
    flags : names of ImGui's; alpha : opacity. Yields whether its title's × leaves it open
    """
    psim.SetNextWindowPos(place, psim.ImGuiCond_Always, pivot)
    psim.SetNextWindowSizeConstraints(least, most)
    psim.PushStyleColor(psim.ImGuiCol_WindowBg, (*PANEL_COLOUR, alpha))
    psim.PushStyleColor(psim.ImGuiCol_PopupBg, (*PANEL_COLOUR, 1.0))  # of lists and tooltips
    psim.PushStyleVar(psim.ImGuiStyleVar_FramePadding, tuple(map(scaled, PADDING)))
    psim.PushStyleVar(psim.ImGuiStyleVar_ScrollbarSize, scaled(SCROLLBAR_WIDTH))
    names = ["AlwaysAutoResize", "NoMove", "NoCollapse", *flags.split()]
    flags = reduce(or_, (getattr(psim, f"ImGuiWindowFlags_{name}") for name in names))
    yield psim.Begin(title, True, flags)[1]
    psim.PopStyleColor(2)
    psim.PopStyleVar(2)
    psim.End()


class Tooltips:
    """Tooltips. `areHidden` while a message is shown, which they could cover."""

    areHidden = False

    @classmethod
    def tell(cls, text):
        """Sets the tooltip of the last widget: beside its panel, or above the timeline."""
        if not text or cls.areHidden:
            return
        if psim.IsItemHovered(psim.ImGuiHoveredFlags_ForTooltip):
            (left, top), (x, y), gap = psim.GetWindowPos(), psim.GetItemRectMin(), scaled(GAP)
            isLow, isRight = y > 0.5 * ps.get_window_size()[1], left > 0.0 == top
            if top == 0.0:  # a column
                x = left - gap if isRight else psim.GetWindowWidth() + gap
            psim.SetNextWindowPos((x, y - gap * isLow), 0, (isRight, isLow))
        psim.SetItemTooltip(fill(text, TOOLTIP_WIDTH))


class NumberField:
    """A field for a number, which takes effect with Enter or on leaving the field."""

    _typed = math.nan

    def draw(self, label, value, step, act, tooltip):
        """Draws the field; act(number) is called with what was typed, if it is a number.

        step : change by the buttons + and -
        """
        isChanged, value = psim.InputDouble(label, value, step, 0.0, "%.4g")
        Tooltips.tell(tooltip)
        if isChanged:
            self._typed = value
        if psim.IsItemDeactivatedAfterEdit() and not math.isnan(self._typed):
            act(self._typed)
            self._typed = math.nan


def draw_section(title, isOpen=False):
    """Draws the title of a section, open or not at first. Returns whether it is open."""
    return psim.CollapsingHeader(title, psim.ImGuiTreeNodeFlags_DefaultOpen if isOpen else 0)


def draw_check(label, value, act, tooltip):
    """Draws a check box; act(value) is called when it is switched."""
    isChanged, value = psim.Checkbox(label, value)
    Tooltips.tell(tooltip)
    if isChanged:
        act(value)


def draw_choice(label, current, names, act, tooltip, shown=None):
    """Draws a list; act(name) is called when a name is chosen. shown : names as they are shown

    names : list of names, or a function, called while the list is open, that returns a list of
        (heading, name, description, what act is called with)
    """
    if callable(names):
        width = scaled(LIST_WIDTH)
        psim.SetNextWindowSizeConstraints((width, 0), (width, scaled(LIST_HEIGHT)))
    shown = shown or {}
    if not psim.BeginCombo(label, shown.get(current, current), psim.ImGuiComboFlags_HeightLargest):
        return Tooltips.tell(tooltip)
    lastGroup = None
    rows = names() if callable(names) else [(None, name, "", name) for name in names]
    for group, name, line, value in rows:
        if group != lastGroup:
            psim.SeparatorText(group)
            lastGroup = group
        if psim.Selectable(shown.get(name, name), selected=name == current):
            act(value)
        if name == current and psim.IsWindowAppearing():
            psim.SetScrollHereY()
        if line:
            psim.SameLine(scaled(LINE_INDENT))
            psim.Text(line)
    if psim.IsKeyPressed(psim.ImGuiKey_Escape, False):
        psim.CloseCurrentPopup()
    psim.EndCombo()


def draw_slider(label, value, low, high, act, tooltip, shown="%.3f"):
    """Draws a slider for a float or an int; act(value) is called when it is moved or typed into."""
    slide, shown = (psim.SliderInt, "%d") if isinstance(value, int) else (psim.SliderFloat, shown)
    psim.PushStyleColor(psim.ImGuiCol_SliderGrab, psim.GetStyleColorVec4(psim.ImGuiCol_Button))
    isMoved, moved = slide(label, value, low, high, shown)
    psim.PopStyleColor()
    Tooltips.tell(f"{tooltip}. Ctrl-click: type a number")
    if isMoved:
        act(round(moved, 3))


def draw_table(rows, indent=0):
    """Draws rows (number, label), numbers flush right. indent : pixels, except for the first."""
    left = psim.GetCursorPosX()
    for place, (number, text) in enumerate(rows):
        end = left + scaled(NUMBER_WIDTH + (indent if place else 0))
        psim.SetCursorPosX(end - psim.CalcTextSize(number)[0])
        psim.Text(number)
        psim.SameLine(end + scaled(GAP))
        psim.Text(text)


def draw_vector(name, values):
    """Draws a line with a name, and one with three numbers, flush right in three columns."""
    left, column = psim.GetCursorPosX(), psim.GetContentRegionAvail()[0] / 3.0
    psim.Text(name)
    for k, number in enumerate(f"{round(value, 2) + 0.0:.2f}" for value in values):
        if k:
            psim.SameLine()
        psim.SetCursorPosX(left + (k + 1) * column - psim.CalcTextSize(number)[0])
        psim.Text(number)
