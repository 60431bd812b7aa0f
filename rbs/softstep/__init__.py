"""The soft step: the contact solver with which piles come to rest.

Selected by `contactSolver="soft-step"`. In reading order:

    springs          contact springs and dampers as impulse coefficients
    manifolds        contact manifolds with up to four points per pair
    sleeping         resting bodies that are skipped, and when they wake
    detection        manifolds kept from the last step, and new ones
    contacts         contact impulses, friction and restitution, with their derivation
    softconstraints  distance constraints in the same sweeps
    step             the substeps, and the state carried over to the next step
"""
