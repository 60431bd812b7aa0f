"""Scenes: reading and writing files, and the simulation that steps a scene.

In reading order:

    messages     one-line messages on stderr
    files        writing whole files
    textfiles    text files line by line, with errors that name the line
    meshfiles    .mesh, .off and others, of tetrahedra or of closed surfaces
    scenefiles   scene and constraint files
    state        poses and velocities of a scene, and its energies and momenta
    changes      changes made by hand, and how they are recorded
    simulation   a scene with its settings and its steps
    grabbing     the spring that drags a body, and the ball that is shot
    suggestions  settings that a scene file recommends
"""
