"""PX4 as measured: docs/autopilot.md, one test per rule."""

import math

import numpy as np
import pytest

from ptnsbc_nodes.autopilot.navigation import QUALITIES
from ptnsbc_nodes.autopilot.px4 import Px4
from ptnsbc_nodes.autopilot.px4_tables import DESCEND, HOLD, LAND, OFFBOARD, POSCTL
from ptnsbc_nodes.autopilot.vehicle import GCS
from ptnsbc_nodes.mavlink.dialect import mavlink

ACCEPTED, REJECTED, DENIED, UNSUPPORTED = 0, 1, 2, 3


def speed(companion):
    return float(np.hypot(*companion.vehicle.flight.true_velocity_enu[:2]))


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


def test_offboard_is_acknowledged_without_a_stream_and_arming_is_not(companion):
    px4 = companion(Px4)
    assert px4.offboard() == ACCEPTED
    assert px4.arm() == REJECTED
    assert not px4.vehicle.armed


def test_a_stream_must_have_come_for_a_second(companion):
    px4 = companion(Px4)
    px4.offboard()
    px4.flown(0, 0, 0, 0.7)
    assert px4.arm() == REJECTED
    px4.flown(0, 0, 0, 0.5)
    assert px4.arm() == ACCEPTED


def test_in_the_air_offboard_without_a_stream_is_rejected(companion):
    px4 = companion(Px4)
    px4.airborne()
    px4.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4, 3)
    px4.run(2.0)
    assert px4.offboard() == REJECTED
    assert px4.vehicle.active == HOLD


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


def test_velocity_is_flown_in_ned(companion):
    px4 = companion(Px4, yaw_rad=2.0)
    px4.airborne()
    px4.flown(1.0, 0.5, 0, 4.0)
    north = px4.vehicle.flight.true_velocity_enu
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
    px4.run(3.0, lambda: px4.target(velocity=(1, 0, 0), mask=mask, frame=frame))
    assert px4.vehicle.flight.true_velocity_enu[:2] == pytest.approx([1.0, 0.0], abs=0.08)


def test_velocity_at_a_height_is_flown(companion):
    px4 = companion(Px4)
    px4.airborne()
    px4.run(6.0, lambda: px4.target(velocity=(0.5, 0, 0), position=(0, 0, -3), mask=0x05E3))
    assert px4.vehicle.flight.truth_enu[2] == pytest.approx(3.0, abs=0.1)
    assert speed(px4) == pytest.approx(0.5, abs=0.05)


def test_a_position_is_reached(companion):
    px4 = companion(Px4)
    px4.airborne()
    px4.run(8.0, lambda: px4.target(position=(3, -2, -5), mask=0x09F8))
    assert px4.vehicle.flight.truth_enu == pytest.approx([-2, 3, 5], abs=0.1)


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
    assert px4.vehicle.flight.true_velocity_enu[1] == pytest.approx(0.9, abs=0.15)


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


@pytest.mark.parametrize(("hz", "holds"), [(2.0, True), (1.1, True), (0.9, False)])
def test_stream_rates_with_one_second(companion, hz, holds):
    px4 = companion(Px4)
    px4.put("COM_OBL_RC_ACT", 5)
    px4.airborne()
    lines = []
    px4.vehicle.log = lines.append
    px4.run(10.0, lambda: px4.velocity(0, 0, 0), hz=hz)
    failed = any("Failsafe activated" in line for line in lines)
    cleared = any("Failsafe cleared" in line for line in lines)
    assert (failed, cleared) == (not holds, not holds)


def test_after_the_stream_it_holds_and_comes_back_by_itself(companion):
    px4 = companion(Px4)
    px4.put("COM_OBL_RC_ACT", 5)
    px4.airborne()
    px4.flown(1, 0, 0, 2.0)
    px4.run(0.9)
    assert px4.vehicle.active == OFFBOARD
    px4.run(0.3)
    assert px4.vehicle.active == HOLD
    px4.run(4.0)
    assert speed(px4) < 0.05
    assert px4.last("HEARTBEAT").custom_mode == HOLD.word
    assert px4.last("HEARTBEAT").system_status == mavlink.MAV_STATE_CRITICAL
    px4.flown(1, 0, 0, 1.5)
    assert px4.vehicle.active == OFFBOARD
    assert speed(px4) > 0.5


def test_a_short_failsafe_never_shows_in_the_heartbeat(companion):
    px4 = companion(Px4)
    px4.put("COM_OBL_RC_ACT", 5)
    px4.airborne()
    while px4.heard[-1][2].get_type() != "HEARTBEAT":
        px4.flown(0, 0, 0, 0.004)
    start = px4.t
    px4.velocity(0, 0, 0)
    px4.run(1.3)
    assert px4.vehicle.active == HOLD
    modes = {m.custom_mode for m in px4.got("HEARTBEAT", since=start)}
    assert modes == {OFFBOARD.word}


def test_by_default_it_sinks_and_drifts(companion):
    px4 = companion(Px4)
    px4.vehicle.flight.body.plant.wind[0] = 3.0
    px4.airborne()
    height = px4.vehicle.flight.truth_enu[2]
    px4.run(3.0)
    assert px4.vehicle.active == POSCTL
    assert px4.vehicle.flight.truth_enu[2] < height - 0.8
    assert speed(px4) > 0.3


@pytest.mark.parametrize(("action", "flown"), [(3, "RTL"), (4, "LAND"), (5, "HOLD")])
def test_the_parameter_says_what_follows(companion, action, flown):
    px4 = companion(Px4)
    px4.put("COM_OBL_RC_ACT", action)
    px4.airborne(5.0)
    px4.run(1.2)
    assert px4.vehicle.mode_name == flown
    px4.flown(0, 0, 0, 0.1)
    assert px4.vehicle.active == OFFBOARD


@pytest.mark.parametrize("action", [6, 7])
def test_the_parameter_may_stop_the_motors(companion, action):
    px4 = companion(Px4)
    px4.put("COM_OBL_RC_ACT", action)
    px4.airborne(5.0)
    px4.run(3.0)
    assert px4.vehicle.in_contact
    assert not px4.vehicle.armed


def test_loss_time_is_the_parameter(companion):
    px4 = companion(Px4)
    px4.put("COM_OF_LOSS_T", 5.0)
    px4.airborne()
    px4.run(4.8)
    assert px4.vehicle.active == OFFBOARD
    px4.run(0.4)
    assert px4.vehicle.active == POSCTL


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


def test_zero_velocity_is_not_hold(companion):
    """About 4 m of true drift in 12 s while the estimate read near zero."""
    drifts = []
    for seed in range(1, 5):
        px4 = companion(Px4, quality=QUALITIES["plain"], seed=seed)
        px4.airborne(5.0)
        px4.flown(0, 0, 0, 4.0)
        before, start = px4.vehicle.flight.truth_enu.copy(), px4.t
        px4.flown(0, 0, 0, 12.0)
        drifts.append(float(np.linalg.norm((px4.vehicle.flight.truth_enu - before)[:2])))
        read = [math.hypot(m.vx, m.vy) for m in px4.got("LOCAL_POSITION_NED", since=start)]
        assert np.mean(read) < 0.1
    assert np.sqrt(np.mean(np.square(drifts))) == pytest.approx(4.0, abs=1.5)


def test_a_position_loop_by_velocity_holds_as_the_measured_one(companion):
    """P = 0.8 at 20 Hz gave 0.31-0.47 m RMS by its estimate and 0.6-1.0 m by truth, over four vehicles."""
    own, true = [], []
    for seed in range(1, 7):
        px4 = companion(Px4, quality=QUALITIES["plain"], seed=seed)
        px4.airborne(5.0)
        flight = px4.vehicle.flight
        goal = flight.position_enu.copy()
        place = goal + flight.navigation.origin_enu

        def close(px4=px4, flight=flight, goal=goal):
            e, n, u = 0.8 * (goal - flight.position_enu)
            px4.velocity(n, e, -u)

        for _ in range(20):
            px4.run(1.0, close)
            own.append(np.sum((flight.position_enu - goal) ** 2))
            true.append(np.sum((flight.truth_enu - place) ** 2))
    assert 0.31 < math.sqrt(np.mean(own)) < 0.47
    assert 0.6 < math.sqrt(np.mean(true)) < 1.0


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
    assert px4.vehicle.flight.truth_enu[2] == pytest.approx(2.5, abs=0.3)


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
    east, north, up = px4.vehicle.flight.true_velocity_enu
    assert east == pytest.approx(2.0 * 9.81 * math.tan(0.1), rel=0.3)
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
