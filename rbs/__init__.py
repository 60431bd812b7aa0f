"""Rigid-body simulation: the rooms behind the modules at the top level."""

__version__ = "0.1.0"
