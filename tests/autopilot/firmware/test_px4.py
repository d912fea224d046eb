"""PX4 as measured: docs/autopilot.md, one test per rule. Arming, take-off, landing, messages."""

import math

import pytest

from ptnsbc_autopilot.firmware.px4 import Px4
from ptnsbc_autopilot.firmware.px4_modes import DESCEND, HOLD, LAND, OFFBOARD
from ptnsbc_autopilot.vehicle import GCS
from ptnsbc_io.mavlink.dialect import mavlink

ACCEPTED, REJECTED, UNSUPPORTED = 0, 1, 3


def test_streams_arrive_unasked(companion):
    px4 = companion(Px4)
    start = px4.t
    px4.run(4.0)
    for name, rate in (("LOCAL_POSITION_NED", 30), ("ATTITUDE", 100), ("HEARTBEAT", 1)):
        assert len(px4.got(name, since=start)) == pytest.approx(4 * rate, abs=1)
    assert px4.last("HEARTBEAT").autopilot == mavlink.MAV_AUTOPILOT_PX4


def test_nothing_of_the_position_before_it_is_valid(companion):
    px4 = companion(Px4, ready=False)
    px4.run(2.0)
    assert not px4.got("LOCAL_POSITION_NED")
    px4.run(8.0)
    assert px4.got("LOCAL_POSITION_NED")


def test_first_motion_comes_some_seconds_after_the_climb_command(companion):
    px4 = companion(Px4)
    px4.flown(0, 0, 0, 1.2)
    px4.offboard()
    px4.arm()
    px4.flown(0, 0, 0, 2.0)
    assert px4.vehicle.in_contact, "zero velocity is not take-off"
    px4.flown(0, 0, -1, 2.0)
    assert px4.vehicle.in_contact
    px4.flown(0, 0, -1, 1.2)
    assert not px4.vehicle.in_contact


def test_armed_without_take_off_it_disarms(companion):
    px4 = companion(Px4)
    px4.flown(0, 0, 0, 1.2)
    px4.offboard()
    px4.arm()
    px4.flown(0, 0, 0, 9.0)
    assert px4.vehicle.armed
    px4.flown(0, 0, 0, 2.0)
    assert not px4.vehicle.armed


def test_landing_disarms_and_offboard_is_back(companion):
    px4 = companion(Px4)
    px4.airborne()
    assert px4.command(mavlink.MAV_CMD_NAV_LAND) == ACCEPTED
    px4.run(1.0)
    assert px4.vehicle.active == LAND
    assert px4.last("EXTENDED_SYS_STATE").landed_state == mavlink.MAV_LANDED_STATE_LANDING
    px4.run(14.0)
    assert not px4.vehicle.armed
    assert px4.last("EXTENDED_SYS_STATE").landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND
    px4.run(1.0)
    assert px4.last("HEARTBEAT").custom_mode == OFFBOARD.word
    px4.flown(0, 0, 0, 1.2)
    assert px4.arm() == ACCEPTED


def test_landing_by_velocity_disarms_too(companion):
    px4 = companion(Px4)
    px4.airborne(5.0)
    px4.flown(0, 0, 0.7, 10.0)
    assert px4.vehicle.in_contact
    assert not px4.vehicle.armed


def test_in_the_air_disarming_needs_the_magic_number(companion):
    px4 = companion(Px4)
    px4.airborne()
    assert px4.disarm() == REJECTED
    assert px4.vehicle.armed
    assert px4.disarm(force=True) == ACCEPTED
    px4.run(2.0)
    assert px4.vehicle.in_contact


def test_texts_go_only_to_a_ground_station_with_a_tab_at_the_end(companion):
    px4 = companion(Px4)
    px4.offboard()
    px4.arm()
    assert not px4.texts()
    assert not px4.texts(GCS)
    px4.gcs_heartbeat()
    px4.arm()
    assert px4.texts(GCS) == ["Arming denied: No offboard signal\t"]
    assert not px4.texts()


def test_long_texts_come_in_chunks(companion):
    px4 = companion(Px4)
    px4.gcs_heartbeat()
    px4.target(frame=7)
    chunks = px4.got("STATUSTEXT", GCS)
    assert [m.chunk_seq for m in chunks] == [0, 1]
    assert chunks[0].id == chunks[1].id != 0
    assert "".join(m.text for m in chunks).endswith("frame 7 unsupported\t")


def test_data_link_loss_action_wants_a_ground_station_to_arm(companion):
    px4 = companion(Px4)
    px4.put("NAV_DLL_ACT", 2)
    onboard = mavlink.MAV_TYPE_ONBOARD_CONTROLLER
    px4.send(mavlink.MAVLink_heartbeat_message(onboard, 8, 0, 0, 4, 3))
    assert px4.arm() == REJECTED
    px4.gcs_heartbeat()
    assert px4.arm() == ACCEPTED


@pytest.mark.parametrize("mode", [1, 3, 4])
def test_no_transmitter_or_ground_station_is_needed(companion, mode):
    px4 = companion(Px4)
    px4.put("COM_RC_IN_MODE", mode)
    px4.flown(0, 0, 0, 1.2)
    assert (px4.offboard(), px4.arm()) == (ACCEPTED, ACCEPTED)


def test_take_off_command_climbs_and_then_holds(companion):
    px4 = companion(Px4)
    nan = math.nan
    assert px4.arm() == ACCEPTED
    assert px4.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, nan) == ACCEPTED
    px4.run(9.0)
    assert px4.vehicle.active == HOLD
    assert px4.vehicle.flight.truth.position_enu[2] == pytest.approx(2.5, abs=0.3)


def test_without_a_position_it_descends(companion):
    px4 = companion(Px4)
    px4.airborne()
    px4.vehicle.flight.navigation.lose(px4.t)
    px4.flown(0, 0, 0, 4.0)
    assert px4.vehicle.active == OFFBOARD
    px4.flown(0, 0, 0, 2.0)
    assert px4.vehicle.active == DESCEND
    start = px4.t
    px4.flown(0, 0, 0, 1.0)
    assert not px4.got("LOCAL_POSITION_NED", since=start)
    assert px4.last("GPS_RAW_INT").fix_type == 1
    px4.flown(0, 0, 0, 15.0)
    assert not px4.vehicle.armed


def test_unknown_commands_are_unsupported_and_those_for_others_unanswered(companion):
    px4, lines = companion(Px4), []
    px4.vehicle.log = lines.append
    assert px4.command(mavlink.MAV_CMD_DO_PARACHUTE) == UNSUPPORTED
    assert lines == ["MAV_CMD_DO_PARACHUTE from system 245: MAV_RESULT_UNSUPPORTED"]
    assert px4.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, target=2) is None
