"""Frames of the stand-in, by hand-computed values; nothing is shared with the bridge."""

import math

import numpy as np
import pytest
from pymavlink.quaternion import Quaternion as Reference
from pymavlink.rotmat import Vector3

from ptnsbc_autopilot.physics.frames import (
    PX4_RADIUS_M,
    Geodetic,
    Quaternion,
    attitude_swap,
    body_swap,
    euler_of,
    geodetic,
    rotate_heading,
    world_swap,
    yaw_swap,
)


def test_east_north_up_is_north_east_down():
    assert world_swap(np.array((1.0, 2.0, 3.0))).tolist() == [2.0, 1.0, -3.0]
    assert body_swap(np.array((1.0, 2.0, 3.0))).tolist() == [1.0, -2.0, -3.0]


@pytest.mark.parametrize(
    ("enu", "ned"), [(0.0, math.pi / 2), (math.pi / 2, 0.0), (math.pi, -math.pi / 2)]
)
def test_yaw(enu, ned):
    assert yaw_swap(enu) == pytest.approx(ned)
    assert math.cos(yaw_swap(ned) - enu) == pytest.approx(1.0)


def test_facing_east_is_a_heading_of_ninety_degrees():
    euler = euler_of(attitude_swap(Quaternion(1.0, 0.0, 0.0, 0.0)))
    assert euler == pytest.approx((0.0, 0.0, math.pi / 2))


def test_nose_down_in_flu_is_nose_down_in_frd():
    down = Quaternion(math.cos(0.1), 0.0, math.sin(0.1), 0.0)  # facing east, turned about left
    assert euler_of(attitude_swap(down)) == pytest.approx((0.0, -0.2, math.pi / 2))


def test_attitude_there_and_back_and_as_matrices():
    random = np.random.default_rng(1)
    for _ in range(20):
        q = random.standard_normal(4)
        q /= np.linalg.norm(q)
        there = attitude_swap(Quaternion(*q))
        assert attitude_swap(there) == pytest.approx(tuple(q))
        v = random.standard_normal(3)  # in the body
        enu, ned = turned(q, v), turned(there, body_swap(v))
        assert ned == pytest.approx(world_swap(enu))


def turned(q, v):
    """A body vector in the world, by pymavlink's own quaternion."""
    out = Reference(list(q)).dcm * Vector3(*v)
    return np.array((out.x, out.y, out.z))


def test_heading_east_turns_forward_into_east():
    assert rotate_heading(np.array((1.0, 0.0, 2.0)), math.pi / 2) == pytest.approx([0, 1, 2])


def test_a_minute_of_latitude_is_a_nautical_mile():
    place = geodetic(Geodetic(45.0, 8.0, 0.0), np.array((0.0, 1853.25, 10.0)), PX4_RADIUS_M)
    assert (place.latitude_deg - 45.0) * 60.0 == pytest.approx(1.0, rel=1e-5)
    assert place.altitude_m == 10.0


def test_a_degree_of_longitude():
    sixty = Geodetic(60.0, 0.0, 0.0)
    place = geodetic(sixty, np.array((111_194.93 / 2, 0.0, 0.0)), PX4_RADIUS_M)
    assert place.longitude_deg == pytest.approx(1.0, rel=1e-6)
