"""The window: panels, keys and mouse.

In reading order:

    playback   number of steps per frame, and the pace
    viewer     the actions of buttons, keys and mouse
    layout     positions of the panels
    widgets    buttons, fields and tables of a panel
    marks      what is drawn on top of the picture, and the help
    plots      plots of energy, momentum and errors
    glass      the events of a step one by one, with the formula and its numbers
    panel      the window: panels, keys and mouse
"""
