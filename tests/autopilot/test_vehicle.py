"""What all stand-ins do alike."""

import math

import numpy as np
import pytest

from ptnsbc_autopilot.firmware.arducopter import ArduCopter
from ptnsbc_autopilot.firmware.px4 import Px4
from ptnsbc_autopilot.firmware.stm32 import Stm32
from ptnsbc_autopilot.physics import targets
from ptnsbc_autopilot.physics.body import VehicleDescription, VehiclePhysics
from ptnsbc_autopilot.physics.navigation import QUALITIES
from ptnsbc_autopilot.server import Codec
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import Framer, Signer

ACCEPTED, DENIED = 0, 2
ALL = pytest.mark.parametrize("kind", [Px4, ArduCopter, Stm32])


def put(companion, name, value, kind):
    return companion.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind))


def frame(message_id, random):
    """A packet with a random payload and a right checksum."""
    kind = mavlink.mavlink_map[int(message_id)]
    payload = random.bytes(kind.unpacker.size)
    number = int(message_id).to_bytes(3, "little")
    head = bytes((len(payload), 0, 0, 0, 245, 191)) + number + payload
    check = mavlink.x25crc(head + bytes((kind.crc_extra,))).crc
    return b"\xfd" + head + check.to_bytes(2, "little")


# Signing.


@ALL
def test_timesync_answers_by_its_own_clock(companion, kind):
    made = companion(kind)
    made.run(1.9)
    (answer,) = made.send(mavlink.MAVLink_timesync_message(0, 123456789))
    assert answer.ts1 == 123456789
    assert answer.tc1 == pytest.approx(2.0e9, abs=1e7)
    assert made.send(mavlink.MAVLink_timesync_message(5, 123)) == []


def test_home_and_origin_on_request(companion):
    px4 = companion(Px4, origin_spread_m=30.0, start_enu=np.array((5.0, 7.0, 0.0)))
    for message_id in (
        mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
        mavlink.MAVLINK_MSG_ID_HOME_POSITION,
    ):
        assert px4.command(mavlink.MAV_CMD_REQUEST_MESSAGE, message_id) == ACCEPTED
    origin, home = px4.last("GPS_GLOBAL_ORIGIN"), px4.last("HOME_POSITION")
    px4.run(0.2)
    local = px4.last("LOCAL_POSITION_NED")
    north_m = (home.latitude - origin.latitude) * 1e-7 * 111_190
    assert north_m == pytest.approx(local.x, rel=0.01)
    assert (home.x, home.y) == pytest.approx((local.x, local.y), abs=1e-3)
    assert 1.0 < math.hypot(local.x, local.y) <= 30.0
    assert px4.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 99_999) == DENIED


def test_every_vehicle_has_an_origin_of_its_own():
    plain = QUALITIES["plain"]
    origins = [
        Px4(n, VehicleDescription(seed=n, quality=plain), 0.0).flight.navigation.origin_enu
        for n in (1, 2)
    ]
    assert 0.01 < np.linalg.norm(origins[0] - origins[1]) < 5.0


def test_odometry_and_local_position_agree(companion):
    px4 = companion(Px4, yaw_rad=1.0)
    px4.airborne()
    px4.flown(1.0, 0.5, 0, 20.0)  # its integral takes 7 s to make up for the drag
    odometry, local = px4.last("ODOMETRY"), px4.last("LOCAL_POSITION_NED")
    assert (odometry.frame_id, odometry.child_frame_id) == (1, 12)
    assert (odometry.x, odometry.z) == pytest.approx((local.x, local.z), abs=0.1)
    # Facing north: forward is north, right is east.
    assert (odometry.vx, odometry.vy) == pytest.approx((1.0, 0.5), abs=0.1)


def test_the_same_seed_and_messages_give_the_same_bytes(companion):
    def flight():
        px4 = companion(Px4, quality=QUALITIES["plain"], seed=11)
        px4.airborne(6.0)
        return [bytes(m.get_msgbuf()) for _, _, m in px4.heard]

    assert flight() == flight()


def test_physics_do_not_depend_on_how_often_they_are_advanced(companion):
    gains = companion(Px4).vehicle.gains()
    climb = targets.climb(targets.TargetPoint(np.zeros(3), 0.5), 1.0)
    ends = []
    for steps in (40, 1000):
        flight = VehiclePhysics(VehicleDescription(seed=4), gains, 0.0)
        flight.target = climb
        for n in range(steps):
            flight.advance(4.0 * (n + 1) / steps)
        ends.append(
            np.concatenate(
                (flight.truth.position_enu, flight.estimate.position_enu, [flight.battery])
            )
        )
    assert ends[0][2] > 2.0
    assert ends[0].tolist() == ends[1].tolist()


def test_the_battery_drains(companion):
    px4 = companion(Px4)
    px4.airborne()
    before = px4.vehicle.flight.battery
    px4.flown(0, 0, 0, 15.0)
    assert before - px4.vehicle.flight.battery == pytest.approx(15.0 / 1500.0, rel=0.1)
    percent = round(px4.vehicle.flight.battery * 100)
    assert px4.last("SYS_STATUS").battery_remaining == percent


# Commands.


def test_a_command_int_is_a_command(companion):
    px4 = companion(Px4)
    force = (1, 21196, 0, 0, 0, 0, 0)
    message = mavlink.MAVLink_command_int_message(
        1, 1, 0, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0, *force
    )
    (ack,) = px4.send(message)
    assert (ack.result, ack.target_system, ack.target_component) == (ACCEPTED, 245, 191)
    assert px4.vehicle.armed


def test_a_ping_comes_back_to_its_sender(companion):
    px4 = companion(Px4)
    (answer,) = px4.send(mavlink.MAVLink_ping_message(7, 3, 0, 0))
    assert (answer.time_usec, answer.seq) == (7, 3)
    assert (answer.target_system, answer.target_component) == (245, 191)
    assert px4.send(mavlink.MAVLink_ping_message(7, 3, 9, 1)) == []


def test_intervals_are_set_told_disabled_and_reset(companion):
    px4 = companion(Px4)
    wanted = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED

    def interval():
        px4.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, wanted)
        return px4.last("MESSAGE_INTERVAL").interval_us

    assert interval() == 33333
    for asked, told in ((10_000, 10_000), (-1, -1), (0, 33333)):
        assert px4.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, wanted, asked) == ACCEPTED
        assert interval() == told
    unknown = mavlink.MAVLINK_MSG_ID_VFR_HUD
    assert px4.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, unknown, 1e5) == 4


def test_home_is_set_here(companion):
    px4 = companion(Px4)
    px4.airborne()
    px4.flown(1.0, 0, 0, 3.0)
    assert px4.command(mavlink.MAV_CMD_DO_SET_HOME, 1) == ACCEPTED
    assert px4.last("HOME_POSITION").x == pytest.approx(px4.last("LOCAL_POSITION_NED").x, abs=0.1)
    assert px4.command(mavlink.MAV_CMD_DO_SET_HOME, 0) == DENIED


@pytest.mark.parametrize("kind", [Px4, ArduCopter])
def test_return_comes_home_and_lands(companion, kind):
    made = companion(kind)
    if kind is Px4:
        made.airborne()
        made.flown(2.0, 0, 0, 4.0)
    else:
        made.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4)
        made.arm()
        made.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 4)
        made.run(6.0)
        made.flown(2.0, 0, 0, 4.0)
    assert made.vehicle.flight.truth.position_enu[1] > 4.0
    made.put("RTL_RETURN_ALT" if kind is Px4 else "RTL_ALT_M", 6.0)
    assert made.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
    made.run(40.0)
    assert not made.vehicle.armed
    assert made.vehicle.flight.truth.position_enu == pytest.approx([0, 0, 0], abs=0.7)


def test_flight_termination_stops_the_motors(companion):
    px4 = companion(Px4)
    px4.airborne()
    assert px4.command(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, 1) == ACCEPTED
    px4.run(2.0)
    assert px4.vehicle.in_contact


@ALL
def test_random_messages_do_no_harm(companion, kind):
    """Any payload, in real frames, most of them addressed to us; truncated and flipped ones too."""
    made, random, codec = companion(kind), np.random.default_rng(5), Codec(1)
    made.arm(force=True)
    heeded = (0, 4, 11, 20, 21, 23, 70, 75, 76, 76, 82, 84, 84, 111)
    others, taken = sorted(mavlink.mavlink_map), 0
    for n in range(4000):
        packet = bytearray(frame(random.choice(heeded if n % 8 else others), random))
        if n % 10 == 0:
            packet[random.integers(len(packet))] ^= 1 << random.integers(8)
        if n % 10 == 1:
            packet = packet[: random.integers(1, len(packet))]
        for message in codec.decode(bytes(packet)):
            if random.integers(4):
                message.target_system = message.target_component = 1
            made.vehicle.handle(message, int(random.integers(2)), made.t)
            taken += 1
        made.vehicle.step(made.t)
        made.t += 0.004
    flight = made.vehicle.flight
    assert taken > 2000
    assert np.isfinite(
        np.concatenate((flight.truth.position_enu, flight.estimate.position_enu))
    ).all()


def test_with_a_key_unsigned_and_wrongly_signed_packets_are_dropped():
    key, other = bytes(range(32)), bytes(32)
    message = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    vehicle = Codec(1, key=key)
    assert vehicle.decode(Codec(245, 191).encode(message)) == []
    assert vehicle.decode(Codec(245, 191, key=other).encode(message)) == []
    packet = Codec(246, 191, key=key).encode(message)
    assert len(vehicle.decode(packet)) == 1
    assert vehicle.decode(packet) == [], "replayed"
    assert vehicle.dropped == 3


def test_the_bridge_and_the_stand_in_believe_each_other():
    """Two implementations of signing, pymavlink's and ours."""
    key, beat = bytes(range(32)), mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    vehicle, signer = Codec(1, key=key), Signer(key)
    (frame,) = Framer(stream=False).feed(vehicle.encode(beat))
    assert signer.has_valid_signature(frame)
    assert signer.is_new(frame)
    bridge = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    signer.prepare(bridge)
    assert len(vehicle.decode(bytes(beat.pack(bridge)))) == 1


# Faults.
