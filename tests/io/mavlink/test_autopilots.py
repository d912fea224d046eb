"""What the parameters of an autopilot mean: advice, refusals, and what a vehicle does without its companion."""

import pytest

pytest.importorskip("pymavlink")

from ptnsbc_io.mavlink.autopilots import ARDUPILOT, GENERIC, PX4, FlightMode, advice, fate, refusal


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
        (0, "needs a remote control (COM_OBL_RC_ACT=0), and sinks and drifts without one"),
        (1, "needs a remote control (COM_OBL_RC_ACT=1), and sinks and drifts without one"),
        (2, "needs a remote control (COM_OBL_RC_ACT=2), and sinks and drifts without one"),
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
