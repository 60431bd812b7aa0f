"""The look of a scene, computed without drawing and without Polyscope.

In reading order:

    camerafiles     viewpoints saved in the window
    pictureoptions  options of pictures and videos
    colours         colours of bodies, constraints and overlays
    pixels          pictures averaged, laid over each other, and with marks
    drawables       surfaces and lines of bodies, constraints and the ground
    shading         light of the window: bodies lit by sun and sky, soft shadows
    framing         viewpoints from which a scene is fully visible
    skins           normals across rounded edges, and contact shadows
    light           sky light, sunlight, and light from bodies and ground
"""
