"""Logs of the stand-ins, by the messages of MAVLink."""

import pytest

from ptnsbc_autopilot.firmware.arducopter import ArduCopter
from ptnsbc_autopilot.firmware.px4 import Px4
from ptnsbc_autopilot.firmware.stm32 import Stm32
from ptnsbc_autopilot.flight_logs import log_bytes
from ptnsbc_io.mavlink.dialect import mavlink

LIST = mavlink.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF)


def asked(companion, message):
    """The words about logs that come within half a second."""
    at = companion.t
    companion.send(message)
    companion.run(0.5)
    return [m for t, _, m in companion.heard if t > at and m.get_type().startswith("LOG_")]


@pytest.mark.parametrize(("kind", "numbers"), [(Px4, [0, 1]), (ArduCopter, [1, 2])])
def test_each_arming_begins_a_log(companion, kind, numbers):
    made = companion(kind)
    assert [entry.num_logs for entry in asked(made, LIST)] == [0]
    for _ in numbers:
        made.vehicle.arm(made.t)
        made.vehicle.disarm("told", made.t)
    entries = asked(made, LIST)
    assert [entry.id for entry in entries] == numbers
    assert {(entry.num_logs, entry.last_log_num) for entry in entries} == {(2, numbers[-1])}
    sizes = [len(log_bytes(1, n)) for n in (1, 2)]
    assert [entry.size for entry in entries] == sizes
    data = asked(made, mavlink.MAVLink_log_request_data_message(1, 1, numbers[0], 180, 200))
    assert [(m.ofs, m.count) for m in data] == [(180, 90), (270, 90), (360, 20)]
    got = b"".join(bytes(m.data[: m.count]) for m in data)
    assert got == log_bytes(1, 1)[180:380]
    beyond = mavlink.MAVLink_log_request_data_message(1, 1, numbers[0], sizes[0], 90)
    assert [m.count for m in asked(made, beyond)] == [0]


def test_a_request_ends_the_one_before(companion):
    made = companion(Px4)
    made.vehicle.flown = 1
    made.send(mavlink.MAVLink_log_request_data_message(1, 1, 0, 0, 9000))
    made.run(0.1)
    assert asked(made, mavlink.MAVLink_log_request_end_message(1, 1)) == []


def test_without_a_card_or_armed_nobody_answers(companion):
    generic, armed = companion(Stm32), companion(ArduCopter)
    generic.vehicle.flown = 1
    assert asked(generic, LIST) == []
    armed.vehicle.arm(0.0)
    assert asked(armed, LIST) == []
    assert [m.text for m in armed.got("STATUSTEXT")][-1] == "Disarm for log download"
