"""The look of a scene, computed without drawing and without Polyscope.

In reading order:

    colours      colours of bodies, constraints and overlays
    drawables    surfaces and lines of bodies, constraints and the ground
    camera       viewpoints that show a whole scene, or from a file; options of pictures
    pixels       marks on top of a picture
    shading      light of the window: bodies lit by sun and sky, soft shadows
    studiolight  light of the studio: lamps of sun, sky and ground
"""
