"""The layout of the window's panels. Nothing here draws.

Two columns at the sides, a strip for the timeline between them, and the picture in the rest.

Units: pixels, at scale 1 where they are constants; from the window's upper left corner.
"""

from typing import NamedTuple

# Width of a column, as a fraction of the window's, and its least and greatest width.
COLUMN_SHARE, LEAST_COLUMN, MOST_COLUMN = 0.25, 260, 420
# Width from which both columns are shown by default, and height from which the settings are.
ROOMY_WIDTH, ROOMY_HEIGHT = 1000, 640
TIMELINE_HEIGHT = 40


class Box(NamedTuple):
    """A rectangle: upper left corner and size."""

    left: int
    top: int
    width: int
    height: int


class Layout(NamedTuple):
    """The Boxes of a window. `side` is None if it is hidden."""

    main: Box
    side: Box | None
    timeline: Box
    picture: Box


def arrange(width, height, hasSide, scale=1.0):
    """Returns the Layout of a window, with or without the right column. scale : of the monitor"""
    column = round(min(max(COLUMN_SHARE * width, scale * LEAST_COLUMN), scale * MOST_COLUMN))
    right = width - column if hasSide else width
    strip = round(scale * TIMELINE_HEIGHT)
    bottom = height - strip
    return Layout(
        main=Box(0, 0, column, height),
        side=Box(right, 0, column, height) if hasSide else None,
        timeline=Box(column, bottom, right - column, strip),
        picture=Box(column, 0, right - column, bottom),
    )
