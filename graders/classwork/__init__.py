"""Command lines, and what `grade.py` writes for a class.

`graderProgram` is the command line that the graders share; `marks`, `sheets` and `likeness` write
marks, tables and feedback.
"""
