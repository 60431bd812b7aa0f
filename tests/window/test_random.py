"""A user who does things at random, to ten scenes and to recordings, with the panels drawn."""

from collections import Counter
from functools import partial

import numpy as np
import pytest
from hands import bits_of, count_time
from program import DATA, record

from rbs.appearance.colours import COLOURINGS
from rbs.pictures.overlays import OVERLAYS
from rbs.pictures.viewpoint import FRONT, SIDE, TOP
from rbs.recordings.recording import Recording
from rbs.recordings.replay import verify
from rbs.scenes.settingtexts import TEXTS
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.settings import SETTINGS, Settings
from rbs.window.hand import shot
from rbs.window.history import SPEEDS
from rbs.window.panel import SLIDER_ENDS

SMALL_SCENES = "cube mixed tower two_chain roll stack cradle ramp arch dominoes".split()
# Acts that few states allow.
RARE = ["push", "fix", "drag", "release"]


class RandomUser:
    """Does at random what the window allows. Attribute: counts, how often each thing was done."""

    def __init__(self, ps, panel, recordings, seed):
        self.ps, self.panel, self.viewer = ps, panel, panel.viewer
        self.recordings = recordings
        self.random = np.random.default_rng(seed)
        self.counts, self.scenes = Counter(), set()

    def choice(self, values):
        values = list(values)
        return values[self.random.integers(len(values))]

    def pixel(self):
        """The pixel of a body, or the nearest one in the picture."""
        width, height = self.ps.get_window_size()
        place = self.choice(self.viewer.simulation.meshes).position
        x, y = np.nan_to_num(self.viewer.view.pixels_of(place)[0]).round().astype(int).tolist()
        return min(max(x, 0), width - 1), min(max(y, 0), height - 1)

    def act(self):
        """Does something that can be done now, preferring what was done rarely; draws a frame."""
        acts = self.acts()
        weights = 0.8 ** np.array([self.counts[name] for name in acts], dtype=np.float64)
        weights *= np.where(np.isin(list(acts), RARE), 6, 1)
        name = str(self.random.choice(list(acts), p=weights / weights.sum()))
        acts[name]()
        self.counts[name] += 1
        if self.viewer.hand.grab is None:  # else the panel would let go: no mouse button is down
            self.ps.frame_tick()
        else:
            self.viewer.play(0.04)

    def acts(self):
        viewer, view, integers = self.viewer, self.viewer.view, self.random.integers
        acts = {
            "seek": lambda: viewer.seek(int(integers(-2, len(viewer.history.axis) + 3))),
            "play": self.play,
            "step": lambda: [viewer.step_once() for _ in range(integers(1, 4))],
            "back": viewer.step_back,
            "redo": viewer.redo,
            "event": lambda: self.panel.glass.go(self.choice((1, -1))),
            "frame": partial(view.viewpoint.frame, self.choice((None, FRONT, SIDE, TOP))),
            "reset": partial(viewer.restart, True),
            "restart": viewer.restart,
            "pick": lambda: viewer.hand.pick_at(self.pixel()),
            "grab": lambda: viewer.hand.grab_at(self.pixel()),
            "shoot": lambda: viewer.hand.shoot(self.pixel()),
            "open scene": self.open_scene,
            "open recording": lambda: viewer.open(self.choice(self.recordings)),
            "colours": lambda: view.colour_by(self.choice(COLOURINGS)),
            "overlay": lambda: view.show(self.choice(OVERLAYS), bool(integers(2))),
            "picture": self.save_picture,
        }
        acts |= {name: partial(viewer.outputs.toggle, name) for name in ("video", "page")}
        if viewer.isReplay:
            return acts | {"continue": viewer.continue_here}
        acts["record"] = partial(viewer.outputs.toggle, "recording")
        acts["setting"] = self.change_setting
        acts["undo all"] = self.undo_all
        if (mesh := viewer.view.picked_mesh) is not None:
            acts["fix"] = lambda: viewer.hand.set_fixed(not mesh.isFixed)
            if not mesh.isFixed:
                acts["push"] = lambda: viewer.hand.push(self.choice([*np.eye(3), *-np.eye(3)]))
        if viewer.hand.grab is not None:
            acts |= {"drag": self.drag, "release": viewer.hand.release}
        return acts

    def undo_all(self):
        """Goes back as far as possible, and forward to the same bits again."""
        viewer, states = self.viewer, [bits_of(self.viewer.simulation)]
        viewer.step_back()
        while viewer.message != "This is the first step.":
            states.append(bits_of(viewer.simulation))
            viewer.step_back()
        for bits in states[-2::-1]:
            viewer.redo()
            assert bits_of(viewer.simulation) == bits

    def play(self):
        self.viewer.playback.speed = self.choice(SPEEDS)
        self.viewer.toggle_play()

    def drag(self):
        self.viewer.hand.drag_to(self.pixel())
        self.viewer.step_once()

    def open_scene(self):
        name = self.choice(sorted(set(SMALL_SCENES) - self.scenes) or SMALL_SCENES)
        self.viewer.open(name)
        assert self.viewer.message[:6] in ("", "saved ")
        self.scenes.add(name)

    def save_picture(self):
        self.viewer.outputs.save_picture()
        assert self.viewer.message.endswith(".png")

    def change_setting(self):
        settings = self.viewer.simulation.settings
        used = [one for one in SETTINGS.values() if one.is_used_by(settings.contactSolver)]
        one = self.choice(one for one in used if TEXTS[one.name].label)
        if one.kind is bool:
            value = not getattr(settings, one.name)
        elif isinstance(one.kind, tuple):
            value = self.choice(one.kind)
        else:
            low, high = SLIDER_ENDS[one.name]
            value = one.kind(self.random.uniform(low, high))
            if self.random.integers(4) == 0:  # beyond the end of the slider
                value = one.kind(min(3 * high, one.limits[1]))
        self.viewer.set(one.name, value)
        assert getattr(settings, one.name) == value


@pytest.mark.parametrize("count", [40, pytest.param(500, marks=pytest.mark.slow)])
def test_random_actions_raise_nothing_and_change_only_what_they_are_for(
    polyscope, open_panel, tmp_path, monkeypatch, count
):
    count_time(monkeypatch)
    monkeypatch.setattr("rbs.window.panel.ROOMY_HEIGHT", 0)  # sections are open
    monkeypatch.setattr("rbs.pictures.capture.SUPERSAMPLING", 1)

    def change_by_hand(simulation, step):
        if step == 4:
            simulation.add(shot(simulation.meshes, 40.0, [0.0, 9.0, 30.0], [0.0, 0.0, -1.0]))
            simulation.meshes[1].isFixed = True

    recordings = []
    for name, solver in (("tower", "impulse"), ("stack", "soft-step")):
        simulation = SceneSimulation(DATA / f"{name}-scene.txt", Settings(contactSolver=solver))
        recordings.append(record(tmp_path / f"{name}.h5", simulation, 12, change_by_hand))
    panel = open_panel("mixed", size=(640, 150), isBasic=False)
    panel.isSideShown, viewer = True, panel.viewer
    user = RandomUser(polyscope, panel, recordings, seed=2)
    while user.counts.total() < count:
        user.act()
        simulation = viewer.simulation
        assert np.isfinite(simulation.state().rows).all() and "must be" not in viewer.message
        assert "internal error" not in viewer.message
    viewer.outputs.stop()
    if count > 100:
        assert len(user.counts) == 27 and min(user.counts.values()) >= 3, user.counts
        assert user.scenes == set(SMALL_SCENES)
    made = list(tmp_path.glob("out/*/recording*.h5"))
    assert (made or count < 100) and all(verify(Recording(path)) == "" for path in made)
