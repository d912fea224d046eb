"""Flight modes of all autopilots. It needs no pymavlink, which a simulated fleet may lack."""

from __future__ import annotations

from enum import Enum


class FlightMode(Enum):
    """A flight mode, as far as the bridge distinguishes them."""

    OWN = "own"  # OFFBOARD, GUIDED: it follows setpoints
    HOLD = "hold"  # holds its position
    LAND = "land"
    RETURN = "return"
    TAKEOFF = "takeoff"
    OTHER = "other"  # for example flown by a pilot

    @classmethod
    def named(cls, name: str) -> FlightMode:
        """By the name that an autopilot has for it."""
        return _MODES.get(name, cls.OTHER)


_MODES = {
    "OFFBOARD": FlightMode.OWN,
    "GUIDED": FlightMode.OWN,
    "HOLD": FlightMode.HOLD,
    "BRAKE": FlightMode.HOLD,
    "LAND": FlightMode.LAND,
    "PRECLAND": FlightMode.LAND,
    "RTL": FlightMode.RETURN,
    "SMART_RTL": FlightMode.RETURN,
    "TAKEOFF": FlightMode.TAKEOFF,
}
