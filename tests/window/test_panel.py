"""Keys, mouse and widgets of the panels, drawn off-screen; and a user who does things at random."""

from collections import Counter
from dataclasses import asdict
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest
from hands import Hands, make_panel
from opengl import pixel_of
from program import DATA, record
from views import make_viewer

from rbs.appearance.colours import COLOURINGS
from rbs.opening.suggestions import recommended_values
from rbs.pictures.view import LAYERS, SceneView
from rbs.recordings.recording import Recording
from rbs.recordings.replay import Replay, restored_settings, verify
from rbs.scenes.changes import fix
from rbs.scenes.grabbing import shot
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.settings import SETTINGS, Settings
from rbs.window.panel import CHOICES, Panel
from rbs.window.playback import SPEEDS


@pytest.fixture
def panel(polyscope, tmp_path, monkeypatch):
    """The panel over the mixed scene, drawn frame by frame through Polyscope's callback."""
    monkeypatch.chdir(tmp_path)
    simulation = SceneSimulation(DATA / "mixed-scene.txt")
    result = make_panel(simulation, polyscope, monkeypatch, (560, 720))
    yield result
    result.viewer.view.set_callback(None)


WIDGETS = "Button Checkbox SliderFloat SliderInt InputDouble InputTextWithHint BeginCombo "
WIDGETS = (WIDGETS + "CollapsingHeader Selectable").split()


@pytest.fixture
def widgets(monkeypatch, polyscope):
    """What is drawn: a list of (kind, label, (x, y) to click at), of tooltips too."""
    import polyscope.imgui as psim

    result = []

    def noting(kind, widget):
        def draw(label, *arguments, **options):
            answer = widget(label, *arguments, **options)
            low, high = psim.GetItemRectMin(), psim.GetItemRectMax()
            # A field's rectangle holds its label, and buttons: its number is at the left.
            result.append((kind, label.split("#")[0], (low[0] + 15.0, 0.5 * (low[1] + high[1]))))
            return answer

        return draw

    for kind in (*WIDGETS, "SetItemTooltip"):
        monkeypatch.setattr(psim, kind, noting(kind, getattr(psim, kind)))
    return result


@pytest.fixture
def all_open(monkeypatch, polyscope):
    """All sections of the panels are open."""
    import polyscope.imgui as psim

    header = psim.CollapsingHeader
    monkeypatch.setattr(psim, "CollapsingHeader", lambda *rest: bool(header(*rest)) or True)


@pytest.fixture
def hands(polyscope, widgets, panel):
    return Hands(polyscope, widgets)


def test_keys_play_step_and_reset_and_edges_are_smooth_while_nothing_moves(hands, panel):
    viewer = panel.viewer
    for isPlaying in (True, False):
        hands.key("Key_Space")
        assert viewer.isPlaying == isPlaying != viewer.view.isSmooth
    count = viewer.simulation.stepCount
    hands.key("Key_S")
    hands.key("Key_RightArrow")
    assert viewer.simulation.stepCount == count + 2
    hands.key("Key_R")
    assert viewer.simulation.stepCount == 0


def test_gravity_as_a_vector_is_shown_and_restored(hands, panel, all_open, monkeypatch):
    shown, draw = [], hands.psim.TextUnformatted
    monkeypatch.setattr(
        hands.psim, "TextUnformatted", lambda text: (shown.append(text), draw(text))
    )
    settings = panel.viewer.simulation.settings
    settings.change("gravity", (1.0, -9.8, 0.0))
    hands.ps.frame_tick()
    assert "1,-9.8,0  gravity (m/s²)" in shown
    panel.viewer.restore_settings("gravity")
    hands.ps.frame_tick()
    assert settings.gravity == 9.8 and "gravity (m/s²)" in [one[1] for one in hands.widgets]


def test_keys_show_help_overlays_and_other_scenes_hide_panels_and_undo(hands, panel):
    viewer = panel.viewer
    for press in (
        lambda: hands.key("Key_H"),
        lambda: hands.key("Key_F1"),
        lambda: hands.key("Mod_Shift", lambda: hands.key("Key_Slash")),
    ):
        press()
        assert panel.isHelpShown
        hands.key("Key_Escape")
        assert not panel.isHelpShown
    for isShown in (True, False):
        hands.key("Key_8")
        assert ("grid cells" in viewer.view.shown) == isShown
        hands.key("Key_Tab")
        assert panel.areHidden == isShown
    for name, scene in (("RightBracket", "tower"), ("LeftBracket", "mixed")):
        hands.key(f"Key_{name}")
        assert viewer.name() == scene
    hands.io.AddMousePosEvent(480.0, 200.0)  # beside the panel
    hands.key("Key_B")
    assert len(viewer.simulation.meshes) == 16
    hands.key("Mod_Ctrl", lambda: hands.key("Key_Z"))  # what was shot is taken back
    assert len(viewer.simulation.meshes) == 15
    start = viewer.simulation.state()["positions"]
    hands.key("Key_S")
    hands.key("Key_LeftArrow")
    assert viewer.simulation.stepCount == 0
    assert np.array_equal(viewer.simulation.state()["positions"], start)


def test_numbers_that_are_typed_in_are_kept_within_their_bounds(hands, panel):
    settings = panel.viewer.simulation.settings
    for label, name, typed, expected in (
        ("time step (s)", "timeStep", "0.005", 0.005),
        ("time step (s)", "timeStep", "0", 1e-4),
        ("time step (s)", "timeStep", "7", 1.0),
        ("restitution", "restitution", "0.9", 0.9),
        ("restitution", "restitution", "1.1", 1.0),
        ("restitution", "restitution", "-3", 0.0),
        ("gravity (m/s²)", "gravity", "24.8", 24.8),  # Jupiter's, beyond the slider
        ("gravity (m/s²)", "gravity", "-1", -1.0),
        ("friction", "friction", "5", 5.0),
    ):
        hands.type_into(label, typed)
        assert getattr(settings, name) == expected
        isClamped = float(typed) != expected
        assert ("is limited to" in panel.viewer.message) == isClamped
        panel.viewer.message = ""
    assert panel.viewer.simulation.stepCount == 0


@pytest.mark.parametrize("solver", ["impulse", "soft-step"])
def test_every_setting_is_changed_by_its_widget(hands, panel, solver):
    panel.viewer.open(DATA / "cube-scene.txt")
    settings, counts = panel.viewer.simulation.settings, Counter()
    settings.change("contactSolver", solver)
    for one in SETTINGS.values():
        if not one.label or not one.is_used_by(solver) or one.name == "timeStep":
            continue
        before = getattr(settings, one.name)
        if isinstance(one.kind, tuple):
            for name in (*one.kind, before):
                hands.click(one.label)
                hands.click(CHOICES.get(name, name))
                assert getattr(settings, one.name) == name
        else:
            hands.click(one.label, along=60.0)  # beside the handle of a slider at its low end
            assert getattr(settings, one.name) != before
        counts[one.kind if one.kind in (bool, float) else "choice"] += 1
    assert counts[float] and counts["choice"] and (counts[bool] or solver == "soft-step")


def test_every_control_says_what_it_is_for_unless_an_error_is_shown(
    polyscope, panel, widgets, all_open
):
    panel.viewer.open(DATA / "cube-scene.txt")
    panel.viewer.view.pick(1, panel.viewer.simulation.meshes[1].position[0])
    panel.isSideShown = True
    polyscope.frame_tick()
    widgets.clear()
    polyscope.frame_tick()
    kinds = [kind for kind, _, _ in widgets if kind != "CollapsingHeader"]
    assert len(kinds) > 80
    for k in range(0, len(kinds), 2):
        assert kinds[k] != "SetItemTooltip" == kinds[k + 1], widgets[k]
    panel.viewer.message = "something is wrong"
    widgets.clear()
    polyscope.frame_tick()
    assert widgets and "SetItemTooltip" not in [kind for kind, _, _ in widgets]


@pytest.mark.parametrize("kind", ["impulse", "soft-step", "recording"])
def test_widgets_write_nothing_while_nobody_touches_them(polyscope, hands, panel, tmp_path, kind):
    viewer, solver = panel.viewer, "impulse" if kind == "recording" else kind
    settings = Settings(friction=0.4, restitution=0.7, contactSolver=solver)
    simulation = SceneSimulation(DATA / "cube-scene.txt", settings)
    if kind == "recording":
        simulation = Replay(Recording(record(tmp_path / "cube.h5", simulation, 3)))
    viewer.simulation, viewer.pushSpeed = simulation, 0.4
    viewer.view.rebuild(simulation)
    simulation.step()
    viewer.view.pick(1, simulation.meshes[1].position[0])
    panel.isSideShown = True
    before = repr(simulation.settings)
    state = {name: values.tobytes() for name, values in simulation.state().items()}
    for _ in range(10):
        polyscope.frame_tick()
    assert repr(simulation.settings) == before and "friction=0.4" in before
    assert {name: values.tobytes() for name, values in simulation.state().items()} == state
    assert repr(viewer.pushSpeed) == "0.4" and simulation.stepCount == 1
    assert viewer.playback.isBackwards is False and viewer.view.follows is False
    hands.key("Key_S")
    assert simulation.stepCount == 2  # the panel is still Polyscope's callback


def test_panel_goes_on_after_a_picture_with_a_legend(polyscope, hands, panel, monkeypatch):
    panel.viewer.view.hasLegend = True
    panel.viewer.view.show("velocities", True)
    for label in ("Simulation", "Display", "Save", "Picture"):
        hands.click(label)
    assert panel.viewer.saved.endswith("/out/mixed/picture_000000.png")
    hands.key("Key_S")
    assert panel.viewer.simulation.stepCount == 1

    def fail(**options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(polyscope, "screenshot_to_buffer", fail)
    panel.viewer.save_picture()
    assert panel.viewer.message == "cannot write: No space left on device"
    hands.key("Key_S")
    assert panel.viewer.simulation.stepCount == 2


def test_file_dropped_onto_the_window_is_opened(polyscope, panel):
    panel.dropped([str(DATA / "tet-scene.txt"), str(DATA / "cube-scene.txt")])
    polyscope.frame_tick()
    assert panel.viewer.simulation.scenePath == DATA / "cube-scene.txt"


# --------------------------------------------------------------------------------------------------
# A user who does things at random
# --------------------------------------------------------------------------------------------------

SMALL_SCENES = "cube mixed tower two_chain slide stack cradle ramp arch dominoes".split()


class RandomUser:
    """Does at random what the window allows. Attribute: counts, how often each thing was done."""

    def __init__(self, ps, panel, recordings, seed):
        self.ps, self.panel, self.viewer = ps, panel, panel.viewer
        self.recordings = recordings
        self.random = np.random.default_rng(seed)
        self.counts, self.scenes = Counter(), set()
        self.note_settings()

    def note_settings(self):
        self.expected = asdict(self.viewer.simulation.settings)

    def choice(self, values):
        values = list(values)
        return values[self.random.integers(len(values))]

    def pixel(self):
        """The pixel of a body, or the nearest one in the picture."""
        width, height = self.ps.get_window_size()
        row, column = pixel_of(self.ps, self.choice(self.viewer.simulation.meshes).position[0])
        return min(max(column, 0), width - 1), min(max(row, 0), height - 1)

    def act(self):
        """Does something that can be done now, preferring what was done rarely; draws a frame."""
        names = [name for name in vars(RandomUser) if name.startswith("do_")]
        # These are possible only while a body is picked, or held.
        isRare = np.isin(names, ("do_push", "do_fix", "do_drag", "do_release"))
        weights = 0.8 ** np.array([self.counts[name] for name in names]) * np.where(isRare, 6, 1)
        isDone = False
        while not isDone:
            name = str(self.random.choice(names, p=weights / weights.sum()))
            isDone = getattr(self, name)() is not False
        self.counts[name] += 1
        if self.viewer.grab is None:  # else the panel would let go: no mouse button is down
            self.ps.frame_tick()
        else:
            self.viewer.play(0.04)

    def do_play(self):
        self.viewer.playback.speed = self.choice(SPEEDS)
        self.viewer.playback.isBackwards = bool(self.random.integers(2))
        self.viewer.toggle_play()

    def do_step(self):
        for _ in range(self.random.integers(1, 4)):
            self.viewer.step_once()

    def do_seek(self):
        if not self.viewer.isReplay:
            return False
        self.viewer.seek(int(self.random.integers(-2, self.viewer.simulation.lastStep + 3)))

    def do_back(self):
        self.viewer.step_back()
        self.viewer.message = ""
        self.note_settings()

    def do_continue(self):
        if not self.viewer.isReplay:
            return False
        self.viewer.continue_here()
        self.note_settings()

    def do_reset(self):
        self.viewer.reset()
        if not self.viewer.isReplay:
            self.expected = asdict(self.viewer.simulation.startSettings)

    def do_restore(self):
        if self.viewer.isReplay:
            return False
        self.viewer.restore_settings(self.choice([None, "friction"]))
        self.note_settings()

    def do_scrub(self):
        if self.viewer.isReplay:
            return False
        self.viewer.seek(int(self.random.integers(self.viewer.last_place() + 1)))
        self.note_settings()

    def do_restart(self):
        self.viewer.restart()

    def do_pick(self):
        self.viewer.pick_at(self.pixel())
        return self.viewer.picked() is not None

    def do_push(self):
        if self.viewer.isReplay or self.viewer.picked() is None or self.viewer.picked().isFixed:
            return False
        direction = self.random.normal(size=3)
        self.viewer.push(direction / np.linalg.norm(direction))

    def do_fix(self):
        if self.viewer.isReplay or self.viewer.picked() is None:
            return False
        self.viewer.set_fixed(not self.viewer.picked().isFixed)

    def do_grab(self):
        self.viewer.grab_at(self.pixel())
        return self.viewer.grab is not None

    def do_drag(self):
        if self.viewer.grab is None:
            return False
        self.viewer.drag_to(self.pixel())
        self.viewer.step_once()

    def do_release(self):
        if self.viewer.grab is None:
            return False
        self.viewer.release()

    def do_shoot(self):
        self.viewer.shoot(self.pixel())
        return not self.viewer.isReplay

    def do_open_scene(self):
        name = self.choice(sorted(set(SMALL_SCENES) - self.scenes) or SMALL_SCENES)
        self.viewer.open(name)
        assert self.viewer.message == ""
        self.scenes.add(name)
        simulation = SceneSimulation(DATA / f"{name}-scene.txt")
        self.expected = asdict(Settings(**recommended_values(simulation.source)))

    def do_open_recording(self):
        self.viewer.open(self.choice(self.recordings))
        assert self.viewer.isReplay

    def do_colours(self):
        self.viewer.view.colouring = self.choice(COLOURINGS)
        self.viewer.view.refresh()

    def do_overlay(self):
        name = self.choice(LAYERS)
        self.viewer.view.show(name, name not in self.viewer.view.shown)

    def do_camera(self):
        self.viewer.view.follows = not self.viewer.view.follows
        self.viewer.view.frame_all()

    def do_picture(self):
        self.viewer.view.hasLegend = bool(self.random.integers(2))
        self.viewer.save_picture()
        assert self.viewer.saved.endswith(".png") and self.viewer.message == ""

    def do_video(self):
        self.viewer.toggle_file("video")

    def do_page(self):
        self.viewer.toggle_file("page")
        assert self.viewer.message == ""

    def do_recording(self):
        if self.viewer.isReplay:
            return False
        self.viewer.toggle_file("recorder")

    def do_setting(self):
        settings = self.viewer.simulation.settings
        used = [one for one in SETTINGS.values() if one.solver in (None, settings.contactSolver)]
        one = self.choice(one for one in used if one.label)
        if self.viewer.isReplay:
            return False
        if one.kind is bool:
            value = not getattr(settings, one.name)
        elif isinstance(one.kind, tuple):
            value = self.choice(one.kind)
        else:
            low, high = one.sliderEnds or (0.005, 0.03)
            value = one.kind(self.random.uniform(low, high))
            if self.random.integers(4) == 0:  # beyond the end of the slider
                value = one.kind(min(3 * high, one.limits[1]))
        settings.change(one.name, value)
        assert getattr(settings, one.name) == value
        if one.name != "contactSolver":
            self.expected[one.name] = value
        else:  # settings that the new solver ignores get their defaults
            ignored = [other for other in SETTINGS.values() if other.solver not in (None, value)]
            self.expected |= {other.name: other.default for other in ignored} | {one.name: value}


@pytest.mark.slow
def test_random_actions_raise_nothing_and_change_only_what_they_are_for(
    polyscope, tmp_path, monkeypatch, all_open
):
    monkeypatch.chdir(tmp_path)
    clock = count(step=0.004)
    for module in ("panel", "viewer", "playback"):
        still = SimpleNamespace(perf_counter=lambda: next(clock), sleep=lambda seconds: None)
        monkeypatch.setattr(f"rbs.window.{module}.time", still)
    polyscope.set_window_size(640, 150)
    monkeypatch.setattr("rbs.pictures.capture.SUPERSAMPLING", 1)

    def change_by_hand(simulation, step):
        if step == 4:
            simulation.change(shot(simulation.meshes, 40.0, [0.0, 9.0, 30.0], [0.0, 0.0, -1.0]))
            simulation.change(fix(1, True))

    recordings = []
    for name, solver in (("tower", "impulse"), ("stack", "soft-step")):
        simulation = SceneSimulation(DATA / f"{name}-scene.txt", Settings(contactSolver=solver))
        recordings.append(record(tmp_path / f"{name}.h5", simulation, 12, change_by_hand))
    simulation = SceneSimulation(DATA / "mixed-scene.txt")
    view = SceneView(simulation)
    viewer = make_viewer(simulation, view, isBasic=False)
    panel = Panel(viewer)
    panel.isSideShown = True
    panel.lay_out()
    view.set_callback(panel.frame)
    user, where = RandomUser(polyscope, panel, recordings, seed=2), Counter()
    while user.counts.total() < 1000:
        user.act()
        simulation = viewer.simulation
        assert simulation.is_finite() and "is limited to" not in viewer.message
        settings = asdict(simulation.settings)
        if viewer.isReplay:
            now = restored_settings(simulation.recording, simulation.stepCount)
            assert settings == asdict(now)
        else:
            assert settings == user.expected
        where["replay" if viewer.isReplay else settings["contactSolver"]] += 1
    viewer.stop_files()
    viewer.release()
    view.set_callback(None)
    names = {name for name in vars(RandomUser) if name.startswith("do_")}
    assert len(names) == 26 and min(user.counts[name] for name in names) >= 10, user.counts
    assert user.scenes == set(SMALL_SCENES) and len(where) == 3 and min(where.values()) >= 50, where
    made = list(tmp_path.glob("out/*/recording*.h5"))
    assert made and all(verify(Recording(path)) == "" for path in made)
