"""Runs as files that other programs show.

In reading order:

    poses    the poses of a run, collected step by step
    gltf     a .glb file, for Blender and other 3-D programs
    page     an .html page that plays the run in a browser
    formats  the exporter of a file, by its ending
"""
