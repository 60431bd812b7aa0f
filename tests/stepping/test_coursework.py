"""The default step calls the coursework's functions, so a student who edits one sees its effect."""

import inspect
from functools import lru_cache

import numpy as np
import pytest
from oracles import DATA, box_body, ground, state_of

import RBSFunctions
from RBSFunctions import Mesh, resolve_collision, run_timestep
from RigidBodySimulation import load_constraint_file, load_scene_file

ways = pytest.mark.parametrize("way", [{}, {"contactScheduling": "batches"}])


def weightless(self, timeStep):
    self.position = self.position + timeStep * self.linVelocity
    self.currVertices = self.origVertices + self.position


def resolve_without_bouncing(m1, m2, depth, contactNormal, penPoint, CRCoeff):
    resolve_collision(m1, m2, depth, contactNormal, penPoint, 0.0)


CHAIN = "tower_chain"
# What a student may have written instead: each with the signature of the coursework, and wrong in a
# way that can be seen in the motion. Arguments have other names, which are not part of it.
REPLACED = {
    "integrate_timestep": (Mesh, weightless, "mixed"),
    "detect_collision": (Mesh, lambda self, m: (False, 0.0, *np.zeros((2, 1, 3))), "mixed"),
    "bounding_box_collision": (Mesh, lambda self, m: False, "mixed"),
    "get_rotated_inv_IT": (Mesh, lambda self: 2.0 * self.invIT, "mixed"),
    "resolve_collision": (RBSFunctions, resolve_without_bouncing, "mixed"),
    "resolve_position_constraint": (RBSFunctions, lambda x, p, ref, w, u, t: (True, x), CHAIN),
    "resolve_velocity_constraint": (RBSFunctions, lambda x, p, v, o, w, i, t: (True, v, o), CHAIN),
}
MODES = {"default": {}, "others": {"broadPhase": "grid", "constraintScheduling": "queue"}}


def end_of(scene, mode):
    """The state of a scene when the bodies have met each other and the ground."""
    meshes = load_scene_file(DATA / f"{scene}-scene.txt")
    rows = load_constraint_file(DATA / f"{CHAIN}-constraints.txt", meshes) if scene == CHAIN else ()
    for _ in range(50 if scene == CHAIN else 90):
        run_timestep(meshes, ground(), 0.02, 0.5, constraints=rows, **MODES[mode])
    return state_of(meshes)


unchanged = lru_cache(end_of)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", REPLACED)
def test_each_function_of_the_coursework_is_called_and_seen_in_the_motion(name, mode, monkeypatch):
    owner, replacement, scene = REPLACED[name]
    original, calls = getattr(owner, name), []

    def passing_on(*arguments):
        assert len(arguments) == len(inspect.signature(replacement).parameters)
        calls.append(1)
        return original(*arguments)

    states = []
    for function in (passing_on, replacement):
        monkeypatch.setattr(owner, name, function)
        states.append(end_of(scene, mode))
    monkeypatch.undo()
    assert len(calls) > 3 and np.array_equal(states[0], unchanged(scene, mode))
    assert np.abs(states[0] - states[1]).max() > 0.01


REFUSED = [
    ([0, 0, 2, 0, 1.0, True], "mesh 2 does not exist"),
    ([-1, 0, 1, 0, 1.0, True], "mesh -1 does not exist"),
    ([0, 8, 1, 0, 1.0, True], "mesh 0 has no vertex 8"),
    ([0, 0, 1, np.nan, 1.0, True], "mesh 1 has no vertex nan"),
    *(([0, 0, 1, 0, value, True], "refValue") for value in (np.nan, np.inf, -1e-9)),
    *(([0, 0, 1, 0, 1.0, value], "upper") for value in (np.nan, -1, 0.5)),
    ([1, 0, 1, 1, 1.0, False], "linked to itself, as 1"),
]


@ways
def test_what_is_not_there_is_refused_by_name(way):
    meshes = [box_body(1.0, 1.0, 1.0, (3.0 * k, 50.0, 0.0)) for k in range(2)]
    before = state_of(meshes)
    for row, said in REFUSED:
        constraints = [[0, 0, 1, 0, 9.0, True], row]
        with pytest.raises(ValueError, match=f"constraint 1: .*{said}"):
            run_timestep(meshes, None, 0.02, 0.5, constraints=constraints, **way)
    with pytest.raises(ValueError, match="mesh 2, 'box', is listed twice"):
        run_timestep([*meshes, meshes[1]], None, 0.02, 0.5, **way)
    assert np.array_equal(state_of(meshes), before)


# Of `run_timestep`, with what is no such thing.
KINDS = {
    "meshes": (3, None, {}, box_body(1, 1, 1, (0, 9, 0))),
    "groundMesh": (3, "ground"),
    "constraints": (3, None, True),
    "functions": (3, np, 0),
    "solverState": (3, ()),
    "observer": (3, "print"),
    r"meshes\[1\]": (3, None),
}


@ways
def test_an_argument_of_another_kind_is_refused_by_name(way):
    meshes = [box_body(1, 1, 1, (0, 9, 0))]
    for name, values in KINDS.items():
        for value in values:
            given = {"meshes": meshes, "groundMesh": None, "timeStep": 0.02, "CRCoeff": 0.5, **way}
            given |= {"meshes": [*meshes, value]} if "1" in name else {name: value}
            with pytest.raises(TypeError, match=f"^{name} must be "):
                run_timestep(**given)


@pytest.mark.parametrize("way", [{"contactScheduling": "batches"}, {"contactSolver": "soft-step"}])
def test_a_step_on_arrays_refuses_a_subclass_by_name(way):
    mesh = box_body(1.0, 1.0, 1.0, (0.0, 9.0, 0.0))
    mesh.__class__ = type("Floating", (Mesh,), {"integrate_timestep": weightless})
    with pytest.raises(ValueError, match="Floating.integrate_timestep would not be called"):
        run_timestep([mesh], None, 0.02, 0.5, **way)
