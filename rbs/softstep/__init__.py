"""The soft step: the contact solver in which piles come to rest.

Selected by `contactSolver="soft-step"`. In reading order:

    springs          contact springs and dampers as impulse coefficients
    manifolds        contact manifolds of up to four points a pair
    sleeping         islands of bodies that rest are put to sleep, and woken
    detection        manifolds kept from the step before, and new ones
    contacts         contact impulses with friction and restitution, and their derivation
    softconstraints  distance constraints in the same sweeps
    step             the step in substeps, and the state that it leaves to the next
"""
