"""Pictures and videos, drawn with Polyscope off-screen or from the window.

In reading order:

    backends        what Polyscope can draw on this machine
    cameras         applying, keeping and writing a camera
    overlays        contacts, impulses, velocities, boxes and trails
    view            bodies, shadows, constraints and overlays as Polyscope structures
    facenumbers     visible faces, from the camera and from the light
    studio          pictures with sky light, soft shadows and rounded edges
    capture         pictures and videos in either look
    pictureprocess  studio pictures drawn by another process
"""
