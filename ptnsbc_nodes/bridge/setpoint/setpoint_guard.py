"""Limits of setpoints: clamps that count, and the geofence."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.autopilots import SetpointLimits
from ptnsbc_sim.scenario.mavlink import Geofence, VehicleLimits

_APPROACH_1_S = 1.0  # allowed speed towards the fence per metre to it, and inwards outside
_EPSILON = 1e-9


def allowed(scenario: VehicleLimits, vehicle: SetpointLimits) -> SetpointLimits:
    """The limits of the scenario taken down to those of the vehicle."""
    limits = vehicle._asdict().items()
    return SetpointLimits(*(min(float(getattr(scenario, name)), limit) for name, limit in limits))


class SetpointGuard:
    """Clamps setpoints, and counts how often."""

    def __init__(self, fence: Geofence, limits: SetpointLimits) -> None:
        self.limits = limits
        self._radius_m = math.inf if fence.radius_m is None else fence.radius_m
        self.low = np.array([-np.inf] * 3 if fence.box_min_m is None else fence.box_min_m)
        self.high = np.array([np.inf] * 3 if fence.box_max_m is None else fence.box_max_m)
        self._slack_m, self._ahead_s = fence.slack_m, fence.ahead_s
        self.clamped: Counter[str] = Counter()

    def velocity(self, velocity_enu: Array, position_enu: Array, moving_enu: Array) -> Array:
        """The velocity setpoint (3,) [m/s] that may be sent at this position and velocity of the vehicle.

        It points inwards where the vehicle is outside, or will be when the setpoint takes effect.
        """
        predicted, limits = self.ahead(position_enu, moving_enu), self.limits
        high = _APPROACH_1_S * (self.high - predicted)  # negative outside: inwards
        low = -_APPROACH_1_S * (predicted - self.low)
        out = np.clip(np.array(velocity_enu, dtype=np.float64), low, high)
        if np.abs(out - velocity_enu).max() > _EPSILON:
            self.clamped["fence"] += 1
        distance = math.hypot(predicted[0], predicted[1])
        if distance >= _EPSILON:
            outward = predicted[0:2] / distance
            excess = float(outward @ out[0:2]) - _APPROACH_1_S * (self._radius_m - distance)
            if excess > _EPSILON:
                out[0:2] -= excess * outward
                self.clamped["fence"] += 1
        speed = math.hypot(out[0], out[1])
        if speed > limits.horizontal_m_s + _EPSILON:
            out[0:2] *= limits.horizontal_m_s / speed
            self.clamped["horizontal"] += 1
        if out[2] > limits.up_m_s + _EPSILON:
            out[2] = limits.up_m_s
            self.clamped["up"] += 1
        if out[2] < -limits.down_m_s - _EPSILON:
            out[2] = -limits.down_m_s
            self.clamped["down"] += 1
        return out

    def ahead(self, position_enu: Array, moving_enu: Array) -> Array:
        """The place of the vehicle (3,) [m] when a setpoint of now takes effect."""
        return np.asarray(position_enu + self._ahead_s * moving_enu)

    def outside(self, position_enu: Array) -> bool:
        """True if a position (3,) [m] is outside of the fence."""
        return self._excess(position_enu) > 0.0

    def position(self, position_enu: Array) -> Array:
        """The position setpoint (3,) [m] that may be sent: inside the fence."""
        out = np.clip(np.array(position_enu, dtype=np.float64), self.low, self.high)
        distance = math.hypot(out[0], out[1])
        if distance > self._radius_m:
            out[0:2] *= self._radius_m / distance
        if np.abs(out - position_enu).max() > _EPSILON:
            self.clamped["fence"] += 1
        return out

    def breach(self, position_enu: Array, moving_enu: Array) -> str:
        """The reason why the vehicle must land; empty while its place and its predicted path are within the slack."""
        if text := self._breach_at(position_enu):
            return f"outside the geofence: {text}"
        if text := self._breach_at(self.ahead(position_enu, moving_enu)):
            return f"outside the geofence in {self._ahead_s:g} s: {text}"
        return ""

    def _breach_at(self, position: Array) -> str:
        if self._excess(position) <= self._slack_m:
            return ""
        outside = np.maximum(self.low - position, position - self.high)
        worst = int(np.argmax(outside))
        if outside[worst] > self._slack_m:
            return f"{'xyz'[worst]} = {position[worst]:.1f} m"
        distance = math.hypot(position[0], position[1])
        return f"{distance:.1f} m of {self._radius_m:g} m from the origin"

    def _excess(self, position: Array) -> float:
        """The distance of a position from the fence [m]; negative inside."""
        box = float(np.maximum(self.low - position, position - self.high).max())
        return max(box, math.hypot(position[0], position[1]) - self._radius_m)
