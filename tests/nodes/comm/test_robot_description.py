"""The URDF of a UAV: its mass and inertia, its shape, and that a late viewer gets it."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.robot_description import publish_description, robot_description
from ptnsbc_sim.scenario import load_scenario


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
