"""This project's Quaternion, for whoever cannot have the project's folder on the path."""

import sys

from projectModules import our_module

sys.modules[__name__] = our_module("Quaternion")
