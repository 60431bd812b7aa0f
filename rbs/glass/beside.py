"""Our run beside a student's, from the same start: its state, and where the two first differ."""

import sys
from functools import cache

import numpy as np

from Quaternion import Q2RotMatrix
from rbs.glass.mistakes import mistake_in
from rbs.glass.model import INERTIA_DIVISOR, in_world_axes
from rbs.glass.trace import TOLERANCE, both, first_difference, gap, state_gaps
from rbs.stepping.meshes import STATE_WIDTHS

# The orientation in which a tensor is compared.
TURN = np.array([[0.5, 0.1, -0.7, 0.5]])


class Beside:
    """Our simulation of a scene, `ours`, which makes a step with each step of a student's.

    difference : lines of the first step's `Difference`; [] so far
    hint : the mistake that explains it, or ""
    """

    def __init__(self, ours, theirs):
        self.ours, self.difference, self.hint = ours, [], ""
        ours.restore(theirs.state())
        take_inertia(ours.meshes, theirs.submitted.inertia_of(theirs))

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
        meshes = zip(self.ours.meshes, theirs.meshes, strict=False)
        pairs = ((own, [getattr(other, name) for name in STATE_WIDTHS]) for own, other in meshes)
        for found, mesh, name, row in state_gaps(pairs):
            if found > TOLERANCE:
                return f"{name} of {mesh.name}{both(getattr(mesh, name), row)}"
        return ""

    def _explain(self, theirs, start):
        """Makes the last step of both again from our state, since theirs may have had other
        rounding; returns where they differ, or [].
        """
        theirs.beside = None
        theirs.set_state(start)
        theirs.advance()
        if not (text := self._gap(theirs)):
            return []
        events = [], []
        for simulation, found in zip((self.ours, theirs), events, strict=True):
            simulation.set_state(start)
            simulation.advance(found.append)
        difference = first_difference(*events, self.ours.meshes)
        if difference is None:
            return [f"the end of run_timestep: {text}"]
        self.hint = mistake_in(difference.other, events[1]) if difference.symbols else ""
        return difference.lines(self.ours.meshes)


def take_inertia(meshes, found):
    """Gives our meshes the skeleton's inertia if a student's have it; returns remarks.

    The skeleton's tensor is six times too small, and its reference solution turns the inverse to
    world axes the wrong way round. Both stand in the supplied code, not in the student's.

    found : of each mesh, the student's invIT, and the tensor in world axes at the orientation TURN
    """
    remarks, R = [], Q2RotMatrix(TURN)
    for mesh, (inverse, turned) in zip(meshes, found, strict=False):
        if mesh.isFixed or not same(inverse, INERTIA_DIVISOR * mesh.invIT):
            continue
        remarks.append("IT is six times too small, as in the released skeleton; allowed for")
        mesh.IT, mesh.invIT = mesh.IT / INERTIA_DIVISOR, mesh.invIT * INERTIA_DIVISOR
        ways = [in_world_axes(R, mesh.invIT, isReleased) for isReleased in (False, True)]
        if same(turned, ways[1]) and not same(turned, ways[0]):
            remarks.append("get_rotated_inv_IT gives Rᵀ I⁻¹ R, but R I⁻¹ Rᵀ is right; allowed for")
            mesh.__class__ = turned_back(type(mesh))
    return list(dict.fromkeys(remarks))


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
