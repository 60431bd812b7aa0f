"""The uniform grid: the same pairs as comparing all boxes, and the same motion to the last bit."""

import subprocess
import sys

import numpy as np
import pytest

import GJK
import RBSFunctions
from RBSFunctions import all_overlaps, grid_overlaps, run_timestep
from RBSRecording import STATE_NAMES
from RigidBodySimulation import DATA_FOLDER, load_scene_file, make_ground

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


def assert_same_pairs(box, isFixed):
    """Both broad phases agree, in order; returns how many pairs they found."""
    expected, found = all_overlaps(box, isFixed), grid_overlaps(box, isFixed)
    assert np.array_equal(expected, found)
    assert (found[0] < found[1]).all()
    return found.shape[1]


@pytest.mark.parametrize("kind", KINDS)
def test_grid_finds_the_pairs_that_comparing_all_finds(kind):
    rng = np.random.default_rng(1)
    pairs = [
        assert_same_pairs(random_boxes(rng, kind, n), rng.random(n) < 0.2)
        for n in rng.integers(1, 300, 60)
    ]
    assert sum(pairs) > (10 if kind == "sparse" else 1000)


def test_boxes_that_only_touch_on_the_borders_of_cells_are_pairs():
    # Unit boxes on whole numbers: each touches its 26 neighbours, on cell borders throughout.
    corner = np.stack(np.meshgrid(*[np.arange(4.0)] * 3)).reshape(3, -1)
    box = np.concatenate((corner, -(corner + 1.0)))
    # Along an axis of 4 there are 4 + 2 · 3 = 10 ordered pairs at a distance of at most 1, of
    # which 4 are of a place with itself: (10³ - 4³) / 2 unordered pairs of boxes.
    assert assert_same_pairs(box, np.zeros(64, bool)) == (10**3 - 4**3) // 2


def test_one_huge_floor_and_bodies_far_away_do_not_fill_the_grid():
    rng = np.random.default_rng(2)
    count = 2000
    box = random_boxes(rng, "alike", count)
    box[:3, 0], box[3:, 0] = (-1e6, -1.0, -1e6), (-1e6, -1.0, -1e6)  # a slab of 2e6 × 2 × 2e6
    box[:3, 1::50] += 1e7
    box[3:, 1::50] -= 1e7
    assert assert_same_pairs(box, np.zeros(count, bool)) > 100


def test_what_has_no_box_is_in_no_pair():
    rng = np.random.default_rng(3)
    box = random_boxes(rng, "crowded", 50)
    box[:, 7] = np.inf  # a mesh without vertices
    box[:, 9] = np.nan
    assert assert_same_pairs(box, np.zeros(50, bool)) > 0
    pairs = grid_overlaps(box, np.zeros(50, bool))
    assert not np.isin((7, 9), pairs).any()
    assert grid_overlaps(np.zeros((6, 0)), np.zeros(0, bool)).shape == (2, 0)


# --------------------------------------------------------------------------------------------------
# Batches of contacts
# --------------------------------------------------------------------------------------------------


def test_batches_keep_the_order_of_pairs_that_share_a_moving_body():
    rng = np.random.default_rng(4)
    isFixed = rng.random(40) < 0.2
    pairs = np.unique(np.sort(rng.integers(0, 40, (400, 2)), axis=1), axis=0)
    pairs = pairs[(pairs[:, 0] < pairs[:, 1]) & ~isFixed[pairs].all(axis=1)]
    batch = RBSFunctions._sequential_batches(*pairs.T.tolist(), isFixed.tolist())
    shared = 0
    for later in range(len(pairs)):
        for earlier in range(later):
            common = set(pairs[earlier]) & set(pairs[later])
            if any(not isFixed[b] for b in common):
                shared += 1
                assert batch[earlier] < batch[later]
    assert shared > 1000 and batch.max() < len(pairs) - 1


def state_of(meshes):
    return [np.array([getattr(m, name)[0] for m in meshes]) for name in STATE_NAMES.values()]


def assert_same_motion(scene, steps, restitution, **options):
    """Steps a scene with both broad phases; returns the number of contacts between bodies."""
    byAll, byGrid = load_scene_file(scene), load_scene_file(scene)
    contacts = 0
    for step in range(steps):
        reports = [
            run_timestep(meshes, make_ground(), 0.02, restitution, broadPhase=name, **options)
            for meshes, name in ((byAll, "all"), (byGrid, "grid"))
        ]
        for one, other in zip(state_of(byAll), state_of(byGrid), strict=True):
            assert np.array_equal(one, other), step
        assert reports[0].contacts == reports[1].contacts
        contacts += sum(contact.body2 >= 0 for contact in reports[0].contacts)
    return contacts


@pytest.mark.parametrize("name", ["mixed", "tower", "stress", "tet", "wrecking_ball"])
@pytest.mark.parametrize("options", [{}, {"mu": 0.4, "closingOnly": True}], ids=["", "friction"])
def test_grid_gives_the_same_bits(name, options):
    contacts = assert_same_motion(DATA_FOLDER / f"{name}-scene.txt", 170, 0.5, **options)
    assert contacts > 10


def test_grid_gives_the_same_bits_in_a_pile_of_all_shapes(tmp_path):
    scene = pile(60, "--shapes", "box", "tetrahedron", "octahedron", "long-octahedron", "cylinder",
                 "ellipsoid", "--seed", "3")  # fmt: skip
    path = tmp_path / "pile-scene.txt"
    path.write_text(scene.replace("\n", f"\n{DATA_FOLDER}/", 60))
    meshes = load_scene_file(path)
    assert len({m.name.split()[0] for m in meshes}) == 6
    assert assert_same_motion(path, 260, 0.0) > 300


def test_a_body_that_strays_beyond_its_reach_is_not_overlooked(monkeypatch):
    """With next to no reach, some steps' collisions have to be done again."""
    attempts = []
    original = RBSFunctions._ContactBatches.__init__

    def counted(self, *arguments):
        attempts.append(arguments)
        original(self, *arguments)

    monkeypatch.setattr(RBSFunctions, "LEAST_REACH", 1e-9)
    monkeypatch.setattr(RBSFunctions, "REACH_GROWTH", 1.001)
    monkeypatch.setattr(RBSFunctions._ContactBatches, "__init__", counted)
    assert assert_same_motion(DATA_FOLDER / "mixed-scene.txt", 150, 0.5) > 10
    assert len(attempts) > 150  # steps


def test_what_is_remembered_changes_no_bit(monkeypatch):
    """A scene that forgets everything after each step moves as one that remembers."""
    remembering = load_scene_file(DATA_FOLDER / "stress-scene.txt")
    forgetting = load_scene_file(DATA_FOLDER / "stress-scene.txt")
    recalled = []
    original = GJK.contact_planes

    def watched(hulls, first, second, t, reach, guess=None, likely=None):
        recalled.append(0 if likely is None else int(likely.sum()))
        return original(hulls, first, second, t, reach, guess, likely)

    monkeypatch.setattr(GJK, "contact_planes", watched)
    for _ in range(200):
        run_timestep(remembering, make_ground(), 0.02, 0.5, broadPhase="grid")
        RBSFunctions._shapes.cache_clear()
        run_timestep(forgetting, make_ground(), 0.02, 0.5, broadPhase="grid")
        for one, other in zip(state_of(remembering), state_of(forgetting), strict=True):
            assert np.array_equal(one, other)


def pile(*arguments):
    """Standard output of data/make_pile.py."""
    command = [sys.executable, DATA_FOLDER / "make_pile.py", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_piles_are_made_as_asked():
    assert pile(200) == (DATA_FOLDER / "pile_200-scene.txt").read_text()
    assert pile(1000) == (DATA_FOLDER / "pile_1000-scene.txt").read_text()
    assert pile(30, "--seed", 5) != pile(30, "--seed", 6)
    layer = [line.split() for line in pile(30, "--spread", "--shapes", "box").splitlines()[1:]]
    assert len(layer) == 30 and {row[0] for row in layer} == {"box.mesh"}
    heights = [float(row[4]) for row in layer]
    assert max(heights) - min(heights) <= 1.0  # one layer, jittered by half a metre up and down
