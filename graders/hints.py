"""Which mistakes explain wrong numbers: tried out, and told only if they give those very numbers.

A mistake is tried by computing what a program with it would give (`rigidModel`), for all samples,
alone and together with another one. One that comes out within the graders' error bound of what the
student has computed is a hint; there is no guessing from the size of an error. Mistakes that change
no number, such as a contact point that is not moved along the normal, cannot be noticed.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from gradingTools import ERROR_BOUND, EXACT, RELEASED_2024
from trials import comparable

# Mistakes that are tried together, at most.
MOST_TOGETHER = 2

# What is told where there is no mistake, and the data do not fit all the same.
OTHER_DATA = "these are the numbers of --convention {}, but not those of the data"


@dataclass(frozen=True)
class Mistake:
    """A mistake that students make.

    text : what is told, a whole sentence without a full stop
    names : what `rigidModel` knows it by
    group : of two mistakes in the same group only one can have been made
    """

    text: str
    names: frozenset
    group: str


def mistake(group, text, *names):
    return Mistake(text, frozenset(names), group)


def explain(part, values, data):
    """What explains a part's wrong numbers: dict from quantity to list of hints.

    part : Part with a model; values : dict from quantity to what was computed, NaN where nothing
    A mistake, or two, that explain all of the part's quantities come first. If none do, those that
    explain a single wrong quantity are told for it.
    """
    tried = part.samples(data)
    finite = [key for key in part.shapes if _is_complete(part, key, values, tried)]

    def agree(key, others):
        samples = comparable(part, key, values, others, tried)
        difference = np.asarray(values[key], float) - np.asarray(others[key], float)
        return bool(np.all(np.abs(difference[samples]) < ERROR_BOUND))

    expected = part.expected(data)
    wrong = [key for key in finite if not agree(key, expected)]
    if part.model is None or not wrong:
        return {}
    found = {}
    with np.errstate(all="ignore"):
        for texts, names in _trials(part.mistakes, data["convention"]):
            outcome = part.model(data, names)
            explained = [key for key in finite if agree(key, outcome)]
            if explained == finite:
                return dict.fromkeys(wrong, texts)
            for key in explained:
                if key in wrong:
                    found.setdefault(key, texts)
    return found


def _is_complete(part, key, values, samples):
    """Whether there is a number for every sample for which there must be one."""
    samples = comparable(part, key, values, values, samples)
    return bool(np.isfinite(values[key][samples]).all())


def _trials(mistakes, convention):
    """Yields (texts, names) of no mistake, of one, and of two, in the order of the list."""
    yield [OTHER_DATA.format(convention)], frozenset()
    for count in range(1, MOST_TOGETHER + 1):
        for chosen in itertools.combinations(mistakes, count):
            if len({one.group for one in chosen}) == count:
                texts = [_worded(one.text, convention) for one in chosen]
                yield texts, frozenset().union(*(one.names for one in chosen))


def _worded(text, convention):
    """The text with the names of what differs between the conventions."""
    if convention == EXACT:
        return text.replace("{other}", RELEASED_2024).replace("{too small}", "too small")
    return text.replace("{other}", EXACT).replace("{too small}", "as large as that of the data")


# ---- The mistakes -------------------------------------------------------------------------------

INTEGRATION_MISTAKES = (
    mistake(
        "all",
        "not implemented: integrate_timestep leaves the mesh as it was",
        "velocity left", "position left", "orientation left",
    ),
    mistake("position", "explicit Euler: the position moves with the velocity from before the "
            "step; semi-implicit Euler takes the new one", "explicit Euler"),
    mistake("position", "not implemented: the position stays as it was", "position left"),
    mistake("velocity", "not implemented: gravity; the velocity stays as it was", "velocity left"),
    mistake("velocity", "gravity pulls upwards; it is -9.8 along y", "gravity upwards"),
    mistake("orientation", "not implemented: the orientation stays as it was", "orientation left"),
    mistake("orientation", "the quaternions are multiplied in the wrong order: it must be "
            "exp(ω h/2) ∘ orientation", "quaternion order"),
    mistake("orientation", "the mesh turns twice as far as it should: the exponential takes half "
            "of the angle, ω h/2", "whole angle"),
    mistake("orientation", "the mesh turns backwards", "turned backwards"),
    mistake("orientation", "the orientation is advanced by orientation + h/2 ω ∘ orientation, a "
            "first-order step, in place of the exponential", "first order"),
    mistake("orientation", "the orientation is advanced by orientation + h/2 ω ∘ orientation, a "
            "first-order step, and not normalised", "first order, any length"),
    mistake("orientation", "the quaternion of the rotation has its scalar part last; it comes "
            "first: [0, ω h/2]", "scalar last"),
)  # fmt: skip

FIXED_INTEGRATION_MISTAKES = (
    mistake("fixed", "a fixed mesh falls like a free one: integrate_timestep must leave it where "
            "it is", "fixed is free"),
    *INTEGRATION_MISTAKES,
)  # fmt: skip

# In the exact convention, a tensor like the release's is a mistake; in the released one, a right
# tensor does not fit the data.
TENSOR_MISTAKES = (
    mistake("tensor", "your inertia tensor and the way it is turned are those of --convention "
            "{other}, with whose data this passes",
            "tensor six times", "tensor turned the other way"),
    mistake("tensor", "your inertia tensor is 6 times {too small}, as in --convention {other}",
            "tensor six times"),
    mistake("tensor", "your inverse inertia tensor is turned to world axes the other way round: "
            "R I⁻¹ Rᵀ is right, and the 2024 release has Rᵀ I⁻¹ R",
            "tensor turned the other way"),
    mistake("tensor", "your inverse inertia tensor is not turned to world axes: it must be "
            "R I⁻¹ Rᵀ", "tensor not turned"),
    mistake("tensor", "not implemented: get_rotated_inv_IT gives the identity",
            "tensor is the identity"),
    mistake("tensor", "the inertia tensor itself is used in place of its inverse",
            "tensor not inverted"),
    mistake("tensor", "the COM is not subtracted before the inertia tensor is computed, which is "
            "about the origin of the file's coordinates", "tensor about the origin"),
)  # fmt: skip
_IMPULSES = (
    mistake("denominator", "your impulse leaves out the rotational part: the denominator is "
            "m1⁻¹ + m2⁻¹ + (r1×n)ᵀI1⁻¹(r1×n) + (r2×n)ᵀI2⁻¹(r2×n)", "no rotational term"),
    mistake("angular", "not implemented: the angular velocities stay as they were",
            "angular velocities left"),
    mistake("angular", "the change of the angular velocities has the wrong sign",
            "angular impulse's sign"),
    mistake("impulse", "the impulse has the wrong sign", "impulse's sign"),
    mistake("lost", "mesh 2's corrected linear velocity is lost, as if assigned to a misspelt "
            "attribute", "velocity 2 lost"),
    mistake("lost", "mesh 2's corrected velocities are lost", "velocities 2 lost"),
    mistake("lost", "mesh 1's corrected linear velocity is lost", "velocity 1 lost"),
    mistake("lost", "mesh 1's corrected velocities are lost", "velocities 1 lost"),
    mistake("closing", "the closing speed leaves out the rotation: it is that of the points, "
            "v + ω × r", "closing speed of the COMs"),
)  # fmt: skip
_WEIGHTS = (
    mistake("weights", "both meshes move by half of the correction; each must move in proportion "
            "to its inverse mass", "equal weights"),
    mistake("weights", "the heavier mesh gives way further: the weights of the two meshes are "
            "exchanged", "weights exchanged"),
)  # fmt: skip

RESOLUTION_MISTAKES = (
    mistake("all", "not implemented: resolve_collision leaves both meshes as they were",
            "positions left", "impulse left"),
    mistake("impulse", "not implemented: the impulse; the velocities stay as they were",
            "impulse left"),
    mistake("position", "not implemented: the meshes are not moved apart", "positions left"),
    mistake("position", "the normal has the wrong sign, so that the meshes are pushed further into "
            "each other: mesh 2 moves along it, mesh 1 against it", "pushed together"),
    mistake("restitution", "the restitution is counted twice: (1 + 2 CRCoeff) in place of "
            "(1 + CRCoeff)", "restitution twice"),
    mistake("restitution", "the restitution is counted twice: (1 + CRCoeff)² in place of "
            "(1 + CRCoeff)", "restitution squared"),
    mistake("restitution", "the restitution is left out of the factor (1 + CRCoeff)",
            "restitution left out"),
    mistake("restitution", "the factor is CRCoeff in place of (1 + CRCoeff)", "restitution alone"),
    mistake("closing", "contacts that already separate are left alone; the data give them an "
            "impulse, too", "closing only"),
    *_WEIGHTS,
    *_IMPULSES,
    *TENSOR_MISTAKES,
)  # fmt: skip
DETECTION_MISTAKES = (
    mistake("normal", "the normal has the wrong sign: it is the direction in which the other mesh "
            "moves to separate", "normal's sign"),
    mistake("depth", "the depth has the wrong sign: it is not negative", "depth's sign"),
    mistake("point", "the point is that of the first mesh; it must be the other mesh's, which lies "
            "deepest inside the first", "point of mesh 1"),
    mistake("COM", "the COM is not subtracted from the rest vertices", "COM not subtracted"),
)  # fmt: skip
FIXED_RESOLUTION_MISTAKES = (
    mistake("fixed", "a fixed mesh is moved and pushed like a free one: its inverse mass and "
            "inverse inertia must be zero", "fixed is free"),
    *RESOLUTION_MISTAKES,
)  # fmt: skip
POSITION_CONSTRAINT_MISTAKES = (
    mistake("valid", "not implemented: every position is called valid and left as it was",
            "always valid"),
    mistake("valid", "every position is corrected, valid or not", "never valid"),
    mistake("bound", "the bounds are exchanged: upper is C ≤ tolerance, lower C ≥ -tolerance",
            "bounds exchanged"),
    mistake("flag", "the flag tells that the position was violated, not that it was valid",
            "flag inverted"),
    mistake("shift", "not implemented: the positions stay as they were", "correction left"),
    mistake("shift", "the correction has the wrong sign", "correction's sign"),
    *_WEIGHTS,
    mistake("COM", "the COM is not subtracted from the rest vertices", "COM not subtracted"),
)  # fmt: skip
VELOCITY_CONSTRAINT_MISTAKES = (
    mistake("valid", "not implemented: every velocity is called valid and left as it was",
            "always valid"),
    mistake("flag", "the flag tells that the velocity was violated, not that it was valid",
            "flag inverted"),
    mistake("impulse", "not implemented: the velocities stay as they were", "impulse left"),
    *_IMPULSES,
    *TENSOR_MISTAKES,
    mistake("COM", "the COM is not subtracted from the rest vertices", "COM not subtracted"),
)  # fmt: skip
