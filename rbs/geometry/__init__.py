"""Vectors, convex hulls, and the penetration of two hulls.

GJK.py builds on these modules. Elementwise formulas on arrays of pairs give each pair the same bits
whatever else is in the array. In reading order:

    triples     vectors of three floats, for one pair of bodies
    vectors     the same algebra on arrays of vectors, and indexing of long arrays
    hulls       convex hulls, of one shape and of many bodies
    lowest      lowest vertices along directions, looked up by cells
    facets      depth and normal: the nearest facet of the Minkowski difference
    patches     contact point: the centroid of the contact patch
    broadphase  overlapping bounding boxes, by uniform grids; islands
"""
