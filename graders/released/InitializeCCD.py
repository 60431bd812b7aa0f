"""Stand-in for the module that compiles the collision library: there is nothing to compile."""


def initialize_libccd():
    """Does nothing: `cppyy.gbl.isCollide` is ready as soon as the stand-in is imported."""
