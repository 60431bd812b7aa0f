"""Widgets of the window's panels: tooltips, fields that clamp, lists, numbers in columns.

Polyscope is imported inside the functions that use it.
"""

# RGB and opacity.
ERROR_TEXT = (1.0, 0.45, 0.40, 1.0)
# Of a list with a line beside each name, in pixels: where the lines begin, and how wide it is.
LINE_INDENT, LIST_WIDTH, LIST_HEIGHT = 140, 560, 460
# The width of a number in a table, in pixels.
NUMBER_WIDTH = 64


class Tooltips:
    """Says what the last widget is for while the mouse rests on it, unless `areHidden`.

    They are hidden while a message is shown, which they could cover.
    """

    areHidden = False

    @classmethod
    def tell(cls, text):
        """To be called right after a widget."""
        import polyscope.imgui as psim

        if text and not cls.areHidden:
            psim.SetItemTooltip(text)


class NumberField:
    """A number to be typed into the panel. It takes effect with Enter, or on leaving the field.

    What lies outside of its bounds becomes the nearer bound.
    """

    def __init__(self, label, name, step, low, high, tooltip):
        """name : of a field of the settings; step : what the buttons + and - change it by"""
        self._label, self._name, self._step = label, name, step
        self._low, self._high, self._tooltip = low, high, tooltip
        self._typed = None

    def draw(self, settings):
        """Draws the field; what is no number changes nothing."""
        import polyscope.imgui as psim

        value = getattr(settings, self._name)
        changed, value = psim.InputDouble(self._label, value, self._step, 0.0, "%.4g")
        Tooltips.tell(self._tooltip)
        if changed:
            self._typed = value
        if psim.IsItemDeactivatedAfterEdit() and self._typed is not None:
            if self._typed == self._typed:  # else it is not a number
                settings.change(self._name, min(max(self._typed, self._low), self._high))
            self._typed = None


def draw_choice(label, current, names, tooltip=""):
    """A list to choose one name from; returns the chosen one, or None where nothing was.

    names : list of names, or of (group, name, line): then there are headings, and a line each; or
    a function that gives such a list, when the list is open
    """
    import polyscope.imgui as psim

    if callable(names):
        psim.SetNextWindowSizeConstraints((LIST_WIDTH, 0), (LIST_WIDTH, LIST_HEIGHT))
    isOpen = psim.BeginCombo(label, current, psim.ImGuiComboFlags_HeightLargest)
    if not isOpen:
        Tooltips.tell(tooltip)
        return None
    chosen, lastGroup = None, None
    names = names() if callable(names) else names
    rows = [name if isinstance(name, tuple) else (None, name, "") for name in names]
    for group, name, line in rows:
        if group != lastGroup:
            psim.SeparatorText(group)
            lastGroup = group
        if psim.Selectable(name, selected=name == current):
            chosen = name
        if line:
            psim.SameLine(LINE_INDENT)
            psim.TextDisabled(line)
    if psim.IsKeyPressed(psim.ImGuiKey_Escape, False):
        psim.CloseCurrentPopup()
    psim.EndCombo()
    return chosen


def draw_slider(label, value, low, high, shown="%.3f"):
    """A slider for a float or an int; returns (whether it was moved, the value as it is shown)."""
    import polyscope.imgui as psim

    clamp = psim.ImGuiSliderFlags_AlwaysClamp  # also what is typed in with Ctrl-click
    if isinstance(value, int):
        return psim.SliderInt(label, value, low, high, "%d", clamp)
    isMoved, moved = psim.SliderFloat(label, value, low, high, shown, clamp)
    return isMoved, round(moved, 3) if isMoved else value


def draw_error(message):
    """A message that nobody overlooks."""
    import polyscope.imgui as psim

    psim.PushStyleColor(psim.ImGuiCol_Text, ERROR_TEXT)
    psim.TextWrapped(message)
    psim.PopStyleColor()


def draw_table(rows, indent=0):
    """Rows (number, what it is), the numbers flush right; indent : pixels, of all but the first."""
    import polyscope.imgui as psim

    left = psim.GetCursorPosX()
    for place, (number, text) in enumerate(rows):
        end = left + NUMBER_WIDTH + (indent if place else 0)
        psim.SetCursorPosX(end - psim.CalcTextSize(number)[0])
        psim.Text(number)
        psim.SameLine(end + 8)
        psim.Text(text)


def draw_vectors(rows):
    """Rows (name, three numbers, unit), in columns; the numbers are texts, and flush right."""
    import polyscope.imgui as psim

    left, right = psim.GetCursorPosX(), psim.GetContentRegionAvail()[0]
    unitWidth = max(psim.CalcTextSize(unit)[0] for _, _, unit in rows)
    nameWidth = max(psim.CalcTextSize(name)[0] for name, _, _ in rows)
    column = (right - unitWidth - nameWidth - 8) / 3.0
    for name, numbers, unit in rows:
        psim.Text(name)
        for k, number in enumerate(numbers):
            end = left + nameWidth + (k + 1) * column
            psim.SameLine(end - psim.CalcTextSize(number)[0])
            psim.Text(number)
        psim.SameLine(left + right - unitWidth)
        psim.Text(unit)
