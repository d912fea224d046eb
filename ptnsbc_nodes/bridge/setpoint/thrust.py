"""The force of a normalised thrust: force = weight (thrust / thrust at hover)^slope, after a delay.

The thrust at hover is followed in the whole flight, so a battery that sags costs no height. Slope and delay are found
once, before the formation: `ThrustTest` adds a known pattern to the thrust of a vehicle that holds a point.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.signal import detrend, lfilter

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import Array

_LEVEL = 0.5
"""Upward part of the thrust axis; a vehicle tilted farther shows nothing about hovering."""
_LEAST_LIFT = 0.2  # of gravity


class HoverThrust:
    """Normalised thrust at hover: from a parameter, then from what thrust does to the velocity."""

    _MIN_THRUST, _MAX_THRUST = 0.05, 0.95
    _RANGE = 0.5  # the estimate stays within this share of its first value
    _TIME_S = 2.0
    _SPAN_S = 0.2

    def __init__(self, first: float, gravity_m_s2: float) -> None:
        self.value = first
        self.slope = 1.0
        """Relative change of the force per relative change of the thrust [1]."""
        self._bounds = (first * (1.0 - self._RANGE), min(first * (1.0 + self._RANGE), 0.9))
        self._gravity = gravity_m_s2
        self._since: tuple[float, float] | None = None  # (time, upward velocity)
        self._sum = 0.0
        self._count = 0

    def on_sent(self, thrust: float) -> None:
        """Count a thrust that was sent."""
        self._sum += thrust
        self._count += 1

    def on_odometry(self, now_s: float, odometry: Array) -> None:
        """Learn from every new odometry (13,) while the bridge sends the thrust."""
        climb, level = _upwards(odometry)
        if self._since is None or now_s - self._since[0] > 2 * self._SPAN_S:
            return self._restart(now_s, climb)
        span = now_s - self._since[0]
        if span < self._SPAN_S or not self._count:
            return None
        lift = ((climb - self._since[1]) / span + self._gravity) / max(level, _LEVEL)
        if lift > _LEAST_LIFT * self._gravity and level > _LEVEL:
            measured = self._sum / self._count * (self._gravity / lift) ** (1.0 / self.slope)
            share = span / (self._TIME_S + span)
            self.value += share * (measured - self.value)
            self.value = min(max(self.value, self._bounds[0]), self._bounds[1])
        return self._restart(now_s, climb)

    def _restart(self, now_s: float, climb: float) -> None:
        self._since = (now_s, climb)
        self._sum, self._count = 0.0, 0

    def normalised(self, force_per_kg: float, nudge: float = 0.0) -> float:
        """Thrust 0 to 1 for a specific force along body z [m/s^2], times exp(`nudge`)."""
        share = max(force_per_kg, 0.0) / self._gravity
        thrust = self.value * share ** (1.0 / self.slope) * math.exp(nudge)
        return min(max(thrust, self._MIN_THRUST), self._MAX_THRUST)


class ThrustResponse(NamedTuple):
    """The findings of `ThrustTest`."""

    slope: float  # relative change of the force per relative change of the thrust
    delay_s: float  # from a target that is sent to its force, the motors' lag included


class ThrustTest:
    """Adds a pattern to the thrust, and finds from how the vehicle moves what thrust does to it.

    The loop that holds the point answers noise and gusts with thrust, so a regression of the acceleration on the thrust
    is biased. The pattern is independent of both: with it k seconds earlier, the covariances of the acceleration are
    those of the thrust, delayed, times the slope, whatever the loop does. Slope, delay and lag of the motors are their
    least squares (instrumental variables, Söderström and Stoica 1983). Acceleration and thrust are logarithms.

    A symbol of the pattern is + - - + or its opposite: it leaves neither speed nor height.
    """

    _SIZE = 0.06  # of the logarithm of the thrust
    _PART_S, _PARTS = 0.15, np.array((1.0, -1.0, -1.0, 1.0))
    _PATTERN = np.kron(np.random.default_rng(6).choice((-1.0, 1.0), 18), _PARTS)
    _PADDED = np.pad(_PATTERN, 1)  # zero before and after
    _GAP_S = 0.25
    _TAIL_S = 0.8
    _LAGS_S = np.arange(-0.2, _TAIL_S, 0.02)  # of the pattern
    _DELAYS_S = np.arange(0.0, 0.4, 0.005)
    _MOTORS_S = (0.0, 0.01, 0.02, 0.03, 0.04, 0.06, 0.08)
    _FINE_S = 0.005
    _LEAST_EXPLAINED = 0.6  # share of the covariances of acceleration and pattern
    _SLOPES = (0.5, 3.0)
    _PATIENCE = 3.0  # lengths

    def __init__(self, gravity_m_s2: float) -> None:
        self.over = False
        self.found: ThrustResponse | None = None
        """None before the test is over, and when the vehicle did not show it."""
        self._gravity = gravity_m_s2
        self._sent: list[tuple[float, float]] = []  # time, logarithm of the thrust
        self._states: list[tuple[float, float, float]] = []  # time, upward velocity, level
        self._first_s, self._flew_s = math.inf, -math.inf

    @property
    def length_s(self) -> float:
        """Duration of the test [s]."""
        return len(self._PATTERN) * self._PART_S + self._TAIL_S

    def nudge(self, now_s: float) -> float:
        """The pattern now, to be added to the logarithm of the thrust; zero on the ground and when the test is over."""
        if not self._runs(now_s):
            return 0.0
        self._forget_before_gap(now_s)
        since_s = now_s - self._sent[0][0] if self._sent else 0.0
        return self._SIZE * float(self._pattern(np.array([since_s]))[0])

    def on_sent(self, now_s: float, thrust: float) -> None:
        """Take the thrust that was sent."""
        if self._runs(now_s):
            self._sent.append((now_s, math.log(thrust)))

    def on_odometry(self, now_s: float, sampled_s: float, odometry: Array) -> bool:
        """Take the odometry (13,) of a flying vehicle, sampled at `sampled_s`; returns whether the test is over."""
        if self.over:
            return True
        self._forget_before_gap(now_s)
        self._flew_s = now_s
        self._first_s = min(self._first_s, now_s)
        if not self._states or sampled_s > self._states[-1][0]:
            self._states.append((sampled_s, *_upwards(odometry)))
        if self._sent and sampled_s - self._sent[0][0] >= self.length_s:
            self.over, self.found = True, self._response()
        self.over = self.over or now_s - self._first_s > self._PATIENCE * self.length_s
        return self.over

    def _forget_before_gap(self, now_s: float) -> None:
        """Without states nothing is sent: so a gap of either shows in what was sent."""
        if self._sent and now_s - self._sent[-1][0] > self._GAP_S:
            self._sent, self._states = [], []

    def _runs(self, now_s: float) -> bool:
        return not self.over and now_s - self._flew_s <= self._GAP_S

    def _pattern(self, since_s: Array) -> Array:
        """The pattern (N,) at times (N,) since it began [s]; zero before and after."""
        part = np.floor(since_s / self._PART_S).astype(int) + 1
        return np.asarray(self._PADDED[np.clip(part, 0, len(self._PADDED) - 1)])

    def _response(self) -> ThrustResponse | None:
        sent, states = np.array(self._sent), np.array(self._states)
        begin = sent[0, 0]
        ends = states[states[:, 0] > begin + self._DELAYS_S[-1]]
        times, level = ends[:, 0], np.maximum(ends[:, 2], _LEVEL)[1:]
        lift = (np.diff(ends[:, 1]) / np.diff(times) / self._gravity + 1.0) / level
        middles = 0.5 * (times[1:] + times[:-1]) - begin
        pattern = self._pattern(middles - self._LAGS_S[:, None])  # (K, N)
        shown = pattern @ detrend(np.log(np.maximum(lift, _LEAST_LIFT)))  # (K,)
        asked = pattern @ detrend(self._thrusts(sent, times), axis=0)  # (K, M)
        slopes = shown @ asked / np.sum(asked * asked, axis=0)
        left = np.sum((shown[:, None] - slopes * asked) ** 2, axis=0)
        best = int(np.argmin(left))
        motor, delay = divmod(best, len(self._DELAYS_S))
        slope, (low, high) = float(slopes[best]), self._SLOPES
        most_left = (1.0 - self._LEAST_EXPLAINED) * float(shown @ shown)
        if not (low <= slope <= high and left[best] <= most_left):
            return None
        return ThrustResponse(slope, float(self._DELAYS_S[delay]) + self._MOTORS_S[motor])

    def _thrusts(self, sent: Array, times: Array) -> Array:
        """Mean logarithm of the thrust between `times` (N + 1,), behind every lag and delay: (N, M)."""
        step = self._FINE_S
        grid = np.arange(sent[0, 0], times[-1] + step, step)
        held = sent[np.searchsorted(sent[:, 0], grid, side="right") - 1, 1]
        late = times[:, None] - self._DELAYS_S
        means = []
        for motor_s in self._MOTORS_S:
            keep = math.exp(-step / motor_s) if motor_s > 0.0 else 0.0
            moved, _ = lfilter([1.0 - keep], [1.0, -keep], held, zi=[keep * held[0]])
            whole = np.concatenate(([0.0], np.cumsum(moved)[:-1])) * step
            means.append(np.diff(np.interp(late, grid, whole), axis=0) / np.diff(times)[:, None])
        return np.concatenate(means, axis=1)


def _upwards(odometry: Array) -> tuple[float, float]:
    """Upward velocity [m/s], and the upward part of the thrust axis, of an odometry (13,)."""
    rotation = rotation_from_quaternion(odometry[3:7])
    return float(rotation[2] @ odometry[7:10]), float(rotation[2, 2])
