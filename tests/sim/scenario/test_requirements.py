"""What one choice needs of other keys: a need that is not met names its key."""

from typing import Any

import pytest

from ptnsbc_sim.scenario import ScenarioError, load_scenario
from ptnsbc_sim.scenario.requirements import REQUIREMENTS


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (
            {"formation.turn_rad": 0.5, "formation.assignment": "optimal"},
            "formation.assignment: optimal: expected fixed beside formation.turn_rad",
        ),
        (
            {"formation.frame": "heading"},
            "formation.task: distance_angles: expected relative_position beside a shape that moves",
        ),
        (
            {"mission": {"legs": [{"kind": "form"}]}, "formation.approach": "task"},
            "formation.approach: task: expected planned beside mission.legs",
        ),
    ],
)
def test_a_need_that_is_not_met_names_its_key(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(ScenarioError) as error:
        load_scenario("paper_5", keys)
    assert words in str(error.value)


def test_every_choice_is_listed_once() -> None:
    choices = [requirement.choice for requirement in REQUIREMENTS]
    assert len(set(choices)) == len(choices)
