"""What comes in: refused, counted and named, and never raised into the executor."""

import random

import numpy as np
import pytest

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io import wire
from ptnsbc_nodes.comm import door as doors
from ptnsbc_nodes.comm.announcements import decode_leg, decode_lost, decode_order
from ptnsbc_nodes.comm.door import (
    LARGEST_MESSAGE,
    Door,
    LockstepStamps,
    RealTimeStamps,
    Refusals,
    as_bytes,
    in_order,
)

PERIOD = 10


def taken(rule, *stamps):
    """Which of these stamps the rule takes."""
    found = []
    for stamp in stamps:
        try:
            rule.check(stamp)
        except wire.WireError:
            continue
        found.append(stamp)
    return found


def test_lockstep_stamps_rise_on_the_grid_up_to_the_horizon():
    latest = [6 * PERIOD]
    rule = LockstepStamps(lambda: latest[0], PERIOD)
    assert taken(rule, 0, 0, 10, 15, 5, 60, 70, 2**62, -10) == [0, 10, 60]
    latest[0] = 20 + 6 * PERIOD
    assert taken(rule, 70, 90, 80) == [70, 80]


class Clocks:
    def __init__(self):
        self.now_ns, self.steady_s = 100 * 10**9, 0.0

    def rule(self):
        return RealTimeStamps(lambda: self.now_ns, lambda: self.steady_s)


def test_real_time_stamps_are_near_the_clock_and_rise():
    clocks = Clocks()
    rule, now = clocks.rule(), clocks.now_ns
    old, future = now - 10_100_000_000, now + 1_100_000_000
    assert taken(rule, now, now, old, future, now - 1, now + 5) == [now, now + 5]


def test_in_real_time_a_stamp_that_comes_twice_is_dropped_and_is_no_refusal():
    """A UAV that was late ticks twice with one odometry."""
    clocks, refusals, delivered = Clocks(), Refusals(), []
    decode = in_order(lambda data: wire.Stamped(clocks.now_ns - data[0], (data[0],)), clocks.rule())
    door = Door("/uav2/leader_estimate", decode, delivered.append, refusals)
    for age in (b"\2", b"\2", b"\1"):
        door(age)
    assert [message.values[0] for message in delivered] == [2, 1]
    assert refusals.values() == {}
    door(b"\3")
    assert refusals.counts == {"/uav2/leader_estimate": 1}


def test_a_clock_that_was_set_back_is_followed_after_a_silence():
    clocks = Clocks()
    rule, now = clocks.rule(), clocks.now_ns
    assert taken(rule, now, now - 3 * 10**9) == [now]
    clocks.steady_s = 0.51
    assert taken(rule, now - 3 * 10**9, now - 3 * 10**9) == [now - 3 * 10**9]


def test_stamps_are_not_compared_with_a_simulated_clock_that_has_not_begun():
    clocks = Clocks()
    clocks.now_ns = 0
    assert taken(clocks.rule(), 5 * 10**9) == [5 * 10**9]


def through(decode, *messages):
    got, refusals = [], Refusals()
    door = Door("/x", decode, got.append, refusals)
    for message in messages:
        door(message)
    return got, refusals


def test_what_is_refused_is_counted_and_named_once():
    got, refusals = through(decode_leg, leg("form"), leg("loop"), b"", leg("hold"))
    assert [one.frame_id for one in got] == ["form", "hold"]
    assert refusals.counts == {"/x": 2}
    assert refusals.values()["refused"] == "/x=2"
    assert "std_msgs/Header" in refusals.values()["refused_newest"]
    assert refusals.report().startswith("2 messages refused: /x: ")
    assert refusals.report() == ""


def test_what_follows_a_message_follows_a_refused_one_too():
    """A recorder that outsiders flooded never looked at the signal that should end it."""
    looks = []
    door = Door("/x", decode_leg, print, Refusals(), after=lambda: looks.append(1))
    for message in (b"", leg("form")):
        door(message)
    assert len(looks) == 2


def test_nothing_is_said_as_long_as_nothing_is_refused():
    _, refusals = through(decode_leg, leg("form"))
    assert refusals.values() == {}
    assert refusals.report() == ""


def test_a_senders_words_are_shown_without_escapes_and_cut():
    _, refusals = through(decode_leg, leg("\x1b[31m\n" + 500 * "x"))
    newest = refusals.values()["refused_newest"]
    assert newest.isprintable()
    assert len(newest) < 250


def test_a_message_of_any_size_costs_nothing_to_refuse():
    got, refusals = through(bytes, bytes(LARGEST_MESSAGE + 1))
    assert got == []
    assert refusals.values()["refused_newest"] == f"/x: {LARGEST_MESSAGE + 1} bytes: expected " + (
        f"{LARGEST_MESSAGE} at most"
    )


def leg(name, stamp_ns=0):
    return wire.HeaderTemplate(name).encode(stamp_ns)


@pytest.mark.parametrize(
    ("name", "uav"),
    [("uav3", 3), ("uav20", 20), ("bridge2", None), ("recorder", None), ("sim", None)],
)
def test_processes_that_may_be_lost(name, uav):
    assert decode_lost(leg(name)) == (name, uav)


@pytest.mark.parametrize(
    "name", ["", "uav", "uav0", "uav-1", "uav" + 5000 * "9", "uav\u0663", "3", "uav3 "]
)
def test_names_that_no_process_has(name):
    with pytest.raises(wire.WireError, match="expected uavN, bridgeN"):
        decode_lost(leg(name))


def test_orders_of_the_operator():
    assert decode_order(leg("kill all")) == ("kill", True)
    with pytest.raises(wire.WireError, match="'dance': expected land, kill"):
        decode_order(leg("dance"))


@pytest.mark.parametrize("t0", [-1, -(10**18)])
def test_no_leg_begins_before_time_does(t0):
    with pytest.raises(wire.WireError, match="expected 0 or later"):
        decode_leg(leg("form", t0))


def odometry(values, frames=("map", "uav1/base_link")):
    return wire.OdometryTemplate(*frames).encode(5, np.asarray(values, dtype=float))


def body():
    values = np.zeros(13)
    values[6] = 1.0
    return values


MESSAGES = {
    "odometry": (wire.OdometryDecoder("map", "uav1/base_link"), odometry(body())),
    "near": (wire.checked_near, wire.encode_near(5, "map", np.ones((3, 8)))),
    "wrench": (wire.checked_wrench, wire.WrenchTemplate("x").encode(5, np.ones(6))),
    "velocity": (wire.checked_velocity, wire.VelocityTemplate("x").encode(5, np.ones(6))),
    "leg": (decode_leg, leg("form")),
    "lost": (decode_lost, leg("uav3")),
    "order": (decode_order, leg("land")),
}


@pytest.mark.parametrize("kind", MESSAGES)
def test_no_bytes_raise(kind):
    """Cut, lengthened, and with any bytes changed: taken or refused."""
    decode, data = MESSAGES[kind]
    draw = random.Random(7)
    messages = [data[:size] for size in range(len(data))] + [data + bytes(9)]
    for _ in range(3000):
        broken = bytearray(data)
        for _ in range(draw.choice((1, 1, 2, 8))):
            at = draw.randrange(len(broken))
            broken[at : at + 4] = draw.choice(
                (b"\xff\xff\xff\xff", b"\0\0\0\0", b"\0\0\xf0\x7f", draw.randbytes(4))
            )
        messages.append(bytes(broken))
    got, refusals = through(decode, *messages)
    assert len(got) + sum(refusals.counts.values()) == len(messages)
    for message in got:
        if kind in ("odometry", "near", "wrench", "velocity"):
            assert np.isfinite(message.values).all()


def test_bytes_are_passed_on_when_they_are_good():
    decode, data = MESSAGES["velocity"]
    assert as_bytes(decode)(data) is data
    with pytest.raises(PtnsbcError):
        as_bytes(decode)(data[:-1])


def test_a_stamp_is_judged_after_the_message():
    rule = LockstepStamps(lambda: 100, 1)
    decode = in_order(wire.checked_wrench, rule)
    bad = wire.WrenchTemplate("x").encode(7, np.full(6, np.nan))
    good = wire.WrenchTemplate("x").encode(5, np.ones(6))
    got, refusals = through(decode, bad, good, good)
    assert len(got) == 1  # the stamp of the bad one does not count
    assert sum(refusals.counts.values()) == 2


@pytest.mark.ros
def test_every_subscription_has_a_door():
    """Of every process of ours, in all three kinds of flight: `docs.make.graph` starts them all."""
    pytest.importorskip("rclpy")
    from docs.make.graph import ends

    found = [end for end in ends() if not end.publishes]
    assert {end.node for end in found} == {"uav", "bridge", "sim", "recorder", "launcher"}
    assert len({end.topic for end in found}) > 12
    assert [end for end in found if not end.guarded] == []


def test_no_module_subscribes_beside_the_doors():
    """A subscription that `docs.make.graph` does not start would pass the test above."""
    from pathlib import Path

    package = Path(doors.__file__).parents[1]
    calls = {
        str(path.relative_to(package))
        for path in package.rglob("*.py")
        if "create_subscription(" in path.read_text(encoding="utf-8")
    }
    foreign = (
        "bridge/ros_vehicle/topics.py"  # behind a door of its own: tests/nodes/bridge/ros_vehicle
    )
    assert calls == {"comm/endpoints.py", "recording/recorder.py", foreign}
