"""The mavlink block: defaults that fit PX4's simulations, and everything twice refused."""

import pytest

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import load_scenario


def scenario(**block):
    return load_scenario("paper_5", {"mavlink": block})


def test_without_an_entry_a_vehicle_is_the_px4_simulation_of_its_number():
    links = [load_scenario("paper_5").vehicle_link(uav) for uav in (1, 3)]
    assert [link.connect for link in links] == ["udpin:127.0.0.1:14540", "udpin:127.0.0.1:14542"]
    assert [link.sysid for link in links] == [1, 3]
    assert links[0].autopilot == "px4"


def test_own_entries_win():
    block = {
        "autopilot": "ardupilot",
        "setpoint": "attitude",
        "vehicles": {
            2: {
                "connect": "serial:/dev/ttyACM0:921600",
                "sysid": 42,
                "autopilot": "px4",
                "tilt_lag_s": 0.4,
                "label": "red, Ada",
            },
            3: {"setpoint": "velocity"},
        },
    }
    link = scenario(**block).vehicle_link(2)
    assert link[:6] == ("serial:/dev/ttyACM0:921600", 42, "px4", "attitude", None, None)
    assert (link.velocity_loop_1_s, link.tilt_lag_s, link.label) == (None, 0.4, "red, Ada")
    others = [scenario(**block).vehicle_link(uav) for uav in (1, 3)]
    assert [other.autopilot for other in others] == ["ardupilot", "ardupilot"]
    assert [other.setpoint for other in others] == ["attitude", "velocity"]


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ({"vehicles": {2: {"sysid": 1}}}, r"mavlink.vehicles.2.sysid: 1: duplicate .* UAV 1"),
        (
            {"vehicles": {3: {"connect": "udpin:0.0.0.0:14540"}}},
            r"mavlink.vehicles.3.connect: .*duplicate .* UAV 1: expected every vehicle to have its own",
        ),
        (
            {"vehicles": {1: {"signing_key": "k"}, 2: {"signing_key": "k"}}},
            r"mavlink.vehicles.2.signing_key: k: duplicate",
        ),
        ({"vehicles": {9: {}}}, r"mavlink.vehicles.9: no such UAV: expected one of .* 1, 2, 3"),
        ({"vehicles": {1: {"connect": "tls:1.2.3.4:5"}}}, r"connect: .*expected udpin:ADDRESS"),
        ({"rate_hz": 10}, r"mavlink.rate_hz: 10: expected >= 20"),
        ({"rate_hz": 200}, r"mavlink.rate_hz: 200: expected <= 100"),
        ({"setpoint": "speed"}, r"mavlink.setpoint: .speed.: "),
        ({"geofence": {"box_min_m": [0, 0, 0]}}, r"expected box_min_m and box_max_m, or neither"),
        (
            {"geofence": {"box_min_m": [0, 0, 0], "box_max_m": [1, 1, 0]}},
            r"box_max_m: 0: expected more than box_min_m, 0",
        ),
        ({"overrides": {"timing.control_hz": 50}}, r"overrides.timing.control_hz: expected a key"),
        ({"takeoff_height": 3}, r"mavlink.takeoff_height: unknown key: did you mean"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(block, message):
    with pytest.raises(PtnsbcError, match=message) as refused:
        scenario(**block)
    assert "\n" not in str(refused.value)


def test_overrides_hold_with_real_vehicles_only():
    changes = {"gains.formation.kappa_1_s": 1.1, "formation.task": "relative_position"}
    simulated = scenario(overrides=changes)
    assert simulated.gains.formation.kappa_1_s == 2.2
    real = simulated.bridged()
    assert real.gains.formation.kappa_1_s == 1.1
    assert real.formation.task == "relative_position"
    assert real.bridged().text == real.text
    with pytest.raises(PtnsbcError, match=r"gains.formation.kapa: unknown key"):
        scenario(overrides={"gains.formation.kapa": 1.1}).bridged()


def test_uavs_come_and_go_with_real_vehicles_too():
    relay = load_scenario("relay")
    assert relay.bridged().text == relay.text
    assert relay.bridged().formation.reconfigures
