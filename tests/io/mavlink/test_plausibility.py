"""Unsigned links: one packet that is broken and has the right checksum by chance changes nothing."""

import random

import numpy as np
import pytest

pytest.importorskip("pymavlink")

import mavlink_wires as wires
from mavlink_wires import heartbeat

from ptnsbc_core.kinematics import quaternion_from_euler
from ptnsbc_io.mavlink.autopilots import PX4, FlightMode
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.frames import quaternion_enu_flu_to_ned_frd
from ptnsbc_io.mavlink.plausibility import ConfirmedValue, RateLimitedValue
from ptnsbc_nodes.bridge.vehicle import VehicleMonitor

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
            v.fix_lost(1e9),
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
