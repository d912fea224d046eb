"""What no setpoint may ask for: clamps that report, and the fence."""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.autopilots import AutopilotLimits
from ptnsbc_sim.scenario.mavlink import Geofence, VehicleLimits

_APPROACH_1_S = 1.0  # speed towards the fence per metre of room
_SLACK_M = 1.0
_EPSILON = 1e-9


class SetpointLimits(NamedTuple):
    """The smaller of what the scenario and the vehicle allow."""

    horizontal_m_s: float
    up_m_s: float
    down_m_s: float
    acceleration_m_s2: float
    tilt_rad: float

    @property
    def planner_m_s(self) -> float:
        """Speed limit for the planner, which knows one number: descents are clamped besides."""
        return min(self.horizontal_m_s, self.up_m_s)


def allowed(wanted: VehicleLimits, own: AutopilotLimits) -> SetpointLimits:
    """The limits of the scenario taken down to the vehicle's."""

    def lower(ours: float, theirs: float | None) -> float:
        return ours if theirs is None else min(ours, theirs)

    return SetpointLimits(
        lower(wanted.horizontal_m_s, own.horizontal_m_s),
        lower(wanted.up_m_s, own.up_m_s),
        lower(wanted.down_m_s, own.down_m_s),
        lower(wanted.acceleration_m_s2, own.acceleration_m_s2),
        lower(wanted.tilt_rad, own.tilt_rad),
    )


class SetpointGuard:
    """Clamps setpoints and counts how often."""

    def __init__(self, fence: Geofence, limits: SetpointLimits) -> None:
        self.limits = limits
        self._radius_m = fence.radius_m
        self._low = None if fence.box_min_m is None else np.array(fence.box_min_m)
        self._high = None if fence.box_max_m is None else np.array(fence.box_max_m)
        self.clamped: Counter[str] = Counter()

    def velocity(self, wanted_enu: Array, position_enu: Array) -> Array:
        """The velocity setpoint (3,) [m/s] that may be sent at this position."""
        out = self._slowed(np.array(wanted_enu, dtype=np.float64))
        out = self._boxed(out, position_enu)
        return self._within_radius(out, position_enu)

    def place(self, wanted_enu: Array) -> Array:
        """The position setpoint (3,) [m] that may be sent: inside the fence."""
        out = np.array(wanted_enu, dtype=np.float64)
        if self._low is not None and self._high is not None:
            out = np.clip(out, self._low, self._high)
        distance = math.hypot(out[0], out[1])
        if self._radius_m is not None and distance > self._radius_m:
            out[0:2] *= self._radius_m / distance
        if np.abs(out - wanted_enu).max() > _EPSILON:
            self.clamped["fence"] += 1
        return out

    def breach(self, position_enu: Array) -> str:
        """Why the vehicle must land, empty while it is inside the fence, or grazes it."""
        if self._low is not None and self._high is not None:
            outside = np.maximum(self._low - position_enu, position_enu - self._high)
            worst = int(np.argmax(outside))
            if outside[worst] > _SLACK_M:
                return f"outside the geofence: {'xyz'[worst]} = {position_enu[worst]:.1f} m"
        distance = math.hypot(position_enu[0], position_enu[1])
        if self._radius_m is not None and distance > self._radius_m + _SLACK_M:
            return f"outside the geofence: {distance:.1f} m of {self._radius_m:g} m from the origin"
        return ""

    def _slowed(self, out: Array) -> Array:
        speed = math.hypot(out[0], out[1])
        if speed > self.limits.horizontal_m_s + _EPSILON:
            out[0:2] *= self.limits.horizontal_m_s / speed
            self.clamped["horizontal"] += 1
        if out[2] > self.limits.up_m_s + _EPSILON:
            out[2] = self.limits.up_m_s
            self.clamped["up"] += 1
        if out[2] < -self.limits.down_m_s - _EPSILON:
            out[2] = -self.limits.down_m_s
            self.clamped["down"] += 1
        return out

    def _boxed(self, out: Array, position: Array) -> Array:
        if self._low is None or self._high is None:
            return out
        most = _APPROACH_1_S * np.maximum(self._high - position, 0.0)
        least = -_APPROACH_1_S * np.maximum(position - self._low, 0.0)
        bounded: Array = np.clip(out, least, most)
        if np.abs(bounded - out).max() > _EPSILON:
            self.clamped["fence"] += 1
        return bounded

    def _within_radius(self, out: Array, position: Array) -> Array:
        distance = math.hypot(position[0], position[1])
        if self._radius_m is None or distance < _EPSILON:
            return out
        outward = position[0:2] / distance
        speed = float(outward @ out[0:2])
        most = _APPROACH_1_S * max(self._radius_m - distance, 0.0)
        if speed > most + _EPSILON:
            out[0:2] -= (speed - most) * outward
            self.clamped["fence"] += 1
        return out
