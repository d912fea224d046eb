"""What the parameters of an autopilot mean: advice, refusals, and what a vehicle does without its companion."""

import struct

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_wires import codec

from ptnsbc_io.mavlink.autopilots import (
    ARDUPILOT,
    AUTOPILOTS,
    GENERIC,
    PX4,
    FlightMode,
    MavlinkParameterError,
    ParameterReader,
    advice,
    decoded,
    fate,
    findings,
    refusal,
    velocity_response,
)
from ptnsbc_io.mavlink.dialect import mavlink


def test_what_a_lab_should_know_before_it_flies():
    warned = list(advice({"COM_OBL_RC_ACT": 0.0, "COM_OF_LOSS_T": 0.05, "NAV_DLL_ACT": 2.0}, 50))
    assert [line.partition("=")[0] for line in warned] == [
        "COM_OBL_RC_ACT", "COM_OF_LOSS_T", "NAV_DLL_ACT"
    ]  # fmt: skip
    assert list(advice({"COM_OBL_RC_ACT": 5.0, "COM_OF_LOSS_T": 1.0}, 50)) == []
    assert "GUID_OPTIONS=8" in refusal(ARDUPILOT, {"GUID_OPTIONS": 0.0}, "attitude")
    assert refusal(ARDUPILOT, {"GUID_OPTIONS": 8.0}, "attitude") is None
    assert "attitude targets only" in refusal(GENERIC, {}, "velocity")


HOVERS = "until somebody lands it or its battery is low"


@pytest.mark.parametrize("name", ["RTL_RETURN_ALT", "RTL_ALT_M"])
def test_a_vehicle_that_returns_says_at_what_height(name):
    words = f"it returns by itself at {name}=15 m"
    assert fate(PX4, FlightMode.RETURN, {name: 15.0}) == words


@pytest.mark.parametrize("autopilot", [PX4, ARDUPILOT, GENERIC])
@pytest.mark.parametrize(
    ("mode", "words"),
    [
        (FlightMode.LAND, "it lands by itself"),
        (FlightMode.RETURN, "it returns by itself"),
        (FlightMode.HOLD, f"it hovers {HOVERS}"),
        (FlightMode.TAKEOFF, f"it hovers {HOVERS}"),
        (FlightMode.OTHER, "its pilot flies it"),
    ],
)
def test_a_vehicle_in_a_mode_of_its_own_goes_on_with_it(autopilot, mode, words):
    """Whatever its parameters say of lost setpoints: it needs none."""
    assert fate(autopilot, mode, {"COM_OBL_RC_ACT": 4.0, "GUID_TIMEOUT": 1.0}) == words


@pytest.mark.parametrize(
    ("action", "words"),
    [
        (0, "needs a remote control, and sinks and drifts without one (COM_OBL_RC_ACT=0)"),
        (1, "needs a remote control, and sinks and drifts without one (COM_OBL_RC_ACT=1)"),
        (2, "needs a remote control, and sinks and drifts without one (COM_OBL_RC_ACT=2)"),
        (3, "returns and lands (COM_OBL_RC_ACT=3)"),
        (4, "lands (COM_OBL_RC_ACT=4)"),
        (5, f"hovers {HOVERS} (COM_OBL_RC_ACT=5)"),
        (6, "stops its motors (COM_OBL_RC_ACT=6)"),
        (7, "stops its motors (COM_OBL_RC_ACT=7)"),
        (99, "acts as COM_OBL_RC_ACT says"),
        (None, "acts as COM_OBL_RC_ACT says"),  # its parameters were not read
    ],
)
def test_a_px4_left_in_offboard_does_what_its_parameter_says(action, words):
    values = {} if action is None else {"COM_OBL_RC_ACT": float(action)}
    assert fate(PX4, FlightMode.OWN, values) == f"without setpoints it {words}"


@pytest.mark.parametrize(("values", "seconds"), [({}, "3"), ({"GUID_TIMEOUT": 1.5}, "1.5")])
def test_an_arducopter_left_in_guided_hovers_after_its_timeout(values, seconds):
    assert fate(ARDUPILOT, FlightMode.OWN, values) == (
        f"it keeps its velocity for {seconds} s (GUID_TIMEOUT), then hovers in GUIDED {HOVERS}"
    )


def test_of_another_vehicle_only_its_failsafe_is_known():
    assert fate(GENERIC, FlightMode.OWN, {}) == "its own failsafe acts"
    alone = "only its driver knows what it does without setpoints"
    assert {fate(AUTOPILOTS[name], FlightMode.OWN, {}) for name in ("ros", "ros_take_off")} == {
        alone
    }


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
    ("raw", "kind", "bytewise", "expected"),
    [
        (struct.pack("<i", 5), INT32, True, 5.0),  # COM_OBL_RC_ACT of PX4
        (struct.pack("<f", 5.0), INT32, False, 5.0),  # the same from ArduPilot
        (struct.pack("<i", -1), INT32, True, -1.0),
        (struct.pack("<b", -3) + b"\x07\x07\x07", INT8, True, -3.0),
        (struct.pack("<f", 0.5), REAL32, True, 0.5),
        (struct.pack("<f", 0.5), REAL32, False, 0.5),
        # a signalling NaN as a float: passing it through one changes the number
        (struct.pack("<I", 0x7F800001), INT32, True, float(0x7F800001)),
    ],
)
def test_values_travel(raw, kind, bytewise, expected):
    assert decoded(value("P", raw, kind), bytewise=bytewise) == expected


def test_a_type_of_64_bits_is_refused():
    with pytest.raises(MavlinkParameterError, match="expected REAL32"):
        decoded(value("P", b"\0\0\0\0", mavlink.MAV_PARAM_TYPE_INT64), bytewise=True)


def test_questions_are_repeated_and_given_up():
    reader = ParameterReader(["A", "B"], bytewise=False)
    assert list(reader.due(0.0)) == ["A", "B"]
    assert list(reader.due(0.4)) == []
    reader.on_param_value(value("A", struct.pack("<f", 2.0), REAL32))
    reader.on_param_value(value("UNASKED", struct.pack("<f", 2.0), REAL32))
    reader.on_param_value(value("B", struct.pack("<f", float("nan")), REAL32))
    asked = [list(reader.due(0.5 * n)) for n in (1, 2, 3, 4)]
    assert asked == [["B"], ["B"], ["B"], []]
    assert not reader.done(1.9)
    assert reader.done(2.0)
    assert reader.values == {"A": 2.0}
    assert reader.missing == ["B"]


def test_not_all_at_once():
    names = [f"P{n}" for n in range(10)]
    reader = ParameterReader(names, bytewise=False)
    assert len(list(reader.due(0.0))) == 4


PX4_VALUES = {
    "MPC_XY_VEL_P_ACC": 1.8,
    "MPC_XY_VEL_I_ACC": 0.4,
    "MPC_XY_VEL_D_ACC": 0.2,
    "MC_ROLL_P": 6.5,
}
NEW = {
    "PSC_NE_POS_P": 1.0,
    "PSC_NE_VEL_P": 2.0,
    "PSC_NE_VEL_I": 1.0,
    "PSC_NE_VEL_D": 0.5,
    "PSC_JERK_NE": 5.0,
    "WP_ACC": 2.5,
    "ATC_INPUT_TC": 0.15,
}
OLD = {
    "PSC_POSXY_P": 1.0,
    "PSC_VELXY_P": 2.0,
    "PSC_VELXY_I": 1.0,
    "PSC_VELXY_D": 0.5,
    "PSC_JERK_XY": 5.0,
    "WPNAV_ACCEL": 250.0,
    "ATC_INPUT_TC": 0.15,
}


def test_px4_has_a_velocity_loop_alone():
    found = velocity_response(PX4, PX4_VALUES)
    assert found[:4] == (1.8, 0.4, 0.2, 0.0)
    assert found.shaping_1_s is None
    assert found.tilt_s[0] == pytest.approx(0.1)


def test_ardupilot_shapes_with_jerk_over_acceleration():
    found = velocity_response(ARDUPILOT, NEW)
    assert found[:5] == (2.0, 1.0, 0.5, 1.0, 2.0)


def test_older_names_say_the_same():
    reader = ParameterReader(ARDUPILOT.parameters, bytewise=False)
    for now_s in np.arange(0.0, 9.0, 0.25):
        for name in reader.due(now_s):
            if name in OLD:
                reader.on_param_value(value(name, struct.pack("<f", OLD[name]), REAL32))
    assert reader.values == pytest.approx(NEW)
    assert not set(reader.missing) & (set(NEW) | set(OLD))


@pytest.mark.parametrize("name", NEW)
def test_a_parameter_without_an_answer_leaves_the_response_unknown(name):
    assert velocity_response(ARDUPILOT, {n: v for n, v in NEW.items() if n != name}) is None


@pytest.mark.parametrize("changes", [{"WP_ACC": 0.0}, {"PSC_NE_VEL_P": 0.0}, {"ATC_INPUT_TC": -1}])
def test_numbers_without_sense_leave_it_unknown(changes):
    assert velocity_response(ARDUPILOT, {**NEW, **changes}) is None


def test_a_controller_of_attitudes_has_none():
    assert velocity_response(GENERIC, {**NEW, **PX4_VALUES}) is None


@pytest.mark.parametrize(("autopilot", "values"), [(PX4, PX4_VALUES), (ARDUPILOT, NEW)])
def test_a_bridge_asks_for_them(autopilot, values):
    lines = " ".join(line for line in findings(autopilot, values, 50) if "not answered" in line)
    assert not set(lines.split()) & set(values)
    assert set(values) <= set(autopilot.parameters)
    assert autopilot is PX4 or set(OLD) <= set(autopilot.parameters)


@pytest.mark.parametrize(
    ("autopilot", "base", "custom", "name", "mode"),
    [
        (PX4, 209, 3 << 16, "POSCTL", FlightMode.OTHER),
        (PX4, 209, 6 << 16, "OFFBOARD", FlightMode.OWN),
        (PX4, 209, 4 << 16 | 9 << 24, "PRECLAND", FlightMode.LAND),
        (PX4, 209, 3 << 16 | 2 << 24, "POSCTL_SLOW", FlightMode.OTHER),
        (PX4, 209, 4 << 16 | 11 << 24, "EXTERNAL1", FlightMode.OTHER),
        (PX4, 209, 77 << 16, "custom_mode 5046272", FlightMode.OTHER),
        (ARDUPILOT, 209, 5, "LOITER", FlightMode.OTHER),
        (ARDUPILOT, 209, 17, "BRAKE", FlightMode.HOLD),
        (GENERIC, mavlink.MAV_MODE_FLAG_GUIDED_ENABLED, 0, "GUIDED", FlightMode.OWN),
        (GENERIC, 0, 0, "not GUIDED", FlightMode.OTHER),
    ],
)
def test_a_mode_has_the_name_that_its_pilot_knows(autopilot, base, custom, name, mode):
    assert autopilot.mode_name(base, custom) == name
    assert FlightMode.named(name) is mode


@pytest.mark.parametrize("autopilot", [PX4, ARDUPILOT])
def test_the_modes_that_are_requested(autopilot):
    names = {
        mode: autopilot.modes[autopilot.mode_numbers(mode)]
        for mode in (FlightMode.OWN, FlightMode.LAND, FlightMode.HOLD)
    }
    hold = "HOLD" if autopilot is PX4 else "BRAKE"
    assert list(names.values()) == [autopilot.own_mode, "LAND", hold]
