"""Normalised thrust at hover, learnt in flight."""

from __future__ import annotations

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import Array

_LEAST_THRUST, _MOST_THRUST = 0.05, 0.95
_HOVER_RANGE = 0.5  # the estimate stays within this share of where it began
_HOVER_TIME_S = 2.0
_HOVER_SPAN_S = 0.2
_LEVEL = 0.5  # of the thrust axis upwards; tilted more, nothing is learnt about hovering


class HoverThrust:
    """Normalised thrust at hover: from a parameter, then from what thrust does to the velocity."""

    def __init__(self, first: float, gravity_m_s2: float) -> None:
        self.value = first
        self._bounds = (first * (1.0 - _HOVER_RANGE), min(first * (1.0 + _HOVER_RANGE), 0.9))
        self._gravity = gravity_m_s2
        self._since: tuple[float, float] | None = None  # (time, upward velocity)
        self._sum = 0.0
        self._count = 0

    def sent(self, thrust: float) -> None:
        """A thrust that was asked for."""
        self._sum += thrust
        self._count += 1

    def flown(self, now_s: float, odometry: Array) -> None:
        """What became of it; call with every new odometry (13,) while thrust is ours."""
        rotation = rotation_from_quaternion(odometry[3:7])
        climb = float(rotation[2] @ odometry[7:10])
        if self._since is None or now_s - self._since[0] > 2 * _HOVER_SPAN_S:
            return self._restart(now_s, climb)
        span = now_s - self._since[0]
        if span < _HOVER_SPAN_S or not self._count:
            return None
        lift = ((climb - self._since[1]) / span + self._gravity) / max(rotation[2, 2], _LEVEL)
        if lift > 0.2 * self._gravity and rotation[2, 2] > _LEVEL:
            found = self._sum / self._count * self._gravity / lift
            share = span / (_HOVER_TIME_S + span)
            self.value += share * (found - self.value)
            self.value = min(max(self.value, self._bounds[0]), self._bounds[1])
        return self._restart(now_s, climb)

    def _restart(self, now_s: float, climb: float) -> None:
        self._since = (now_s, climb)
        self._sum, self._count = 0.0, 0

    def normalised(self, force_n: float, mass_kg: float) -> float:
        """Thrust 0 to 1 for a force along body z [N]."""
        thrust = self.value * force_n / (mass_kg * self._gravity)
        return min(max(thrust, _LEAST_THRUST), _MOST_THRUST)
