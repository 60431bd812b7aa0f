"""The window's step under glass: events one by one, what the picture shows of them, and clicks."""

import re

import numpy as np
import pytest
from hands import Hands, bits_of, make_steps
from program import DATA
from studentVariants import write_submission

from rbs.glass.events import Kind
from rbs.glass.terms import values
from rbs.glass.trace import deviations
from rbs.pictures.viewpoint import apply_camera, present_camera
from rbs.program.submittedsteps import SubmittedSteps
from rbs.scenes import shapes
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.settings import Settings
from rbs.window.glass import sentence


@pytest.fixture
def open_at(open_panel, polyscope):
    """A function of a scene, steps and settings: the panel over it, after these steps."""

    def start(scene, steps, **settings):
        panel = open_panel(scene, Settings(**settings))
        make_steps(panel.viewer, steps)
        polyscope.frame_tick()
        return panel

    return start


def test_events_go_forth_and_back_through_steps(open_at, polyscope):
    hands = Hands(polyscope, {})
    panel = open_at("slide", 41, friction=0.5)
    viewer, glass = panel.viewer, panel.glass
    bits = bits_of(viewer.simulation)
    hands.key("Key_E")  # of the last step
    assert (viewer.simulation.stepCount, glass.place) == (41, glass.shown()[0])
    assert glass.events[glass.place].kind == Kind.CONTACT
    assert 0 < glass.height <= panel.picture.height / 3 + 1
    glass.skips = False
    hands.key("Mod_Shift", lambda: hands.key("Key_E"))
    count, first = len(glass.events), glass.place
    assert glass.events[first].kind == Kind.FLIGHT
    for place in range(first + 1, count):
        hands.key("Key_E")
        assert (viewer.simulation.stepCount, glass.place) == (41, place)
    assert bits_of(viewer.simulation) == bits  # the picture alone goes through the step
    hands.key("Key_E")
    assert (viewer.simulation.stepCount, glass.place) == (42, 0)
    assert glass.events[0].kind == Kind.FLIGHT
    hands.key("Mod_Shift", lambda: hands.key("Key_E"))
    assert (viewer.simulation.stepCount, glass.place) == (41, count - 1)
    assert bits_of(viewer.simulation) == bits
    hands.key("Key_Escape")
    assert glass.events is None and viewer.view.highlight is None


def test_constraints_that_hold_are_skipped_but_not_if_nothing_else_is_there(open_at):
    glass = open_at("tower_chain", 3).glass
    glass.go()
    kinds = {event.kind for event in glass.events}
    assert kinds == {Kind.FLIGHT, Kind.CONSTRAINT}
    assert {glass.events[k].kind for k in glass.shown()} == {Kind.CONSTRAINT}
    make_steps(glass.viewer, 40)
    glass.open()
    shown = [glass.events[k] for k in glass.shown()]
    assert len(shown) < len(glass.events) and Kind.CONSTRAINT in {event.kind for event in shown}
    assert not any(event.given.get("isValid") for event in shown)


def test_bodies_are_as_after_the_event_and_arrows_as_in_the_formula(open_at):
    panel = open_at("slide", 41, friction=0.5)
    view, glass, state = panel.viewer.view, panel.glass, panel.viewer.simulation.state()
    glass.go()
    names = set()
    for place, event in enumerate(glass.events):
        glass.show(place)
        poses, _, arrows = view.highlight
        for body, after in zip(event.bodies, event.after, strict=True):
            assert np.array_equal(poses[:, body], np.concatenate(after[:2]))
        names |= {name.split(":")[0] for name in arrows}
        if event.kind in (Kind.IMPULSE, Kind.FRICTION):
            found, push = values(event), ("j", "n") if event.kind == Kind.IMPULSE else ("f", "t")
            for name, way in (("n", "n"), ("u", "u"), ("r2", "r2"), (f"{push[0]} on 2", push[1])):
                point, arrow, _ = arrows[name]
                lengths = np.linalg.norm(found[way]) * np.linalg.norm(arrow)
                assert found[way] @ arrow == pytest.approx(lengths)
                assert np.allclose(point + (name == "r2") * arrow, found["p"])
    assert {"n", "r2", "u", "u′", "j on 2", "f on 2", "COM2"} <= names
    assert np.array_equal(poses, np.hstack([state["positions"], state["orientations"]]).T)


def test_what_is_nothing_is_neither_told_nor_drawn(open_panel):
    """Boxes that fall side by side do not move relative to each other. Forces are in MN."""
    for settings, kinds, height in (
        ({}, {Kind.IMPULSE, Kind.FRICTION}, 9.0),
        ({"contactSolver": "soft-step"}, {Kind.POINT}, 0.5),
    ):
        boxes = [shapes.box((1, 1, 1), 1e6, (x, height, 0)) for x in (0, 1)]
        settings = Settings(friction=0.5, **settings)
        panel = open_panel(SceneSimulation.from_meshes(boxes, settings=settings))
        make_steps(panel.viewer, 1)
        panel.glass.go()
        told = {event.kind: sentence(event) for event in panel.glass.events}
        assert kinds <= told.keys() and not re.search(r"\b0 (m|rad)/s|e[+-]\d", str(told))
        for place in range(len(panel.glass.events)):
            panel.glass.show(place)
            arrows = panel.viewer.view.highlight.arrows.values()
            assert all(np.linalg.norm(arrow) > 1e-9 for _, arrow, _ in arrows)


def test_the_camera_goes_back_after_the_events_unless_a_hand_moved_it(open_at):
    panel = open_at("slide", 41)
    viewpoint, before = panel.viewer.view.viewpoint, present_camera()
    for isMoved in (False, True):
        panel.glass.go()
        panel.glass.go()
        apply_camera(before._replace(eye=before.eye + 1.0, centre=before.centre + 1.0))
        if isMoved:
            viewpoint.stay()
        panel.glass.close()
        eye = before.eye + isMoved * np.ones(3)
        assert np.allclose(present_camera().eye, eye, atol=1e-4)


@pytest.mark.parametrize(
    "settings", [{}, {"contactSolver": "soft-step"}, {"contactScheduling": "batches"}]
)
def test_a_contact_is_shown_by_its_number_in_each_solver(settings, open_at):
    panel = open_at("slide", 60, friction=0.5, **settings)
    contact = panel.viewer.simulation.report.contacts[1]
    panel.glass.show_contact(2)
    event = panel.glass.events[panel.glass.place]
    isSoft = settings.get("contactSolver") == "soft-step"
    assert event.kind == (Kind.POINT if isSoft else Kind.IMPULSE)
    assert event.bodies == (contact.body1, contact.body2)
    assert values(event)["j"] == pytest.approx(contact.impulse, rel=1e-9)


def test_the_first_difference_of_a_student_is_shown_where_it_is(open_panel, tmp_path):
    edit = "total + np.sum(c1 * (c1 @ invI1.T)) + ", "total + "
    submitted = SubmittedSteps(write_submission(tmp_path / "theirs", [edit]))
    theirs = SceneSimulation(DATA / "mixed-scene.txt", submitted=submitted)
    panel = open_panel(theirs, size=(1280, 720))
    make_steps(panel.viewer, 46)
    found, glass = theirs.beside.difference, panel.glass
    glass.show_difference(found)
    assert theirs.stepCount == found.step < 46 and glass.hint
    assert set(found.symbols) <= set(deviations(glass.events[glass.place]))


def test_there_are_no_events_at_the_start_or_after_something_by_hand(open_at):
    viewer, glass = (panel := open_at("mixed", 0)).viewer, panel.glass
    glass.go(-1)
    assert not glass.events and viewer.message
    glass.go()
    assert viewer.simulation.stepCount == 1 and glass.events
    viewer.set("gravity", 3.0)  # the step is repeated with its own
    glass.skips = False
    glass.go(-1)
    assert glass.events and viewer.simulation.settings.gravity == 3.0
    viewer.view.pick(0, viewer.view.poses[:3, 0])
    viewer.hand.push([0.0, 1.0, 0.0])
    glass.go(-1)
    assert not glass.events and viewer.message
    glass.go()
    assert viewer.simulation.stepCount == 2 and glass.events and not viewer.message


def test_a_jump_is_found_however_long_ago_and_events_begin_with_the_selected_body(open_at):
    """Of a box that falls onto the ground: its impulse there is the only jump."""
    viewer, glass = (panel := open_at("singlebox", 10)).viewer, panel.glass
    viewer.view.pick(0, viewer.view.poses[:3, 0])
    glass.show_jump()
    assert not glass.events and viewer.message
    while viewer.simulation.meshes[0].linVelocity[0, 1] <= 0.0:
        viewer.step_once()
    hit = viewer.simulation.stepCount
    make_steps(viewer, 8)
    glass.show_jump()
    assert viewer.simulation.stepCount == hit
    assert glass.events[glass.place].kind == Kind.IMPULSE
    glass = (panel := open_at("mixed", 60)).glass
    panel.viewer.view.pick(3, panel.viewer.view.poses[:3, 3])
    glass.skips = False
    glass.go()
    assert glass.events[glass.place].bodies == (3,)
