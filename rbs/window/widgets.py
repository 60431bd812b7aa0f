"""Widgets of the window's panels: panels, tooltips, fields, lists.

What ImGui begins it also ends if a block raises, so that the next frame is not spoilt.
"""

from contextlib import contextmanager
from functools import reduce
from operator import or_
from textwrap import fill

import polyscope as ps
import polyscope.imgui as psim

from rbs.scenes.messages import one_line

# Colours: of what is secondary, of the heads of sections and the chosen row of a list, of the light
# and the button of a file that is being written, and of the present step on the timeline.
WEAK_TEXT = (0.68, 0.70, 0.72)
HEAD, HEAD_HOVERED, ACTION = (0.29, 0.31, 0.33), (0.36, 0.38, 0.40), (0.19, 0.40, 0.31)
LIGHT, RUNNING, MARK = (1.0, 0.25, 0.2), (0.65, 0.16, 0.13), (0.55, 0.80, 0.70)
# Pixels, of a list with a description beside each name: indent of these, width, height.
LINE_INDENT, LIST_WIDTH, LIST_HEIGHT = 140, 560, 460
# Pixels between a field and its label.
GAP = 6
# Pixels around the text of a widget, and between widgets; those beside lists. Colour of panels.
PADDING, SPACING, SCROLLBAR_WIDTH = (5, 2), (6, 4), 10
PANEL_COLOUR = (0.17, 0.18, 0.19)
# Characters in a line of a tooltip, at most.
TOOLTIP_WIDTH = 60


def scaled(pixels):
    """Converts pixels of an ordinary monitor to pixels of this one."""
    return pixels * ps.get_ui_scale()


def packed(colour):
    """Returns an RGB colour as ImGui's number: opacity, blue, green, red."""
    return psim.ColorConvertFloat4ToU32((*colour, 1.0))


@contextmanager
def styled(colours=None, sizes=None):
    """Draws the `with` block in these colours and sizes, dicts by ImGui's names."""
    for name, colour in (colours or {}).items():
        psim.PushStyleColor(getattr(psim, f"ImGuiCol_{name}"), (*colour, 1.0)[:4])
    for name, size in (sizes or {}).items():
        psim.PushStyleVar(getattr(psim, f"ImGuiStyleVar_{name}"), size)
    try:
        yield
    finally:
        psim.PopStyleColor(len(colours or {}))
        psim.PopStyleVar(len(sizes or {}))


@contextmanager
def panel(
    title, place, least, most, flags="", pivot=(0, 0), alpha=1.0, labels=0, size=None, isFront=False
):
    """Draws the widgets of the `with` block in a panel, as large as they need within limits.

    place : pixel of the panel's point `pivot`, (0, 0) to (1, 1); least, most : (width, height)
    flags : names of ImGui's; alpha : opacity; labels : width beside fields
    size : at first, if its free edges can be dragged
    isFront : whether it has a title, and stands in front of the others. Yields whether the title's
        × leaves it open
    """
    psim.SetNextWindowPos(place, psim.ImGuiCond_Always, pivot)
    psim.SetNextWindowSizeConstraints(least, most)
    names = ["NoMove", "NoCollapse", "NoFocusOnAppearing", "NoSavedSettings", *flags.split()]
    names += ["NoTitleBar", "NoBringToFrontOnFocus"] * (not isFront)
    if size is None:
        names.append("AlwaysAutoResize")
    else:
        psim.SetNextWindowSize(size, psim.ImGuiCond_FirstUseEver)
    flags = reduce(or_, (getattr(psim, f"ImGuiWindowFlags_{name}") for name in names))
    colours = {"WindowBg": (*PANEL_COLOUR, alpha), "PopupBg": PANEL_COLOUR}
    colours |= {"Header": HEAD, "HeaderHovered": HEAD_HOVERED, "HeaderActive": HEAD_HOVERED}
    colours |= {"Button": ACTION, "TitleBgActive": ACTION, "TitleBg": HEAD}
    colours |= {"TextDisabled": WEAK_TEXT, "SliderGrab": (0.20, 0.42, 0.36)}
    colours |= {"SliderGrabActive": (0.24, 0.50, 0.42), "Border": (0.55, 0.57, 0.60)}
    colours["ResizeGrip"] = (0.0, 0.0, 0.0, 0.0)  # an edge is easier to drag
    sizes = {"FramePadding": tuple(map(scaled, PADDING)), "ScrollbarSize": scaled(SCROLLBAR_WIDTH)}
    with styled(colours, sizes | {"ItemSpacing": tuple(map(scaled, SPACING))}):
        isOpen = psim.Begin(title, True, flags)[1]
        psim.PushItemWidth(psim.GetContentRegionAvail()[0] - scaled(labels))
        try:
            yield isOpen
        finally:
            psim.PopItemWidth()
            psim.End()


@contextmanager
def child(name, size=(0.0, 0.0)):
    """Draws the `with` block in a part of a panel that scrolls."""
    psim.BeginChild(name, size)
    try:
        yield
    finally:
        psim.EndChild()


def tell(text):
    """Sets the tooltip of the last widget."""
    if psim.IsItemHovered(psim.ImGuiHoveredFlags_ForTooltip):
        lines = map(one_line, text.splitlines())
        psim.SetTooltip("\n".join(fill(line, TOOLTIP_WIDTH) for line in lines))


def draw_patch(colour, text, draw=psim.Text):
    """Draws a square of a colour (r, g, b), and a text beside it."""
    side = psim.GetFontSize()
    with styled(sizes={"FrameBorderSize": 1.0}):  # dark ones are seen, too
        psim.ColorButton(text, (*colour, 1.0), psim.ImGuiColorEditFlags_NoTooltip, (side, side))
    psim.SameLine()
    draw(text)


def draw_columns(texts):
    """Draws texts on one line, right-aligned in columns of the same width."""
    left, column = psim.GetCursorPos()[0], psim.GetContentRegionAvail()[0] / len(texts)
    for k, text in enumerate(texts, 1):
        psim.SetCursorPos((left + k * column - psim.CalcTextSize(text)[0], psim.GetCursorPos()[1]))
        psim.Text(text)
        if k < len(texts):
            psim.SameLine()


def draw_gap(ends):
    """Blanks out the last slider between two fractions of its length, between which is nothing."""
    (left, top), (right, bottom) = psim.GetItemRectMin(), psim.GetItemRectMax()
    begin, end = (left + share * (right - left) for share in ends)
    psim.GetWindowDrawList().AddRectFilled((begin, top), (end, bottom), packed(PANEL_COLOUR))


def draw_check(label, value, act, tooltip):
    """Draws a check box; act(value) is called when it is switched."""
    isChanged, value = psim.Checkbox(label, value)
    tell(tooltip)
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
        return tell(tooltip)
    try:
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
    finally:
        psim.EndCombo()


def draw_slider(label, value, low, high, act, tooltip):
    """Draws a slider for a float or an int; act(value) is called when it is moved or typed into."""
    isWhole = isinstance(value, int)
    slide, shown = (psim.SliderInt, "%d") if isWhole else (psim.SliderFloat, "%.3g")
    isMoved, moved = slide(label, value, low, high, shown)
    tell(f"{tooltip}. Ctrl-click: type a number")
    if isMoved:
        # a float of ImGui has seven digits
        act(moved if isWhole else float(f"{moved:.4g}"))
