"""The window: panels, keys and the mouse.

In reading order:

    playback        how many steps a frame makes
    layout          where the panels lie
    widgets         buttons and fields of a panel
    plots           energies over time
    helppanel       the table of keys and mouse actions
    panel           the panels
    pictureprocess  a studio picture drawn by another process
    viewer          the window, and what buttons, keys and mouse do
"""
