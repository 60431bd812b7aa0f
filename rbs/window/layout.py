"""The layout of the window's panels. Nothing here draws.

Two columns at the sides, a strip for the timeline between them, and the picture in the rest.

Units: pixels, from the window's upper left corner.
"""

from typing import NamedTuple

# Width of a column, as a fraction of the window's, and its least and greatest width.
COLUMN_SHARE, LEAST_COLUMN, MOST_COLUMN = 0.25, 260, 420
# Width from which both columns are shown by default.
ROOMY_WIDTH = 1000
# Height from which the settings are shown by default.
ROOMY_HEIGHT = 640
TIMELINE_HEIGHT = 70


class Box(NamedTuple):
    """A rectangle: upper left corner and size."""

    left: int
    top: int
    width: int
    height: int


class Layout(NamedTuple):
    """The Boxes of a window. `side` and `timeline` are None if they are hidden."""

    main: Box
    side: Box | None
    timeline: Box | None
    picture: Box

    def margins(self, width, height):
        """Returns the margins around the picture: left, top, right, bottom."""
        left, top, wide, high = self.picture
        return left, top, width - left - wide, height - top - high


def arrange(width, height, hasSide, hasTimeline):
    """Returns the Layout of a window, with or without the right column and the timeline."""
    column = round(min(max(COLUMN_SHARE * width, LEAST_COLUMN), MOST_COLUMN))
    right = width - column if hasSide else width
    bottom = height - TIMELINE_HEIGHT if hasTimeline else height
    return Layout(
        main=Box(0, 0, column, height),
        side=Box(right, 0, column, height) if hasSide else None,
        timeline=Box(column, bottom, right - column, TIMELINE_HEIGHT) if hasTimeline else None,
        picture=Box(column, 0, right - column, bottom),
    )
