"""Vectors, convex hulls, and how deep two of them overlap.

GJK.py builds on these modules. They work on arrays of pairs with elementwise formulas, so that a
pair gives the same bits whatever else is in the array. In reading order:

    triples     vectors of three floats, for one pair of bodies
    vectors     the same algebra on arrays of vectors
    arrays      indexing of long arrays in few calls
    hulls       convex hulls, of one shape and of many bodies
    facets      depth and normal: the nearest facet of the Minkowski difference
    patches     contact point: the centroid of the contact patch
    broadphase  bounding boxes that overlap, by uniform grids
"""
