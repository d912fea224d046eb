"""The ros block: names of topics and services, and what a vehicle behind them has of the rest of the scenario."""

import pytest

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import load_scenario


def link(uav=1, **ros_keys):
    keys = {f"ros.{key}": value for key, value in ros_keys.items()}
    return load_scenario("lab_4", keys).bridged(ros=True).vehicle_link(uav)


def test_names_hold_the_id_and_the_name_of_a_vehicle():
    own = {2: {"name": "cf231", "output": "/{name}/cmd_{n}"}, 3: {"pose": "/three"}}
    ros = [link(uav, vehicles=own, name="cf{n}").ros for uav in (1, 2, 3)]
    assert [one.pose for one in ros] == ["/cf1/pose", "/cf231/pose", "/three"]
    assert [one.output for one in ros] == ["/cf1/cmd_vel", "/cf231/cmd_2", "/cf3/cmd_vel"]
    assert [one.services["land"][0].service for one in ros] == [
        "/cf1/land", "/cf231/land", "/cf3/land",
    ]  # fmt: skip


def test_the_profile_and_the_kind_of_setpoint_follow_from_what_it_takes():
    plain = link()
    assert (plain.connect, plain.autopilot, plain.setpoint) == (
        "ros:uav1", "ros_take_off", "velocity",
    )  # fmt: skip
    assert plain.origin_m == (0.0, 0.0, 0.0)
    assert link(services={"take_off": []}).autopilot == "ros"
    full = link(services={}, fields={"position": "transforms.0.translation"})
    assert (full.autopilot, full.setpoint) == ("ros", "position_velocity")


def test_mavlink_and_ros_fly_side_by_side():
    keys = {"mavlink.vehicles": {2: {"autopilot": "px4"}}}
    mixed = load_scenario("lab_4", keys).bridged(ros=True)
    assert mixed.vehicle_link(2).ros is None
    assert mixed.vehicle_link(2).connect.startswith("udpin:")
    assert load_scenario("lab_4").bridged().vehicle_link(1).ros is None


@pytest.mark.parametrize(
    ("name", "keys", "why"),
    [
        ("take_off_4", {}, "ros: missing: expected topics, for mavlink.autopilot: ros"),
        ("lab_4", {"ros.fields": {"speed": "twist.linear"}}, "ros.fields"),
        ("lab_4", {"ros.pose_type": "std_msgs/msg/Empty"}, 'ros.pose_type: "std_msgs/msg/Empty"'),
        ("lab_4", {"ros.output_type": "Twist"}, "ros.output_type: "),
        ("lab_4", {"ros.services": {"start": []}}, "ros.services"),
        ("lab_4", {"ros.vehicles": {1: {"name": "a"}, 2: {"name": "a"}}},
         r"ros.vehicles.2.name: a: duplicate of that of UAV 1"),
        ("lab_4", {"ros.output": "/cmd"}, r"ros.vehicles.2.output: /cmd: duplicate of that of UAV 1"),
        ("lab_4", {"ros.vehicles": {7: {"name": "a"}}}, "ros.vehicles.7: no such UAV"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_with_its_key(name, keys, why):
    with pytest.raises(PtnsbcError, match=why):
        load_scenario(name, keys).bridged(ros=True)


def test_a_class_of_the_user_takes_all_that_is_known_of_a_setpoint(tmp_path):
    (tmp_path / "mine.py").write_text("class Mine: pass\n")
    file = tmp_path / "mine.yaml"
    file.write_text("extends: lab_4\nname: mine\nplugins: {vehicle: mine.py:Mine}\n")
    mine = load_scenario(file).bridged(ros=True)
    assert mine.plugins.vehicle == f"{tmp_path / 'mine.py'}:Mine"
    assert mine.vehicle_link(1).setpoint == "position_velocity"
