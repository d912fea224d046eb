"""Conversions between ENU/FLU (ours, REP-103) and NED/FRD (MAVLink's), and between degrees and metres.

World: x_ned = y_enu, y_ned = x_enu, z_ned = -z_enu. Body: x forward in both, y and z change sign.
Both maps are their own inverses, so each pair of functions is one formula with two names.
Quaternions: ours x y z w (nav_msgs), MAVLink's w x y z; body to world in both.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import wrap_angle
from ptnsbc_core.types import Array

EARTH_RADIUS_M = {"px4": 6371000.0, "ardupilot": 6378100.0, "generic": 6371000.0}
"""Of the local projection of each autopilot."""
_HALF = math.sqrt(0.5)


class GeoPoint(NamedTuple):
    """A point on the Earth, as in GPS_GLOBAL_ORIGIN."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float  # above mean sea level


def vector_enu_to_ned(vector: Array) -> Array:
    """(3,) position, velocity or acceleration, world."""
    return np.array([vector[1], vector[0], -vector[2]])


def vector_flu_to_frd(vector: Array) -> Array:
    """(3,) velocity, rates or force, body."""
    return np.array([vector[0], -vector[1], -vector[2]])


vector_ned_to_enu, vector_frd_to_flu = vector_enu_to_ned, vector_flu_to_frd


def yaw_enu_to_ned(yaw_enu_rad: float) -> float:
    """Heading: counter-clockwise from east to clockwise from north, in (-pi, pi]; the same the other way round."""
    return -wrap_angle(yaw_enu_rad - 0.5 * math.pi)


def quaternion_ned_frd_to_enu_flu(wxyz: Array) -> Array:
    """Attitude (4,) w x y z of FRD in NED as x y z w of FLU in ENU.

    q_enu = t q_ned r with t half a turn about (1, 1, 0) and r half a turn about x.
    """
    w, x, y, z = wxyz
    return np.array([_HALF * (x + y), _HALF * (x - y), _HALF * (w - z), _HALF * (w + z)])


def quaternion_enu_flu_to_ned_frd(xyzw: Array) -> Array:
    """Attitude (4,) x y z w of FLU in ENU as w x y z of FRD in NED, with w >= 0."""
    x, y, z, w = xyzw
    turned = np.array([_HALF * (w + z), _HALF * (x + y), _HALF * (x - y), _HALF * (w - z)])
    return -turned if turned[0] < 0.0 else turned


def quaternion_from_euler_ned(roll: float, pitch: float, yaw: float) -> Array:
    """Attitude (4,) w x y z from the angles [rad] of the ATTITUDE message, FRD in NED; NaN where one is not finite."""
    half = 0.5 * np.array((roll, pitch, yaw))
    with np.errstate(invalid="ignore"):
        (cf, ct, cp), (sf, st, sp) = np.cos(half), np.sin(half)
    vector = sf * ct * cp - cf * st * sp, cf * st * cp + sf * ct * sp, cf * ct * sp - sf * st * cp
    return np.array([cf * ct * cp + sf * st * sp, *vector])


def offset_enu(place: GeoPoint, reference: GeoPoint, earth_radius_m: float) -> Array:
    """Position of `place` in the ENU frame at `reference`, (3,) [m].

    Azimuthal equidistant on a sphere, as autopilots project. With the vehicle's own earth radius,
    two vehicles that report the same latitude get the same position; a more accurate ellipsoid
    would not give that.
    """
    latitude, reference_latitude = map(math.radians, (place.latitude_deg, reference.latitude_deg))
    turn = math.radians(place.longitude_deg - reference.longitude_deg)
    sine, cosine = math.sin(latitude), math.cos(latitude)
    reference_sine, reference_cosine = math.sin(reference_latitude), math.cos(reference_latitude)
    north = reference_cosine * sine - reference_sine * cosine * math.cos(turn)
    east = cosine * math.sin(turn)
    along = reference_sine * sine + reference_cosine * cosine * math.cos(turn)
    angle = math.atan2(math.hypot(north, east), along)
    stretch = earth_radius_m * (angle / math.sin(angle) if angle > 0.0 else 1.0)
    return np.array([stretch * east, stretch * north, place.altitude_m - reference.altitude_m])


def point_at(offset: Array, reference: GeoPoint, earth_radius_m: float) -> GeoPoint:
    """The point at an ENU offset (3,) [m] from `reference`: the inverse of `offset_enu` for some hundred metres."""
    latitude = reference.latitude_deg + math.degrees(offset[1] / earth_radius_m)
    # the middle latitude: without it, 30 m north-east would be a millimetre off
    middle = math.radians(0.5 * (latitude + reference.latitude_deg))
    longitude = math.degrees(offset[0] / (earth_radius_m * math.cos(middle)))
    return GeoPoint(
        latitude, reference.longitude_deg + longitude, reference.altitude_m + float(offset[2])
    )
