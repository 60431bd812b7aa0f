"""Scenes: reading and writing files, and the simulation that steps a scene.

In reading order:

    messages     one-line messages on stderr
    files        writing whole files
    textfiles    text files line by line, with errors that name the line
    meshfiles    .mesh, .off and others, of tetrahedra or of closed surfaces
    scenefiles   scene and constraint files
    signals      Ctrl-C and kill, held back while a file is written
    state        a moment of a run to go back to
    energies     energies and momenta of a state
    scene        a run that can be asked for its states, and what follows it
    changes      what was done to the bodies between two steps
    simulation   a scene with its settings and its steps
    grabbing     the spring that drags a body, and the ball that is shot
    suggestions  settings that a scene file recommends
"""
