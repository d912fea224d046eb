"""The true place of a simulated vehicle, for the verdict: HIL_STATE_QUATERNION of PX4, SIM_STATE of ArduPilot.

Nothing flies by it. A real vehicle sends neither.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import ODOMETRY_SIZE, Array
from ptnsbc_io.mavlink import frames
from ptnsbc_io.mavlink.frames import GeoPoint

TRUTH_MESSAGES = ("HIL_STATE_QUATERNION", "SIM_STATE")

_DEGREES_E7, _MILLI, _CENTI = 1e-7, 1e-3, 0.01
_NORM_TOLERANCE = 0.05


def place_of(message: Any) -> GeoPoint:
    """The true place on the Earth."""
    if message.get_type() == "HIL_STATE_QUATERNION":
        return GeoPoint(message.lat * _DEGREES_E7, message.lon * _DEGREES_E7, message.alt * _MILLI)
    if message.lat_int or message.lon_int:  # `lat` and `lon` are floats: good to a metre
        return GeoPoint(message.lat_int * _DEGREES_E7, message.lon_int * _DEGREES_E7, message.alt)
    return GeoPoint(message.lat, message.lon, message.alt)


def true_odometry(message: Any, position: Array) -> Array | None:
    """Odometry (13,) at a world position (3,) [m] with attitude and velocities of the message; None if not finite."""
    if message.get_type() == "HIL_STATE_QUATERNION":
        wxyz = np.array(message.attitude_quaternion, dtype=np.float64)
        rates = (message.rollspeed, message.pitchspeed, message.yawspeed)
        velocity = _CENTI * np.array([message.vx, message.vy, message.vz])
    else:
        wxyz = np.array([message.q1, message.q2, message.q3, message.q4])
        rates = (message.xgyro, message.ygyro, message.zgyro)
        velocity = np.array([message.vn, message.ve, message.vd])
    norm = float(np.sqrt(wxyz @ wxyz))
    if not abs(norm - 1.0) <= _NORM_TOLERANCE:
        return None
    out = np.empty(ODOMETRY_SIZE)
    out[0:3] = position
    out[3:7] = frames.quaternion_ned_frd_to_enu_flu(wxyz / norm)
    out[7:10] = rotation_from_quaternion(out[3:7]).T @ frames.vector_ned_to_enu(velocity)
    out[10:13] = frames.vector_frd_to_flu(np.array(rates))
    return out if np.isfinite(out).all() else None
