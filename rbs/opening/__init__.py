"""Opening scenes and recordings by name, each scene with the settings that it recommends.

In reading order:

    catalogue    a line about each scene in data/
    lookup       scenes and recordings by path or name, and those in a folder
    suggestions  settings that a scene file recommends
"""
