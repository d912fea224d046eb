"""World ENU metres about a datum to latitude and longitude, on WGS 84."""

from __future__ import annotations

import math
from typing import NamedTuple

from ptnsbc_core.types import Array

_SEMI_MAJOR_M = 6378137.0
_ECCENTRICITY_SQUARED = 6.69437999014e-3


class Geodetic(NamedTuple):
    """A place on the earth."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float  # above mean sea level


PX4_HOME = Geodetic(47.397742, 8.545594, 488.0)
"""Where PX4's simulations start unless told otherwise."""


def geodetic(datum: Geodetic, position_enu: Array) -> Geodetic:
    """The place (3,) [m, ENU] from the datum.

    By the two radii of curvature at the datum: good to a millimetre within a kilometre.
    """
    latitude = math.radians(datum.latitude_deg)
    w = 1.0 - _ECCENTRICITY_SQUARED * math.sin(latitude) ** 2
    meridian = _SEMI_MAJOR_M * (1.0 - _ECCENTRICITY_SQUARED) / w**1.5 + datum.altitude_m
    vertical = _SEMI_MAJOR_M / math.sqrt(w) + datum.altitude_m
    east, north, up = (float(v) for v in position_enu)
    return Geodetic(
        datum.latitude_deg + math.degrees(north / meridian),
        datum.longitude_deg + math.degrees(east / (vertical * math.cos(latitude))),
        datum.altitude_m + up,
    )
