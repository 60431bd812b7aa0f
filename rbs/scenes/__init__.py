"""Scenes: reading and writing files, and the simulation that steps a scene.

In reading order:

    messages      one-line messages on stderr; standard streams
    files         text read line by line, with errors that name it; whole files; signals held
    meshfiles     .mesh, .off and others; closed surfaces, turned outwards and filled
    shapes        bodies: boxes, spheres, cylinders, convex hulls, and those of closed surfaces
    settingtexts  options and labels of settings, and the settings that a scene file suggests
    state         a moment of a run, its energies, and what was done to the bodies since
    scenefiles    scene and constraint files
    scene         a run that can be asked for its states, and what follows it
    simulation    a scene with its settings and its steps; ours beside a student's
"""
