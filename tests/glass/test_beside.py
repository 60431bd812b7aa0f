"""A student's run beside ours: from the same start, and where the two first differ."""

import numpy as np
import pytest
from oracles import ROOT
from studentVariants import write_submission

from rbs.glass.beside import Beside
from rbs.program.submittedsteps import SubmittedSteps
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.settings import Settings

# A fault of run_timestep itself, which no event shows: the first mesh is not integrated.
LOOP = "    for mesh in meshes:\n        mesh.int"
FORGOTTEN = LOOP, LOOP.replace("meshes:", "meshes[1:]:")
NO_SPIN = "total + np.sum(c1 * (c1 @ invI1.T)) + ", "total + "
EVEN_SHARES = "invMasses[1] / total * push", "0.5 * push"
ARMS = (
    "r1 = contact - m1.position\n    r2 = contact - m2.position",
    "r1 = m1.position - contact\n    r2 = m2.position - contact",
)
UNTURNED = "R @ self.invIT @ R.T", "self.invIT"
LAST_BLOCK = "-n, -np.cross(r2, n)", "-n, np.cross(r2, n)"
HALF_GRAVITY = "timeStep * gravity", "0.5 * timeStep * gravity"


def beside(folder, scene, *edits):
    """A student's simulation of a scene beside ours; edits : (old, new) of the solution."""
    write_submission(folder, edits)
    scene = ROOT / f"data/{scene}-scene.txt"
    theirs = SceneSimulation(scene, submitted=SubmittedSteps(folder))
    theirs.beside = Beside(SceneSimulation(scene, theirs.settings), theirs)
    return theirs


def gap(theirs):
    pairs = zip(theirs.state().values(), theirs.beside.ours.state().values(), strict=True)
    return max(np.abs(a - b).max() for a, b in pairs)


def test_a_right_solution_does_not_differ(tmp_path):
    for scene in ("mixed", "tower_chain"):
        theirs = beside(tmp_path / scene, scene)
        for _ in range(80):
            theirs.step()
        assert theirs.beside.difference == [] and theirs.beside.ours.stepCount == 80
        assert gap(theirs) < 1e-9


FIRST = [
    ("mixed", NO_SPIN, (43, "cylinder 1 and the ground; K"), "leaves out the rotational part"),
    ("mixed", ARMS, (43, "the ground; ω1′"), "the arms point from the contact to the COM"),
    ("mixed", UNTURNED, (43, "the ground; K"), "inertia tensor is not turned to world axes"),
    ("tower_chain", EVEN_SHARES, (27, "box 0 and box 1; COM2′"), "half of the correction"),
    ("tower_chain", LAST_BLOCK, (27, "; ω2′"), "the last block of J has the wrong sign"),
    ("mixed", HALF_GRAVITY, (1, "long-octahedron 0; v′"), "the velocity changes by g h/2"),
    ("mixed", FORGOTTEN, (1, "the end of run_timestep"), None),
]


@pytest.mark.parametrize(("scene", "edit", "first", "hint"), FIRST)
def test_the_first_step_event_and_quantity_are_named(tmp_path, scene, edit, first, hint):
    theirs = beside(tmp_path / "theirs", scene, edit)
    while not theirs.beside.difference and theirs.stepCount < 60:
        theirs.step()
    step, line = theirs.beside.difference[0], "; ".join(theirs.beside.difference[1:])
    assert step == f"step {first[0]}" and first[1] in line and "theirs" in line
    assert hint in theirs.beside.hint if hint else theirs.beside.hint == ""
    assert theirs.beside is not None and theirs.report is None and theirs.stepSeconds is not None


FRICTION = """    slip = m1.linVelocity + np.cross(m1.angVelocity, r1) - m2.linVelocity
    slip = slip - np.cross(m2.angVelocity, r2)
    slip = slip - np.sum(slip * n) * n
    speed = max(np.linalg.norm(slip), 1e-12)
    t = slip / speed
    c1, c2 = np.cross(r1, t), np.cross(r2, t)
    K = total + np.sum(c1 * (c1 @ invI1.T)) + np.sum(c2 * (c2 @ invI2.T))
    f = min(speed / K, mu * max(j, 0.0))
    m1.linVelocity = m1.linVelocity - m1.invMass * f * t
    m2.linVelocity = m2.linVelocity + m2.invMass * f * t
    m1.angVelocity = m1.angVelocity - f * c1 @ invI1.T
    m2.angVelocity = m2.angVelocity + f * c2 @ invI2.T
    m1.update_vertices"""
RUBBED = [
    ("f = min", "f = min", ""),
    ("f = min", "f = -min", "friction has the wrong sign"),
    ("mu * max(j, 0.0)", "1e9", "friction has no limit"),
]


@pytest.mark.parametrize(("old", "new", "hint"), RUBBED)
def test_a_mistake_in_friction_is_named(tmp_path, old, new, hint):
    edits = [(f"{end}):", f"{end}, mu=0.0):") for end in ("penPoint, CRCoeff", "tolerance=0.0")]
    edits += [(f"{end})", f"{end}, mu)") for end in ("normal, point, CRCoeff", "lowest, CRCoeff")]
    write_submission(tmp_path, [*edits, ("    m1.update_vertices", FRICTION.replace(old, new))])
    scene, settings = ROOT / "data/slide-scene.txt", Settings(friction=0.3)
    submitted = SubmittedSteps(tmp_path)
    theirs = SceneSimulation(scene, settings, submitted=submitted)
    theirs.beside = Beside(SceneSimulation(scene, settings), theirs)
    while not theirs.beside.difference and theirs.stepCount < 20:
        theirs.step()
    assert bool(theirs.beside.difference) == bool(hint) and hint in theirs.beside.hint


def test_both_go_back_together(tmp_path):
    theirs = beside(tmp_path / "theirs", "mixed", HALF_GRAVITY)
    start = theirs.state()
    for _ in range(10):
        theirs.step()
    assert gap(theirs) > 0.0
    theirs.restore(start)
    assert gap(theirs) == 0.0 and theirs.beside.ours.stepCount == theirs.stepCount == 0
    theirs.step()
    theirs.reset()
    assert gap(theirs) == 0.0
