"""ENU/FLU to NED/FRD and back, and ENU metres to latitude and longitude; for the stand-in only.

The bridge has its own conversions. A stand-in that shared them would hide their errors.

Autopilots project satellite positions on a sphere of their own. Their metres and the metres on the ellipsoid
differ by up to 0.5 %, the same for all vehicles. The world of the stand-in has the autopilot's metres.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.types import Array

_HALF = math.sqrt(0.5)

PX4_RADIUS_M = 6371000.0
"""CONSTANTS_RADIUS_OF_EARTH of src/lib/geo."""

ARDUPILOT_RADIUS_M = 6378100.0
"""RADIUS_OF_EARTH of AP_Math."""


class Quaternion(NamedTuple):
    """Unit quaternion in MAVLink's order."""

    w: float
    x: float
    y: float
    z: float


class Euler(NamedTuple):
    """Angles [rad]."""

    roll: float
    pitch: float
    yaw: float


def world_swap(v: Array) -> Array:
    """(3,) ENU to NED or NED to ENU: the same map both ways."""
    return np.array((v[1], v[0], -v[2]))


def body_swap(v: Array) -> Array:
    """(3,) FLU to FRD or FRD to FLU: the same map both ways."""
    return np.array((v[0], -v[1], -v[2]))


def yaw_swap(yaw_rad: float) -> float:
    """Yaw [rad] from east, counter-clockwise, to heading from north, clockwise; or back. In [-pi, pi)."""
    return (1.5 * math.pi - yaw_rad) % (2.0 * math.pi) - math.pi


def attitude_swap(q: Quaternion) -> Quaternion:
    """Attitude FLU in ENU to FRD in NED, or back: q_T q q_D with T the map of the world and D that of the body."""
    w, x, y, z = q
    return Quaternion(_HALF * (w + z), _HALF * (x + y), _HALF * (x - y), _HALF * (w - z))


def euler_of(q: Quaternion) -> Euler:
    """Roll, pitch and yaw [rad] of a quaternion, in its own frames."""
    w, x, y, z = q
    sine = min(max(2.0 * (w * y - x * z), -1.0), 1.0)
    return Euler(
        math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        math.asin(sine),
        math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )


def rotate_heading(v: Array, yaw_rad: float) -> Array:
    """(3,) from a heading-aligned NED frame to NED: turned by the heading about down."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array((c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]))


def integrate_rates(xyzw: Array, rates: Array, dt: float) -> Array:
    """Unit quaternion (4,) x y z w after turning with body rates (3,) [rad/s] for dt [s], small turns."""
    x, y, z, w = xyzw
    p, q, r = 0.5 * dt * rates
    out = xyzw + np.array(
        (
            w * p + y * r - z * q,
            w * q + z * p - x * r,
            w * r + x * q - y * p,
            -x * p - y * q - z * r,
        )
    )
    return np.asarray(out / math.sqrt(float(out @ out)))


class Geodetic(NamedTuple):
    """A position on the earth."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float  # above mean sea level


PX4_HOME = Geodetic(47.397742, 8.545594, 488.0)
"""The default start of PX4's simulations."""


def geodetic(datum: Geodetic, position_enu: Array, radius_m: float) -> Geodetic:
    """The point (3,) [m, ENU] from the datum; flat, accurate to a millimetre within 100 m."""
    east, north, up = (float(v) for v in position_enu)
    narrow = math.cos(math.radians(datum.latitude_deg))
    return Geodetic(
        datum.latitude_deg + math.degrees(north / radius_m),
        datum.longitude_deg + math.degrees(east / (radius_m * narrow)),
        datum.altitude_m + up,
    )
