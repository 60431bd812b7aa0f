"""Scenes: reading and writing files, and the simulation that steps a scene.

In reading order:

    messages     one-line messages on stderr
    files        text read line by line, with errors that name it; whole files written; signals held
    surfaces     closed surfaces of triangles: turned outwards, and filled with tetrahedra
    shapes       bodies: boxes, spheres, cylinders, convex hulls, and those of closed surfaces
    meshfiles    .mesh, .off and others, of tetrahedra or of closed surfaces
    state        a moment of a run, its energies, and what was done to the bodies since
    scenefiles   scene and constraint files
    scene        a run that can be asked for its states, and what follows it
    simulation   a scene with its settings, also those that its file suggests, and its steps
"""
