"""The vehicle monitor: states in ENU and FLU, broken ones refused, reboots and duplicates noticed."""

import math

import pytest

pytest.importorskip("pymavlink")

from mavlink_wires import attitude, heartbeat, position

from ptnsbc_core.kinematics import velocity_enu, yaw_of
from ptnsbc_io.mavlink.autopilots import ARDUPILOT, PX4, FlightMode
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_nodes.bridge.vehicle_monitor import VehicleMonitor

ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def test_a_vehicle_facing_east_that_flies_north():
    vehicle = VehicleMonitor(PX4)
    vehicle.on_message(attitude(1000, math.pi / 2), 0.0)
    sample = vehicle.on_message(position(1010, (3, 4, -5), (2, 0, -1)), 0.0)
    assert sample.boot_s == 1.01
    assert sample.odometry[0:3] == pytest.approx([4, 3, 5])
    assert yaw_of(sample.odometry) == pytest.approx(0.0)
    assert velocity_enu(sample.odometry) == pytest.approx([0, 2, 1])
    assert sample.odometry[7:10] == pytest.approx([0, 2, 1])  # left of the nose, and up
    assert sample.odometry[10:13] == pytest.approx([0.1, -0.2, -0.3])


def test_attitude_as_angles_and_odometry_say_the_same():
    angles = mavlink.MAVLink_attitude_message(1000, 0.1, 0.2, 0.7, 0, 0, 0)
    vehicle = VehicleMonitor(PX4)
    vehicle.on_message(angles, 0.0)
    one = vehicle.on_message(position(1000, (1, 2, 3)), 0.0).odometry
    from ptnsbc_io.mavlink.frames import quaternion_from_euler_ned

    message = mavlink.MAVLink_odometry_message(
        1_000_000,
        mavlink.MAV_FRAME_LOCAL_NED,
        mavlink.MAV_FRAME_BODY_FRD,
        1,
        2,
        3,
        quaternion_from_euler_ned(0.1, 0.2, 0.7).tolist(),
        0,
        0,
        0,
        0,
        0,
        0,
        [0.0] * 21,
        [0.0] * 21,
    )
    other = VehicleMonitor(PX4).on_message(message, 0.0).odometry
    assert other == pytest.approx(one)
    assert vehicle.on_message(message, 0.0) is None  # one source at a time


@pytest.mark.parametrize(
    "broken",
    [
        position(1000, (math.nan, 0, 0)),
        position(1000, (0, 0, 0), (math.inf, 0, 0)),
        position(1000, (1e7, 0, 0)),
        position(1500),  # its attitude is half a second older
    ],
)
def test_states_that_cannot_be_flown_by(broken):
    vehicle = VehicleMonitor(PX4)
    vehicle.on_message(attitude(1000), 0.0)
    assert vehicle.on_message(broken, 0.0) is None


def test_a_quaternion_that_is_none():
    vehicle = VehicleMonitor(PX4)
    vehicle.on_message(mavlink.MAVLink_attitude_quaternion_message(1, 0, 0, 0, 0, 0, 0, 0), 0.0)
    assert vehicle.on_message(position(1), 0.0) is None
    assert vehicle.pose.invalid == 1


@pytest.mark.parametrize(
    ("autopilot", "custom", "mode"),
    [
        (PX4, 6 << 16, FlightMode.OWN),
        (PX4, 4 << 16 | 3 << 24, FlightMode.HOLD),
        (PX4, 4 << 16 | 6 << 24, FlightMode.LAND),
        (PX4, 3 << 16, FlightMode.OTHER),
        (ARDUPILOT, 4, FlightMode.OWN),
        (ARDUPILOT, 9, FlightMode.LAND),
        (ARDUPILOT, 5, FlightMode.OTHER),
    ],
)
def test_modes(autopilot, custom, mode):
    vehicle = VehicleMonitor(autopilot)
    base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | ARMED
    vehicle.on_message(
        heartbeat(autopilot=autopilot.number, base_mode=base, custom_mode=custom), 1.0
    )
    assert (vehicle.mode, vehicle.armed, vehicle.wrong_vehicle) == (mode, True, "")


def test_strangers_are_named():
    vehicle = VehicleMonitor(PX4)
    vehicle.on_message(heartbeat(autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA), 1.0)
    assert vehicle.wrong_vehicle == (
        "MAV_AUTOPILOT 3 (ardupilot): expected px4, see mavlink.autopilot"
    )
    vehicle.on_message(heartbeat(type=mavlink.MAV_TYPE_FIXED_WING), 1.0)
    assert "MAV_TYPE 1: expected a multirotor" in vehicle.wrong_vehicle
    gimbal = VehicleMonitor(PX4)
    gimbal.on_message(heartbeat(autopilot=mavlink.MAV_AUTOPILOT_INVALID), 1.0)
    assert gimbal.heartbeat_s is None


def test_a_reboot_is_time_that_went_back_and_a_vehicle_that_is_disarmed():
    vehicle = VehicleMonitor(PX4)
    vehicle.on_message(heartbeat(base_mode=ARMED), 100.0)
    vehicle.on_message(attitude(90_000), 100.0)
    vehicle.on_message(attitude(1_500), 101.0)
    vehicle.on_message(attitude(1_520), 101.02)
    assert not vehicle.rebooted  # armed as far as we know: its clock may have jumped
    vehicle.on_message(heartbeat(), 101.5)
    assert vehicle.rebooted


def test_a_disarmed_px4_whose_checks_fail_is_not_initialised_and_has_not_rebooted():
    vehicle = VehicleMonitor(PX4)
    vehicle.on_message(attitude(90_000), 100.0)
    vehicle.on_message(heartbeat(base_mode=ARMED), 100.0)
    vehicle.on_message(heartbeat(system_status=mavlink.MAV_STATE_UNINIT), 101.0)
    assert not vehicle.armed
    assert not vehicle.rebooted


def test_a_boot_is_believed_only_of_a_clock_that_is_young():
    vehicle = VehicleMonitor(PX4)
    booting = heartbeat(system_status=mavlink.MAV_STATE_BOOT)
    vehicle.on_message(attitude(90_000), 100.0)
    vehicle.on_message(booting, 101.0)
    assert not vehicle.rebooted
    for boot_ms in (700, 720):
        vehicle.on_message(attitude(boot_ms), 102.0 + 1e-3 * boot_ms)
    assert vehicle.rebooted


def test_forged_young_times_are_no_reboot_when_the_old_time_goes_on():
    vehicle = VehicleMonitor(PX4, signed=False)
    for n in range(100):
        vehicle.on_message(attitude(90_000 + 20 * n), 100.0 + 0.02 * n)
        if n in (50, 51):
            vehicle.on_message(attitude(1_500 + 20 * n), 100.01 + 0.02 * n)
            vehicle.on_message(attitude(1_520 + 20 * n), 100.012 + 0.02 * n)
    for t in (102.0, 102.1):  # at touchdown: disarmed
        vehicle.on_message(heartbeat(), t)
    assert not vehicle.armed
    assert not vehicle.rebooted


def test_messages_that_were_held_up_are_no_reboot():
    vehicle = VehicleMonitor(PX4)
    for n in range(50):
        vehicle.on_message(attitude(20_000 + 20 * n), 100.0 + 0.02 * n)
    for n in range(50, 250):  # a host that stood still for five seconds has them all at once
        vehicle.on_message(attitude(20_000 + 20 * n), 106.0)
    for n in range(300, 350):
        vehicle.on_message(attitude(20_000 + 20 * n), 100.0 + 0.02 * n)
    vehicle.on_message(heartbeat(), 107.5)
    assert not vehicle.rebooted
    assert not vehicle.pose.clock.jumps_to_and_fro(107.5)


def test_two_vehicles_with_one_id_are_time_to_and_fro():
    vehicle = VehicleMonitor(PX4)
    for n in range(3):
        vehicle.on_message(attitude(90_000 + n), 100.0 + 0.1 * n)
        assert not vehicle.pose.clock.jumps_to_and_fro(100.0 + 0.1 * n)
        vehicle.on_message(attitude(5_000 + n), 100.05 + 0.1 * n)
    assert vehicle.pose.clock.jumps_to_and_fro(100.3)
    assert not vehicle.pose.clock.jumps_to_and_fro(110.0)


def test_gps_battery_landing_and_texts():
    vehicle = VehicleMonitor(PX4)

    def gps(fix):
        return mavlink.MAVLink_gps_raw_int_message(0, fix, 0, 0, 0, 0, 0, 0, 0, 9)

    assert vehicle.gnss.fix == ""  # no receiver was heard
    vehicle.on_message(gps(1), 0.0)
    assert vehicle.gnss.fix == "none"
    assert not vehicle.gnss.fix_lost(9.0)  # never had one: it flies without
    vehicle.on_message(gps(6), 10.0)
    assert vehicle.gnss.fix == "RTK fixed"
    vehicle.on_message(gps(1), 11.0)
    assert not vehicle.gnss.fix_lost(11.5)
    assert vehicle.gnss.fix_lost(12.0)
    status = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 0, 0, 15, 0, 0, 0, 0, 0, 0)
    vehicle.on_message(status, 0.0)
    assert not vehicle.battery.below(20.0, 0.0)  # one reading may be a dip
    assert vehicle.battery.below(20.0, 3.5)
    assert not vehicle.battery.below(10.0, 4.0)
    assert vehicle.battery.newest == (None, 0.0, 15.0)
    unknown = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 15_800, 1_234, -1, 0, 0, 0, 0, 0, 0)
    vehicle.on_message(unknown, 4.0)
    assert vehicle.battery.newest == (15.8, 12.34, 15.0)  # the share that was known last
    cells = mavlink.MAVLink_battery_status_message(0, 0, 0, 0, [3_900] * 10, 900, 0, 0, 12)
    vehicle.on_message(cells, 5.0)
    assert vehicle.battery.newest == (15.8, 12.34, 12.0)
    vehicle.on_message(mavlink.MAVLink_extended_sys_state_message(0, 2), 0.0)
    assert vehicle.landed is False
    for chunk, text in enumerate((b"Preflight Fail: ", b"no compass\t")):
        vehicle.on_message(mavlink.MAVLink_statustext_message(4, text, 7, chunk), 0.0)
    assert vehicle.warning == "Preflight Fail: no compass"
