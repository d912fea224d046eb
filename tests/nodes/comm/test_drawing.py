"""Markers made of recorded odometry, and the URDF of a UAV: mass, inertia and shape, and that viewers get it."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from ptnsbc_io import wire
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.drawing import (
    TRAIL_POINTS,
    OdometryMarkers,
    publish_description,
    robot_description,
)
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_sim.scenario import load_scenario

PERIOD_NS = 20_000_000


def told(uav: int, tick: int) -> bytes:
    state = np.zeros(13)
    state[0:3], state[6] = (uav, tick, 2.0), 1.0
    return wire.OdometryTemplate("map", f"uav{uav}/base_link").encode(tick * PERIOD_NS, state)


def test_one_picture_a_period_of_everybody_where_last_heard():
    scenario = load_scenario("experiment_4")
    pictures = OdometryMarkers(scenario)
    drawn = []
    for tick in range(50):  # one second
        for uav in scenario.uav_ids:
            if uav == 4 and tick < 15:
                continue  # not heard yet: nothing to draw it by
            drawn.append(pictures.of(topics.odom(uav).name, told(uav, tick)))
    found = [data for data in drawn if data is not None]
    assert len(found) == 4  # 5 Hz, after UAV 4 was heard at 0.3 s
    markers = deserialize_message(found[-1], MarkerArray).markers
    places = {m.id: m.pose.position for m in markers if m.ns == "uavs"}
    assert sorted(places) == list(scenario.uav_ids)
    assert (places[1].x, places[1].y) == (1.0, 40.0)
    assert (places[3].x, places[3].y) == (3.0, 39.0)  # its message of that tick came later
    around = {m.id: m for m in markers if m.ns == "keep_outs"}
    assert {i: m.pose.position for i, m in around.items()} == places


def test_the_spheres_of_two_uavs_touch_at_their_least_distance():
    changes = {"uavs.3.keep_out_m": 1.3, "formation.uav_keep_out_above_m": 1.5}
    scenario = load_scenario("experiment_4", changes)
    pictures = OdometryMarkers(scenario)
    found = [pictures.of(topics.odom(uav).name, told(uav, 1)) for uav in (4, 3, 2, 1)][-1]
    markers = deserialize_message(found, MarkerArray).markers
    widths = {m.id: m.scale.x for m in markers if m.ns == "keep_outs"}
    assert widths[4] == 1.3
    assert {m.scale.z / m.scale.x for m in markers if m.ns == "keep_outs"} == {3.0}
    for one, other in [(1, 4), (1, 2)]:
        assert (widths[one] + widths[other]) / 2 == scenario.keep_out_between(one, other)


def test_the_trail_of_a_uav_is_where_it_was_the_newest_position_first():
    scenario = load_scenario("experiment_4")
    pictures = OdometryMarkers(scenario)
    ids = scenario.uav_ids[::-1]  # the leader's odometry ends the picture
    for tick in range(0, 10 * (TRAIL_POINTS + 5), 10):  # one picture each
        found = [pictures.of(topics.odom(uav).name, told(uav, tick)) for uav in ids][-1]
        markers = deserialize_message(found, MarkerArray).markers
        trails = {m.id: [(p.x, p.y, p.z) for p in m.points] for m in markers if m.ns == "trails"}
        assert sorted(trails) == list(scenario.uav_ids)
        was = [max(tick - 10 * k, 0) for k in range(TRAIL_POINTS)]
        assert trails[3] == [(3.0, float(at), 2.0) for at in was]


def test_other_topics_and_broken_messages_draw_nothing():
    pictures = OdometryMarkers(load_scenario("experiment_4"))
    assert pictures.of("/uav1/setpoint/wrench", b"") is None
    assert pictures.of("/uav1/odom", b"\x00\x01") is None


def test_bodies_have_their_form_and_those_that_move_their_place():
    path = {"kind": "line", "position_m": [1, 2, 3], "velocity_m_s": [0.5, 0, 0]}
    bodies = [
        {"name": "box", "kind": "box", "keep_out_m": 0.5, "size_m": [1, 2, 3], "trajectory": path},
        {
            "name": "pole",
            "kind": "cylinder",
            "keep_out_m": 0.5,
            "radius_m": 1,
            "position_m": [4, 5, 6],
        },
        {"name": "ground", "kind": "ground", "keep_out_m": 0.5, "height_m": 0},
    ]
    scenario = load_scenario("experiment_4", {"world.obstacles": bodies})
    pictures = OdometryMarkers(scenario)
    pictures.of(topics.EPOCH.name, wire.HeaderTemplate("form").encode(10 * PERIOD_NS))

    def drawn(tick: int) -> list:
        found = [pictures.of(topics.odom(uav).name, told(uav, tick)) for uav in (4, 3, 2, 1)][-1]
        markers = deserialize_message(found, MarkerArray).markers
        return [marker for marker in markers if marker.ns == "obstacles"]

    box, pole, ground = drawn(10)
    assert [box.type, pole.type, ground.type] == [Marker.CUBE, Marker.CYLINDER, Marker.CUBE]
    assert (box.scale.x, box.scale.y, box.scale.z) == (1.0, 2.0, 3.0)
    assert (pole.pose.position.x, pole.scale.x) == (4.0, 2.0)
    assert (box.pose.position.x, box.pose.position.y) == (1.0, 2.0)
    later = drawn(60)[0]  # one second after the epoch
    assert later.pose.position.x == pytest.approx(1.5)


def test_one_link_with_the_mass_of_this_uav():
    scenario = load_scenario(
        "paper_5", {"uavs.1.mass_scale": 1.5, "uavs.1.inertia_scale": [1, 1, 2]}
    )
    robot = ElementTree.fromstring(robot_description(scenario, 2))
    (link,) = robot.findall("link")
    assert (robot.get("name"), link.get("name")) == ("uav2", "base_link")
    assert float(link.find("inertial/mass").get("value")) == pytest.approx(
        1.5 * scenario.plant.mass_kg
    )
    inertia = link.find("inertial/inertia").attrib
    assert float(inertia["izz"]) == pytest.approx(2 * scenario.plant.inertia_kg_m2[2])
    assert {float(inertia[name]) for name in ("ixy", "ixz", "iyz")} == {0.0}


def test_rotors_stand_around_the_middle_and_every_colour_is_defined():
    robot = ElementTree.fromstring(robot_description(load_scenario("paper_5"), 1))
    visuals = robot.findall("link/visual")
    rotors = [v for v in visuals if v.find("geometry/cylinder") is not None]
    places = np.array([v.find("origin").get("xyz").split() for v in rotors], dtype=float)
    assert places.shape == (4, 3)
    assert np.allclose(places[:, :2].mean(axis=0), 0.0)
    assert np.allclose(np.linalg.norm(places[:, :2], axis=1), 0.2)
    colours = {material.get("name") for material in robot.findall("material")}
    assert {v.find("material").get("name") for v in visuals} == colours


@pytest.mark.ros
def test_who_looks_later_gets_it(ros):
    sender = Endpoints(ros.node("uav"), lockstep=False)
    publish_description(sender, load_scenario("paper_5"), 3)
    heard = []
    Endpoints(ros.node("viewer"), lockstep=False).listen(
        topics.robot_description(3), bytes, heard.append
    )
    ros.spin_until(lambda: heard)
    assert deserialize_message(heard[0], String).data.startswith('<robot name="uav3">')
