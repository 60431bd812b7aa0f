"""Widgets of the window's panels: tooltips, fields, lists, tables of numbers."""

import polyscope as ps
import polyscope.imgui as psim

# Colour of error messages: RGB and opacity.
ERROR_TEXT = (1.0, 0.45, 0.40, 1.0)
# Pixels, of a list with a description beside each name: indent of these, width, height.
LINE_INDENT, LIST_WIDTH, LIST_HEIGHT = 140, 560, 460
# Pixels: width of a number in a table, and the gap beside it.
NUMBER_WIDTH, GAP = 64, 8


def scaled(pixels):
    """Returns so many pixels of an ordinary monitor on this one."""
    return pixels * ps.get_ui_scale()


class Tooltips:
    """Tooltips. `areHidden` while a message is shown, which they could cover."""

    areHidden = False

    @classmethod
    def tell(cls, text):
        """Sets the tooltip of the last widget."""
        if text and not cls.areHidden:
            psim.SetItemTooltip(text)


class NumberField:
    """A field for a number, which takes effect with Enter or on leaving the field.

    Values are clamped to the bounds.
    """

    def __init__(self, setting, step, low, high):
        """setting : from CHOSEN; step : change by the buttons + and -"""
        self._name, self._label, self._tooltip = setting.name, setting.label, setting.tooltip
        self._step, self._low, self._high = step, low, high
        self._typed = None

    def draw(self, settings):
        """Draws the field; returns a message if a value was clamped, or "".

        Text that is not a number changes nothing.
        """
        value = getattr(settings, self._name)
        changed, value = psim.InputDouble(self._label, value, self._step, 0.0, "%.4g")
        Tooltips.tell(self._tooltip)
        if changed:
            self._typed = value
        if psim.IsItemDeactivatedAfterEdit() and self._typed is not None:
            typed, self._typed = self._typed, None
            if typed == typed:  # not NaN
                typed, message = clamped(self._label, typed, self._low, self._high)
                settings.change(self._name, typed)
                return message
        return ""


def clamped(label, value, low, high):
    """Returns the nearest value within bounds, and a message if it is another one, or ""."""
    nearest = min(max(value, low), high)
    message = "" if nearest == value else f"{label} is limited to {low:g} to {high:g}"
    return nearest, message


def draw_check(label, value, act, tooltip):
    """Draws a check box; act(value) is called when it is switched."""
    isChanged, value = psim.Checkbox(label, value)
    Tooltips.tell(tooltip)
    if isChanged:
        act(value)


def draw_choice(label, current, names, act, tooltip):
    """Draws a list; act(name) is called when a name is chosen.

    names : list of names, or of (heading, name, description, …), or a function that returns such a
        list, called while the list is open
    """
    if callable(names):
        width = scaled(LIST_WIDTH)
        psim.SetNextWindowSizeConstraints((width, 0), (width, scaled(LIST_HEIGHT)))
    isOpen = psim.BeginCombo(label, current, psim.ImGuiComboFlags_HeightLargest)
    if not isOpen:
        Tooltips.tell(tooltip)
        return
    lastGroup = None
    names = names() if callable(names) else names
    rows = [name if isinstance(name, tuple) else (None, name, "") for name in names]
    for group, name, line, *_ in rows:
        if group != lastGroup:
            psim.SeparatorText(group)
            lastGroup = group
        if psim.Selectable(name, selected=name == current):
            act(name)
        if name == current and psim.IsWindowAppearing():
            psim.SetScrollHereY()
        if line:
            psim.SameLine(scaled(LINE_INDENT))
            psim.Text(line)
    if psim.IsKeyPressed(psim.ImGuiKey_Escape, False):
        psim.CloseCurrentPopup()
    psim.EndCombo()


def draw_slider(label, value, low, high, act, tooltip, shown="%.3f"):
    """Draws a slider for a float or an int; act(value) is called when it is moved.

    A value can be typed after Ctrl-click. Returns a message if it was clamped, or "".
    """
    if isinstance(value, int):
        isMoved, moved = psim.SliderInt(label, value, low, high, "%d")
    else:
        isMoved, moved = psim.SliderFloat(label, value, low, high, shown)
    Tooltips.tell(tooltip)
    moved, message = clamped(label, round(moved, 3), low, high)
    if isMoved:
        act(moved)
    return message


def draw_table(rows, indent=0):
    """Draws rows (number, label), numbers flush right. indent : pixels, except for the first."""
    left = psim.GetCursorPosX()
    for place, (number, text) in enumerate(rows):
        end = left + scaled(NUMBER_WIDTH + (indent if place else 0))
        psim.SetCursorPosX(end - psim.CalcTextSize(number)[0])
        psim.Text(number)
        psim.SameLine(end + scaled(GAP))
        psim.Text(text)


def draw_vectors(rows):
    """Draws rows (name, three numbers, unit), numbers flush right."""
    left, right = psim.GetCursorPosX(), psim.GetContentRegionAvail()[0]
    unitWidth = max(psim.CalcTextSize(unit)[0] for _, _, unit in rows)
    nameWidth = max(psim.CalcTextSize(name)[0] for name, _, _ in rows)
    column = (right - unitWidth - nameWidth - scaled(GAP)) / 3.0
    for name, numbers, unit in rows:
        psim.Text(name)
        for k, number in enumerate(f"{value:.2f}" for value in numbers):
            end = left + nameWidth + (k + 1) * column
            psim.SameLine(end - psim.CalcTextSize(number)[0])
            psim.Text(number)
        psim.SameLine(left + right - unitWidth)
        psim.Text(unit)
