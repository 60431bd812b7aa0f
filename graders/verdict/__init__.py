"""Judges one submission.

`parts` calls what is graded, sample by sample; `bodies` makes the meshes of the graded class;
`gradeReport` compares the results with the data; `hints` finds the mistakes that explain them.
"""
