"""Values of a scenario file that are refused because of other keys, and the disturbances that a file may have."""

import math

import pytest

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import PROFILE_PAPER
from ptnsbc_sim.scenario import agent_config, load_scenario

FIXES = {"noise_m": 0.02, "rate_hz": 10}


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("communication.loss", 1.0, "communication.loss: 1.0: expected < 1"),
        ("communication.loss", -0.1, "expected >= 0"),
        ("communication.delay_s", -0.1, "expected >= 0"),
        ("uavs[1].mass_scale", 0, "expected > 0"),
        ("uavs[1].mass_scale", 2.3, "more than the weight of UAV 2, 27.1 N"),
        ("world.gravity_m_s2", 0, "world.gravity_m_s2: 0: expected more than 0"),
        ("uavs[1].position_m", [465000, 5249000, 0], "uavs[1].position_m: [465000.0, 5249000.0"),
        (
            "leader.trajectory",
            {"kind": "hover", "position_m": [465000, 5249000, 5]},
            "leader.trajectory: [465000.0, 5249000.0, 5.0]: expected a place less than 1e+06 m",
        ),
        (
            "mavlink.vehicles",
            {2: {"connect": "udpin:0.0.0.0:99999"}},
            'mavlink.vehicles.2.connect: "udpin:0.0.0.0:99999": expected udpin:ADDRESS:PORT',
        ),
        ("plant.rigid_body.drag_1_s", -1, "expected >= 0"),
        ("communication.delay_s", "0.1 m", "expected the unit s"),
        ("communication.delay_s", 0.5, "less than communication.stale_s (0.5)"),
        ("communication.links", [{"sender": 1, "receiver": 9}], "no messages from UAV 1 to UAV 9"),
        ("communication.links", [{"sender": 5, "receiver": 1}], "no messages from UAV 5 to UAV 1"),
        (
            "communication.links",
            [{"sender": 1, "receiver": 2}] * 2,
            "links[1]: duplicate of communication.links[0]",
        ),
        (
            "communication.links",
            [{"sender": 1, "receiver": 2, "delay_s": 0.6}],
            "links[0].delay_s: 0.6: expected less than",
        ),
        ("world.gust_m_s", [1, -1, 0], "world.gust_m_s[1]: -1: expected >= 0"),
        ("world.gust_time_s", 0, "expected > 0"),
        ("sensor.positioning", {**FIXES, "rate_hz": 30}, "sensor.positioning.rate_hz: 30: "),
        ("sensor.positioning", {**FIXES, "latency_s": 0.055}, "a multiple of the control period"),
        ("sensor.positioning", {**FIXES, "latency_s": 2}, "expected <= 1"),
        (
            "sensor.positioning",
            {**FIXES, "noise_m": 0},
            "sensor.positioning.noise_m: 0: expected > 0",
        ),
        ("sensor.positioning", {"noise_m": 0.02}, "sensor.positioning.rate_hz: missing"),
        ("sensor.positioning", {**FIXES, "noise": 1}, '"noise_m"'),
        (
            "sensor.positioning",
            {**FIXES, "latency_s": 0.05, "unknown_latency_s": 0.06},
            "unknown_latency_s: 0.06: expected at most latency_s (0.05)",
        ),
        (
            "sensor.positioning",
            {**FIXES, "latency_s": 0.05, "unknown_latency_s": 0.004},
            "unknown_latency_s: 0.004: expected a multiple",
        ),
        ("sensor.noise_m", -0.01, "sensor.noise_m: -0.01: expected >= 0"),
        (
            "formation.sight_m",
            0.3,
            "expected at most half of the smallest keep-out of a UAV (0.5 m)",
        ),
        ("formation.tolerance_m", 0, "expected > 0"),
        ("gains.formation.time_base", "no", "expected true or false"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(key: str, value: object, expected: str) -> None:
    with pytest.raises(PtnsbcError) as caught:
        load_scenario("paper_5", {key: value})
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("plant.rigid_body.max_force_n", 1, "expected more than the weight, 11.8 N"),
        ("uavs[2].max_force_n", 1, "uavs[2].max_force_n: 1: expected more than the weight of UAV"),
        ("uavs[2].attitude_rad", [0, 1.5707963267, 0], "uavs[2].attitude_rad[1]: 1.5708: expected"),
    ],
)
def test_a_rigid_body_that_cannot_fly_is_refused(key: str, value: object, expected: str) -> None:
    with pytest.raises(PtnsbcError) as caught:
        load_scenario("paper_5", {"plant.kind": "rigid_body_6dof", key: value})
    assert expected in str(caught.value)


def test_units_may_be_repeated() -> None:
    fixes = {"noise_m": "0.02 m", "rate_hz": "10 Hz", "latency_s": "0.05 s"}
    scenario = load_scenario("paper_5", {"sensor.positioning": fixes})
    assert scenario.sensor.positioning is not None
    assert scenario.sensor.positioning.latency_s == 0.05


def test_what_is_imperfect() -> None:
    assert not load_scenario("paper_5").imperfect
    assert not load_scenario("experiment_4_calm").imperfect
    for key, value in (
        ("communication.loss", 0.01),
        ("communication.delay_s", 0.01),
        ("communication.links", [{"sender": 1, "receiver": 2, "loss": 0.01}]),
        ("world.gust_m_s", [0, 0, 0.1]),
        ("sensor.positioning", FIXES),
        ("sensor.noise_m", 0.01),
        ("sensor.velocity_noise_m_s", 0.01),
    ):
        assert load_scenario("paper_5", {key: value}).imperfect


@pytest.mark.parametrize("profile", ["paper", "soft", "reference"])
def test_a_loop_without_a_time_base_has_its_own_constant_gain(profile: str) -> None:
    changes = {
        "gains.profile": profile,
        "gains.formation.time_base": False,
        "gains.formation.scale": 0.5,
        "gains.estimator.time_base": False,
    }
    config = agent_config(load_scenario("paper_5", changes), 2)
    assert config.formation.residual == math.inf
    assert (config.formation.scale, config.formation.kappa) == (0.5, 2.2)
    assert config.formation.profile == PROFILE_PAPER
    assert config.estimator.residual == math.inf
    assert config.attitude.residual < 1.0
