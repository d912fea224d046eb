"""Baselines on the scenario of the paper: who meets the deadline, at what cost, and what is refused."""

from functools import lru_cache

import numpy as np
import pytest

from paper.baselines import LAWS, BaselineError, fly, settled_s
from paper.baselines.settling import tuned
from ptnsbc_core.agent import GAIN, SATURATED
from ptnsbc_sim import swarm
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.swarm import HeadlessFlight

SCENARIO = {"plant.kind": "rigid_body_6dof", "timing.duration_s": 7.0}
WEIGHT_N = 1.2 * 9.81
WITHOUT = ("ptsmc_exponential", "ptsmc_two_sided")


@lru_cache
def flight(law: str, limit_n: float | None = None, settle_s: float | None = None) -> HeadlessFlight:
    return fly(load_scenario("paper_5_free", SCENARIO), law, limit_n, settle_s)


def inputs(flown: HeadlessFlight) -> np.ndarray:
    return np.linalg.norm(flown.track.wrench, axis=2)


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_all_settle_by_the_deadline_where_nothing_limits_them(law: str) -> None:
    settled = settled_s(flight(law))
    assert settled is not None
    assert settled <= 5.0
    assert all(np.all(np.isfinite(part)) for part in flight(law).track)


@pytest.mark.slow
@pytest.mark.parametrize("law", WITHOUT)
def test_our_input_at_the_start_is_sixty_percent_below_theirs(law: str) -> None:
    """The claim of the paper, in the first 0.1 s: at t = 0 itself nobody has heard anybody."""
    assert inputs(flight("ours"))[:10].max() < 0.4 * inputs(flight(law))[:10].max()
    assert inputs(flight("ours")).max() < 0.4 * inputs(flight(law)).max()


@pytest.mark.slow
@pytest.mark.parametrize("law", WITHOUT)
def test_also_when_they_are_tuned_to_settle_when_ours_does(law: str) -> None:
    ours = settled_s(flight("ours"))
    assert ours is not None
    matched = flight(law, None, ours)
    found = settled_s(matched)
    assert found is not None
    assert ours - 0.15 < found <= ours
    assert matched.scenario.gains.formation.deadline_s > 5.0
    assert inputs(flight("ours"))[:10].max() < 0.4 * inputs(matched)[:10].max()


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_an_actuator_limit_holds_for_everybody(law: str) -> None:
    flown = flight(law, 2 * WEIGHT_N)
    force = np.linalg.norm(flown.track.wrench[:, :, :3], axis=2)
    assert force.max() <= 2 * WEIGHT_N + 1e-9
    assert flown.track.diagnostics[:, :, SATURATED].any() or law == "ours"


def test_ours_is_the_swarm() -> None:
    plain = swarm.fly(load_scenario("paper_5_free", SCENARIO))
    for a, b in zip(flight("ours").track, plain.track, strict=True):
        assert a.tobytes() == b.tobytes()


def test_the_cascade_has_constant_gains_and_is_tuned_the_same_every_time() -> None:
    once, again = (
        flight("linear_cascade"),
        fly(load_scenario("paper_5_free", SCENARIO), "linear_cascade"),
    )
    gains = once.scenario.gains
    assert not any(loop.time_base for loop in (gains.formation, gains.force, gains.estimator))
    assert gains == again.scenario.gains
    settled = settled_s(once)
    assert settled is not None
    assert 4.0 < settled <= 5.0
    gain = once.track.diagnostics[:, :, GAIN]
    np.testing.assert_allclose(gain, gains.formation.kappa_1_s)


def test_tuning_finds_the_gentlest_value_that_settles_in_time() -> None:
    ladder = [0.5 * 1.2**step for step in range(20)]
    assert tuned(lambda gain: 4.0 / gain, 2.5, ladder) == pytest.approx(1.6, rel=0.003)
    assert tuned(lambda gain: 0.1, 2.5, ladder) == ladder[0]
    with pytest.raises(BaselineError, match="expected a longer time"):
        tuned(lambda gain: None, 2.5, ladder)


def test_what_cannot_be_compared_is_refused() -> None:
    with pytest.raises(BaselineError, match="expected one of ours, ptsmc_exponential"):
        fly(load_scenario("paper_5_free", SCENARIO), "pid")
    with pytest.raises(BaselineError, match="expected rigid_body_6dof"):
        fly(load_scenario("paper_5_free"), "ptsmc_two_sided")
