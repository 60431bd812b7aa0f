"""Offsets: how soft bounds hold a load where it is when the length h of the substeps changes.

A load F violates a soft bound by F / (m ω²). As ω is relative to the frequency of the substeps,
that is a length in proportion to h²: with another h, bodies at rest would be thrown back, or drop,
by the difference. That becomes the bound's offset: it acts on violations beyond it, or, where it is
negative, before there are any.
"""

import numpy as np


def ratios(h, substep):
    """h over the lengths of substeps before, (M,); 1 where there have been none, which is 0."""
    isKnown = substep > 0.0
    return np.where(isKnown, h / np.where(isKnown, substep, h), 1.0)


def converted(offset, give, violation, ratio, most):
    """Offsets for substeps that are `ratio` times as long.

    give : by what the bounds have given way to the impulses; violation : by what they are violated.
        In motion these differ, and the smaller one is a load's
    most : of a negative offset: a blow would make it far larger than a load
    """
    give = np.minimum(give, np.maximum(violation - offset, 0.0))
    return np.maximum(offset + (give - ratio * give * ratio), -most)


def lasting(offset, violation):
    """What is left of offsets where bounds are violated by so much, negative where they are apart.

    They end with the load: what is no longer violated has none, and none holds bodies apart.
    """
    held = np.minimum(np.maximum(offset, offset - violation), 0.0)
    return np.where(offset > 0.0, np.minimum(offset, np.maximum(violation, 0.0)), held)
