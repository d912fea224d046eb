"""Attitude targets: from the controller's wrench, and a small point hold for what takes nothing else.

The controller of ptnsbc_core asks for torques; a flight controller closes the attitude and rate loops
itself and asks for an attitude. So the torque is read backwards through the two loops that made it:
rates_d = rates + torque / (inertia G), turn = rates_d / attitude_gain, q_d = q exp(turn).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.timebase import Clock, loop_gain
from ptnsbc_core.types import Array, ControllerConfig

_AT_LIMIT = 1.0 - 1e-9


class AttitudeTarget(NamedTuple):
    """What SET_ATTITUDE_TARGET carries, in our frames."""

    quaternion: Array  # (4,) x y z w, FLU to ENU
    rates: Array  # (3,) [rad/s] at which the target itself turns, FLU of the target
    thrust: float  # 0 to 1


def from_wrench(
    wrench: Array,
    odometry: Array,
    flight_s: float,
    config: ControllerConfig,
    max_tilt_rad: float,
) -> Array:
    """Attitude (4,) x y z w that a wrench (6,) asks for.

    `odometry` (13,) is the one it was computed from, `flight_s` the time since the first epoch.
    """
    time = max(flight_s, 0.0)
    gain = loop_gain(config.torque, Clock(time, time, 0.01))
    rates = odometry[10:13] + wrench[3:6] / (np.array(config.nominal.inertia) * gain)
    tilt, yaw = config.attitude_gain
    turn = rates / np.array([tilt, tilt, yaw])
    wanted = product(odometry[3:7], exponential(turn))
    return tilt_limited(wanted, max_tilt_rad)


def understood(wrench: Array, config: ControllerConfig) -> Array:
    """Axes (3,) whose torque is within its limit: only there does `from_wrench` find what was meant.

    A torque at its limit says "more", not how much: the attitude read from it is a little ahead of the
    vehicle's own, and turns as the vehicle does.
    """
    return np.asarray(np.abs(wrench[3:6]) < _AT_LIMIT * np.array(config.max_torque))


def product(a: Array, b: Array) -> Array:
    """Quaternion a b, both x y z w."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return np.array(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ]
    )


def exponential(turn: Array) -> Array:
    """Quaternion (4,) x y z w of a rotation vector (3,) [rad]."""
    angle = math.sqrt(float(turn @ turn))
    share = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    return np.array([*(share * turn), math.cos(0.5 * angle)])


def tilt_limited(quaternion: Array, max_tilt_rad: float) -> Array:
    """The attitude with its thrust axis no farther from vertical than allowed, turned straight back."""
    up = rotation_from_quaternion(quaternion)[:, 2]
    tilt = math.acos(min(max(float(up[2]), -1.0), 1.0))
    level = math.hypot(up[0], up[1])
    if tilt <= max_tilt_rad or level < 1e-9:
        return quaternion
    axis = np.array([-up[1], up[0], 0.0]) / level  # towards more tilt
    back = product(exponential(-(tilt - max_tilt_rad) * axis), quaternion)
    return back / math.sqrt(float(back @ back))


def pointing(force_enu: Array, yaw_enu_rad: float) -> Array:
    """Attitude (4,) x y z w whose z is along a force (3,) and whose x points along a heading."""
    up = force_enu / math.sqrt(float(force_enu @ force_enu))
    level = math.hypot(up[0], up[1])
    tilt = math.acos(min(max(float(up[2]), -1.0), 1.0))
    axis = np.zeros(3) if level < 1e-9 else np.array([-up[1], up[0], 0.0]) / level
    return product(exponential(tilt * axis), exponential(np.array([0.0, 0.0, yaw_enu_rad])))


class PointHold:
    """Acceleration towards a point: proportional, damped, with a slow integral against the wind.

    For vehicles that take attitude targets only, before the formation begins and when it fails.
    """

    _STIFFNESS_1_S2 = 1.4
    _DAMPING_1_S = 2.2
    _INTEGRAL_1_S3 = 0.3
    _MOST_M_S2 = 2.5
    _MOST_INTEGRAL_M_S2 = 2.0

    def __init__(self, gravity_m_s2: float) -> None:
        self._gravity = gravity_m_s2
        self._integral = np.zeros(3)

    def reset(self) -> None:
        """Forget the wind."""
        self._integral = np.zeros(3)

    def force_per_kg(self, odometry: Array, place_enu: Array, dt: float) -> Array:
        """Specific force (3,) [m/s^2, ENU] that brings the vehicle to `place_enu` (3,) [m]."""
        off = place_enu - odometry[0:3]
        velocity = rotation_from_quaternion(odometry[3:7]) @ odometry[7:10]
        limit = self._MOST_INTEGRAL_M_S2
        near = np.clip(off, -0.5, 0.5)
        self._integral = np.clip(self._integral + dt * self._INTEGRAL_1_S3 * near, -limit, limit)
        wanted = self._STIFFNESS_1_S2 * off - self._DAMPING_1_S * velocity + self._integral
        wanted = np.clip(wanted, -self._MOST_M_S2, self._MOST_M_S2)
        wanted[2] += self._gravity
        return np.asarray(wanted)
