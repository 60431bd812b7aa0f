"""Recordings of runs, replays, statistics, videos, and runs as files that other programs show.

In reading order:

    recording   the HDF5 file: writing and reading
    replay      replaying, resuming and verifying a recording
    statistics  energies, momenta and contacts per step, as a table or a plot
    encoder     video files, written by ffmpeg
    catalogue   a line about each scene in data/
    lookup      scenes and recordings by path or name, and those in a folder
    poses       the poses of a run, collected step by step
    gltf        a .glb file, for Blender and other 3-D programs
    page        an .html page that plays the run in a browser
    formats     the exporter of a file, by its ending
"""
