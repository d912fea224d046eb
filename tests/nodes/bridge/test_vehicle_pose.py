"""Unsigned links: one packet that is broken and has the right checksum by chance changes nothing."""

import math
import random

import numpy as np
import pytest

pytest.importorskip("pymavlink")

import mavlink_wires as wires
from mavlink_fleet import MavlinkFleet
from mavlink_wires import heartbeat

from ptnsbc_core.kinematics import quaternion_from_euler, rotation_from_quaternion, velocity_enu
from ptnsbc_io.mavlink.autopilots import PX4, FlightMode
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.frames import quaternion_enu_flu_to_ned_frd
from ptnsbc_nodes.bridge.vehicle_monitor import VehicleMonitor
from ptnsbc_nodes.bridge.vehicle_pose import (
    ConfirmedValue,
    RateLimitedValue,
    place_of,
    true_odometry,
)
from ptnsbc_sim.scenario import load_scenario

ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
OFFBOARD, HOLD = 6 << 16, 4 << 16 | 3 << 24
DT = 0.02


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


@pytest.mark.parametrize("kind", ["px4", "arducopter"])
@pytest.mark.parametrize("height", ["ground", "origin"])
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
