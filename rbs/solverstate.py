"""The state of the soft-step solver: all that one step leaves to the next, beside the bodies.

Without it a step starts cold: it finds every contact anew and begins with no impulses. With it, a
simulation that is saved with its bodies and restored goes on with the same bits.
"""

import numpy as np

from rbs.arrays import indices
from rbs.manifolds import COLUMNS, Manifolds
from rbs.sleeping import Sleep


class SolverState:
    """What `run_timestep` takes as solverState, reads, and puts its successor's content into.

    It belongs to a list of bodies, to the end of which others may be added, or from it be removed.

    count : number of bodies; None before the first step
    manifolds : `Manifolds`; sleep : `Sleep`
    pairKey : (P,), i · (count + 1) + j of the pairs i < j whose boxes were near each other
    pairAxis : (3, P), along which they were found apart, or penetrating; 0 where it is unknown
    constraint : (6, R), what distance constraints there were, see `SoftConstraints`
    constraintImpulse : (R,), of these in the last substep; constraintOffset and constraintSubstep
        (R,), as offset and substep of `Manifolds`
    """

    COLUMNS = (
        "pairKey", "pairAxis", "constraint", "constraintImpulse", "constraintOffset",
        "constraintSubstep",
    )  # fmt: skip

    def __init__(self):
        self.clear()

    def clear(self):
        """Forgets everything: the next step starts cold."""
        self.count = self.manifolds = self.sleep = None
        self.pairKey, self.pairAxis = np.zeros(0, dtype=np.int64), np.zeros((3, 0))
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
            state.manifolds, state.sleep = Manifolds.none(), Sleep.none(bodies)
        elif self.count != count:
            first, second = np.divmod(self.pairKey, self.count + 1)
            left = indices(second < count)
            state.pairKey = first[left] * (count + 1) + second[left]
            state.pairAxis = self.pairAxis[:, left]
            state.manifolds, touched = self.manifolds.resized(self.count, count)
            state.sleep = self.sleep.resized(bodies, touched)
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
        found |= {f"sleep.{name}": getattr(self.sleep, name) for name in Sleep.COLUMNS}
        found |= {f"manifolds.{n}": getattr(self.manifolds, n) for n in ("key", *COLUMNS)}
        return {name: np.array(value) for name, value in found.items()}

    @classmethod
    def from_arrays(cls, arrays):
        """The `SolverState` that `arrays` was made from."""
        state = cls()
        if arrays:
            arrays = {name: np.array(value) for name, value in arrays.items()}
            for name in cls.COLUMNS:
                setattr(state, name, arrays[name])
            state.sleep = Sleep(**{name: arrays[f"sleep.{name}"] for name in Sleep.COLUMNS})
            state.manifolds = Manifolds(**{n: arrays[f"manifolds.{n}"] for n in ("key", *COLUMNS)})
            state.count = len(state.sleep.timer)
        return state
