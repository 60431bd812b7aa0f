"""Recordings of runs, replays, statistics and videos.

In reading order:

    recording   the HDF5 file: writing and reading
    replay      replaying, resuming and verifying a recording
    statistics  energies, momenta and contacts per step, as a table or a plot
    encoder     video files, written by ffmpeg
"""
