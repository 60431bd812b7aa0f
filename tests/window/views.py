"""Views that draw nothing, for tests of the viewer, and viewers made as the program makes them."""

import numpy as np

from rbs.recordings.lookup import SceneOpener
from rbs.window.viewer import Viewer


def make_viewer(simulation, view, isBasic=True):
    """A Viewer that opens scenes with or without the settings that they recommend."""
    return Viewer(simulation, view, SceneOpener(isBasic=isBasic))


class StillView:
    """A SceneView that draws nothing and counts calls. A pixel is (body, x): it shows that body x
    metres from its middle, or nothing if body is -1.
    """

    size = 80.0
    showsReport = False

    def __init__(self, simulation):
        self.simulation = simulation
        self.refreshed = self.rebuilt = 0
        self.picked = self.highlight = None

    def refresh(self):
        self.refreshed += 1

    def rebuild(self, simulation):
        self.simulation = simulation
        self.rebuilt += 1

    show_instead = rebuild

    @property
    def picked_mesh(self):
        return None if self.picked is None else self.simulation.meshes[self.picked]

    def rest_point(self, body, point):
        return point

    def world_point(self, body, point):
        return point

    def picked_point(self):
        return np.array([1.0, 2.0, 3.0])

    def body_at(self, pixel):
        body, x = pixel
        if body < 0:
            return None, None
        return body, self.simulation.meshes[body].position[0] + [x, 0.0, 0.0]

    def distance_of(self, point):
        return 100.0

    def point_at(self, pixel, distance):
        return np.array([0.0, 30.0, pixel[1]])

    def aim(self, pixel):
        return np.array([0.0, 20.0, 60.0]), np.array([0.0, 0.0, -1.0])
