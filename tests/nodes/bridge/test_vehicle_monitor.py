"""The vehicle monitor: states in ENU and FLU, broken ones refused, reboots and duplicates noticed."""

import math
import random

import numpy as np
import pytest

pytest.importorskip("pymavlink")

import mavlink_wires as wires
from mavlink_fleet import MavlinkFleet
from mavlink_wires import attitude, heartbeat, position

from ptnsbc_core.kinematics import (
    quaternion_from_euler,
    rotation_from_quaternion,
    velocity_enu,
    yaw_of,
)
from ptnsbc_io.mavlink.autopilots import ARDUPILOT, PX4
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_io.mavlink.frames import quaternion_enu_flu_to_ned_frd
from ptnsbc_nodes.bridge.vehicle_monitor import (
    ConfirmedValue,
    RateLimitedValue,
    VehicleMonitor,
    place_of,
    true_odometry,
)
from ptnsbc_sim.scenario import load_scenario

ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
OFFBOARD, HOLD = 6 << 16, 4 << 16 | 3 << 24
DT = 0.02


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


@pytest.mark.parametrize(
    "broken",
    [
        mavlink.MAVLink_attitude_quaternion_message(1, 0, 0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_attitude_message(1, math.inf, 0, 0, 0, 0, 0),
        mavlink.MAVLink_attitude_message(1, 0, math.nan, 0, 0, 0, 0),
    ],
)
def test_attitudes_that_are_none(broken):
    vehicle = VehicleMonitor(PX4)
    vehicle.on_message(broken, 0.0)
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
    assert vehicle.unready == "MAV_STATE 0: expected STANDBY"
    vehicle.on_message(heartbeat(), 102.0)
    assert vehicle.unready == ""


@pytest.mark.parametrize(
    ("enabled", "healthy", "unready"),
    [(True, False, True), (True, True, False), (False, False, False)],
)
def test_a_vehicle_is_not_ready_whose_pre_arm_check_fails(enabled, healthy, unready):
    """A sensor that is not healthy alone does not count: the vehicle may fly without it."""
    check, gps = mavlink.MAV_SYS_STATUS_PREARM_CHECK, mavlink.MAV_SYS_STATUS_SENSOR_GPS
    bits = (check | gps, check * enabled | gps, check * healthy)
    vehicle = VehicleMonitor(PX4)
    vehicle.on_message(mavlink.MAVLink_sys_status_message(*bits, 0, 0, 0, -1, *[0] * 6), 1.0)
    assert bool(vehicle.unready) is unready
    assert vehicle.unhealthy


def sensors(enabled, healthy):
    return mavlink.MAVLink_sys_status_message(enabled, enabled, healthy, *[0] * 3, -1, *[0] * 6)


def test_a_sensor_fails_in_flight_and_one_that_was_bad_before_does_not():
    accel, mag = mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL, mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    battery = mavlink.MAV_SYS_STATUS_SENSOR_BATTERY  # it has a rule of its own
    vehicle = VehicleMonitor(PX4)
    vehicle.on_message(sensors(accel | mag | battery, accel | battery), 1.0)
    vehicle.on_message(heartbeat(base_mode=mavlink.MAV_MODE_FLAG_SAFETY_ARMED), 2.0)
    vehicle.on_message(sensors(accel | mag | battery, accel), 3.0)
    assert vehicle.failed == ""
    vehicle.on_message(sensors(accel | mag | battery, 0), 4.0)
    assert vehicle.failed == "3d accel"
    vehicle.on_message(sensors(accel | mag | battery, accel), 5.0)
    assert vehicle.failed == ""


def test_a_bridge_that_takes_over_in_flight_blames_no_sensor_that_it_found_bad():
    vehicle, accel = VehicleMonitor(PX4), mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    vehicle.on_message(heartbeat(base_mode=mavlink.MAV_MODE_FLAG_SAFETY_ARMED), 2.0)
    vehicle.on_message(sensors(accel, 0), 3.0)
    assert vehicle.failed == ""


@pytest.mark.parametrize(("severity", "alarms"), [(2, True), (0, True), (3, False)])
def test_a_critical_text_is_an_alarm(severity, alarms):
    vehicle = VehicleMonitor(PX4)
    vehicle.on_message(mavlink.MAVLink_statustext_message(severity, b"EKF variance"), 7.0)
    assert vehicle.alarm == (("EKF variance", 7.0) if alarms else ("", float("-inf")))


@pytest.mark.parametrize(
    "text", ["EKF Failsafe Cleared", "Glitch cleared", "Vibration compensation OFF"]
)
def test_what_is_well_again_is_no_alarm(text):
    """ArduCopter calls it critical."""
    vehicle = VehicleMonitor(ARDUPILOT)
    vehicle.on_message(mavlink.MAVLink_statustext_message(2, text.encode()), 7.0)
    assert vehicle.alarm == ("", float("-inf"))
    assert vehicle.warning == text


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
    assert not vehicle.battery.low(20.0, 0.0)  # one reading may be a dip
    assert vehicle.battery.low(20.0, 3.5)
    assert not vehicle.battery.low(10.0, 4.0)
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


def test_a_change_counts_when_it_is_said_twice():
    twice = ConfirmedValue()
    assert [twice.accepts(value) for value in "aabacbccd"] == [
        False, True, False, True, False, False, False, True, False
    ]  # fmt: skip
    assert twice.unconfirmed


def test_a_jump_counts_when_the_next_one_follows_it():
    smooth = RateLimitedValue(np.array([0.2]), np.array([10.0]))
    path = [0.0, 0.1, 0.3, 9.0, 0.5, 7.0, 7.1, 7.2, float("nan"), float("nan"), 7.3]
    told = [smooth.accepts(np.array([x]), DT * n) for n, x in enumerate(path)]
    assert told == [False, True, True, False, True, False, True, True, False, False, True]
    assert smooth.rejected == 4


class Flown:
    """A vehicle on an unsigned link that flies a circle: 50 Hz of states, everything else now and then."""

    def __init__(self, mode=OFFBOARD):
        self.vehicle = VehicleMonitor(PX4, signed=False)
        self.mode, self.n = mode, 0
        self.samples = []
        for _ in range(100):
            self.step()

    def step(self, all_kinds=False):
        now, boot_ms = 1000.0 + DT * self.n, 90_000 + round(1e3 * DT * self.n)
        q = quaternion_enu_flu_to_ned_frd(quaternion_from_euler(np.array([0.1, 0.0, 0.2 * now])))
        angle = 0.5 * now
        xyz = (2.0 * np.cos(angle), 2.0 * np.sin(angle), -5.0)
        v = (-np.sin(angle), np.cos(angle), 0.0)
        messages = [
            mavlink.MAVLink_attitude_quaternion_message(boot_ms, *q, 0.0, 0.0, -0.2),
            mavlink.MAVLink_local_position_ned_message(boot_ms, *xyz, *v),
        ]
        if all_kinds or self.n % 50 == 0:
            messages.append(heartbeat(base_mode=ARMED, custom_mode=self.mode))
            messages.append(mavlink.MAVLink_extended_sys_state_message(0, 2))
            origin = mavlink.MAVLink_gps_global_origin_message(473977420, 85455940, 488000)
            messages.append(origin)
        for message in messages:
            self.hear(message, now)
        self.n += 1

    def hear(self, message, now=None):
        sample = self.vehicle.on_message(message, 1000.0 + DT * self.n if now is None else now)
        if sample is not None:
            self.samples.append(sample)

    def facts(self):
        v = self.vehicle
        return (
            v.mode,
            v.armed,
            v.landed,
            v.rebooted,
            v.wrong_vehicle,
            v.anchor.place,
            v.gnss.fix_lost(1e9),
        )


def test_a_real_change_costs_one_message():
    flown = Flown()
    assert (flown.vehicle.mode, flown.vehicle.armed) == (FlightMode.OWN, True)
    flown.hear(heartbeat(base_mode=ARMED, custom_mode=HOLD))
    assert flown.vehicle.mode is FlightMode.OWN
    assert flown.vehicle.unconfirmed  # and the bridge asks for another one
    flown.hear(heartbeat(base_mode=ARMED, custom_mode=HOLD))
    assert flown.vehicle.mode is FlightMode.HOLD
    assert not flown.vehicle.unconfirmed


def test_a_signed_vehicle_is_believed_at_once():
    vehicle = VehicleMonitor(PX4, signed=True)
    vehicle.on_message(heartbeat(base_mode=ARMED, custom_mode=HOLD), 0.0)
    assert vehicle.mode is FlightMode.HOLD


KINDS = [
    heartbeat(base_mode=ARMED, custom_mode=OFFBOARD),
    mavlink.MAVLink_attitude_quaternion_message(91_000, 1, 0, 0, 0, 0, 0, 0),
    mavlink.MAVLink_attitude_message(91_000, 0.1, 0, 0.3, 0, 0, 0),
    mavlink.MAVLink_local_position_ned_message(91_000, 2, 0, -5, 0, 1, 0),
    mavlink.MAVLink_extended_sys_state_message(0, 2),
    mavlink.MAVLink_gps_global_origin_message(473977420, 85455940, 488000),
    mavlink.MAVLink_system_time_message(10**15, 91_000),
]


@pytest.mark.parametrize("message", KINDS, ids=lambda message: message.get_type())
def test_a_thousand_broken_packets_with_the_right_checksum_change_nothing(message):
    """Each among real traffic; what is told of the vehicle stays on its circle."""
    rng, flown, codec = random.Random(1), Flown(), wires.codec()
    before, clean = flown.facts(), len(flown.samples)
    for _ in range(1000):
        flown.hear(_with_right_checksum(rng, message, codec))
        assert flown.facts() == before
        flown.step(all_kinds=True)  # as when it is asked for
    told = np.array([sample.odometry for sample in flown.samples[clean:]])
    assert len(told) >= 900  # one that looks right may cost the next one its place
    assert np.abs(np.hypot(told[:, 0], told[:, 1]) - 2.0).max() < 0.9  # one step of noise
    assert np.abs(told[:, 2] - 5.0).max() < 0.9
    assert np.abs(told[:, 10:13]).max() < 2.0


def _with_right_checksum(rng, message, codec):
    """The message with bits of its payload turned over, packed anew."""
    data = bytearray(message.pack(codec))
    payload = bytearray(data[10:-2])
    for _ in range(rng.randint(1, 6)):
        payload[rng.randrange(len(payload))] ^= 1 << rng.randrange(8)
    data[10:-2] = payload
    crc = mavlink.x25crc(bytes(data[1:-2]) + bytes([message.crc_extra])).crc
    data[-2:] = crc.to_bytes(2, "little")
    return wires.mavlink.MAVLink(None).decode(data)


AUTOPILOTS = {"px4": "px4", "arducopter": "ardupilot", "stm32": "generic"}
RESOLUTION_M = 0.02  # 1e-7 degrees are 11 mm


def fleet(kind, **overrides):
    changes = {"mavlink.autopilot": AUTOPILOTS[kind], **overrides}
    if kind == "stm32":
        changes["mavlink.setpoint"] = "attitude"
        settings = load_scenario("experiment_4").mavlink.overrides
        changes["mavlink.overrides"] = {**settings, "gains.force.kappa_1_s": 3.0}
    made = MavlinkFleet(
        load_scenario("experiment_4", changes).bridged(), kind, count=1, gnss="quiet"
    )
    return made.airborne()


@pytest.mark.parametrize(("kind", "height"), [("px4", "origin"), ("arducopter", "ground")])
def test_the_truth_of_a_stand_in_is_in_the_world_of_the_fleet(kind, height):
    made = fleet(kind, **{"mavlink.height": height})
    made.form().run(3.0)
    uav = made.uavs[1]
    (_, first), (_, last) = uav.truths[0], uav.truths[-1]
    flight = uav.vehicle.flight
    # The leader defines the world: it stands at its start by its estimate. The moves are true.
    assert last[0:3] - first[0:3] == pytest.approx(
        flight.truth.position_enu - uav.vehicle.body.start_enu, abs=2 * RESOLUTION_M
    )
    estimated = uav.odometry[-1][0:3] if uav.odometry else uav.tracks[-1][1][0:3]
    assert np.linalg.norm(last[0:3] - estimated) < 1.0
    assert velocity_enu(last) == pytest.approx(flight.truth.velocity_enu, abs=0.05)
    up = rotation_from_quaternion(last[3:7])[2, 2]
    assert up == pytest.approx(rotation_from_quaternion(flight._state[3:7])[2, 2], abs=0.01)


def test_a_controller_that_tells_no_truth_has_none():
    assert fleet("stm32").uavs[1].truths == []


def hil(**changes):
    fields = {
        "time_usec": 0,
        "attitude_quaternion": [1.0, 0.0, 0.0, 0.0],
        **dict.fromkeys(("rollspeed", "pitchspeed", "yawspeed"), 0.0),
        **dict.fromkeys(("lat", "lon", "alt", "vx", "vy", "vz"), 0),
        **dict.fromkeys(("ind_airspeed", "true_airspeed", "xacc", "yacc", "zacc"), 0),
    }
    return mavlink.MAVLink_hil_state_quaternion_message(**{**fields, **changes})


@pytest.mark.parametrize(
    "changes",
    [
        {"attitude_quaternion": [0.0] * 4},
        {"attitude_quaternion": [math.nan, 0.0, 0.0, 1.0]},
        {"rollspeed": math.inf},
    ],
)
def test_numbers_without_sense_are_no_truth(changes):
    assert true_odometry(hil(**changes), np.zeros(3)) is None


def test_a_place_is_in_degrees_and_metres():
    place = place_of(hil(lat=473977420, lon=85455940, alt=488_500))
    assert place == pytest.approx((47.397742, 8.545594, 488.5))
