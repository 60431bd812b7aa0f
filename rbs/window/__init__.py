"""The window: panels, keys and mouse.

In reading order:

    history  the pace of playing, and the moments that can be gone back to
    outputs  pictures, videos, pages and recordings
    hand     what the user does to bodies
    viewer   time, settings and files: the actions of buttons and keys
    widgets  panels, and their buttons, fields and lists
    marks    what is drawn on top of the picture, and the help
    plots    plots of energy, momentum and errors
    glass    the events of a step one by one, with the formula and its numbers
    panel    the window: panels, keys and mouse
"""
