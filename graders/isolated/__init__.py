"""Keeps a student's files and code away from everything else.

`archives` finds and unpacks submissions; `processes` runs them within limits, through `worker`;
`stepComparison` runs in such a process for `compare.py`.
"""
