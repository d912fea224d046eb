"""Results that are kept for a block."""

from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.scenario.fields import kept


def test_the_newest_result_is_kept_for_the_very_block() -> None:
    asked = []

    @kept
    def name_of(scenario: Scenario) -> str:
        asked.append(scenario)
        return scenario.name

    first = load_scenario("paper_5")
    twin = first.model_copy()
    assert [name_of(one) for one in (first, first, twin, twin, first)] == ["paper_5"] * 5
    assert len(asked) == 3
