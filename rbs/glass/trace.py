"""Placeholder of the second module of this package, so that the package has three."""
