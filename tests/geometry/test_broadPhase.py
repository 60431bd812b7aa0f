"""The uniform grid finds the same pairs as comparing all boxes."""

import numpy as np
import pytest

from rbs.geometry.broadphase import grid_overlaps

# Per kind of scene: the range of the boxes' sides as powers of ten, and half the width of the
# region that their least corners lie in.
KINDS = {
    "alike": ((0.3, 0.7), 15.0),
    "from 0.1 to 1000": ((-1.0, 3.0), 300.0),
    "crowded": ((0.0, 0.5), 8.0),
    "sparse": ((0.0, 0.3), 40.0),
}


def random_boxes(rng, kind, count):
    """(6, n): least coordinates, and greatest ones negated."""
    (low, high), region = KINDS[kind]
    corner = rng.uniform(-region, region, (3, count))
    return np.concatenate((corner, -(corner + 10 ** rng.uniform(low, high, (3, count)))))


def assert_same_pairs(box):
    """Asserts that the grid finds the same pairs as comparing all, in order; returns how many."""
    low, high, found = box[:3], -box[3:], grid_overlaps(box)
    near = ((low[:, :, None] <= high[:, None]) & (low[:, None] <= high[:, :, None])).all(axis=0)
    assert np.array_equal(np.argwhere(np.triu(near, 1)).T, found)
    assert (found[0] < found[1]).all()
    return found.shape[1]


@pytest.mark.parametrize("kind", KINDS)
def test_grid_finds_the_pairs_that_comparing_all_finds(kind):
    rng = np.random.default_rng(1)
    pairs = [assert_same_pairs(random_boxes(rng, kind, n)) for n in rng.integers(1, 300, 30)]
    assert sum(pairs) > (10 if kind == "sparse" else 1000)


@pytest.mark.parametrize("places", [0, 999_990, -7_000_000], ids=["near", "far", "beyond"])
def test_boxes_that_touch_within_rounding_on_the_borders_of_cells_are_pairs(places):
    """Sides and corners are whole numbers of sides, more or less by one or a few roundings."""
    rng, total = np.random.default_rng(2), 0
    assert grid_overlaps(np.zeros((6, 0))).shape == (2, 0)
    for _ in range(42):
        side = 10.0 ** rng.integers(-6, 7)
        corners = rng.integers(places, places + 5, (3, 80)) * side
        sides = side * rng.choice([1.0, 0.125, 2.0], 80, p=[0.8, 0.1, 0.1])
        low, high = corners, corners + sides
        for _ in range(2):
            low = np.where(rng.random(low.shape) < 0.3, np.nextafter(low, -np.inf), low)
            high = np.where(rng.random(low.shape) < 0.3, np.nextafter(high, -np.inf), high)
            low = low - rng.choice([0.0, 1e-17 * side], low.shape)
        box = np.concatenate((low, -high))
        box[:, 7], box[:, 9] = np.inf, np.nan  # as of a mesh without vertices
        total += assert_same_pairs(box)
    assert total > 10_000
