"""Flights of the experiments: what a run changes, an experiment may set again."""

from paper import flights


def test_settings_of_the_run_reach_every_scenario_and_yield_to_the_experiment() -> None:
    with flights.using({"gains.formation.kappa_1_s": 1.5, "gains.profile": "reference"}):
        for name in flights.SCENARIOS:
            assert flights.scenario(name).gains.formation.kappa_1_s == 1.5
            assert flights.scenario(name).gains.profile == "reference"
            assert flights.scenario(name, {"gains.profile": "paper"}).gains.profile == "paper"
    assert flights.scenario("paper_5").gains.formation.kappa_1_s == 2.2


def test_a_flight_is_flown_once_and_again_after_a_change() -> None:
    short = {"timing.duration_s": 6.0}
    first = flights.fly_judged("paper_5_free", short)
    assert flights.fly_judged("paper_5_free", short) is first
    with flights.using({"gains.formation.kappa_1_s": 0.5}):
        changed = flights.fly_judged("paper_5_free", short)
    assert changed is not first
    assert changed.worst_at_deadline_m() > first.worst_at_deadline_m()
    assert first.inputs.shape == (600, 5)
    assert first.energy_beyond_hover() < first.verdict.energy
