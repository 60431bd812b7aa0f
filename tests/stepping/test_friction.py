"""Friction: boxes that slide on a level and on slopes, in closed forms.

Boxes are 12 x 6 x 8 m, a step is 0.02 s, and a contact has one point. A box that lies is held at
one place after the other and rocks: at the end of a step it falls with 0.2 to 0.6 m/s and its
lower side swings to and fro with up to 0.4 m/s. Tests that allow for it say how.
"""

import numpy as np
import pytest
from oracles import box_body, ground

from RBSFunctions import run_timestep

G = 9.8
H = 0.02  # seconds
FAST = 10.0  # m/s


def slide(mu, e, floor):
    """x and velocity after each step, (n,) and (n, 3), of a box with 10 m/s along x.

    It goes on for a tenth longer than the sliding should last.
    """
    mesh, groundMesh = box_body(12, 6, 8, (0, 3, 0)), None
    mesh.linVelocity[:] = FAST, 0, 0
    slab = box_body(1000, 100, 1000, (0, -50, 0), isFixed=True)
    meshes = {"ground": [mesh], "body before": [slab, mesh], "body after": [mesh, slab]}[floor]
    if floor == "ground":
        groundMesh = ground()
    x, v = [], []
    for _ in range(round(1.1 * FAST / (mu * G) / H)):
        run_timestep(meshes, groundMesh, H, e, mu=mu)
        x.append(mesh.position[0, 0])
        v.append(mesh.linVelocity[0].copy())
    return np.array(x), np.array(v)


@pytest.mark.parametrize(
    ("mu", "e", "floor"),
    [(0.1, 0.5, "ground"), (0.6, 0.0, "body before"), (0.6, 0.5, "body after")],
)
def test_sliding_box_stops_where_it_should(mu, e, floor):
    x, v = slide(mu, e, floor)
    distance, expected = x[-1], FAST**2 / (2 * mu * G)
    # From 51.0 m with μ = 0.1 to 8.5 m with μ = 0.6. The mean deceleration, v²/2 by the distance,
    # is off by as much the other way.
    assert FAST**2 / (2 * distance) == pytest.approx(mu * G, rel=0.1)
    assert abs(v[-1, 0]) < 2 * G * H  # what is left is the rocking

    # The friction lags behind by the fall that one contact leaves, w = -v_y, 0.1 to 0.6 m/s, for
    # v_0/(μ g): v_0 w/g further. And a step moves before it slows: half a step with v_0 further.
    w = -v[v[:, 0] > 0.1 * FAST, 1].mean()
    assert distance == pytest.approx(expected + FAST * w / G + FAST * H / 2, rel=0.01)
