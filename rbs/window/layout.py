"""The window's layout: where the panels lie, whatever the window's size. Nothing here draws.

Two columns at the window's sides, from top to bottom, and a strip for the timeline between them.
The picture has what is left.

Units: pixels, from the window's upper left corner.
"""

from typing import NamedTuple

# The part of the window's width that a column has, and its least and greatest width.
COLUMN_SHARE, LEAST_COLUMN, MOST_COLUMN = 0.25, 260, 420
# From this width on there is room for both columns without being asked.
ROOMY_WIDTH = 1000
# From this height on there is room for the settings without being asked.
ROOMY_HEIGHT = 640
TIMELINE_HEIGHT = 70


class Box(NamedTuple):
    """A rectangle: its upper left corner and its size."""

    left: int
    top: int
    width: int
    height: int


class Layout(NamedTuple):
    """Where things lie, each a Box; `side` and `timeline` are None where they are not shown."""

    main: Box
    side: Box | None
    timeline: Box | None
    picture: Box

    def margins(self, width, height):
        """What the panels take of a window: pixels at the left, top, right and bottom."""
        left, top, wide, high = self.picture
        return left, top, width - left - wide, height - top - high


def arrange(width, height, hasSide, hasTimeline):
    """The Layout of a window of this size.

    hasSide : whether the right column is shown; hasTimeline : whether the timeline is
    """
    column = round(min(max(COLUMN_SHARE * width, LEAST_COLUMN), MOST_COLUMN))
    right = width - column if hasSide else width
    bottom = height - TIMELINE_HEIGHT if hasTimeline else height
    return Layout(
        main=Box(0, 0, column, height),
        side=Box(right, 0, column, height) if hasSide else None,
        timeline=Box(column, bottom, right - column, TIMELINE_HEIGHT) if hasTimeline else None,
        picture=Box(column, 0, right - column, bottom),
    )
