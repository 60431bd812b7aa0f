"""Scenes that suggest the soft-step solver: suggestions, and some that stand, slide and swing."""

import pytest
from oracles import DATA
from restingScenes import CHECKS

from rbs.opening.suggestions import recommended_values
from rbs.scenes.scenefiles import SceneSource

RESTING = {"contactSolver": "soft-step", "friction": 0.5, "restitution": 0.0}


def test_scenes_recommend_what_they_rest_with():
    for name in (*CHECKS, "heap", "pile_1000"):
        values = recommended_values(SceneSource.of_files(DATA / f"{name}-scene.txt"))
        assert values == RESTING or name == "cradle", name


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stack", "card_house", "ramp", "round_tower", "cradle"])
def test_scene_shows_what_it_is_named_for(name):
    CHECKS[name]()
