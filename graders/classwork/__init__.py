"""Command lines, and what `grade.py` writes for a class.

`graderProgram` is the command line that the graders share; `marks` and `sheets` write marks, tables
and feedback; `origins` looks at a submission's source.
"""
