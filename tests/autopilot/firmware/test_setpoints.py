"""PX4 as measured: which setpoints it follows, and how."""

import math

import numpy as np
import pytest

from ptnsbc_autopilot.firmware.px4 import Px4
from ptnsbc_autopilot.vehicle import GCS
from ptnsbc_io.mavlink.dialect import mavlink

ACCEPTED, REJECTED = 0, 1


SETTLED_S = 20.0  # its integral takes 7 s to make up for the drag


def speed(companion):
    return float(np.hypot(*companion.vehicle.flight.truth.velocity_enu[:2]))


def against_drag(push, seconds):
    """Speed [m/s] that a push [m/s^2] from rest reaches against the drag of the vehicle."""
    return push / Px4.drag_1_s * (1.0 - math.exp(-Px4.drag_1_s * seconds))


def test_velocity_is_flown_in_ned(companion):
    px4 = companion(Px4, yaw_rad=2.0)
    px4.airborne()
    px4.flown(1.0, 0.5, 0, SETTLED_S)
    north = px4.vehicle.flight.truth.velocity_enu
    assert north[:2] == pytest.approx([0.5, 1.0], abs=0.05)
    last = px4.last("LOCAL_POSITION_NED")
    assert (last.vx, last.vy) == pytest.approx((1.0, 0.5), abs=0.05)
    assert px4.last("ATTITUDE").yaw == pytest.approx(0.0, abs=0.05)


def test_body_ned_turns_with_the_heading(companion):
    px4 = companion(Px4)
    px4.airborne()
    mask = 0x05C7  # velocity and yaw rate
    px4.run(3.0, lambda: px4.target(yaw=math.pi / 2))
    frame = mavlink.MAV_FRAME_BODY_NED
    px4.run(SETTLED_S, lambda: px4.target(velocity=(1, 0, 0), mask=mask, frame=frame))
    assert px4.vehicle.flight.truth.velocity_enu[:2] == pytest.approx([1.0, 0.0], abs=0.08)


def test_velocity_at_a_height_is_flown(companion):
    px4 = companion(Px4)
    px4.airborne()
    px4.run(SETTLED_S, lambda: px4.target(velocity=(0.5, 0, 0), position=(0, 0, -3), mask=0x05E3))
    assert px4.vehicle.flight.truth.position_enu[2] == pytest.approx(3.0, abs=0.1)
    assert speed(px4) == pytest.approx(0.5, abs=0.05)


def test_a_position_is_reached(companion):
    px4 = companion(Px4)
    px4.airborne()
    px4.run(SETTLED_S, lambda: px4.target(position=(3, -2, -5), mask=0x09F8))
    assert px4.vehicle.flight.truth.position_enu == pytest.approx([-2, 3, 5], abs=0.1)


@pytest.mark.parametrize("frame", [7, 9, 20])
def test_other_frames_are_no_sign_of_life(companion, frame):
    px4 = companion(Px4)
    px4.offboard()
    px4.gcs_heartbeat()
    px4.run(1.5, lambda: px4.target(frame=frame))
    assert px4.arm() == REJECTED
    assert any("coordinate frame" in text for text in px4.texts(GCS))


def test_a_mask_that_ignores_all_is_no_sign_of_life(companion):
    px4 = companion(Px4)
    px4.offboard()
    px4.run(1.5, lambda: px4.target(mask=0x0DFF))
    assert px4.arm() == REJECTED


def test_a_force_is_no_sign_of_life(companion):
    px4 = companion(Px4)
    px4.offboard()
    px4.run(1.5, lambda: px4.target(acceleration=(1, 0, 0), mask=0x0A3F))
    assert px4.arm() == REJECTED


def test_an_acceleration_is_flown(companion):
    px4 = companion(Px4)
    px4.airborne()
    px4.run(1.0, lambda: px4.target(acceleration=(1, 0, 0), mask=0x083F))
    reached = against_drag(1.0, 0.9)
    assert px4.vehicle.flight.truth.velocity_enu[1] == pytest.approx(reached, abs=0.1)


def test_not_a_number_is_as_if_ignored(companion):
    px4 = companion(Px4)
    px4.offboard()
    px4.run(1.5, lambda: px4.target(velocity=(math.nan,) * 3))
    assert px4.arm() == REJECTED


@pytest.mark.parametrize(
    ("system", "component", "heard"),
    [(1, 1, True), (0, 0, True), (1, 0, True), (2, 1, False), (1, 2, False)],
)
def test_setpoints_for_others_are_dropped(companion, system, component, heard):
    px4 = companion(Px4)
    px4.offboard()
    px4.run(1.5, lambda: px4.target(system=system, component=component))
    assert px4.arm() == (ACCEPTED if heard else REJECTED)


def test_attitude_and_thrust_are_flown(companion):
    px4 = companion(Px4)
    px4.airborne()
    hover = px4.vehicle.flight.hover_share
    half = 0.05  # pitch down by 0.1 rad, facing east: forward is east
    c, s = math.cos(math.pi / 4), math.sin(math.pi / 4)
    q = [c * math.cos(half), s * math.sin(half), -c * math.sin(half), s * math.cos(half)]
    thrust = hover / math.cos(2 * half)

    def each():
        px4.send(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0b111, q, 0, 0, 0, thrust))

    px4.run(2.0, each, hz=50.0)
    east, north, up = px4.vehicle.flight.truth.velocity_enu
    assert east == pytest.approx(against_drag(9.81 * math.tan(0.1), 1.9), rel=0.1)
    assert abs(north) < 0.1
    assert abs(up) < 0.3
    assert px4.last("ATTITUDE").pitch == pytest.approx(-0.1, abs=0.01)


def test_body_rates_and_thrust_are_flown(companion):
    px4 = companion(Px4)
    px4.airborne()
    hover, mask = px4.vehicle.flight.hover_share, 0b10000000
    q = [1.0, 0.0, 0.0, 0.0]

    def each():
        px4.send(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, mask, q, 0, 0, 0.5, hover))

    before = px4.last("ATTITUDE").yaw
    px4.run(1.0, each, hz=50.0)
    assert px4.last("ATTITUDE").yaw - before == pytest.approx(0.5, abs=0.05)


def test_rates_beside_an_attitude_do_not_tilt(companion):
    px4 = companion(Px4)
    px4.airborne()
    hover, north = px4.vehicle.flight.hover_share, [1.0, 0.0, 0.0, 0.0]

    def each():
        px4.send(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0, north, 2, 2, 0, hover))

    px4.run(1.0, each, hz=50.0)
    assert px4.last("ATTITUDE").roll == pytest.approx(0.0, abs=0.01)
    assert px4.last("ATTITUDE").pitch == pytest.approx(0.0, abs=0.01)
