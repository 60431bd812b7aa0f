"""The state of the soft-step solver: all that one step leaves to the next, beside the bodies.

Without it a step starts cold: it finds every contact anew and begins with no impulses. With it, a
simulation that is saved with its bodies and restored goes on with the same bits.
"""

import numpy as np

from rbs.manifolds import COLUMNS, Manifolds
from rbs.nearpairs import NearPairs
from rbs.sleeping import Sleep


class SolverState:
    """What `run_timestep` takes as solverState, reads, and puts its successor's content into.

    It belongs to a list of bodies, to the end of which others may be added, or from it be removed.

    count : number of bodies; None before the first step
    pairs : `NearPairs`; manifolds : `Manifolds`; sleep : `Sleep`
    constraint : (6, R), what distance constraints there were, see `SoftConstraints`
    constraintImpulse : (R,), of these in the last substep; constraintOffset and constraintSubstep
        (R,), as offset and substep of `Manifolds`
    """

    PARTS = {"pairs": NearPairs, "sleep": Sleep}
    COLUMNS = ("constraint", "constraintImpulse", "constraintOffset", "constraintSubstep")

    def __init__(self):
        self.clear()

    def clear(self):
        """Forgets everything: the next step starts cold."""
        self.count = None
        self.pairs = self.manifolds = self.sleep = None
        self.constraint = np.zeros((6, 0))
        self.constraintImpulse = self.constraintOffset = self.constraintSubstep = np.zeros(0)

    def begun(self, bodies):
        """The state that a step of these bodies begins with: another one, this stays as it is.

        Bodies that have been added are awake, without contacts; what has touched bodies that have
        been removed is awake, too.
        """
        count = len(bodies.invMass)
        state = SolverState()
        state.replace(self)
        if self.count is None:
            state.pairs, state.manifolds = NearPairs.none(count), Manifolds.none()
            state.sleep = Sleep.none(bodies)
        elif self.count != count:
            state.pairs = self.pairs.resized(count)
            state.manifolds, left = self.manifolds.resized(self.count, count)
            state.sleep = self.sleep.resized(bodies, left)
        state.count = count
        return state

    def replace(self, other):
        """Takes over the content of another state. Nobody writes into the arrays of a state."""
        self.__dict__.update(other.__dict__)

    def arrays(self):
        """The content as arrays: dict, {} before the first step. `from_arrays` takes it back."""
        if self.count is None:
            return {}
        found = {name: getattr(self, name) for name in self.COLUMNS}
        for part, kind in self.PARTS.items():
            for name in kind.COLUMNS:
                found[f"{part}.{name}"] = getattr(getattr(self, part), name)
        for name in ("key", *COLUMNS):
            found[f"manifolds.{name}"] = getattr(self.manifolds, name)
        return {name: np.array(value) for name, value in found.items()}

    @classmethod
    def from_arrays(cls, arrays):
        """The `SolverState` that `arrays` was made from."""
        state = cls()
        if arrays:
            arrays = {name: np.array(value) for name, value in arrays.items()}
            for part, kind in cls.PARTS.items():
                columns = {name: arrays[f"{part}.{name}"] for name in kind.COLUMNS}
                setattr(state, part, kind(**columns))
            columns = {name: arrays[f"manifolds.{name}"] for name in COLUMNS}
            state.manifolds = Manifolds(arrays["manifolds.key"], **columns)
            for name in cls.COLUMNS:
                setattr(state, name, arrays[name])
            state.count = len(state.pairs.path)
        return state
