"""Our run beside a student's, from the same start, and where the two first differ."""

import sys
from contextlib import suppress
from functools import cache

import numpy as np

from Quaternion import Q2RotMatrix
from rbs.glass.mistakes import mistake_in
from rbs.glass.model import in_world_axes
from rbs.glass.trace import TOLERANCE, Difference, first_difference, gap, state_difference
from rbs.stepping.meshes import StateError

TURNED_BACK = "get_rotated_inv_IT gives Rᵀ I⁻¹ R, but R I⁻¹ Rᵀ is right; allowed for"
# The orientation in which a tensor is compared: by an angle of which no small multiple is a circle,
# so that R², Rᵀ and R³ differ.
TURN = np.array([[0.9, 0.1, -0.3, 0.3]])


class Beside:
    """Our simulation of a scene beside a student's, from the same start.

    ours : until the two differ, each of its steps begins with the student's state
    difference : their first `Difference`, or None
    remark : what is allowed for, or ""
    """

    def __init__(self, ours, theirs):
        self.ours, self.difference, self.remark = ours, None, ""
        ours.restore(theirs.state())
        if theirs.submitted.is_turned_back(theirs.meshes):
            self.remark = TURNED_BACK
            for mesh in ours.meshes:
                mesh.__class__ = turned_back(type(mesh))

    def begin(self, theirs):
        """Is called before each step of theirs."""
        self.ours.settings, self.ours.constraints = theirs.settings, theirs.constraints
        if self.difference is None:
            self._start = theirs.state()
            self.ours.set_state(self._start)

    def follow(self, theirs):
        """Makes our step after theirs, and looks for the first difference."""
        self.ours.advance()
        if self.difference is not None:
            return
        names = [mesh.name for mesh in theirs.meshes]
        if state := state_difference(self.ours.meshes, theirs.meshes, names):
            found = self._explain(theirs, theirs.stepCount)
            self.difference = found or Difference(None, None, state=state, step=theirs.stepCount)

    def fail(self, theirs):
        """Looks for the first difference in the step that theirs could not make."""
        if self.difference is None:
            found = self._explain(theirs, theirs.stepCount + 1)
            self.difference = found if found and found.other else None

    def _explain(self, theirs, step):
        """Makes a step of both once more; returns the event in which they first differ, or None."""
        both = []
        with theirs.undone(self._start):  # and ours with it
            theirs.beside = None
            for simulation in (self.ours, theirs):
                simulation.set_state(self._start)
                both.append(events := [])
                with suppress(StateError):
                    simulation.advance(events.append)
            found = first_difference(*both, self.ours.meshes)
        if found is None:
            return None
        hint = mistake_in(found.other, both[1]) if found.symbols else ""
        return found._replace(step=step, hint=hint)


def is_turned_back(inverse, turned):
    """Whether a tensor, in world axes at the orientation TURN, is Rᵀ I⁻¹ R and not R I⁻¹ Rᵀ."""
    R = Q2RotMatrix(TURN)
    right, released = (in_world_axes(R, inverse, isReleased) for isReleased in (False, True))
    return same(turned, released) and not same(turned, right)


def same(value, tensor):
    """Whether a value holds a tensor's numbers, but for rounding."""
    return gap(tensor, value, least=sys.float_info.min) <= TOLERANCE


@cache
def turned_back(Mesh):
    """Returns a subclass of our Mesh whose tensor is turned as the release's."""

    class TurnedBack(Mesh):
        def get_rotated_inv_IT(self):
            return in_world_axes(Q2RotMatrix(self.orientation), self.invIT, True)

    return TurnedBack
