"""Targets of the autopilots' own modes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_sim.autopilot.physics import airframe

_BRAKING_S = 0.8
_OVER_HOME_M = 0.5
_NEAR_HOME_M = 5.0


class TargetPoint(NamedTuple):
    """Where to be, in the vehicle's local ENU."""

    position_enu: Array  # (3,) [m]
    yaw_rad: float
    over_home: bool = False

    def ahead(self, velocity_enu: Array) -> TargetPoint:
        """Where a vehicle with this velocity comes to rest, about."""
        return self._replace(position_enu=self.position_enu + _BRAKING_S * velocity_enu)


def _constant(kind: float) -> Array:
    target = airframe.no_target()
    target[airframe.KIND] = kind
    target.setflags(write=False)
    return target


OFF_TARGET, IDLE_TARGET = _constant(airframe.OFF), _constant(airframe.IDLE)


def _trajectory(place: TargetPoint) -> Array:
    target = airframe.no_target()
    target[airframe.KIND] = airframe.TRAJECTORY
    target[airframe.POSITION] = place.position_enu
    target[airframe.YAW] = place.yaw_rad
    return target


def hold(place: TargetPoint) -> Array:
    """Stay at a place."""
    return _trajectory(place)


def land(place: TargetPoint, speed_m_s: float) -> Array:
    """Come down over a place."""
    return climb(place, -speed_m_s)


def climb(place: TargetPoint, speed_m_s: float) -> Array:
    """Go up over a place."""
    target = _trajectory(place)
    target[3], target[6] = math.nan, speed_m_s
    return target


def sink(speed_m_s: float) -> Array:
    """Come down level, wherever the wind takes it."""
    target = airframe.no_target()
    target[airframe.KIND] = airframe.TRAJECTORY
    target[6] = -speed_m_s
    return target


def way_home(now_enu: Array, home_enu: Array, height_m: float, start: TargetPoint) -> TargetPoint:
    """Next place on the way home: up to the height, across, then over it. Near home without the climb."""
    far = math.hypot(now_enu[0] - home_enu[0], now_enu[1] - home_enu[1])
    if far < _OVER_HOME_M:
        over = np.array((home_enu[0], home_enu[1], now_enu[2]))
        return TargetPoint(over, start.yaw_rad, over_home=True)
    if far < _NEAR_HOME_M:
        return TargetPoint(np.array((home_enu[0], home_enu[1], now_enu[2])), start.yaw_rad)
    if now_enu[2] < height_m - 0.5:
        up = np.array((start.position_enu[0], start.position_enu[1], height_m))
        return TargetPoint(up, start.yaw_rad)
    return TargetPoint(np.array((home_enu[0], home_enu[1], now_enu[2])), start.yaw_rad)
