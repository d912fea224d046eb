"""Markers made of recorded odometry, for bags of vehicles that no simulator draws."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rclpy.serialization import deserialize_message
from visualization_msgs.msg import MarkerArray

from ptnsbc_io import wire
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.markers import OdometryMarkers
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


def test_other_topics_and_broken_messages_draw_nothing():
    pictures = OdometryMarkers(load_scenario("experiment_4"))
    assert pictures.of("/uav1/setpoint/wrench", b"") is None
    assert pictures.of("/uav1/odom", b"\x00\x01") is None
