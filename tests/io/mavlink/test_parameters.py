"""Parameters: both encodings of integers, questions repeated, names that do not exist."""

import struct

import pytest
from mavlink_wires import codec

from ptnsbc_io.mavlink import parameters
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.parameters import Encoding, ParameterReader, decoded

INT32, REAL32 = mavlink.MAV_PARAM_TYPE_INT32, mavlink.MAV_PARAM_TYPE_REAL32
INT8 = mavlink.MAV_PARAM_TYPE_INT8


def value(name, raw, kind):
    """A PARAM_VALUE as it arrives, with exactly these four bytes."""
    message = mavlink.MAVLink_param_value_message(name.encode(), 1.5, kind, 10, 3)
    data = bytearray(message.pack(codec()))
    data[10:14] = raw
    data[-2:] = struct.pack("<H", mavlink.x25crc(data[1:-2] + bytes([message.crc_extra])).crc)
    return mavlink.MAVLink(None).decode(data)


@pytest.mark.parametrize(
    ("raw", "kind", "encoding", "expected"),
    [
        (struct.pack("<i", 5), INT32, Encoding.BYTEWISE, 5.0),  # COM_OBL_RC_ACT of PX4
        (struct.pack("<f", 5.0), INT32, Encoding.C_CAST, 5.0),  # the same from ArduPilot
        (struct.pack("<i", -1), INT32, Encoding.BYTEWISE, -1.0),
        (struct.pack("<b", -3) + b"\x07\x07\x07", INT8, Encoding.BYTEWISE, -3.0),
        (struct.pack("<f", 0.5), REAL32, Encoding.BYTEWISE, 0.5),
        (struct.pack("<f", 0.5), REAL32, Encoding.C_CAST, 0.5),
        # a signalling NaN as a float: passing it through one changes the number
        (struct.pack("<I", 0x7F800001), INT32, Encoding.BYTEWISE, float(0x7F800001)),
    ],
)
def test_values_travel(raw, kind, encoding, expected):
    message = value("P", raw, kind)
    assert decoded(parameters.raw_value(message), message.param_type, encoding) == expected


def test_a_type_of_64_bits_is_refused():
    with pytest.raises(parameters.MavlinkParameterError, match="expected REAL32"):
        decoded(b"\0\0\0\0", mavlink.MAV_PARAM_TYPE_INT64, Encoding.BYTEWISE)


def test_questions_are_repeated_and_given_up():
    reader = ParameterReader(["A", "B"], Encoding.C_CAST)
    assert list(reader.due(0.0)) == ["A", "B"]
    assert list(reader.due(0.4)) == []
    reader.on_param_value(value("A", struct.pack("<f", 2.0), REAL32))
    reader.on_param_value(value("UNASKED", struct.pack("<f", 2.0), REAL32))
    asked = [list(reader.due(0.5 * n)) for n in (1, 2, 3, 4)]
    assert asked == [["B"], ["B"], ["B"], []]
    assert not reader.done(1.9)
    assert reader.done(2.0)
    assert reader.values == {"A": 2.0}
    assert reader.missing == ["B"]


def test_not_all_at_once():
    names = [f"P{n}" for n in range(10)]
    reader = ParameterReader(names, Encoding.C_CAST)
    assert len(list(reader.due(0.0))) == 4
