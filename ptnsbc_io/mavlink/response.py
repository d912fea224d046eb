"""The response of a vehicle to a velocity setpoint, from the parameters of its autopilot.

Both autopilots close a velocity loop around the tilt of the vehicle. ArduCopter shapes the velocity before it and
follows the shaped path by position too. docs/autopilot.md has what was measured of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from ptnsbc_io.mavlink.autopilots import ARDUPILOT, PX4, Autopilot

_RATE_LOOP_S = 0.06  # of the rates and the motors
_PX4_TILT = 0.65  # lag of the tilt times MC_ROLL_P, as measured
_ARDUPILOT_TILT_S = 0.167  # behind the shaped tilt, as measured


class VelocityResponse(NamedTuple):
    """The horizontal velocity loop of a vehicle."""

    gain: float  # [1/s] proportional
    integral: float  # [1/s^2]
    derivative: float
    position_gain: float  # [1/s]; 0: no position loop around it
    shaping_1_s: float | None  # first order before the loop; None: none
    tilt_s: tuple[float, float]  # the two lags between the acceleration asked for and flown

    @property
    def tilt_lag_s(self) -> float:
        """Sum of the lags between the acceleration asked for and flown."""
        return sum(self.tilt_s)

    def measured(self, gain: float | None, tilt_lag_s: float | None) -> VelocityResponse:
        """The same with a proportional gain, and lags of this sum in the same proportion, as they were measured."""
        share = 1.0 if tilt_lag_s is None else tilt_lag_s / self.tilt_lag_s
        first_s, second_s = self.tilt_s
        return self._replace(
            gain=self.gain if gain is None else gain, tilt_s=(share * first_s, share * second_s)
        )


_ARDUPILOT_NAMES = {
    "gain": ("PSC_NE_VEL_P", "PSC_VELXY_P"),
    "integral": ("PSC_NE_VEL_I", "PSC_VELXY_I"),
    "derivative": ("PSC_NE_VEL_D", "PSC_VELXY_D"),
    "position": ("PSC_NE_POS_P", "PSC_POSXY_P"),
    "jerk": ("PSC_JERK_NE", "PSC_JERK_XY"),
}


def velocity_response(autopilot: Autopilot, values: Mapping[str, float]) -> VelocityResponse | None:
    """The response by the parameters that were read; None where one of them is missing or makes no sense."""
    try:
        if autopilot is PX4:
            loop = [values[f"MPC_XY_VEL_{part}_ACC"] for part in "PID"]
            tilt_s = (_PX4_TILT / values["MC_ROLL_P"], _RATE_LOOP_S)
            found = VelocityResponse(loop[0], loop[1], loop[2], 0.0, None, tilt_s)
        elif autopilot is ARDUPILOT:
            found = _ardupilot(values)
        else:
            return None
    except (KeyError, ZeroDivisionError, StopIteration):
        return None
    if found.gain <= 0.0 or min(found[:4]) < 0.0 or min(found.tilt_s) < 0.0:
        return None
    return found


def _ardupilot(values: Mapping[str, float]) -> VelocityResponse:
    known = {
        what: next(values[n] for n in names if n in values)
        for what, names in _ARDUPILOT_NAMES.items()
    }
    acceleration = values["WP_ACC"] if "WP_ACC" in values else 0.01 * values["WPNAV_ACCEL"]
    return VelocityResponse(
        known["gain"],
        known["integral"],
        known["derivative"],
        known["position"],
        known["jerk"] / acceleration,
        (values["ATC_INPUT_TC"], _ARDUPILOT_TILT_S + _RATE_LOOP_S),
    )
