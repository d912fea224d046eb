"""Frames: values computed by hand, round trips over everything, and the cases that hurt in the field."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptnsbc_core.kinematics import quaternion_from_euler, rotation_from_quaternion, yaw_of
from ptnsbc_io.mavlink import frames
from ptnsbc_io.mavlink.frames import GeoPoint

PX4_RADIUS = 6371000.0
HOME = GeoPoint(47.397742, 8.545594, 488.0)

numbers = st.floats(-1e4, 1e4)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
angles = st.floats(-3.1, 3.1)
pitches = st.floats(-1.5, 1.5)


def test_north_east_up_by_hand():
    # 1 m east, 2 m north, 3 m up
    assert frames.vector_enu_to_ned(np.array([1.0, 2.0, 3.0])).tolist() == [2.0, 1.0, -3.0]
    # climbing at 1 m/s is a negative z velocity
    assert frames.vector_ned_to_enu(np.array([0.0, 0.0, -1.0])).tolist() == [0.0, 0.0, 1.0]
    # forward stays, left becomes minus right
    assert frames.vector_flu_to_frd(np.array([1.0, 2.0, 3.0])).tolist() == [1.0, -2.0, -3.0]


@pytest.mark.parametrize(
    ("enu_deg", "ned_deg"),
    [(0, 90), (90, 0), (180, -90), (-90, 180), (45, 45), (-135, -135), (135, -45), (450, 0)],
)
def test_headings_by_hand(enu_deg, ned_deg):
    ned = frames.yaw_enu_to_ned(math.radians(enu_deg))
    assert math.degrees(ned) == pytest.approx(ned_deg)


def test_yaw_wraps_into_one_turn():
    # a heading of 179 and -179 degrees are 2 degrees apart in both frames
    one = frames.yaw_enu_to_ned(math.radians(-89.0))  # 179 in NED
    other = frames.yaw_enu_to_ned(math.radians(-91.0))  # -179 in NED
    assert math.degrees(one) == pytest.approx(179.0)
    assert math.degrees(other) == pytest.approx(-179.0)
    assert math.degrees(math.remainder(one - other, math.tau)) == pytest.approx(-2.0)
    assert frames.yaw_enu_to_ned(-0.5 * math.pi) == math.pi


def test_level_and_pointing_north_is_a_quarter_turn_in_enu():
    enu = frames.quaternion_ned_frd_to_enu_flu(np.array([1.0, 0.0, 0.0, 0.0]))
    assert enu == pytest.approx([0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)])


def test_a_vehicle_that_boots_facing_east():
    east_ned = frames.quaternion_from_euler_ned(0.0, 0.0, 0.5 * math.pi)
    enu = frames.quaternion_ned_frd_to_enu_flu(east_ned)
    assert rotation_from_quaternion(enu) == pytest.approx(np.eye(3), abs=1e-12)
    # 1 m/s forward is 1 m/s to the east, whatever its heading was at boot
    forward = rotation_from_quaternion(enu) @ np.array([1.0, 0.0, 0.0])
    assert forward == pytest.approx([1.0, 0.0, 0.0])


def test_nose_up_and_right_wing_down_by_hand():
    # heading north, nose up by 30 degrees: body x points north and up
    nose_up = frames.quaternion_from_euler_ned(0.0, math.radians(30.0), 0.0)
    rotation = rotation_from_quaternion(frames.quaternion_ned_frd_to_enu_flu(nose_up))
    assert rotation[:, 0] == pytest.approx([0.0, math.cos(math.pi / 6), 0.5])
    # right wing down: body y (left) points up
    banked = frames.quaternion_from_euler_ned(math.radians(30.0), 0.0, 0.0)
    rotation = rotation_from_quaternion(frames.quaternion_ned_frd_to_enu_flu(banked))
    assert rotation[2, 1] == pytest.approx(0.5)


@given(vectors)
def test_vectors_return(vector):
    assert np.array_equal(frames.vector_ned_to_enu(frames.vector_enu_to_ned(vector)), vector)
    assert np.array_equal(frames.vector_frd_to_flu(frames.vector_flu_to_frd(vector)), vector)


@given(angles)
def test_yaw_returns(yaw):
    assert frames.yaw_enu_to_ned(frames.yaw_enu_to_ned(yaw)) == pytest.approx(yaw, abs=1e-12)


@given(angles, pitches, angles)
def test_attitudes_return_and_agree_with_the_rotation_matrices(roll, pitch, yaw):
    ours = quaternion_from_euler(np.array([roll, pitch, yaw]))
    theirs = frames.quaternion_enu_flu_to_ned_frd(ours)
    assert theirs[0] >= 0.0
    back = frames.quaternion_ned_frd_to_enu_flu(theirs)
    assert abs(float(back @ ours)) == pytest.approx(1.0)
    # R_ned = T R_enu T' column by column, with the vector maps
    enu = rotation_from_quaternion(ours)
    ned = rotation_from_quaternion(np.roll(theirs, -1))
    for axis in np.eye(3):
        moved = frames.vector_enu_to_ned(enu @ frames.vector_frd_to_flu(axis))
        assert ned @ axis == pytest.approx(moved, abs=1e-9)


@given(angles, pitches, angles)
def test_euler_angles_of_the_attitude_message(roll, pitch, yaw):
    ours = frames.quaternion_ned_frd_to_enu_flu(frames.quaternion_from_euler_ned(roll, pitch, yaw))
    odometry = np.zeros(13)
    odometry[3:7] = ours
    off = math.remainder(yaw_of(odometry) - frames.yaw_enu_to_ned(yaw), math.tau)
    assert off == pytest.approx(0.0, abs=1e-9)


def test_an_origin_30_m_away():
    # 30 m on PX4's sphere: to the north in latitude, to the east divided by cos(latitude)
    degree = math.degrees(30.0 / PX4_RADIUS)
    north = HOME._replace(latitude_deg=HOME.latitude_deg + degree)
    stretch = 1.0 / math.cos(math.radians(HOME.latitude_deg))
    east = HOME._replace(longitude_deg=HOME.longitude_deg + degree * stretch, altitude_m=490.0)
    assert frames.offset_enu(north, HOME, PX4_RADIUS) == pytest.approx([0.0, 30.0, 0.0], abs=1e-6)
    assert frames.offset_enu(east, HOME, PX4_RADIUS) == pytest.approx([30.0, 0.0, 2.0], abs=1e-3)
    assert frames.offset_enu(HOME, HOME, PX4_RADIUS).tolist() == [0.0, 0.0, 0.0]


@given(st.floats(-300.0, 300.0), st.floats(-300.0, 300.0))
def test_two_origins_see_each_other_from_opposite_sides(north_m, east_m):
    degree = math.degrees(1.0 / PX4_RADIUS)
    stretch = 1.0 / math.cos(math.radians(HOME.latitude_deg))
    there = GeoPoint(
        HOME.latitude_deg + north_m * degree, HOME.longitude_deg + east_m * degree * stretch, 488.0
    )
    one = frames.offset_enu(there, HOME, PX4_RADIUS)
    other = frames.offset_enu(HOME, there, PX4_RADIUS)
    assert one + other == pytest.approx(np.zeros(3), abs=0.03)


@given(st.floats(-200.0, 200.0), st.floats(-200.0, 200.0), st.floats(-20.0, 20.0))
def test_places_return(east, north, up):
    there = frames.point_at(np.array([east, north, up]), HOME, PX4_RADIUS)
    back = frames.offset_enu(there, HOME, PX4_RADIUS)
    assert back == pytest.approx([east, north, up], abs=5e-3)
