"""Airframe targets of the autopilots' own modes: hold, climb, land, return."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_autopilot.physics import airframe
from ptnsbc_core.types import Array

_BRAKING_S = 0.8
_OVER_HOME_M = 0.5
_NEAR_HOME_M = 5.0


class TargetPoint(NamedTuple):
    """A point to fly to, in the vehicle's local ENU."""

    position_enu: Array  # (3,) [m]
    yaw_rad: float
    over_home: bool = False

    def after_braking(self, velocity_enu: Array) -> TargetPoint:
        """About the point where a vehicle with this velocity comes to rest."""
        return self._replace(position_enu=self.position_enu + _BRAKING_S * velocity_enu)


def _constant(kind: float) -> Array:
    # nobody writes it, but for an array that cannot be written numba compiles the airframe again
    target = airframe.no_target()
    target[airframe.KIND] = kind
    return target


OFF_TARGET, IDLE_TARGET = _constant(airframe.OFF), _constant(airframe.IDLE)


def hold(point: TargetPoint) -> Array:
    """Stay at a point."""
    target = airframe.no_target()
    target[airframe.KIND] = airframe.TRAJECTORY
    target[airframe.POSITION] = point.position_enu
    target[airframe.YAW] = point.yaw_rad
    return target


def climb(point: TargetPoint, speed_m_s: float) -> Array:
    """Climb over a point; with a negative speed come down."""
    target = hold(point)
    target[3], target[6] = math.nan, speed_m_s
    return target


def sink(speed_m_s: float) -> Array:
    """Come down level, without a horizontal position."""
    target = airframe.no_target()
    target[airframe.KIND] = airframe.TRAJECTORY
    target[6] = -speed_m_s
    return target


def return_point(
    now_enu: Array, home_enu: Array, height_m: float, start: TargetPoint
) -> TargetPoint:
    """Next point of a return: up to the height, then across, then over home. Near home without the climb."""
    distance = math.hypot(now_enu[0] - home_enu[0], now_enu[1] - home_enu[1])
    if distance >= _NEAR_HOME_M and now_enu[2] < height_m - 0.5:
        up = np.array((start.position_enu[0], start.position_enu[1], height_m))
        return TargetPoint(up, start.yaw_rad)
    over = np.array((home_enu[0], home_enu[1], now_enu[2]))
    return TargetPoint(over, start.yaw_rad, over_home=distance < _OVER_HOME_M)
