"""Islands: bodies that hang together, by contacts or by constraints."""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components


def islands(links, isFree):
    """The island (n,) of each body, a number from 0.

    links : (2, L), bodies that hang together; n or -1 is the ground
    isFree : (n,) bool; what is not free, and the ground, connects nothing
    """
    count = len(isFree)
    first, second = links[:, np.append(isFree, False)[links].all(axis=0)]
    graph = csr_array((np.ones(len(first)), (first, second)), shape=(count, count))
    return connected_components(graph, directed=False)[1]
