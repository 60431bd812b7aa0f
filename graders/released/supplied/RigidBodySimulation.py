"""The loaders of the released driver, without its window."""

from RBSLoadVis import *  # noqa: F403
