"""What `ptnsbc fleet --backend mavlink` changes in a scenario is said before it flies."""

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.commands.fleet import in_flight


def test_every_override_is_told_beside_what_the_file_says() -> None:
    overrides = {"gains.formation.deadline_s": 9, "formation.tolerance_m": 0.3}
    scenario = load_scenario("paper_5", {"mavlink.overrides": overrides})
    told = list(in_flight(scenario))
    assert told == [
        f"in flight: gains.formation.deadline_s: 9 instead of {scenario.gains.formation.deadline_s} "
        "(mavlink.overrides)",
        f"in flight: formation.tolerance_m: 0.3 instead of {scenario.file.formation.tolerance_m} "
        "(mavlink.overrides)",
    ]
    assert scenario.bridged().gains.formation.deadline_s == 9


def test_without_overrides_there_is_nothing_to_tell() -> None:
    assert list(in_flight(load_scenario("paper_5"))) == []
