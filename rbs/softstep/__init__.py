"""The soft step: the contact solver with which piles come to rest.

Selected by `contactSolver="soft-step"`. In reading order:

    manifolds        contact manifolds with up to four points per pair, and their report
    supports         planes along which bodies meet what is flush with their support
    detection        manifolds kept from the last step, and new ones
    rows             contacts as rows of velocity constraints, with their derivation
    energies         a bound on the energy that contacts give
    contacts         contact impulses: springs, relaxation, and blows
    softconstraints  all distance constraints, solved together
    sleeping         resting bodies that are skipped, and when they wake
    step             the substeps, and the state carried over to the next step
"""
