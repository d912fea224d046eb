"""Messages of a bridge about its vehicle, as rclpy writes them and cut anywhere."""

import contextlib
import math

import pytest

pytest.importorskip("rclpy")

from rclpy.serialization import serialize_message
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from ptnsbc_io.cdr import WireError
from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_nodes.comm.vehicle_messages import (
    PlannerLimits,
    decode_limits,
    decode_origin,
    encode_limits,
    encode_origin,
)

PLACE, LIMITS = GeoPoint(47.4, -8.5, 488.0), PlannerLimits(1.5, 3.0)


def fix(**fields) -> bytes:
    message = NavSatFix(latitude=47.4, longitude=-8.5, altitude=488.0)
    message.header.frame_id = "earth"
    for name, value in fields.items():
        setattr(message, name, value)
    return serialize_message(message)


def array(*numbers: float) -> bytes:
    message = Float64MultiArray(data=list(numbers))
    message.layout.dim = [MultiArrayDimension(label="speed acceleration", size=2, stride=2)]
    return serialize_message(message)


def test_what_is_written_is_read_whoever_writes_it():
    for data in (encode_origin(PLACE), fix()):
        assert decode_origin(data) == PLACE
    for data in (encode_limits(LIMITS), array(1.5, 3.0), array(1.5, 3.0, 9.0)):
        assert decode_limits(data) == LIMITS


@pytest.mark.parametrize(
    ("decode", "data"),
    [
        *((decode_origin, fix(**{name: 1e6})) for name in ("latitude", "longitude", "altitude")),
        (decode_origin, fix(latitude=math.nan)),
        *((decode_limits, array(*numbers)) for numbers in ((), (1.0,), (0.0, 1.0), (1.0, math.inf))),
    ],
    ids=[*(f"origin-{k}" for k in range(4)), *(f"limits-{k}" for k in range(4))],  # rclpy leaves what is in the gaps
)  # fmt: skip
def test_what_no_vehicle_tells_is_refused(decode, data):
    with pytest.raises(WireError, match="expected"):
        decode(data)


@pytest.mark.parametrize(
    ("decode", "data"),
    [(decode_origin, fix()), (decode_limits, array(1.0, 2.0))],
    ids=["origin", "limits"],
)
def test_a_cut_or_changed_message_raises_nothing_else(decode, data):
    for at in range(len(data)):
        changed = bytearray(data)
        changed[at] ^= 0xFF
        for broken in (data[:at], bytes(changed)):
            with contextlib.suppress(WireError):
                decode(broken)
