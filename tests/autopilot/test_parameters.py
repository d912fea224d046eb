"""How the stand-ins tell and take their parameters."""

import struct

import pytest

from ptnsbc_autopilot.firmware.arducopter import ArduCopter
from ptnsbc_autopilot.firmware.px4 import Px4
from ptnsbc_autopilot.firmware.stm32 import Stm32
from ptnsbc_io.mavlink.dialect import mavlink

ALL = pytest.mark.parametrize("kind", [Px4, ArduCopter, Stm32])


def read(companion, name):
    request = mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), -1)
    return companion.send(request)


def put(companion, name, value, kind):
    return companion.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind))


def as_bits(value):
    return struct.unpack("<f", struct.pack("<i", value))[0]


def test_px4_sends_the_bits_of_a_whole_number(companion):
    px4 = companion(Px4)
    (sent,) = put(px4, "COM_OBL_RC_ACT", as_bits(5), mavlink.MAV_PARAM_TYPE_INT32)
    assert struct.unpack("<i", struct.pack("<f", sent.param_value)) == (5,)
    assert px4.vehicle.parameters["COM_OBL_RC_ACT"] == 5
    (sent,) = read(px4, "COM_OF_LOSS_T")
    assert (sent.param_value, sent.param_type) == (1.0, mavlink.MAV_PARAM_TYPE_REAL32)


def test_px4_does_not_take_a_number_of_another_type(companion):
    px4 = companion(Px4)
    (sent,) = put(px4, "COM_OBL_RC_ACT", 5.0, mavlink.MAV_PARAM_TYPE_REAL32)
    assert sent.param_value == as_bits(0)


def test_arducopter_sends_the_number(companion):
    copter = companion(ArduCopter)
    (sent,) = put(copter, "GUID_OPTIONS", 8.0, mavlink.MAV_PARAM_TYPE_REAL32)
    assert (sent.param_value, sent.param_type) == (8.0, mavlink.MAV_PARAM_TYPE_INT32)
    assert copter.vehicle.parameters["GUID_OPTIONS"] == 8


def test_a_limit_acts_once_it_is_set(companion):
    px4 = companion(Px4)
    px4.airborne()
    put(px4, "MPC_XY_VEL_MAX", 0.5, mavlink.MAV_PARAM_TYPE_REAL32)
    px4.flown(3.0, 0, 0, 20.0)
    assert px4.vehicle.flight.truth.velocity_enu[1] == pytest.approx(0.5, abs=0.05)


def test_nothing_is_said_of_unknown_parameters(companion):
    px4 = companion(Px4)
    assert read(px4, "NO_SUCH") == []


@ALL
def test_the_list_is_complete(companion, kind):
    made = companion(kind)
    made.send(mavlink.MAVLink_param_request_list_message(1, 1))
    made.run(1.0)
    got = made.got("PARAM_VALUE")
    assert [m.param_index for m in got] == list(range(got[0].param_count))
    assert len({m.param_id for m in got}) == len(made.vehicle.parameters)
