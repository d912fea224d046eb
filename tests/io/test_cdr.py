"""Cut, damaged and random bytes in every decoder, and values that CDR cannot carry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wire_messages import foreign_near

from ptnsbc_io import wire

DECODERS = [
    wire.decode_odometry,
    wire.decode_near,
    wire.decode_velocity,
    wire.decode_wrench,
    wire.decode_header,
    wire.peek_stamp,
    wire.peek_sequence_stamp,
]


def samples():
    odom = wire.OdometryTemplate("map", "uav1").encode(3, np.ones(13))
    six = wire.WrenchTemplate("uav1").encode(3, np.ones(6))
    near = wire.encode_near(3, "map", np.ones((2, 8)))
    return [
        odom,
        six,
        near,
        wire.HeaderTemplate("leg 1").encode(3),
        wire.encode_clock(3),
        foreign_near(),
    ]


@given(st.one_of(st.binary(max_size=200), st.sampled_from(samples())), st.data())
@settings(max_examples=200)
def test_rubbish_raises_only_wire_errors(buf, data):
    broken = bytearray(buf)
    for at in data.draw(st.lists(st.integers(0, max(len(buf) - 1, 0)), max_size=4)):
        if broken:
            broken[at] = data.draw(st.integers(0, 255))
    cut = bytes(broken[: data.draw(st.integers(0, len(broken)))])
    for decode in DECODERS:
        try:
            decode(cut)
        except wire.WireError as error:
            assert "expected" in str(error) or "no field" in str(error)


@pytest.mark.parametrize(
    ("decode", "buf"),
    [
        (wire.decode_odometry, samples()[0]),
        (wire.decode_wrench, samples()[1]),
        (wire.decode_near, samples()[2]),
        (wire.decode_header, samples()[3]),
        (wire.peek_stamp, samples()[4]),
        (wire.decode_near, samples()[5]),
    ],
)
def test_every_cut_is_an_error(decode, buf):
    decode(buf)
    decode(buf + b"\0\0")  # a transport may round a message up
    for size in range(len(buf)):
        with pytest.raises(wire.WireError, match="expected"):
            decode(buf[:size])


def test_unknown_encapsulation():
    with pytest.raises(wire.WireError, match="encapsulation 0006: expected 0001 or 0000"):
        wire.decode_odometry(b"\x00\x06" + samples()[0][2:])


def test_stamp_beyond_the_wire():
    with pytest.raises(wire.WireError, match="expected seconds within 32 bits"):
        wire.HeaderTemplate("x").encode(2**31 * 10**9)


def test_string_with_nul():
    with pytest.raises(wire.WireError, match="expected no NUL"):
        wire.HeaderTemplate("a\0b")
