"""World ENU metres about a datum to latitude and longitude, on the sphere of the autopilot.

Autopilots project satellite positions on a sphere of their own; between metres of theirs and metres on the
ellipsoid lie up to 0.5 %, the same for all vehicles. Here the world has the autopilot's metres.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ptnsbc_core.types import Array

PX4_RADIUS_M = 6371000.0
"""CONSTANTS_RADIUS_OF_EARTH of src/lib/geo."""

ARDUPILOT_RADIUS_M = 6378100.0
"""RADIUS_OF_EARTH of AP_Math."""


class Geodetic(NamedTuple):
    """A place on the earth."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float  # above mean sea level


PX4_HOME = Geodetic(47.397742, 8.545594, 488.0)
"""Where PX4's simulations start unless told otherwise."""


def geodetic(datum: Geodetic, position_enu: Array, radius_m: float) -> Geodetic:
    """The place (3,) [m, ENU] from the datum; flat, good to a millimetre within 100 m."""
    east, north, up = (float(v) for v in position_enu)
    narrow = math.cos(math.radians(datum.latitude_deg))
    return Geodetic(
        datum.latitude_deg + math.degrees(north / radius_m),
        datum.longitude_deg + math.degrees(east / (radius_m * narrow)),
        datum.altitude_m + up,
    )
