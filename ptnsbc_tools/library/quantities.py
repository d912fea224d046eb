"""The quantities of a flight: name with unit, axes of the array, meaning."""

from __future__ import annotations

from typing import NamedTuple

TIME, UAV, XYZ, XYZW = "time_s", "uav", "axis", "component"
"""Names of the axes of the arrays."""

COORDINATES: dict[str, tuple[str, ...]] = {XYZ: ("x", "y", "z"), XYZW: ("x", "y", "z", "w")}
"""Labels along the axes that do not depend on the flight."""


class Quantity(NamedTuple):
    """One array of a flight."""

    name: str  # of the property of Flight
    unit: str
    axes: tuple[str, ...]
    meaning: str


QUANTITIES: tuple[Quantity, ...] = (
    Quantity("time_s", "s", (TIME,), "Time after the epoch."),
    Quantity("position_m", "m", (TIME, UAV, XYZ), "Position, ENU; the true one where it is known."),
    Quantity("velocity_m_s", "m/s", (TIME, UAV, XYZ), "Velocity as measured, ENU."),
    Quantity(
        "quaternion", "", (TIME, UAV, XYZW), "Attitude as measured: body FLU to world ENU, x y z w."
    ),
    Quantity("rate_rad_s", "rad/s", (TIME, UAV, XYZ), "Body rate as measured, FLU."),
    Quantity("force_n", "N", (TIME, UAV, XYZ), "Commanded force, FLU; NaN where none is recorded."),
    Quantity("torque_n_m", "N m", (TIME, UAV, XYZ), "Commanded torque, FLU; NaN likewise."),
    Quantity(
        "leader_estimate_m", "m", (TIME, UAV, XYZ), "A UAV's estimate of the leader; NaN likewise."
    ),
    Quantity(
        "error_m", "m", (TIME, UAV), "Distance from its place; of the leader, from its trajectory."
    ),
)
"""All arrays of a flight, in the order in which tables show them."""
