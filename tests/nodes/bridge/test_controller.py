"""Setpoints of the UAV process: only replies to our own odometry count."""

import math

import numpy as np
import pytest

from ptnsbc_io.wire import VelocityTemplate, decode_velocity
from ptnsbc_nodes.bridge.controller import ControllerSetpoints, PublishedOdometry


def receive(controller, stamp_ns, values):
    return controller.on_message(VelocityTemplate("map").encode(stamp_ns, values))


def test_only_answers_to_our_own_odometry_count():
    controller = ControllerSetpoints(decode_velocity)
    odometry = np.zeros(13)
    odometry[6] = 1.0
    for n in range(3):
        controller.remember(n, PublishedOdometry(10.0 + n, 10.0 + n, odometry))
    assert controller.age_s(20.0) == math.inf
    assert not receive(controller, 77, np.zeros(6))
    assert not receive(controller, 1, np.full(6, math.nan))
    assert receive(controller, 1, np.zeros(6))
    assert not receive(controller, 0, np.zeros(6))  # overtaken
    assert controller.age_s(11.25) == 0.25
    assert (controller.foreign, controller.invalid) == (1, 1)


def test_a_heading_is_read_from_the_yaw_rate_that_would_lead_there():
    odometry = np.zeros(13)
    odometry[5:7] = math.sin(0.5), math.cos(0.5)  # yaw 1.0
    controller = ControllerSetpoints(decode_velocity)
    controller.remember(1, PublishedOdometry(0.0, 0.0, odometry))
    receive(controller, 1, np.array([0, 0, 0, 0, 0, 3.0 * 0.2]))
    assert controller.newest.desired_yaw(3.0) == pytest.approx(1.2)
