"""ArduCopter as measured and as its sources have it: docs/autopilot.md, one test per rule."""

import math

import numpy as np
import pytest

from ptnsbc_autopilot.firmware.arducopter import GUIDED, LAND, STABILIZE, ArduCopter
from ptnsbc_autopilot.physics.frames import attitude_swap, euler_of
from ptnsbc_autopilot.vehicle import GCS
from ptnsbc_core.algebra import wrap_angle
from ptnsbc_io.mavlink.dialect import mavlink

ACCEPTED, FAILED = 0, 4
UP = 5.0


def guided(copter):
    return copter.command(mavlink.MAV_CMD_DO_SET_MODE, 1, GUIDED)


def take_off(copter, height=UP):
    return copter.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height)


@pytest.fixture
def copter(companion):
    return companion(ArduCopter)


@pytest.fixture
def flying(copter):
    """In GUIDED, at its take-off height."""
    assert (guided(copter), copter.arm(), take_off(copter)) == (ACCEPTED,) * 3
    copter.run(8.0)
    assert copter.vehicle.flight.truth.position_enu[2] == pytest.approx(UP, abs=0.3)
    return copter


def test_only_heartbeats_and_texts_until_asked(copter):
    copter.run(3.0)
    assert {m.get_type() for _, _, m in copter.heard} == {"HEARTBEAT", "STATUSTEXT"}
    wanted = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED
    assert copter.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, wanted, 50_000) == ACCEPTED
    start = copter.t
    copter.run(2.0)
    assert len(copter.got("LOCAL_POSITION_NED", since=start)) == pytest.approx(40, abs=1)


def test_it_is_ready_tens_of_seconds_after_boot(companion):
    copter = companion(ArduCopter, boot_time=1.0)
    wanted = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED
    copter.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, wanted, 100_000)
    assert guided(copter) == FAILED
    copter.run(20.0 - copter.t)
    assert not copter.got("LOCAL_POSITION_NED")
    copter.run(20.2)
    assert copter.got("LOCAL_POSITION_NED")
    assert guided(copter) == ACCEPTED


def test_velocity_alone_on_the_ground_does_nothing_and_says_nothing(copter):
    guided(copter)
    copter.arm()
    texts = len(copter.texts())
    copter.flown(0, 0, -1, 6.0)
    assert copter.vehicle.in_contact
    assert len(copter.texts()) == texts


def test_take_off_wants_guided_and_armed(copter):
    assert take_off(copter) == FAILED
    guided(copter)
    assert take_off(copter) == FAILED
    copter.arm()
    assert take_off(copter) == ACCEPTED


def test_a_velocity_ends_the_take_off(copter):
    guided(copter)
    copter.arm()
    take_off(copter)
    copter.velocity(0, 0, -1)
    copter.run(4.0)
    assert copter.vehicle.in_contact


def test_velocity_is_flown_in_ned(flying):
    flying.flown(1.0, 0.5, 0, 4.0)
    assert flying.vehicle.flight.truth.velocity_enu[:2] == pytest.approx([0.5, 1.0], abs=0.1)


def test_it_keeps_the_last_velocity_for_three_seconds_and_stays_in_guided(flying):
    flying.flown(1.0, 0, 0, 3.0)
    flying.run(2.8)
    assert flying.vehicle.flight.truth.velocity_enu[1] == pytest.approx(1.0, abs=0.1)
    flying.run(3.0)
    assert np.linalg.norm(flying.vehicle.flight.truth.velocity_enu) < 0.1
    flying.run(1.0)
    assert flying.last("HEARTBEAT").custom_mode == GUIDED


def test_the_timeout_is_the_parameter(flying):
    flying.put("GUID_TIMEOUT", 1.0)
    flying.flown(1.0, 0, 0, 3.0)
    flying.run(3.0)
    assert np.linalg.norm(flying.vehicle.flight.truth.velocity_enu) < 0.1


def test_an_acceleration_goes_on_until_the_timeout(flying):
    """Measured on 4.7-dev: `update_vel_accel_xy` moves the velocity that was requested."""
    flying.target(velocity=(1, 0, 0), acceleration=(1, 0, 0), mask=0x0C07)
    flying.run(2.5)
    assert np.linalg.norm(flying.vehicle.flight.truth.velocity_enu) > 2.5
    flying.run(6.0)
    assert np.linalg.norm(flying.vehicle.flight.truth.velocity_enu) < 0.1


@pytest.mark.parametrize("frame", [1, 7, 8, 9])
def test_four_frames_are_taken(flying, frame):
    flying.run(3.0, lambda: flying.target(velocity=(1, 0, 0), frame=frame))
    assert np.linalg.norm(flying.vehicle.flight.truth.velocity_enu) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize(
    "wrong", [{"frame": 20}, {"mask": 0x05E3}, {"mask": 0x0DFF}, {"velocity": (2000, 0, 0)}]
)
def test_wrong_input_stops_it(flying, wrong):
    flying.flown(1.0, 0, 0, 3.0)
    flying.run(3.0, lambda: flying.target(**{"velocity": (1, 0, 0), **wrong}))
    assert np.linalg.norm(flying.vehicle.flight.truth.velocity_enu) < 0.1


def test_setpoints_outside_guided_are_ignored(flying):
    flying.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 5)
    flying.run(2.0)
    flying.flown(1.0, 0, 0, 2.0)
    assert np.linalg.norm(flying.vehicle.flight.truth.velocity_enu) < 0.1


def test_landing_disarms(flying):
    assert flying.command(mavlink.MAV_CMD_NAV_LAND) == ACCEPTED
    flying.run(15.0)
    assert not flying.vehicle.armed
    assert flying.last("HEARTBEAT").custom_mode == LAND


def test_standing_armed_it_disarms(copter):
    guided(copter)
    copter.arm()
    copter.run(9.5)
    assert copter.vehicle.armed
    copter.run(1.0)
    assert not copter.vehicle.armed


def test_in_the_air_disarming_needs_the_magic_number(flying):
    assert flying.disarm() == FAILED
    assert flying.disarm(force=True) == ACCEPTED


def heading(copter):
    """Clockwise from north [rad], by its own estimate."""
    return euler_of(attitude_swap(copter.vehicle.flight.estimate.attitude_enu)).yaw


def attitude(copter, thrust, mask=0b111, q=(1.0, 0.0, 0.0, 0.0)):
    copter.send(
        mavlink.MAVLink_set_attitude_target_message(0, 1, 1, mask, list(q), 0, 0, 0, thrust)
    )


def test_thrust_of_an_attitude_is_a_climb_rate(flying):
    flying.run(3.0, lambda: attitude(flying, 0.7))
    climb = 0.4 * flying.vehicle.parameters["WP_SPD_UP"]
    assert flying.vehicle.flight.truth.velocity_enu[2] == pytest.approx(climb, abs=0.1)
    flying.run(3.0, lambda: attitude(flying, 0.5))
    assert flying.vehicle.flight.truth.velocity_enu[2] == pytest.approx(0.0, abs=0.1)


def test_thrust_of_an_attitude_is_a_thrust_when_the_option_says_so(flying):
    flying.put("GUID_OPTIONS", 8)
    hover = flying.vehicle.flight.hover_share
    flying.run(1.0, lambda: attitude(flying, 1.2 * hover))
    assert flying.vehicle.flight.truth.velocity_enu[2] == pytest.approx(0.2 * 9.81, rel=0.2)


def test_an_attitude_that_climbs_takes_off(copter):
    guided(copter)
    copter.arm()
    copter.run(4.0, lambda: attitude(copter, 0.7))
    assert not copter.vehicle.in_contact


def test_an_attitude_turns_on_with_the_rates_beside_it_until_it_times_out(flying):
    flying.put("GUID_TIMEOUT", 1)
    start = heading(flying)
    level = (math.cos(0.5 * start), 0.0, 0.0, math.sin(0.5 * start))
    flying.send(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0, level, 0, 0, 0.5, 0.5))
    flying.run(0.9)
    assert 0.25 < wrap_angle(heading(flying) - start) < 0.5  # to the right
    flying.run(3.0)
    assert wrap_angle(heading(flying) - start) == pytest.approx(
        0.5, abs=0.1
    )  # a second of it, no more


def test_after_an_attitude_it_levels_and_keeps_its_height(flying):
    tilt = (math.cos(0.05), 0.0, math.sin(0.05), 0.0)
    flying.run(2.0, lambda: attitude(flying, 0.6, q=tilt))
    flying.run(6.0)
    height = flying.vehicle.flight.truth.position_enu[2]
    flying.run(2.0)
    assert flying.vehicle.flight.truth.position_enu[2] == pytest.approx(height, abs=0.1)
    assert flying.vehicle.mode == GUIDED


@pytest.mark.parametrize("wrong", [{"q": (1.1, 0, 0, 0)}, {"mask": 0b110}, {"mask": 0b1000111}])
def test_wrong_attitudes_stop_it(flying, wrong):
    flying.flown(1.0, 0, 0, 2.0)
    flying.run(3.0, lambda: attitude(flying, 0.8, **wrong))
    assert np.linalg.norm(flying.vehicle.flight.truth.velocity_enu) < 0.1


def test_texts_go_to_every_link_without_a_tab(copter):
    guided(copter)
    copter.vehicle.faults.refuse_arming = True
    assert copter.arm() == FAILED
    assert copter.texts()[-1] == copter.texts(GCS)[-1] == "Arm: Compasses inconsistent"


def test_without_a_position_it_lands(flying):
    flying.vehicle.flight.navigation.lose(flying.t)
    flying.flown(0, 0, 0, 6.0)
    assert flying.vehicle.mode == LAND
    flying.run(15.0)
    assert not flying.vehicle.armed


def test_it_boots_in_stabilize(copter):
    copter.run(1.0)
    beat = copter.last("HEARTBEAT")
    assert (beat.custom_mode, beat.autopilot) == (STABILIZE, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)
