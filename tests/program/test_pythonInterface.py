"""Simulations from Python: from meshes, restored, recorded, drawn."""

import base64
import io
import re
import signal

import numpy as np
import pytest
from oracles import ROOT, box_body
from PIL import Image
from program import bits, python, require_opengl

import RigidBodySimulation
from rbs.pictures.backends import Backend
from rbs.recordings.recording import Recording
from rbs.recordings.replay import verify
from rbs.scenes.scene import Writer
from RigidBodySimulation import Settings, Simulation, shapes

CONSTRAINTS = [[0, 0, 1, 0, 3.0, True], [0, 0, 1, 0, 1.0, False]]


def boxes():
    """Three tilted boxes over each other, the first of which moves."""
    places = [((0.2 * k, 2 + 1.7 * k, 0), (1, 0.1 * k, 0.2, 0.05 * k)) for k in range(3)]
    meshes = [box_body(2, 1, 2, place, orientation=turn) for place, turn in places]
    meshes[0].linVelocity = np.array([[0.3, 0.1, -0.2]])
    return meshes


def test_a_signal_waits_until_polyscope_has_started(monkeypatch):
    started, begin = [], "rbs.pictures.capture.start_view"
    monkeypatch.setattr(begin, lambda *given: started.append(signal.raise_signal(signal.SIGINT)))
    with pytest.raises(KeyboardInterrupt):
        RigidBodySimulation.start_drawing(None, RigidBodySimulation.PictureOptions(), Backend("x"))
    assert started


@pytest.mark.parametrize("solver", ["impulse", pytest.param("soft-step", marks=pytest.mark.slow)])
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


def test_bodies_that_are_added_and_removed_take_their_constraints_along():
    simulation = Simulation.from_meshes(boxes(), CONSTRAINTS).run(5)
    first, state = simulation.meshes[0], simulation.state()
    added = simulation.add(shapes.sphere(0.5, 2.0, (4, 2, 0), "late", orientation=(1, 0.2, 0, 0)))
    simulation.constrain(added, added.position, 1, 0, lower=0.0)
    *_, low, high = [list(row) for row in simulation.constraints]
    assert low[:3] == [3, low[1], 1] and low[4:] == [0.0, False]
    simulation.remove(first)
    assert simulation.constraints == [[2, row[1], 0, *row[3:]] for row in (low, high)]
    simulation.remove(added)
    assert simulation.constraints == [] and len(simulation.meshes) == 2
    simulation.restore(state)
    assert simulation.meshes[0] is first and simulation.constraints == CONSTRAINTS


@pytest.mark.parametrize(
    "settings",
    [{}, {"contactScheduling": "batches"}, {"contactSolver": "soft-step", "substeps": 1}],
)
@pytest.mark.parametrize("gyroscopic", [False, True])
def test_a_constant_force_and_torque_accelerate_as_newton_and_euler_say(settings, gyroscopic):
    """By semi-implicit Euler, v = n h a, x = h² a n (n + 1) / 2, a = g + F / m; angles likewise."""
    ball = shapes.sphere(1.0, 3.0)
    ball.set_force((2.0, -1.0, 0.5), (0.0, 0.0, 0.7))
    wall = shapes.box((1, 1, 1), 1.0, (50, 50, 50), isFixed=True)
    wall.set_force((1e3, 0, 0), (1e3, 0, 0))
    g = 3.0, -1.6, -2.0
    settings = Settings(gravity=g, gyroscopic=gyroscopic, **settings)
    simulation = Simulation.from_meshes([ball, wall], settings=settings)
    simulation.groundMesh = None
    simulation.run(50)
    moved, h = simulation.meshes[0], 0.02
    a = g + np.array([[2.0, -1.0, 0.5]]) / ball.mass
    np.testing.assert_allclose(moved.linVelocity, 50 * h * a, rtol=1e-12)
    np.testing.assert_allclose(moved.position, h * h * a * 50 * 51 / 2, rtol=1e-12)
    rate = 0.7 / ball.IT[2, 2]
    np.testing.assert_allclose(moved.angVelocity, [[0, 0, 50 * h * rate]], rtol=1e-9, atol=1e-12)
    w, _, _, z = moved.orientation[0]
    assert 2.0 * np.arctan2(z, w) == pytest.approx(h * h * rate * 50 * 51 / 2, rel=1e-6)
    assert simulation.meshes[1].position.tolist() == [[50, 50, 50]]


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
    box = shapes.box((2.0, 4.0, 6.0), 2.0, (1, 2, 3))
    assert box.mass == pytest.approx(96.0) and box.position.tolist() == [[1, 2, 3]]
    np.testing.assert_allclose(np.diag(box.IT), [416.0, 320.0, 160.0])  # m (a² + b²) / 12
    cylinder = shapes.cylinder(0.5, 3.0, 4.0, sides=200, isFixed=True)
    mass = 4.0 * np.pi * 0.25 * 3.0
    assert cylinder.isFixed and cylinder.mass == pytest.approx(mass, rel=1e-3)
    across = mass * (3.0 * 0.25 + 9.0) / 12.0
    np.testing.assert_allclose(np.diag(cylinder.IT), [across, mass * 0.125, across], rtol=1e-3)
    sphere = shapes.sphere(2.0, 1.0)
    np.testing.assert_allclose(np.linalg.norm(sphere.hull.vertices, axis=1), 2.0)
    assert 0.96 < sphere.mass / (32.0 / 3.0 * np.pi) < 1.0
    hull = shapes.convex_hull(np.concatenate([box.currVertices, [[1.2, 2.0, 3.0]]]), 2.0)
    assert hull.mass == pytest.approx(96.0)
    np.testing.assert_allclose(hull.position, [[1, 2, 3]], atol=1e-12)


ONE, EMPTY = shapes.box((1, 1, 1), 1.0), Simulation.from_meshes([])


# What is asked of a run s of three boxes, the first of which is m, or of a recording o of it; and
# behind it, a word that the message must have: the name of the argument, or what was meant.
MISUSES = """
s.gravity = 0  # settings.change('gravity'
s.video("v.gif", every=0)  # every
s.settings.change("gravity", (np.float64("inf"), 0, 0))  # (inf, 0, 0)
m.velocity = (1, 0, 0); s.step()  # linVelocity
m.IT = m.IT + np.eye(3)[[1, 2, 0]]  # IT
o.settings.change("gravity", 0)  # gravity
o.settings.friction = 1  # friction
o.seek(6)  # 0 to 5
s.set_state({"positions": np.zeros((3, 3))})  # orientations
s.from_meshes([ONE, ONE], [["a", 0, 1, 0, 1, 1]])  # constraint
Simulation("ok.h5")  # Simulation.open
Simulation("tet", constraintPath=3)  # constraintPath must be a path
s.move(0, (0, 1, 0), (0, 0, 0, 0))  # orientation
s.stepCount = True  # stepCount
shapes.cylinder(1, 1, 1, axis="z")  # cylinder() got an unexpected keyword argument 'axis'
s.constrain(0, m.position, 1, (0, 20, 0))  # outside
s.record("run.csv").__enter__()  # run.csv
s.export("c.glb", colouring=np.str_("sped"))  # not 'sped'
EMPTY.picture()  # bodies
s.picture(camra=None)  # no option camra; there are size
s.picture(overlays=3)  # overlays must be one of
s.picture(look=[])  # look must be one of
shapes.from_surface("x", 3, [[0, 1, 2]], 1.0)  # mesh x: vertices must be rows of 3
Simulation.resume(o.recording.path, 9)  # step 9
""".strip().splitlines()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("recorded") / "ok.h5"
    with Simulation.from_meshes(boxes()).record(path) as simulation:
        simulation.run(5)
    return path


@pytest.mark.parametrize("line", MISUSES)
def test_what_is_refused_is_named_and_changes_nothing(line, recorded, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    simulation, (act, word) = Simulation.from_meshes(boxes()), line.split("  # ")
    with Simulation.open(recorded) as opened:
        before, at = bits(simulation.state()), opened.state().rows.tobytes()
        space = {"s": simulation, "m": simulation.meshes[0], "o": opened}
        kinds = ValueError, TypeError, AttributeError
        with pytest.raises(kinds, match=re.escape(word)) as raised:
            exec(act, vars(RigidBodySimulation) | globals() | space)
        assert "\n" not in str(raised.value)
        assert opened.state().rows.tobytes() == at and opened.stepCount == 0
    assert bits(simulation.state()) == before and list(tmp_path.iterdir()) == []
    assert len(simulation.meshes[0].origVertices) == 8 and simulation.settings == Settings()
    assert simulation.constraints == [] and simulation.stepCount == 0


def test_a_rollout_and_a_resumed_run_have_the_bits_of_single_steps(tmp_path):
    simulation, path = Simulation.from_meshes(iter(boxes()), ground=False), tmp_path / "a.h5"
    with simulation.record(path):
        rows = simulation.rollout(9)
        assert simulation.rollout(0)["orientations"].shape == (0, 3, 4)
    again = Simulation.from_meshes(boxes(), settings=Settings(ground=False))
    for k in range(9):
        again.step()
        assert bits({name: table[k] for name, table in rows.items()}) == bits(again.state())
    assert again.meshes[0].position[0, 1] < 1.9 and again.groundMesh is None
    low = shapes.box((1, 1, 1), 1.0, (0, -3, 0))
    arguments = [low], RigidBodySimulation.ground()
    assert RigidBodySimulation.run_timestep(*arguments, settings=again.settings).contactCount == 0
    with Simulation.resume(path, 4).record(tmp_path / "b.h5") as resumed:
        assert bits(resumed.run(5).state()) == bits(again.state())
    for recording in (path, tmp_path / "b.h5"):
        assert Simulation.verify(recording) == ""
    assert "ground=False" in repr(Simulation.open(path).settings)


def test_time_is_a_multiple_of_the_time_step():
    simulation = Simulation.from_meshes([])
    for k in range(1, 501):
        simulation.step()
        assert simulation.time == k * 0.02
    simulation.settings.timeStep = 0.03
    assert simulation.run(2).time == pytest.approx(10.06)


def test_an_export_that_ctrl_c_ends_has_the_steps_so_far(tmp_path):
    def stop(simulation):
        if simulation.stepCount == 7:
            raise KeyboardInterrupt

    simulation, stopping = Simulation.from_meshes(boxes()), Writer()
    stopping.add = stop
    simulation.writers.append(stopping)
    with pytest.raises(KeyboardInterrupt):
        simulation.export(tmp_path / "a.html", 20)
    assert [one.name for one in tmp_path.iterdir()] == ["a.html"]


def test_a_notebook_shows_simulation_and_player(tmp_path):
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
    pytest.importorskip("imageio_ffmpeg")
    assert simulation.video(tmp_path / "three.gif", 20, size=(64, 48)).stepCount == 35
    with Image.open(tmp_path / "three.gif") as film:
        assert film.n_frames == 11 and film.size == (64, 48)  # in real time
