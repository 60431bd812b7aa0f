"""What runs in the process of a student's code. It is given inputs, and returns numbers.

`calls` calls what is graded, sample by sample; `steps` makes steps of a scene; `main` is the
process. Nothing here knows a result, nor a formula of the coursework.
"""
