"""Distance constraints of the soft step: joints and short bars, and bodies that are removed."""

import experiments as laws
import numpy as np
import pytest
from oracles import box_body, quaternion, rotation, state_of

from rbs.softstep.step import SolverState
from RBSFunctions import run_timestep


def hung(count, length):
    """`(meshes, constraints)` of rods that hang by their corners from a fixed cube, at 60°."""
    turn = quaternion((0, 0, 1), 60)
    way = rotation(turn).apply((0, -1, 0))
    meshes, constraints = [box_body(0.2, 0.2, 0.2, (0, 0, 0), isFixed=True)], []
    low, high = (int((meshes[0].origVertices @ (1, s, 3)).argmax()) for s in (-2, 2))
    for k in range(count):
        mesh = box_body(0.1, 1.0, 0.1, (0, 0, 0), orientation=turn)
        mesh.position = (meshes[k].currVertices[low] + length * way - mesh.currVertices[high])[None]
        constraints += [[k, low, k + 1, high, length, isUpper] for isUpper in (True, False)]
        meshes.append(mesh)
    return meshes, constraints


def tied_at_both_ends():
    """`(meshes, constraints)` of a box, 1 m long, with two corners on fixed ones; it swings."""
    mesh = box_body(1.0, 0.1, 0.1, (0, 0, 0), orientation=quaternion((0, 0, 1), 20))
    meshes, constraints = [mesh], []
    for k, side in enumerate((-1, 1), 1):
        own = (mesh.origVertices @ (side, -2, 3)).argmax()
        place = mesh.currVertices[own] + 0.1
        meshes.append(box_body(0.2, 0.2, 0.2, place, isFixed=True))
        other = np.linalg.norm(meshes[k].currVertices - mesh.currVertices[own], axis=1).argmin()
        constraints += [[0, own, k, other, 0.0, isUpper] for isUpper in (True, False)]
    return meshes, constraints


# Rods and their distances, or a box on two joints; how much of its largest kinetic energy may be
# missing, or added, within 3 s; and whether it tumbles.
HUNG = [((1, 0.0), 0.01, False), ((5, 0.0), 0.01, False), ((2, 0.0), 0.01, True)]
HUNG += [((1, 0.001), 0.01, False), ((2, 0.0001), 0.01, False), ((1, 0.1), 0.01, False)]
HUNG += [((2, 0.1), 0.02, False), (None, 0.03, False)]


@pytest.mark.parametrize("rods, within, isGyroscopic", HUNG)
def test_rods_on_joints_and_short_bars_keep_their_energy(rods, within, isGyroscopic):
    meshes, constraints = hung(*rods) if rods else tied_at_both_ends()
    before = laws.energy(meshes)
    settings = laws.HANGING | {"constraints": constraints, "linkedBodiesCollide": False}
    settings["gyroscopic"] = isGyroscopic
    settings["watch"] = lambda: (laws.energy(meshes), laws.kinetic(meshes))
    _, track = laws.run("soft step", meshes, 3.0, **settings)
    assert abs(track[:, 0] - before).max() < within * track[:, 1].max()
    for a, i, b, j, length, _ in constraints:
        apart = np.linalg.norm(meshes[a].currVertices[i] - meshes[b].currVertices[j])
        assert apart == pytest.approx(length, abs=5e-4)


class Chain:
    """A chain of six with an end of 1000 times their mass, let go at 60°, among other bodies."""

    def __init__(self, before, after):
        self.links, constraints = laws.beads(6, 1000.0, 60.0)
        self.others = [box_body(1, 1, 1, (50.0 + 3 * k, 0, 0)) for k in range(before + after)]
        self.meshes = [*self.others[:before], *self.links, *self.others[before:]]
        self.constraints = [[a + before, i, b + before, *end] for a, i, b, *end in constraints]
        self.state = SolverState()

    def remove(self, mesh):
        gone = next(k for k, other in enumerate(self.meshes) if other is mesh)
        self.state.remove(gone)
        del self.meshes[gone]
        rows = [row for row in self.constraints if gone not in (row[0], row[2])]
        self.constraints = [[a - (a > gone), i, b - (b > gone), *end] for a, i, b, *end in rows]

    def run(self, steps):
        settings = {"constraints": self.constraints, "linkedBodiesCollide": False}
        settings |= {"contactSolver": "soft-step", "solverState": self.state, "mu": 0.5}
        for _ in range(steps):
            run_timestep(self.meshes, None, 0.02, 0.0, **settings)
        return self


@pytest.mark.parametrize("gone", [(0,), (5,), (4, 0, 1), (3, 2, 5)])
def test_a_chain_swings_on_bit_for_bit_while_other_bodies_are_removed(gone):
    chain = Chain(3, 3).run(20)
    for k in gone:
        chain.remove(chain.others[k])
    same = Chain(3, 3).run(20)
    given = [chain.state.constraintImpulse, same.state.constraintImpulse]
    assert np.array_equal(*given) and given[0].any()
    assert np.array_equal(state_of(chain.run(20).links), state_of(same.run(20).links))


def test_a_link_that_is_removed_takes_only_its_own_constraints_along():
    """What hangs below falls freely; what is left above swings on, as if the link were untied."""
    chain, untied = Chain(1, 0).run(20), Chain(1, 0).run(20)
    upper, lower = chain.links[1:3], chain.links[4:]
    mass = np.array([[mesh.mass] for mesh in lower])
    place, speed = (
        (mass * [getattr(m, name)[0] for m in lower]).sum(axis=0) / mass.sum()
        for name in ("position", "linVelocity")
    )
    chain.remove(chain.links[3])
    untied.constraints = [row for row in untied.constraints if 4 not in (row[0], row[2])]
    chain.run(10), untied.run(10)
    substep, count = 0.02 / 6, 60
    fall = -laws.G * substep**2 * count * (count + 1) / 2
    centre = (mass * [m.position[0] for m in lower]).sum(axis=0) / mass.sum()
    assert centre == pytest.approx(place + 0.2 * speed + [0, fall, 0], abs=1e-5)
    assert state_of(upper) == pytest.approx(state_of(untied.links[1:3]), abs=1e-9)


@pytest.mark.parametrize("isNoted", [True, False])
def test_what_sleeps_on_ropes_falls_when_its_anchor_is_removed(isNoted):
    """The anchor is fixed or, as the last of the list, also removed without a word."""
    meshes = [box_body(1, 1, 1, (0, 0, 0)), box_body(1, 1, 1, (0, 3, 0), isFixed=True)]
    high = np.flatnonzero(meshes[0].origVertices[:, 1] > 0)
    ends = [
        np.abs(meshes[1].origVertices - (x, -y, z)).sum(axis=1)
        for x, y, z in meshes[0].origVertices[high]
    ]
    ropes = [[0, i, 1, d.argmin(), 2.0, True] for i, d in zip(high, ends, strict=True)]
    state = SolverState()
    settings = {"contactSolver": "soft-step", "solverState": state, "mu": 0.5}
    for _ in range(100):
        run_timestep(meshes, None, 0.02, 0.0, constraints=ropes, **settings)
    assert state.sleep.isAsleep[0]
    if isNoted:
        state.remove(1)
    run_timestep(meshes[:1], None, 0.02, 0.0, constraints=[], **settings)
    assert meshes[0].linVelocity[0, 1] == pytest.approx(-0.02 * laws.G)
