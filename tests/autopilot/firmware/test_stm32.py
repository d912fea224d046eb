"""The controller that takes attitude targets only."""

import pytest

from ptnsbc_autopilot.firmware.stm32 import Stm32
from ptnsbc_io.mavlink.dialect import mavlink

ACCEPTED, REJECTED, UNSUPPORTED = 0, 1, 3


@pytest.fixture
def stm32(companion):
    return companion(Stm32)


def attitude(stm32, thrust, mask=0b111):
    level_north = [0.0] * 4
    level_north[0] = 1.0
    stm32.send(
        mavlink.MAVLink_set_attitude_target_message(0, 1, 1, mask, level_north, 0, 0, 0, thrust)
    )


def climbed(stm32):
    assert stm32.arm() == ACCEPTED
    hover = stm32.vehicle.flight.hover_share
    stm32.run(1.5, lambda: attitude(stm32, 1.3 * hover), hz=50.0)
    stm32.run(0.5, lambda: attitude(stm32, hover), hz=50.0)
    assert stm32.vehicle.flight.truth.position_enu[2] > 1.0


def test_its_heartbeat_is_that_of_a_generic_autopilot(stm32):
    stm32.run(1.0)
    beat = stm32.last("HEARTBEAT")
    assert (beat.autopilot, beat.custom_mode) == (mavlink.MAV_AUTOPILOT_GENERIC, 0)


def test_thrust_lifts_it_and_silence_brings_it_down(stm32):
    climbed(stm32)
    stm32.run(0.4)
    assert stm32.vehicle.flight.truth.velocity_enu[2] > 0.5
    stm32.run(20.0)
    assert stm32.vehicle.in_contact
    assert not stm32.vehicle.armed


def test_its_force_is_a_power_of_the_thrust_and_falls_with_the_battery(stm32):
    for name, value in (("THR_CURVE", 2.0), ("THR_SAG", 0.5), ("BATT_LIFE_S", 20.0)):
        stm32.vehicle.set_parameter(name, value)
    stm32.arm()
    stm32.run(2.0, lambda: attitude(stm32, 0.9), hz=50.0)
    flight = stm32.vehicle.flight
    assert flight.battery < 0.9
    left = 1.0 - 0.5 * (1.0 - flight.battery)
    assert flight.thrust_share == pytest.approx(0.9**2 * left, rel=0.02)


def test_a_target_counts_after_its_delay(stm32):
    stm32.vehicle.set_parameter("THR_DELAY_S", 0.2)
    stm32.arm()
    stm32.run(0.18, lambda: attitude(stm32, 0.9), hz=50.0)
    assert stm32.vehicle.flight.thrust_share < 0.5
    stm32.run(0.1, lambda: attitude(stm32, 0.9), hz=50.0)
    assert stm32.vehicle.flight.thrust_share == pytest.approx(0.9, rel=0.02)


@pytest.mark.parametrize("mask", [0b10000111, 0b1000111])
def test_attitude_and_thrust_must_be_there(stm32, mask):
    stm32.arm()
    stm32.run(2.0, lambda: attitude(stm32, 0.9, mask), hz=50.0)
    assert stm32.vehicle.in_contact


def test_nothing_else_moves_it(stm32):
    stm32.arm()
    stm32.flown(0, 0, -1, 3.0)
    assert stm32.vehicle.in_contact
    assert stm32.command(mavlink.MAV_CMD_NAV_TAKEOFF, 1, 4) == UNSUPPORTED
    assert stm32.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4) == UNSUPPORTED


def test_guided_is_a_flag_of_its_base_mode(stm32):
    guided = mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
    assert stm32.command(mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_MODE_GUIDED_DISARMED) == ACCEPTED
    stm32.run(1.0)
    assert stm32.last("HEARTBEAT").base_mode & guided
    assert stm32.command(mavlink.MAV_CMD_DO_SET_MODE, 0) == ACCEPTED
    stm32.run(1.0)
    assert not stm32.last("HEARTBEAT").base_mode & guided
    attitude(stm32, 0.1)
    stm32.run(1.0)
    assert stm32.last("HEARTBEAT").base_mode & guided


def test_it_lands_where_it_is_whatever_targets_still_come(stm32):
    climbed(stm32)
    assert stm32.command(mavlink.MAV_CMD_NAV_LAND) == ACCEPTED
    hover = stm32.vehicle.flight.hover_share
    stm32.run(15.0, lambda: attitude(stm32, 1.3 * hover), hz=50.0)
    assert stm32.vehicle.in_contact
    assert not stm32.vehicle.armed
    place = stm32.vehicle.flight.truth.position_enu
    assert place[:2] == pytest.approx([0.0, 0.0], abs=0.2)


def test_in_the_air_disarming_needs_the_magic_number(stm32):
    climbed(stm32)
    assert stm32.disarm() == REJECTED
    assert stm32.disarm(force=True) == ACCEPTED
