"""The response of a vehicle from its parameters."""

import pytest

pytest.importorskip("pymavlink")

from ptnsbc_io.mavlink.autopilots import ARDUPILOT, GENERIC, PX4, missing_parameters
from ptnsbc_io.mavlink.response import velocity_response

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
    assert velocity_response(ARDUPILOT, OLD) == velocity_response(ARDUPILOT, NEW)


@pytest.mark.parametrize("name", NEW)
def test_a_parameter_without_an_answer_leaves_the_response_unknown(name):
    assert velocity_response(ARDUPILOT, {n: v for n, v in NEW.items() if n != name}) is None


@pytest.mark.parametrize("changes", [{"WP_ACC": 0.0}, {"PSC_NE_VEL_P": 0.0}, {"ATC_INPUT_TC": -1}])
def test_numbers_without_sense_leave_it_unknown(changes):
    assert velocity_response(ARDUPILOT, {**NEW, **changes}) is None


def test_a_controller_of_attitudes_has_none():
    assert velocity_response(GENERIC, {**NEW, **PX4_VALUES}) is None


@pytest.mark.parametrize(
    ("autopilot", "values"), [(PX4, PX4_VALUES), (ARDUPILOT, NEW), (ARDUPILOT, OLD)]
)
def test_a_bridge_asks_for_them(autopilot, values):
    missing = missing_parameters(autopilot, values)
    assert not set(missing) & (set(NEW) | set(OLD) | set(PX4_VALUES))
    assert set(values) <= set(autopilot.parameters)
