"""The graders' data and physics, written apart from the simulation that they judge.

`graderData` reads the data files; `rigidModel` computes every result in plain NumPy, with and
without known mistakes; `referencePhysics` computes them in 50 digits for `make_reference.py`.
"""
