"""The program: command line, and runs without a window.

In reading order:

    catalogue       one line about each of our scenes
    opening         from names to scenes and recordings
    suggestions     settings that a scene file suggests
    options         the command line
    headless        runs without a window
    notebook         `Simulation` for Python programs and notebooks
    submissions     modules of a student in place of ours
    submittedsteps  steps of a scene by a student's functions
"""
