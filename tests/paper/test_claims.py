"""A test per claim of the paper, on short flights: what docs/results.md says must go on being so."""

import numpy as np
import pytest

from paper import claims
from paper.baselines import BaselineError
from paper.claims import FAILS, HOLDS
from paper.experiments import (
    baselines,
    cost,
    estimator,
    experiment,
)
from paper.figures.inputs import PAPER_LIMIT_N
from paper.flights import fly_judged
from ptnsbc_sim.scenario import agent_config
from ptnsbc_sim.world import World
from ptnsbc_tools.sweeps.summary import share

SECONDS = 12.0


def flights(scenario: str) -> dict:
    common = {"plant.kind": "rigid_body_6dof", "timing.duration_s": SECONDS}
    return {
        name: fly_judged(scenario, {**common, "gains.profile": name}) for name in ("paper", "soft")
    }


def test_words_of_a_verdict() -> None:
    assert claims.verdict({"paper": True, "soft": False}) == HOLDS
    assert claims.verdict({"paper": False, "soft": True}) == "holds when soft"
    assert claims.verdict({"a": True, "b": True}, "paper") == "holds when a or b"
    assert claims.verdict({"paper": False, "soft": False}) == FAILS


@pytest.mark.parametrize("scenario", ["paper_5", "paper_5_free", "paper_20"])
def test_a_formation_is_judged_by_the_share_of_its_flights(scenario: str) -> None:
    shares = {"ours": share(200, 200), "soft": share(186, 200), "paper": share(3, 200)}
    claim = claims.formation_claim(scenario, shares)
    assert claim.verdict == "holds when the approach is planned"  # 186 of 200: at least 88.6 %
    assert "paper: 3 of 200, 1.5 % (0.5 to 4.3 %)" in claim.ours
    assert claims.formation_claim(scenario, {"paper": share(0, 200)}).verdict == FAILS
    assert claims.formation_claim(scenario, {"paper": share(200, 200)}).verdict == HOLDS
    assert claims.experiment_claim(shares).verdict == claim.verdict


def test_twenty_uavs_below_500_n() -> None:
    common = {"plant.kind": "rigid_body_6dof", "timing.duration_s": 8.0}
    found = {
        name: fly_judged("paper_20", {**common, "gains.profile": name})
        for name in ("paper", "soft")
    }
    assert claims.twenty_inputs_claim(found, PAPER_LIMIT_N).verdict == HOLDS
    assert claims.twenty_inputs_claim(found, 20.0).verdict == FAILS
    assert max(one.peak_input() for one in found.values()) < PAPER_LIMIT_N / 10


def test_velocities_follow_their_commands_after_tf3() -> None:
    found = flights("paper_5_free")
    assert claims.velocity_claim(found).verdict == "holds when the profile is soft"
    assert claims.velocity_claim({"paper": found["paper"]}).verdict == FAILS


def test_the_first_force_of_profile_soft_is_the_weight() -> None:
    found = flights("paper_5_free")
    assert abs(found["soft"].initial_beyond_hover_n()) < 0.3
    assert found["paper"].initial_beyond_hover_n() > 10.0


def test_the_estimate_needs_the_velocity_of_the_leader() -> None:
    ours, printed = (estimator.flight(case, 8.0) for case in estimator.CASES[:2])
    claim = estimator.estimator_claim(ours, printed)
    assert claim.verdict == "holds when the leader's velocity is fed forward"
    assert estimator.worst_estimate_from(ours, 5.0) < 1e-3
    assert estimator.estimator_claim(printed, printed).verdict == FAILS
    assert estimator.estimator_claim(ours, ours).verdict == HOLDS


def test_a_follower_hears_no_more_when_there_are_more() -> None:
    loads = {size: cost.tick_load(cost.tree(size)) for size in (5, 20, 50)}
    assert (
        loads[50].sent == loads[20].sent == 5
    )  # state to two children, estimate to these and its parent
    assert (
        loads[50].received == loads[20].received == 5
    )  # parent, leader, own parent's and two children's
    assert loads[50].sent_by_leader == 49
    flat, steep = dict.fromkeys(loads, 10.0), {5: 10.0, 20: 20.0, 50: 30.0}
    assert cost.cost_claim(loads, flat).verdict.startswith(HOLDS)
    assert cost.cost_claim(loads, steep).verdict == FAILS


def test_a_follower_computes_with_no_more_when_there_are_more() -> None:
    """The step is one compiled function: what it works on decides how much it has to do.

    The slots of the others are as many as the others. They are searched only for a UAV that a straight path would meet.
    """
    sizes = []
    for size in (20, 50):
        scenario = cost.tree(size)
        deepest = scenario.followers[-1]
        known = cost.follower_inputs(scenario, World(scenario), deepest)
        config = agent_config(scenario, deepest)
        config = config._replace(other_slots=config.other_slots[:1])
        sizes.append([np.shape(part) for part in (*known, *config) if isinstance(part, np.ndarray)])
    assert sizes[0] == sizes[1]


def test_with_few_links_the_graph_weakens_instead() -> None:
    few = {size: cost.tick_load(cost.tree(size, all_linked=False)) for size in (5, 50)}
    assert few[50].sent_by_leader == few[5].sent_by_leader == 2
    assert few[50].lambda_min < few[5].lambda_min / 5


@pytest.mark.slow
def test_the_initial_input_is_far_below_that_of_the_baselines_but_not_as_printed() -> None:
    laws, way = baselines.PREDEFINED, baselines.LawVariant()
    found = {**baselines.ours(), **{law: baselines.flight(law, way) for law in laws}}
    claim = claims.initial_claim("initial", found, None, 60.0, laws)
    assert claim.verdict == (
        "holds when the printed gains are flown behind a command filter or the profile is soft"
    )
    assert claims.initial_claim("x", found, None, 99.0, laws).verdict == FAILS
    for law in laws:
        assert claims.initial_reduction(found, "ours, soft", law) > 90.0
        settled = found[law].settled_s()
        assert settled is not None and settled < 5.0  # or it would be no rival
    assert claims.energy_claim(found, found, laws).verdict.startswith("holds when ")
    assert "the profile is soft" in claims.energy_claim(found, found, laws).verdict
    thrifty = {**found, laws[0]: found["ours, soft"]}
    assert claims.energy_claim(thrifty, found, laws).verdict == FAILS


@pytest.mark.slow
def test_with_twenty_uavs_the_initial_input_is_far_below_too_but_not_as_printed() -> None:
    laws, way = baselines.PREDEFINED, baselines.LawVariant(name="paper_20")
    found = {**baselines.ours("paper_20"), **{law: baselines.flight(law, way) for law in laws}}
    claim = claims.initial_claim("twenty", found, None, 66.0, laws)
    assert claim.said.startswith("With twenty UAVs") and claim.number == "at least 66 %"
    assert claim.verdict == (
        "holds when the printed gains are flown behind a command filter or the profile is soft"
    )
    for law in laws:
        assert claims.initial_reduction(found, claims.PRINTED, law) < 66.0
        assert claims.initial_reduction(found, "ours, soft", law) > 90.0
        assert found[law].within_at(5.0) == 20  # or it would be no rival
    assert claims.initial_claim("twenty", found, None, 99.0, laws).verdict == FAILS


@pytest.mark.slow
def test_limited_actuators_limit_every_law_and_each_is_flown_from_the_same_draws() -> None:
    limit_n, laws = 23.5, baselines.PREDEFINED
    variant = baselines.LawVariant(limit_n=limit_n)
    found = {
        **baselines.ours(limit_n=limit_n),
        **{law: baselines.flight(law, variant) for law in laws},
    }
    assert max(one.force.max() for one in found.values()) <= limit_n * (1 + 1e-9)
    from_file = baselines.shares_in_time(found, runs=1, starts="file")
    for law, one in found.items():
        assert from_file[law].count == (one.within_at(5.0) == 5), law
    drawn = baselines.shares_in_time({"ours, soft": found["ours, soft"]}, runs=3)
    assert drawn["ours, soft"].of == 3


def test_a_law_suits_limited_actuators_when_its_share_is_sure() -> None:
    sure, half = share(200, 200), share(100, 200)
    shares = {**dict.fromkeys(claims.CASES, half), "ours, soft": sure}
    shares |= {"one": sure, "other": half}
    claim = claims.saturated_claim(shares, 5.0, 23.5, ("one", "other"))
    assert claim.verdict == "holds when the profile is soft; one does too"
    assert "ours, soft: 200 of 200" in claim.ours and "at 5 s" in claim.ours
    late = {**shares, "ours, soft": half}
    assert claims.saturated_claim(late, 5.0, 23.5, ("one", "other")).verdict == FAILS


@pytest.mark.slow
def test_the_cascade_is_compared_at_the_settling_it_reaches() -> None:
    settle_s, found = baselines.cascade_settling()
    assert set(found) == {"ours, soft", "ours, reference", *baselines.PREDEFINED, baselines.CASCADE}
    for one in found.values():
        settled = one.settled_s()
        assert settled is not None
        assert settle_s - baselines.MATCHED_S < settled <= settle_s
    mine, cascade = found["ours, soft"], found[baselines.CASCADE]
    assert mine.initial_input() < 0.6 * cascade.initial_input()
    assert mine.energy_beyond_hover() < 0.5 * cascade.energy_beyond_hover()


@pytest.mark.slow
def test_a_cascade_behind_an_opened_filter_settles_when_ours_does() -> None:
    wanted_s = 4.0
    with pytest.raises(BaselineError):
        baselines.flight(baselines.CASCADE, baselines.LawVariant(settle_s=wanted_s))
    one = baselines.flight(
        baselines.CASCADE, baselines.LawVariant(settle_s=wanted_s, open_filter=True)
    )
    settled = one.settled_s()
    assert settled is not None and wanted_s - baselines.MATCHED_S < settled <= wanted_s
    assert 10.0 < one.scenario.gains.filter.max_acceleration_m_s2 < 15.0
    ours = baselines.flight("ours", baselines.LawVariant())
    assert ours.initial_input() < 0.6 * one.initial_input()


def test_what_settles_at_another_time_is_named() -> None:
    late = baselines.flight("ours", baselines.LawVariant(profile="reference"))
    good = baselines.flight("ours", baselines.LawVariant())
    settled_s = good.settled_s()
    assert settled_s is not None
    table = baselines._table("t", "T", {"ours, soft": good, "ours, reference": late}, (), settled_s)
    assert "No match" in table.meaning and "*ours, reference* settles at 5.1" in table.meaning
    assert "*ours, soft* settles" not in table.meaning
    alone = baselines._table("t", "T", {"ours, soft": good}, (), settled_s)
    assert "No match" not in alone.meaning


def test_told_places_alone_would_not_keep_the_experiment_s_promise() -> None:
    own_m, pair_m, share = experiment.fixes_only_bound(0.05)
    assert own_m == pytest.approx(0.0095, abs=1e-4)
    assert pair_m == pytest.approx(own_m * 6**0.5)
    assert 0.98 < share < 0.995
    assert experiment.fixes_only_bound(0.06)[2] > share
    short = {"timing.duration_s": 6.0, "formation.sight_m": 0}
    blind = [fly_judged("experiment_4", {"seed": seed, **short}) for seed in range(1, 7)]
    assert max(one.worst_at_deadline_m() for one in blind) > 0.05
