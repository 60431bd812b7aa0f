"""The studio look: its light against closed forms, and what pictures hold. Drawn off-screen."""

import math

import numpy as np
from oracles import box_body
from program import require_opengl

from rbs.appearance import studiolight
from rbs.appearance.camera import PictureOptions
from rbs.appearance.drawables import SUN
from rbs.pictures import studio
from rbs.pictures.capture import start_view
from rbs.scenes.simulation import SceneSimulation

SIZE = (160, 90)


def view_of(*meshes):
    """A SceneView of bodies in the studio look."""
    simulation = SceneSimulation.from_meshes(meshes)
    options = PictureOptions(SIZE, look="studio")
    return start_view(simulation, require_opengl(), options)


def on_ground(view, x, z):
    """The visible fraction (m,) of the sun, and the sky light (3, m), at points of the ground."""
    faces, _, _, light = studio.drawn(view, studio.STILL_LAMPS)
    x, z = np.broadcast_arrays(x, z)
    points = np.stack([x, np.zeros(x.shape), z]).astype(np.float32)
    up = np.repeat([[0.0], [1.0], [0.0]], points.shape[1], axis=1).astype(np.float32)
    given = points, up, np.full(points.shape[1], faces.ground)
    return light.sunlight(*given), light.skylight(*given)


def test_a_boxs_shadow_ends_where_the_sun_says_as_softly_as_the_suns_disc_does():
    """A box 6 m high throws the shadow of its upper edge x = 1 onto the ground."""
    x = np.linspace(1.0, 8.0, 400)
    share, _ = on_ground(view_of(box_body(2, 6, 8, (0, 3, 0))), x, 6.0 * -SUN[2] / SUN[1])
    # of the disc, finely: what passes over the edge
    rng = np.random.default_rng(0)
    radius, angle = np.sqrt(rng.random(20_000)), 2.0 * math.pi * rng.random(20_000)
    side = np.cross(SUN, [0, 1, 0]) / np.linalg.norm(np.cross(SUN, [0, 1, 0]))
    across = (radius * np.cos(angle))[:, None] * side
    across += (radius * np.sin(angle))[:, None] * np.cross(side, SUN)
    towards = SUN + math.tan(studiolight.SUN_ANGLE / 2.0) * across
    ends = np.sort(1.0 - 6.0 * towards[:, 0] / towards[:, 1])
    expected = np.searchsorted(ends, x) / len(ends)
    assert 0.2 < np.ptp(ends) < 0.5 and (share[x < ends[0] - 0.05] == 0).all()
    assert (share[x > ends[-1] + 0.05] == 1).all()
    assert np.abs(share - expected).max() < 0.12  # 16 lamps, and a map's pixels of 2 cm
    assert abs(np.trapezoid(share - expected, x)) < 0.01


def test_the_skys_share_beside_a_wall(monkeypatch):
    """In an even sky, among black bodies: 1 less the form factors of both halves of the wall."""
    for name in ("ZENITH", "HORIZON"):
        monkeypatch.setattr(studiolight, name, np.full(3, 1.0 / math.pi))
    monkeypatch.setattr(studiolight, "BETWEEN_BODIES", 0.0)
    wall = view_of(box_body(1, 4, 24, (-0.5, 2, 0)))
    away = np.array([0.3, 1.0, 3.0, 8.0, 20.0])
    slant = np.hypot(4.0, away)
    expected = 1.0 - (np.arctan2(12.0, away) - away / slant * np.arctan2(12.0, slant)) / math.pi
    assert expected[0] < 0.55 and expected[-1] > 0.99
    np.testing.assert_allclose(on_ground(wall, away, 0.0)[1][1], expected, atol=0.02)


def test_what_is_below_a_body_lights_it():
    """The sunlit ground, or without it the sky."""
    view, down = view_of(box_body(2, 2, 2, (0, 8, 0))), np.array([[0.0], [-1.0], [0.0]])
    found = []
    for isThere in (True, False):
        view.simulation.settings.ground = isThere
        _, _, _, light = studio.drawn(view, studio.STILL_LAMPS)
        point = np.array([[0.0], [6.99], [0.0]], np.float32)
        found.append(light.skylight(point, down.astype(np.float32), np.array([0]))[:, 0])
    bounced = studiolight.BELOW_BODIES * studiolight.GROUND * studiolight.OPEN
    np.testing.assert_allclose(found, [bounced, math.pi * studiolight.HORIZON], rtol=1e-3)
