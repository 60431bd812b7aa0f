"""Recordings of runs, replays, statistics, videos, and runs as files that other programs show.

In reading order:

    outputs     the base of the writers of files, and the table of energies, momenta and contacts
    recording   the HDF5 file: writing and reading
    replay      replaying, resuming and verifying a recording
    encoder     videos, and series of pictures
    lookup      the scenes in data/, those and recordings in a folder, and opening them
    poses       the poses of a run, collected step by step
    gltf        a .glb file, for Blender and other 3-D programs
    page        an .html page that plays the run in a browser
    writers     the writer of each kind of file
"""
