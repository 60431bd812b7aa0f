"""Recordings of runs: what a run was, step by step.

In reading order:

    recording   the HDF5 file: writing and reading
    replay      replaying, resuming and verifying
    statistics  energies, momenta and contacts of every step, as a table or a plot
    encoder     video files, written by ffmpeg
"""
