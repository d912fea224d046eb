"""Errors of a satellite receiver: slow errors of the estimate, a local origin per vehicle, and the loss of the fix.

Errors are Gauss-Markov: e' = a e + sigma sqrt(1 - a^2) n. The velocity error of `plain` is set so that zero
velocity drifts about 4 m in 12 s while the estimate reads near zero, as measured on a simulated PX4.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_autopilot.physics.airframe import ERROR_POSITION, ERROR_SIZE, ERROR_VELOCITY, ERROR_YAW
from ptnsbc_core.types import Array

UPDATE_HZ = 25
_AT_REST_SHARE, _SHARE_TAU_S = 0.1, 2.0
_DEAD_RECKONING_M_S2 = 0.3  # growth of the velocity error without satellites, [m/s per sqrt(s)]


class ReceiverAccuracy(NamedTuple):
    """Standard deviations and correlation times of one kind of receiver."""

    position_m: float  # horizontal, per axis
    height_m: float
    position_tau_s: float
    velocity_m_s: float  # horizontal
    climb_m_s: float
    velocity_tau_s: float
    yaw_rad: float
    fix_type: int  # GPS_FIX_TYPE
    smooth_s: float = (
        0.0  # of the estimator between the error of the receiver and the one of the position
    )


QUALITIES = {
    "plain": ReceiverAccuracy(0.45, 0.35, 60.0, 0.33, 0.04, 40.0, 0.017, 3),
    "quiet": ReceiverAccuracy(0.11, 0.08, 20.0, 0.02, 0.02, 10.0, 0.005, 3, 1.0),
    "rtk": ReceiverAccuracy(0.014, 0.02, 20.0, 0.01, 0.008, 1.0, 0.005, 6),
    "perfect": ReceiverAccuracy(0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 6),
}
"""Receivers to choose from: `plain` as measured, `quiet` as measured with a twentieth of the noise, `rtk` as in the
paper's experiment.

With `rtk` a velocity error is short: it would show within seconds in positions known to centimetres.
"""


class Navigation:
    """Errors of one vehicle's estimate. The same seed gives the same errors."""

    def __init__(
        self, quality: ReceiverAccuracy, start_enu: Array, spread_m: float, seed: int
    ) -> None:
        self.quality = quality
        self._random = np.random.default_rng(seed)
        self._spread_m = spread_m
        self.errors = np.zeros(ERROR_SIZE)
        self.origin_enu = np.zeros(3)
        self._global = np.zeros(3)
        self._received = np.zeros(3)
        self._drift = np.zeros(3)  # velocity error in the air
        self._share = _AT_REST_SHARE
        self._since_lost: float | None = None
        self.restart(start_enu)

    def restart(self, position_enu: Array) -> None:
        """Boot at a position (3,): new errors, and the origin at the position of the first fix."""
        quality, random = self.quality, self._random
        self._global = random.standard_normal(3) * self._deviations()
        self._received = self._global.copy()
        direction = random.uniform(0.0, 2.0 * math.pi)
        self._drift = quality.velocity_m_s * np.array(
            (math.cos(direction), math.sin(direction), 0.0)
        )
        self.errors[ERROR_VELOCITY] = _AT_REST_SHARE * self._drift
        self.errors[ERROR_YAW] = quality.yaw_rad * random.standard_normal()
        offset = np.zeros(3)
        angle, share = random.uniform(0.0, 2.0 * math.pi), math.sqrt(random.uniform())
        offset[0] = self._spread_m * share * math.cos(angle)
        offset[1] = self._spread_m * share * math.sin(angle)
        self.origin_enu = position_enu + self._global + offset
        self.errors[ERROR_POSITION] = self._global - self.origin_enu

    def lose(self, t: float) -> None:
        """Lose the satellites at t [s]."""
        if self._since_lost is None:
            self._since_lost = t

    def regain(self) -> None:
        """Receive satellites again."""
        self._since_lost = None

    def jump(self, east_m: float) -> None:
        """The estimator resets: the local position moves to the east at once, and stays there."""
        self.origin_enu = self.origin_enu - np.array((east_m, 0.0, 0.0))

    @property
    def fix_type(self) -> int:
        """GPS_FIX_TYPE now: 1 is no fix."""
        return self.quality.fix_type if self._since_lost is None else 1

    def lost_s(self, t: float) -> float:
        """Seconds without satellites."""
        return 0.0 if self._since_lost is None else t - self._since_lost

    def update(self, dt: float, at_rest: bool) -> None:
        """Advance the errors by dt [s]; at rest on the ground the velocity error is smaller."""
        noise = self._random.standard_normal(6)
        tau, deviations = self.quality.velocity_tau_s, self._velocity_deviations()
        if self._since_lost is not None:
            self._drift += _DEAD_RECKONING_M_S2 * math.sqrt(dt) * noise[3:6]
            self._drift[2] = 0.0  # the barometer still holds the height
            self._global += self._drift * dt
            self._received = self._global.copy()
        else:
            self._move(self._drift, deviations, tau, noise, dt)
            tau = self.quality.position_tau_s
            self._move(self._received, self._deviations(), tau, noise[3:], dt)
            self._global += dt / (self.quality.smooth_s + dt) * (self._received - self._global)
        aim = _AT_REST_SHARE if at_rest else 1.0
        self._share += (aim - self._share) * min(dt / _SHARE_TAU_S, 1.0)
        self.errors[ERROR_VELOCITY] = self._share * self._drift
        self.errors[ERROR_POSITION] = self._global - self.origin_enu

    def _deviations(self) -> Array:
        quality = self.quality
        return np.array((quality.position_m, quality.position_m, quality.height_m))

    def _velocity_deviations(self) -> Array:
        per_axis = self.quality.velocity_m_s * math.sqrt(0.5)
        return np.array((per_axis, per_axis, self.quality.climb_m_s))

    @staticmethod
    def _move(value: Array, deviation: Array, tau_s: float, noise: Array, dt: float) -> None:
        keep = math.exp(-dt / tau_s)
        value *= keep
        value += math.sqrt(1.0 - keep * keep) * deviation * noise[:3]
