"""This project's Quaternion, for programs without the project's folder on the path."""

import sys

from projectModules import our_module

sys.modules[__name__] = our_module("Quaternion")
