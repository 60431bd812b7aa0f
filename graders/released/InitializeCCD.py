"""Stand-in for the module that compiles the collision library; nothing needs compiling."""


def initialize_libccd():
    """Does nothing: `cppyy.gbl.isCollide` is ready as soon as the stand-in is imported."""
