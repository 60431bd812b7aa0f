"""Pictures and videos, drawn with Polyscope off-screen or from the window.

In reading order:

    backends   what Polyscope can draw on this machine
    overlays   constraints, contacts, impulses, velocities, boxes and trails
    viewpoint  the camera: where it looks beside the panels
    view       bodies, shadows and overlays as Polyscope structures
    studio     pictures with sky light, soft shadows and rounded edges
    capture    pictures and videos in either look
    drawing    options of pictures, checked, and starting Polyscope to draw them
"""
