"""What a message from outside must satisfy before a law computes with it."""

import numpy as np
import pytest

from ptnsbc_io import wire

FRAMES = ("map", "uav3/base_link")


def body(at=None, value=0.0):
    values = np.zeros(13)
    values[6] = 1.0
    if at is not None:
        values[at] = value
    return values


def odometry(values, frames=FRAMES):
    return wire.OdometryTemplate(*frames).encode(7, values)


@pytest.mark.parametrize("decode", [wire.OdometryDecoder(), wire.OdometryDecoder(*FRAMES)])
def test_a_possible_state_is_what_was_sent(decode):
    values = np.array([-1e3, 2e3, 50.0, 0.5, 0.5, -0.5, 0.5, 30.0, -30.0, 5.0, 6.0, 6.0, -6.0])
    stamp_ns, found = decode(odometry(values))
    assert stamp_ns == 7
    assert found.tobytes() == values.tobytes()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e308, -1e7])
@pytest.mark.parametrize("at", range(13))
def test_no_number_of_a_state_may_be_impossible(at, value):
    with pytest.raises(wire.WireError, match="expected"):
        wire.OdometryDecoder()(odometry(body(at, value)))


@pytest.mark.parametrize("turn", [0.0, 0.9, 1.1, 2.0])
def test_a_quaternion_has_norm_one(turn):
    with pytest.raises(wire.WireError, match=r"quaternion of norm .*: expected 1"):
        wire.OdometryDecoder()(odometry(body(6, turn)))


@pytest.mark.parametrize(
    "frames", [("odom", FRAMES[1]), ("map", "uav2/base_link"), ("map", ""), ("map", "uav3")]
)
def test_a_neighbour_names_its_frames(frames):
    with pytest.raises(wire.WireError, match=r"expected 'map' and 'uav3/base_link'"):
        wire.OdometryDecoder(*FRAMES)(odometry(body(), frames))
    assert wire.OdometryDecoder()(odometry(body(), frames)).stamp_ns == 7


def test_frames_are_compared_by_name_where_the_gaps_hold_old_memory():
    data = bytearray(odometry(body(), ("map", "uav33/base_link")))
    gap = data.index(b"base_link\0") + len(b"base_link\0")
    assert data[gap] == 0
    assert wire.OdometryDecoder("map", "uav33/base_link")(bytes(data)).stamp_ns == 7
    aligned = odometry(body(), ("world", FRAMES[1]))
    data = bytearray(aligned)
    gap = data.index(b"world\0") + 6
    assert data[gap : gap + 2] == bytes(2)
    data[gap : gap + 2] = b"\xab\xcd"
    assert wire.OdometryDecoder("world", FRAMES[1])(bytes(data)).stamp_ns == 7


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e308, -1e7])
@pytest.mark.parametrize("at", range(6))
def test_no_number_of_a_setpoint_may_be_impossible(at, value):
    values = np.zeros(6)
    values[at] = value
    with pytest.raises(wire.WireError, match="expected"):
        wire.checked_wrench(wire.WrenchTemplate("x").encode(0, values))
    with pytest.raises(wire.WireError, match="expected"):
        wire.checked_velocity(wire.VelocityTemplate("x").encode(0, values))


def near(rows):
    return wire.encode_near(0, "map", np.asarray(rows, dtype=float).reshape(-1, 7))


def test_near_objects_that_can_be():
    assert wire.checked_near(near([])).values.shape == (0, 7)
    rows = np.ones((40, 7))
    assert wire.checked_near(near(rows)).values.tobytes() == rows.tobytes()
    rows[3, 0] = np.nan  # "no return"
    assert len(wire.checked_near(near(rows)).values) == 39


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([[0, 0, 0, -1, 0, 0, 0]], "radius -1 m: expected 0 or more"),
        (
            [[0, 0, 0, 1, 0, 0, 0], [1e9, 0, 0, 1, 0, 0, 0]],
            "position 1e\\+09, 0, 0: expected finite",
        ),
        ([[0, 0, 0, 1, 1e5, 0, 0]], "velocity 100000, 0, 0: .*below 1000"),
        (np.ones((1025, 7)), "1025 objects: expected at most 1024"),
    ],
)
def test_near_objects_that_cannot_be(rows, words):
    with pytest.raises(wire.WireError, match=words):
        wire.checked_near(near(rows))
