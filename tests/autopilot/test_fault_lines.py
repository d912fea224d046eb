"""Faults to inject, and what the stand-ins do then."""

import numpy as np
import pytest

from ptnsbc_autopilot.fault_lines import inject, run_fault_line, state
from ptnsbc_autopilot.firmware.px4 import Px4
from ptnsbc_autopilot.firmware.px4_modes import HOLD, LAND, OFFBOARD, POSCTL
from ptnsbc_autopilot.vehicle import IMPOSTOR, AutopilotError
from ptnsbc_io.mavlink.dialect import mavlink

ACCEPTED, REJECTED = 0, 1


def put(companion, name, value, kind):
    return companion.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind))


def test_a_silent_heartbeat_leaves_the_rest(companion):
    px4 = companion(Px4)
    run_fault_line([px4.vehicle], "1 heartbeat off", px4.t)
    start = px4.t
    px4.run(3.0)
    assert not px4.got("HEARTBEAT", since=start)
    assert px4.got("ATTITUDE", since=start)


def test_without_radio_it_neither_sends_nor_answers_and_fails_safe(companion):
    px4 = companion(Px4)
    px4.put("COM_OBL_RC_ACT", 4)
    px4.airborne(5.0)
    run_fault_line([px4.vehicle], "all radio off", px4.t)
    start = px4.t
    assert px4.disarm(force=True) is None
    px4.flown(0, 0, 0, 15.0)
    assert not [m for t, _, m in px4.heard if t > start]
    assert not px4.vehicle.armed


def test_a_reboot_in_flight_stops_the_motors_and_the_clock_begins_anew(companion):
    px4 = companion(Px4)
    px4.airborne()
    run_fault_line([px4.vehicle], "1 reboot", px4.t)
    start = px4.t
    px4.run(1.9)
    assert not [m for t, _, m in px4.heard if t > start]
    px4.run(1.2)
    assert px4.vehicle.in_contact
    assert px4.last("ATTITUDE").time_boot_ms < 1500
    assert not px4.last("HEARTBEAT").base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def test_a_reboot_on_command_is_refused_while_armed(companion):
    px4 = companion(Px4)
    px4.flown(0, 0, 0, 0.1)
    px4.arm(force=True)
    reboot = mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN
    assert px4.command(reboot, 1) == REJECTED
    px4.disarm()
    assert px4.command(reboot, 1) == ACCEPTED
    px4.run(3.0)
    assert px4.vehicle.boots == 1


def test_the_pilot_takes_over(companion):
    px4 = companion(Px4)
    px4.airborne()
    px4.flown(1.0, 0, 0, 1.0)
    run_fault_line([px4.vehicle], "1 mode posctl", px4.t)
    px4.flown(1.0, 0, 0, 3.0)
    assert px4.vehicle.active == POSCTL
    assert np.linalg.norm(px4.vehicle.flight.truth.velocity_enu) < 0.1
    assert px4.last("HEARTBEAT").custom_mode == POSCTL.word


def test_refused_arming(companion):
    px4 = companion(Px4)
    run_fault_line([px4.vehicle], "1 arming refuse", px4.t)
    assert px4.arm() == REJECTED
    run_fault_line([px4.vehicle], "1 arming allow", px4.t)
    assert px4.arm() == ACCEPTED


def test_an_unhealthy_sensor_and_an_alarm_are_told(companion):
    px4 = companion(Px4)
    px4.gcs_heartbeat()
    accelerometer = mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    for word, bit in (("accelerometer", 0), ("none", accelerometer)):
        run_fault_line([px4.vehicle], f"1 unhealthy {word}", px4.t)
        px4.run(1.2)
        assert px4.last("SYS_STATUS").onboard_control_sensors_health & accelerometer == bit
    run_fault_line([px4.vehicle], "1 alarm fire", px4.t)
    px4.run(0.1)
    assert any("Alarm: fire" in text for text in px4.texts(1))


@pytest.mark.parametrize(("action", "flown"), [(0, OFFBOARD), (2, LAND)])
def test_a_low_battery_warns_and_lands_where_the_parameter_says(companion, action, flown):
    px4 = companion(Px4)
    px4.put("COM_LOW_BAT_ACT", action)
    px4.airborne()
    px4.gcs_heartbeat()
    run_fault_line([px4.vehicle], "1 battery 0.06", px4.t)
    px4.flown(0, 0, 0, 1.0)
    assert px4.vehicle.active == flown
    assert any("battery" in text for text in px4.texts(1))


def test_a_clock_that_jumps(companion):
    px4 = companion(Px4)
    px4.run(1.0)
    before = px4.last("ATTITUDE").time_boot_ms
    run_fault_line([px4.vehicle], "1 clock 5", px4.t)
    px4.run(0.1)
    assert px4.last("ATTITUDE").time_boot_ms - before == pytest.approx(5100, abs=30)


def test_somebody_else_with_our_system_id(companion):
    px4 = companion(Px4)
    run_fault_line([px4.vehicle], "1 duplicate on", px4.t)
    out = [o for n in range(300) for o in px4.vehicle.step(px4.t + n * 0.004)]
    kinds = {o.message.get_type() for o in out if o.link == IMPOSTOR}
    assert kinds == {"HEARTBEAT", "LOCAL_POSITION_NED"}


@pytest.mark.parametrize(
    "line",
    [
        "1 gps maybe",
        "9 gps off",
        "1",
        "",
        "1 sulk",
        "1 battery 2",
        "1 mode X",
        "1 clock x",
        "1 wind 90",
        "1 unhealthy pilot",
    ],
)
def test_what_cannot_be_done_is_refused(companion, line):
    px4 = companion(Px4)
    with pytest.raises(AutopilotError, match="expected"):
        run_fault_line([px4.vehicle], line, px4.t)


def test_state_tells_the_truth(companion):
    px4 = companion(Px4)
    px4.airborne()
    told = state(px4.vehicle)
    assert (told["armed"], told["mode"]) == (True, "OFFBOARD")
    assert told["position_enu_m"] == px4.vehicle.flight.truth.position_enu.tolist()


def test_gps_comes_back(companion):
    px4 = companion(Px4)
    inject(px4.vehicle, "gps", "off", px4.t)
    px4.run(6.0)
    assert not px4.vehicle.position_valid(px4.t)
    inject(px4.vehicle, "gps", "on", px4.t)
    assert px4.vehicle.position_valid(px4.t)
    assert px4.vehicle.active == HOLD
