"""What a scene looks like, computed without drawing: nothing here needs Polyscope.

In reading order:

    pictureoptions  the options of pictures and videos
    colours         the colours of bodies, constraints and overlays
    drawables       surfaces and lines made of bodies, constraints and the ground
    framing         where a camera has to stand
    skins           normals across rounded edges, and contact shadows
    light           sky light, sunlight, and light from bodies and ground
    gltf            export of a run to 3-D programs
"""
