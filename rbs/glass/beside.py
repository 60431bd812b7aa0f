"""Our run beside a student's, from the same start: its state, and where the two first differ."""

import numpy as np

from rbs.glass.trace import differs, first_difference, shown
from rbs.stepping.meshes import STATE_WIDTHS


class Beside:
    """Our simulation of a scene, which makes a step with each step of a student's.

    ours : SceneSimulation of the same scene, without a student's functions
    restartsEachStep : whether each step of theirs begins with our state
    difference : lines, see `first_difference`, of the first step that differs; [] so far
    """

    def __init__(self, ours, theirs):
        self.ours, self.restartsEachStep, self.difference = ours, False, []
        ours.restore(theirs.state())

    def begin(self, theirs):
        """Prepares a step of theirs, a SceneSimulation: gives it our state if restartsEachStep."""
        if self.restartsEachStep:
            theirs.set_state(self.ours.state())

    def follow(self, theirs):
        """Makes our step after theirs, and looks for the first difference."""
        start = self.ours.state()
        self.ours.settings, self.ours.constraints = theirs.settings, theirs.constraints
        self.ours.advance()
        if not self.difference and self._gap(theirs):
            with theirs.undone():  # and ours with it
                lines = self._explain(theirs, start)
            self.difference = [f"step {theirs.stepCount}", *lines] if lines else []

    def _gap(self, theirs):
        """Returns the first quantity that differs, with its body, as text; "" if none does."""
        for mesh, other in zip(self.ours.meshes, theirs.meshes, strict=False):
            for name in STATE_WIDTHS:
                own, its = (np.ravel(getattr(one, name)) for one in (mesh, other))
                if differs(own, its) and differs(own, -its if name == "orientation" else its):
                    return f"{name} of {mesh.name} is {shown(own)} in ours, {shown(its)} in theirs"
        return ""

    def _explain(self, theirs, start):
        """Makes the last step of both again from our state, since theirs may have had other
        rounding; returns where they differ, or [].
        """
        theirs.beside = None
        theirs.set_state(start)
        theirs.advance()
        if not (gap := self._gap(theirs)):
            return []
        lines = repeated_difference(self.ours, theirs, start)
        return lines or [f"the end of run_timestep: {gap}"]


def repeated_difference(ours, theirs, start, showsAll=False):
    """Makes a step of both simulations from a state; returns `first_difference` of its events."""
    events = [], []
    for simulation, found in zip((ours, theirs), events, strict=True):
        simulation.set_state(start)
        simulation.advance(found.append)
    return first_difference(*events, ours.meshes, showsAll)
