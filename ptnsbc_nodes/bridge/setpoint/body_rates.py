"""How fast an attitude target turns: the body rates beside it, a feed-forward for the vehicle's attitude loop.

A vehicle adds them to the rates with which it turns towards the target. So they must be the target's own
and nothing of the vehicle's: a target that was worked out from the measured attitude and moves with it would
feed the vehicle's turning back to it.
"""

from __future__ import annotations

import numpy as np

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import Array
from ptnsbc_nodes.bridge.setpoint.attitude import product

_SMOOTH_S = 0.15
_MOST_RAD_S = 2.0
_LONGEST_S = 0.2
_CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])


class BodyRateEstimator:
    """Rates (3,) [rad/s, FLU of the target] of a sequence of attitude targets, smoothed."""

    def __init__(self) -> None:
        self._rates = np.zeros(3)
        self._last: Array | None = None
        self._last_s = 0.0
        self._known = np.zeros(3, dtype=bool)

    def of(self, quaternion: Array, known: Array, at_s: float) -> Array:
        """The rates with this target.

        Args:
            quaternion: (4,) x y z w, FLU to ENU.
            known: (3,) axes about which the target is the controller's own; zero about the others.
            at_s: the instant that the target belongs to; one that is not newer changes nothing.
        """
        last = self._last
        if last is not None and at_s <= self._last_s:
            return self._rates
        if last is None or at_s - self._last_s > _LONGEST_S:
            self._rates = np.zeros(3)
        else:
            step = product(last * _CONJUGATE, quaternion)
            self._learn(step, known & self._known, at_s - self._last_s)
        self._last, self._last_s, self._known = quaternion, at_s, known
        return self._rates

    def _learn(self, step: Array, known: Array, dt: float) -> None:
        found = 2.0 * np.copysign(1.0, step[3]) * step[0:3] / dt
        if np.abs(found).max() > _MOST_RAD_S:
            found = np.zeros(3)  # a new target is no motion of the old one
        smoothed = self._rates + dt / (_SMOOTH_S + dt) * (found - self._rates)
        self._rates = np.where(known, smoothed, 0.0)


def about_vertical(rates: Array, quaternion: Array) -> float:
    """Of rates (3,) [rad/s, FLU] of a target (4,) the part about the vertical, positive to the left."""
    return float(rotation_from_quaternion(quaternion)[2] @ rates)
