"""Scenes: from files to meshes, and the simulation that steps them.

In reading order:

    messages    errors and lines for the terminal
    files       reading with a size limit, and writing whole files
    textfiles   text files line by line, with errors that name the line
    meshfiles   .mesh and .off files
    scenefiles  scene and constraint files
    state       the state of a scene: poses, velocities, energies, momenta
    simulation  a scene with its settings and its steps
    changes     changes made by hand, and how they are recorded
    grabbing    the spring that drags a body, and the ball that is shot
"""
