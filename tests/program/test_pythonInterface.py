"""Simulations from Python: from meshes, restored, recorded, drawn."""

import base64
import io
import pickle
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from opengl import require_opengl
from oracles import ROOT, box_body
from PIL import Image
from program import bits, call, python

from rbs.recordings.recording import Recording
from rbs.recordings.replay import verify
from rbs.scenes.scene import Writer
from RBSFunctions import Mesh
from RigidBodySimulation import Settings, Simulation

CONSTRAINTS = [[0, 0, 1, 0, 3.0, True], [0, 0, 1, 0, 1.0, False]]
# Of a box of 2 × 4 × 6 m and 96 kg.
BOX_INERTIA = 96.0 / 12.0 * np.array([4**2 + 6**2, 2**2 + 6**2, 2**2 + 4**2])


def boxes():
    """Three tilted boxes over each other, the first of which moves."""
    places = [((0.2 * k, 2 + 1.7 * k, 0), (1, 0.1 * k, 0.2, 0.05 * k)) for k in range(3)]
    meshes = [box_body(2, 1, 2, place, orientation=turn) for place, turn in places]
    meshes[0].linVelocity = np.array([[0.3, 0.1, -0.2]])
    return meshes


bothSolvers = pytest.mark.parametrize("solver", ["impulse", "soft-step"])


@bothSolvers
def test_a_recording_of_meshes_is_replayed_and_verified(solver, tmp_path):
    meshes = boxes()
    settings = Settings(contactSolver=solver, gravity=1.62)
    simulation = Simulation.from_meshes(meshes, CONSTRAINTS, settings, name="three")
    with simulation.record(tmp_path / "three.h5"):
        table = simulation.stats(20)
        simulation.run(30)
    assert meshes[0].position[0, 1] == 2.0  # the simulation has copies
    simulation.run(5)  # not recorded any more
    assert table["step"].tolist() == list(range(21)) and table["contacts"].dtype == float
    assert verify(Recording(tmp_path / "three.h5")) == ""
    opened = Simulation.open(tmp_path / "three.h5")
    np.testing.assert_array_equal(opened.stats()["kineticEnergy"][:21], table["kineticEnergy"])
    opened.seek(50)
    assert opened.settings.gravity == 1.62 and opened.constraints == CONSTRAINTS
    expected = sum(1.62 * mesh.mass * mesh.position[0, 1] for mesh in opened.meshes)
    assert opened.potential_energy() == pytest.approx(expected)


@bothSolvers
def test_what_is_done_by_hand_is_recorded_verified_and_restored(solver, tmp_path):
    settings = Settings(contactSolver=solver, friction=0.5)
    simulation = Simulation.from_meshes(boxes(), CONSTRAINTS, settings)
    late = Mesh.sphere(0.5, 2.0, (4, 2, 0), "late", orientation=(1, 0.2, 0, 0))
    late.angVelocity = np.array([[0, 0, 3.0]])
    with simulation.record(tmp_path / "run.h5"):
        simulation.run(5).push(1, (9.0, 0, 0))
        simulation.push(simulation.meshes[2], (0, 0, 5.0), simulation.meshes[2].currVertices[0])
        simulation.run(15).set_force(2, (40.0, 0.0, 0.0), (0.0, 9.0, 0.0))
        added = simulation.add(late)
        assert added is simulation.meshes[3] is not late and added.angVelocity[0, 2] == 3.0
        middle = simulation.run(10).meshes[1].currVertices[:4].mean(axis=0)
        simulation.constrain(added, added.position, 1, middle, lower=0.0)
        rows = [list(row) for row in simulation.constraints]
        assert len(rows) == 4 and rows[2][4:] == [0.0, False]
        simulation.run(5).fix(added)
        simulation.fix(3, False)
        state = simulation.run(5).state()
        first = simulation.meshes[0]
        simulation.remove(first)  # and the constraints of the file
        rows = [[one[0] - 1, one[1], one[2] - 1, *one[3:]] for one in rows[2:]]
        assert first not in simulation.meshes and simulation.constraints == rows
        simulation.run(20).move(0, (5, 2, 5))
        simulation.run(10).remove(added)
        assert simulation.constraints == [] and len(simulation.meshes) == 2
        end = simulation.run(20).state()
    assert verify(Recording(tmp_path / "run.h5")) == ""
    opened = Simulation.open(tmp_path / "run.h5")
    for step, count, ties in ((90, 2, 0), (65, 3, 2), (5, 3, 2), (35, 4, 4), (90, 2, 0)):
        opened.seek(step)
        assert (len(opened.meshes), len(opened.constraints)) == (count, ties)
    for kind in ("velocity", "force"):  # a push, and the force
        changed = Recording(tmp_path / "run.h5")
        kinds = [one.kind for _, one in changed.changes]
        changed.changes.pop(kinds.index(kind))
        assert " differs: " in verify(changed)
    # back to what has been removed, and forth again with the same bits
    simulation.restore(pickle.loads(pickle.dumps(state)))
    assert simulation.meshes[0] is first and simulation.meshes[3].name == late.name
    simulation.remove(0)
    simulation.run(20).move(0, (5, 2, 5))
    simulation.run(10).remove(2)
    assert bits(end) == bits(simulation.run(20).state())
    simulation.reset()
    assert len(simulation.meshes) == 3 and simulation.constraints == CONSTRAINTS
    assert simulation.meshes[2].load is None and len(simulation.meshes[1].origVertices) == 8


def test_others_sleep_on_if_a_body_is_removed():
    places = [(x, 0.5 + k, 0) for x in (0, 5) for k in range(3)]
    meshes = [Mesh.box((1, 1, 1), 100.0, place) for place in places]
    settings = Settings(contactSolver="soft-step", friction=0.5, restitution=0.0)
    simulation = Simulation.from_meshes(meshes, settings=settings).run(60)
    assert simulation.report.isAsleep.all()
    before = simulation.state()["positions"]
    simulation.remove(1)
    assert simulation.run(1).report.isAsleep.tolist() == [False, False, True, True, True]
    after = simulation.run(80).state()["positions"]
    np.testing.assert_array_equal(after[2:], before[3:])
    np.testing.assert_allclose(after[:2, 1], [0.5, 1.5], atol=0.02)  # the upper one has dropped


@pytest.mark.parametrize(
    "settings",
    [{}, {"contactScheduling": "batches"}, {"contactSolver": "soft-step", "substeps": 1}],
)
@pytest.mark.parametrize("gyroscopic", [False, True])
def test_a_constant_force_and_torque_accelerate_as_newton_and_euler_say(settings, gyroscopic):
    """v = n h F / m, and x = h² F / m n (n + 1) / 2 by semi-implicit Euler; the angle likewise."""
    ball = Mesh.sphere(1.0, 3.0)
    ball.set_force((2.0, -1.0, 0.5), (0.0, 0.0, 0.7))
    wall = Mesh.box((1, 1, 1), 1.0, (50, 50, 50), isFixed=True)
    wall.set_force((1e3, 0, 0), (1e3, 0, 0))
    settings = Settings(gravity=0.0, gyroscopic=gyroscopic, **settings)
    simulation = Simulation.from_meshes([ball, wall], settings=settings)
    simulation.groundMesh = None
    simulation.run(50)
    moved, h = simulation.meshes[0], 0.02
    a = np.array([[2.0, -1.0, 0.5]]) / ball.mass
    np.testing.assert_allclose(moved.linVelocity, 50 * h * a, rtol=1e-12)
    np.testing.assert_allclose(moved.position, h * h * a * 50 * 51 / 2, rtol=1e-12)
    rate = 0.7 / ball.IT[2, 2]
    np.testing.assert_allclose(moved.angVelocity, [[0, 0, 50 * h * rate]], rtol=1e-9, atol=1e-12)
    w, _, _, z = moved.orientation[0]
    assert 2.0 * np.arctan2(z, w) == pytest.approx(h * h * rate * 50 * 51 / 2, rel=1e-6)
    assert simulation.meshes[1].position.tolist() == [[50, 50, 50]]


def test_a_state_of_another_scene_is_refused_and_changes_nothing():
    simulation = Simulation("mixed").run(3)
    before = simulation.state()
    for other in (Simulation("singlebox"), Simulation("tet")):
        bodies = "1 body" if len(other.meshes) == 1 else "25 bodies"
        with pytest.raises(ValueError, match=rf"^a state of {bodies} is not one of .*'mixed', 15"):
            simulation.restore(other.state())
    assert bits(before) == bits(simulation.state())


@pytest.mark.slow
@pytest.mark.parametrize("place", [0, 1])
def test_the_readmes_examples_run_in_an_empty_folder(tmp_path, place):
    require_opengl()
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    examples = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(examples) == 2
    process = python(tmp_path, "-c", examples[place], PYTHONPATH=str(ROOT))
    assert process.returncode == 0, process.stderr
    assert list(tmp_path.glob(("*.png", "run.h5")[place])) and process.stdout


def test_shapes_have_the_masses_and_inertias_of_textbooks():
    box = Mesh.box((2.0, 4.0, 6.0), 2.0, (1, 2, 3))
    assert box.mass == pytest.approx(96.0) and box.position.tolist() == [[1, 2, 3]]
    np.testing.assert_allclose(np.diag(box.IT), BOX_INERTIA)
    cylinder = Mesh.cylinder(0.5, 3.0, 4.0, sides=200, isFixed=True)
    mass = 4.0 * np.pi * 0.25 * 3.0
    assert cylinder.isFixed and cylinder.mass == pytest.approx(mass, rel=1e-3)
    across = mass * (3.0 * 0.25 + 9.0) / 12.0
    np.testing.assert_allclose(np.diag(cylinder.IT), [across, mass * 0.125, across], rtol=1e-3)
    sphere = Mesh.sphere(2.0, 1.0)
    np.testing.assert_allclose(np.linalg.norm(sphere.hull.vertices, axis=1), 2.0)
    assert 0.96 < sphere.mass / (32.0 / 3.0 * np.pi) < 1.0
    hull = Mesh.convex_hull(np.concatenate([box.currVertices, [[1.2, 2.0, 3.0]]]), 2.0)
    assert hull.mass == pytest.approx(96.0)
    np.testing.assert_allclose(hull.position, [[1, 2, 3]], atol=1e-12)


ONE = Mesh.box((1, 1, 1), 1.0)
# What is asked of three boxes, and the error.
REFUSED = {
    "overlays must be one of contacts, .*, not 'contact'": lambda s: s.picture(overlays="contact"),
    "the name of a picture must end in .png, not 'a.jpg'": lambda s: s.picture("a.jpg"),
    "unexpected keyword argument 'colour'": lambda s: s.picture(colour=1),
    "no bodies": lambda s: s.from_meshes([]).picture(),
    "must end in .h5 or .hdf5, not ": lambda s: s.record("run.csv").__enter__(),
    "name of a recording must be a path, not NoneType": lambda s: s.record(None).__enter__(),
    "a constraint is a row of six": lambda s: s.from_meshes([ONE, ONE], [["a", 0, 1, 0, 1, 1]]),
    r"impulse must be 3 finite numbers, not \('1'": lambda s: s.push(0, ("1", "0", "0")),
    r"isFixed must be True or False, not \[T": lambda s: s.fix(0, np.array([True, False])),
    "faces must be rows of 3 indices, 0": lambda s: Mesh.from_surface("a", np.eye(3), [[0, 1, -1]]),
    "count must be a whole number, not '3'": lambda s: s.run("3"),
    "count must be a whole number, not True": lambda s: s.stats(True),
    "meshes must be a list of Mesh, not Mesh": lambda s: s.from_meshes(ONE),
    "constraints must be a list of rows, not Settings": lambda s: s.from_meshes([ONE], Settings()),
    "settings must be Settings, not dict": lambda s: Simulation("mixed", {"friction": 1}),
    "scene must be a path or a name .from_meshes .*not list": lambda s: Simulation([ONE]),
    "ok.h5: a recording, not a scene; --replay shows it": lambda s: Simulation("ok.h5"),
    "TOWER: no such scene or file; did you mean tower": lambda s: Simulation("TOWER"),
    "'late' is no body of this simulation": lambda s: s.fix("late"),
    "True is no body of this simulation": lambda s: s.push(True, (1, 0, 0)),
    "^-1 is no body of this simulation": lambda s: s.remove(np.int64(-1)),
    r"position must be 3 finite numbers, not \(0, 1\)": lambda s: s.move(0, (0, 1)),
    "orientation must not be zero": lambda s: s.move(0, (0, 1, 0), (0, 0, 0, 0)),
    "angular must be 3 finite numbers": lambda s: s.set_velocity(0, (0, 0, 0), 1.0),
    "the point lies .* outside": lambda s: s.constrain(0, s.meshes[0].position, 1, (0, 20, 0)),
    "0 ≤ lower ≤ upper, not 2.0 and 1.0": lambda s: s.constrain(0, 0, 1, 0, 2.0, 1.0),
    "a bound must be a finite number": lambda s: s.constrain(0, 0, 1, 0, "a"),
    "a vertex must be one of 0 to 7, not -1": lambda s: s.constrain(0, -1, 1, 0),
    "a body cannot be linked to itself": lambda s: s.constrain(1, 0, s.meshes[1], 3),
    "state must be a State, not NoneType": lambda s: s.restore(None),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_is_refused_is_named_and_changes_nothing(message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    simulation = Simulation.from_meshes(boxes())
    with pytest.raises((ValueError, TypeError, AttributeError), match=message):
        REFUSED[message](simulation)
    assert list(tmp_path.iterdir()) == [] and simulation.stepCount == 0
    assert len(simulation.meshes[0].origVertices) == 8
    assert simulation.constraints == []


def test_an_unknown_attribute_of_a_body_is_named_before_it_is_lost():
    """Where the body is handed over, and before the next run; a subclass may have its own."""

    class Marked(Mesh):
        pass

    mesh = Mesh.box((1, 1, 1), 1.0)
    simulation = Simulation.from_meshes([mesh])
    mesh.friction = simulation.meshes[0].friction = 3
    made = Simulation.from_meshes
    for act, given in ((simulation.run, 1), (simulation.add, mesh), (made, [mesh])):
        with pytest.raises(AttributeError, match="body 0, 'box': a Mesh has no attribute friction"):
            act(given)
    own = Marked.box((1, 1, 1), 1.0)
    own.colour = "red"
    assert Simulation.from_meshes([own]).run(1).stepCount == 1


def test_a_scenes_recommendations_are_used_as_on_the_command_line(capsys, tmp_path):
    simulation = Simulation("card_house")
    assert call(capsys, "card_house", "--steps", 20, "--record", tmp_path / "r.h5")[0] == 0
    with Simulation.open(tmp_path / "r.h5") as recorded:
        assert simulation.settings == recorded.settings != Settings()
        recorded.seek(20)
        assert bits(simulation.run(20).state()) == bits(recorded.state())
    assert simulation.recommended == "restitution 0, friction 0.5, solver soft-step"
    for basic in (Simulation("card_house", recommended=False), Simulation("stack", Settings())):
        assert basic.settings == Settings() and basic.recommended == ""


@pytest.mark.parametrize("name", ["a.h5", "a.glb", "a.html", "a.gif"])
@pytest.mark.parametrize(("moment", "count"), [("before", 0), ("add", 7)])
def test_what_ends_a_run_loses_no_file(tmp_path, name, moment, count):
    """Neither the steps so far, nor, if there are none, an older file."""

    def stop(self, simulation):
        if simulation.stepCount == count:
            raise KeyboardInterrupt

    path, simulation = tmp_path / name, Simulation.from_meshes(boxes())
    path.write_text("old")
    simulation.writers.append(type("Stopping", (Writer,), {moment: stop})())
    if name == "a.gif":
        require_opengl()
        pytest.importorskip("imageio_ffmpeg")
    with pytest.raises(KeyboardInterrupt):
        if name == "a.h5":
            with simulation.record(path):
                simulation.run(20)
        elif name == "a.gif":
            simulation.video(path, 20, size=(64, 48))
        else:
            simulation.export(path, 20)
    assert path.read_bytes() == b"old"
    kept = [one for one in tmp_path.iterdir() if one != path]
    # a recording that has a state is never removed
    assert [one.name for one in kept] == [name.replace(".", ".part.")] * (
        count > 0 or ".h5" in name
    )


def test_a_notebook_shows_simulation_player_and_mesh(tmp_path):
    require_opengl()
    pytest.importorskip("k3d")
    simulation = Simulation.from_meshes(boxes(), name="a <b>")
    html = simulation._repr_html_()
    picture = base64.b64decode(re.search('base64,([^"]*)"', html)[1])
    assert Image.open(io.BytesIO(picture)).size == (480, 270)
    assert "a &lt;b&gt;" in html and "3 (0 fixed)" in html and "<b>a <b>" not in html
    player = simulation.show(10)
    assert simulation.stepCount == 10 and "a &lt;b&gt;" in player.page
    assert player._repr_html_().startswith('<iframe srcdoc="&lt;!doctype html')
    assert simulation.export(tmp_path / "run.html", 5) is simulation
    assert simulation.stepCount == 15 and (tmp_path / "run.html").stat().st_size > 1e6
    image = simulation.picture(tmp_path / "three.png", size=(64, 48))
    with Image.open(tmp_path / "three.png") as picture:
        assert picture.size == image.size == (64, 48) and np.ptp(np.asarray(picture)[..., 0]) > 50
    svg = re.search("<svg.*</svg>", simulation.meshes[0]._repr_html_())[0]
    # three sides of a box are seen, of two triangles each
    assert len(ElementTree.fromstring(svg)) == 6
    pytest.importorskip("imageio_ffmpeg")
    assert simulation.video(tmp_path / "three.gif", 20, size=(64, 48)).stepCount == 35
    with Image.open(tmp_path / "three.gif") as film:
        assert film.n_frames == 11 and film.size == (64, 48)  # in real time
