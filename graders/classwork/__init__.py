"""Command lines, and what `grade.py` writes for a class."""
