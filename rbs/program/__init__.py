"""The program: command line, and runs without a window.

In reading order:

    submissions      loading a student's modules
    returned         what a student's functions must return
    parsing          a parser, and types of values
    headless         runs without a window, and their summary
    results          pictures, videos, pages and statistics from Python
    options          the options of the command line
    pythoninterface  `Simulation` for Python programs and notebooks
    submittedsteps   time steps by a student's functions
    stubs            types for the modules at the top, when a wheel is built
"""
