"""Broad phase of the loop over pairs: those whose bounding boxes overlap, by a uniform grid."""

from heapq import heappop, heappush

import numpy as np

from rbs.geometry.arrays import indices
from rbs.geometry.broadphase import grid_overlaps

# Margin of a body's reach, as a fraction of the largest side of its box. More makes more pairs that
# do not touch; with less, more bodies leave it and are looked up again.
MARGIN = 0.05


def grid_pairs(meshes):
    """Yields the pairs i < j whose boxes, with margins, overlap when it is their turn, in order.

    Corrections move bodies between two pairs. A body whose box has left its reach, the box with a
    margin, gets a new one, and its later pairs join the queue. Pairs of fixed bodies are left out.
    """
    count, isFixed = len(meshes), np.array([m.isFixed for m in meshes], dtype=bool)
    boxes = [mesh.bounding_box() for mesh in meshes]
    reach = np.array([_reach(box) for box in boxes]).reshape(-1, 6).T
    first, second = grid_overlaps(reach, isFixed)
    queue = (first * count + second).tolist()  # sorted, so it is a heap
    known = set(queue)
    while queue:
        key = heappop(queue)
        pair = divmod(key, count)
        yield pair
        for b in pair:
            box = meshes[b].bounding_box()
            if box is boxes[b] or (_column(box) >= reach[:, b]).all():
                continue
            boxes[b], reach[:, b] = box, _reach(box)
            meets = (reach[:3] <= -reach[3:, b, None]) & (reach[:3, b, None] <= -reach[3:])
            meets = meets.all(axis=0) & ~(isFixed & isFixed[b])
            for other in indices(meets).tolist():
                found = min(b, other) * count + max(b, other)
                if found > key and found not in known and other != b:
                    known.add(found)
                    heappush(queue, found)


def _column(box):
    """A mesh's box as a column for `grid_overlaps`."""
    return np.array((*box[:3], -box[3], -box[4], -box[5]))


def _reach(box):
    margin = MARGIN * max(box[3] - box[0], box[4] - box[1], box[5] - box[2])
    return _column(box) - margin
