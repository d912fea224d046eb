"""The setpoint with which a vehicle flies the velocity that the planner wants: the inverse of its known response.

A vehicle is v' = L (a + C (u - v)) - d v, with the setpoint u, its acceleration a, the velocity loop C and the lag L of
the tilt. Solved for v = wanted it gives u and a; docs/tuning.md, "Prediction", has the limits.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.autopilots import VelocityResponse

_SMOOTHING_S = 0.05
"""Low pass per derivative: the planner passes the noise of positions on. 0.05 s doubles it at 2 Hz."""
PLANNER_DELAY_S = 0.1
"""Allowed from a state of the vehicle to the setpoint that answers it: link both ways, planner, command filter."""
MOST_RISE = 4.0 / 3.0
"""Of a position loop around a vehicle: the most that it may make of a wanted motion."""
_MOST_KAPPA_TENTHS = 50

_ONE, _S = Polynomial([1.0]), Polynomial([0.0, 1.0])


class Transfer(NamedTuple):
    """A rational function of s."""

    above: Polynomial
    below: Polynomial

    def at(self, s: Array) -> Array:
        """The value at complex frequencies."""
        return np.asarray(self.above(s) / self.below(s))


class Inverse(NamedTuple):
    """The addition to a wanted velocity, if any, and the acceleration beside it; each without and per unit of drag."""

    velocity: tuple[Transfer, Transfer] | None
    acceleration: tuple[Transfer, Transfer]


def inverse(response: VelocityResponse, smoothing_s: float = _SMOOTHING_S) -> Inverse:
    """The inverse of a response, with a low pass of `smoothing_s` per derivative.

    Without shaping the wanted velocity itself is sent, and its acceleration does the rest.
    """
    lag = (_ONE + response.tilt_s[0] * _S) * (_ONE + response.tilt_s[1] * _S)
    smooth = _ONE + smoothing_s * _S
    if response.shaping_1_s is None:
        below = smooth**3
        pushed = Transfer(_S * lag + response.derivative * _S, below), Transfer(lag, below)
        return Inverse(None, pushed)
    # u - wanted = (1/L - 1) s + d/L over s + C (1 + p/s); the shaped velocity follows u with its acceleration exactly.
    loop = Polynomial([response.integral, response.gain, response.derivative])
    loop = loop * Polynomial([response.position_gain, 1.0])
    below = (_S**3 + loop) * smooth**2
    ahead, dragged = (lag - _ONE) * _S**3, lag * _S**2
    wanted = (_S**3 + loop) * _S
    pushed = (Transfer(wanted + ahead * _S, below * smooth), Transfer(dragged * _S, below * smooth))
    return Inverse((Transfer(ahead, below), Transfer(dragged, below)), pushed)


def flown_per_wanted(
    response: VelocityResponse, lead: Inverse | None, drag_1_s: float, s: Any
) -> Array:
    """Velocity that a vehicle flies per velocity that is wanted, at complex frequencies `s` [1/s].

    `lead` is what is sent in place of the wanted velocity; None: the wanted velocity alone. It knows the specific drag.
    """
    s = np.asarray(s)
    sent, push = np.ones_like(s), np.zeros_like(s)
    if lead is not None:
        still, dragged = lead.acceleration
        push = still.at(s) + drag_1_s * dragged.at(s)
        if lead.velocity is not None:
            still, dragged = lead.velocity
            sent = sent + still.at(s) + drag_1_s * dragged.at(s)
    lag = 1.0 / ((1.0 + response.tilt_s[0] * s) * (1.0 + response.tilt_s[1] * s))
    loop, slope = response.gain + response.integral / s, response.derivative * s
    if response.shaping_1_s is None:
        return np.asarray(lag * (loop * sent + push) / (s + drag_1_s + lag * (loop + slope)))
    shaped = (response.shaping_1_s * sent + push) / (s + response.shaping_1_s)
    loop = (loop + slope) * (1.0 + response.position_gain / s)
    return np.asarray(lag * (s + loop) * shaped / (s + drag_1_s + lag * loop))


def _is_stable(response: VelocityResponse, drag_1_s: float) -> bool:
    lag = (_ONE + response.tilt_s[0] * _S) * (_ONE + response.tilt_s[1] * _S)
    loop = Polynomial([response.integral, response.gain, response.derivative])
    closed = _S * (_S + drag_1_s) * lag + loop
    if response.shaping_1_s is not None:
        closed = _S**2 * (_S + drag_1_s) * lag + loop * Polynomial([response.position_gain, 1.0])
    # A zero at the origin is an integral or a position loop that is switched off.
    return bool(np.all(closed.roots().real < 1e-9))


def largest_kappa_1_s(response: VelocityResponse, lead: bool) -> float:
    """Largest gain [1/s] of a position loop around the vehicle that rises by less than a third, in steps of 0.1.

    It is 0 for a vehicle whose own velocity loop is not stable.
    It counts a delay of 0.1 s for link and planner, drags from 0 to 1 1/s, and tilts a quarter slower than known.
    """
    s = 1j * np.geomspace(0.1, 20.0, 300)
    made = inverse(response) if lead else None
    slower = response._replace(tilt_s=(1.25 * response.tilt_s[0], 1.25 * response.tilt_s[1]))
    cases = [(one, drag) for one in (response, slower) for drag in (0.0, 1.0)]
    if not all(_is_stable(one, drag) for one, drag in cases):
        return 0.0
    around = [
        np.exp(-PLANNER_DELAY_S * s) / s * flown_per_wanted(one, made, d, s) for one, d in cases
    ]
    for tenths in range(1, _MOST_KAPPA_TENTHS):
        peaks = [np.abs(0.1 * tenths * loop / (1.0 + 0.1 * tenths * loop)).max() for loop in around]
        if max(peaks) > MOST_RISE:
            return 0.1 * (tenths - 1)
    return 0.1 * _MOST_KAPPA_TENTHS


class _Filter:
    """Two transfer functions with one denominator, the second per unit of drag, on horizontal vectors (2,).

    Tustin: x' = A x + B u, y = C x + D u in the companion form, where a steady value stands in the first entry of x
    alone. Time counts in periods, so that all coefficients are of one size.
    """

    def __init__(self, transfers: tuple[Transfer, Transfer], period_s: float) -> None:
        below = transfers[0].below.trim().coef
        # Without an integral the vehicle's loop and its lead have powers of s in common.
        common = int(np.flatnonzero(below)[0])
        order = len(below) - common - 1
        units = period_s ** np.arange(order, -1.0, -1.0) / below[-1]
        above = np.zeros((2, order + 1))
        for row, transfer in zip(above, transfers, strict=True):
            coefficients = transfer.above.trim().coef[common:]
            row[: len(coefficients)] = coefficients
        below, above = below[common:] * units, above * units
        half = 0.5 * np.eye(order, k=1)
        half[-1] -= 0.5 * below[:-1]
        inverse = np.linalg.inv(np.eye(order) - half)
        self._next, self._input = inverse @ (np.eye(order) + half), inverse[:, -1:]
        self._out = (above[:, :-1] - above[:, -1:] * below[:-1]) @ inverse
        self._through = above[:, -1:] + 0.5 * self._out[:, -1:]
        self._rest = np.eye(order, 1) / below[0]
        self._state: Array | None = None  # (order, 2)

    def restart(self) -> None:
        """The next value has been there for ever."""
        self._state = None

    def step(self, value: Array, drag_1_s: float) -> Array:
        state = self._rest * value if self._state is None else self._state
        self._state = self._next @ state + self._input * value
        still, dragged = self._out @ state + self._through * value
        return np.asarray(still + drag_1_s * dragged)


class VelocityLead:
    """Velocity and acceleration setpoints of one vehicle for the velocities that the planner wants."""

    def __init__(self, response: VelocityResponse, period_s: float) -> None:
        velocity, acceleration = inverse(response)
        self._acceleration = _Filter(acceleration, period_s)
        self._velocity = None if velocity is None else _Filter(velocity, period_s)

    def restart(self) -> None:
        """The next velocity begins a new sequence."""
        self._acceleration.restart()
        if self._velocity is not None:
            self._velocity.restart()

    def setpoint(self, wanted: Array, drag_1_s: float) -> tuple[Array, Array]:
        """Velocity (2,) [m/s] and acceleration (2,) [m/s^2] to send one period after those before.

        `wanted` (2,) is the horizontal velocity [m/s, ENU] that the vehicle is meant to fly.
        """
        ahead = 0.0 if self._velocity is None else self._velocity.step(wanted, drag_1_s)
        return wanted + ahead, self._acceleration.step(wanted, drag_1_s)


class DragEstimator:
    """Specific drag [1/s] from how a vehicle moves with its tilt, beside a constant push of the wind.

    Least squares over spans of 0.2 s: what the tilt has not given of the change of the velocity is -d times the way,
    plus the wind's push times the span.
    """

    _SPAN_S = 0.2
    _MEMORY_S = 60.0
    _NOISE_M_S = 0.03  # of the change of the velocity over a span
    _FIRST, _FIRST_SPREAD = 0.2, 0.3  # [1/s]
    _WIND_SPREAD_M_S2 = 2.0
    _MOST = 1.5  # [1/s]

    def __init__(self, gravity_m_s2: float) -> None:
        self._gravity = gravity_m_s2
        self._prior = np.diag([self._FIRST_SPREAD**-2, *[self._WIND_SPREAD_M_S2**-2] * 2])
        self._matrix, self._vector = np.zeros((3, 3)), np.zeros(3)
        self._begin: tuple[float, Array] | None = None
        self._last_s = 0.0
        self._tilt, self._way = np.zeros(2), np.zeros(2)
        self.value = self._FIRST

    def on_odometry(self, now_s: float, odometry: Array) -> None:
        """Learn from an odometry (13,) while the vehicle flies."""
        rotation = rotation_from_quaternion(odometry[3:7])
        velocity = np.asarray(rotation @ odometry[7:10])
        dt = now_s - self._last_s
        self._last_s = now_s
        if self._begin is None or dt > self._SPAN_S or rotation[2, 2] < 0.5:
            return self._restart(now_s, velocity)
        self._tilt = self._tilt + dt * self._gravity * rotation[0:2, 2] / rotation[2, 2]
        self._way = self._way + dt * velocity[0:2]
        span_s = now_s - self._begin[0]
        if span_s < self._SPAN_S:
            return None
        unexplained = velocity[0:2] - self._begin[1][0:2] - self._tilt
        for axis in range(2):
            row = np.array([-self._way[axis], 0.0, 0.0])
            row[1 + axis] = span_s
            self._matrix += np.outer(row, row) / self._NOISE_M_S**2
            self._vector += row * unexplained[axis] / self._NOISE_M_S**2
        keep = math.exp(-span_s / self._MEMORY_S)
        self._matrix *= keep
        self._vector *= keep
        first = self._prior @ np.array([self._FIRST, 0.0, 0.0])
        found = np.linalg.solve(self._matrix + self._prior, self._vector + first)
        self.value = float(min(max(found[0], 0.0), self._MOST))
        return self._restart(now_s, velocity)

    def _restart(self, now_s: float, velocity: Array) -> None:
        self._begin = (now_s, velocity)
        self._tilt, self._way = np.zeros(2), np.zeros(2)


_PERIOD_S = 0.05
_SPAN_S, _LEAST_SPAN_S = 30.0, 10.0
_MOST_LAG_S = 1.0
_GAIN_OFF, _LAG_OFF_S = 0.3, 0.3  # farther from what was wanted, the prediction does not fit
_LEAST_M_S = 0.1  # root of the mean square of what was wanted about its mean: less shows nothing


class Following(NamedTuple):
    """Gain and lag of one vehicle."""

    gain: float
    lag_s: float

    @property
    def unlike(self) -> str:
        """A sentence on gain and lag that are too far from 1 and 0 s; empty when both are near enough."""
        if abs(self.gain - 1.0) <= _GAIN_OFF and self.lag_s <= _LAG_OFF_S:
            return ""
        return (
            f"flies the wanted velocities with gain {self.gain:.2f}, {self.lag_s:.2f} s late: expected "
            f"{1.0 - _GAIN_OFF:g} to {1.0 + _GAIN_OFF:g} and at most {_LAG_OFF_S:g} s: "
            "set velocity_loop_1_s and tilt_lag_s of its vehicle"
        )


class FollowingEstimator:
    """Compares the last half minute of wanted and flown horizontal velocities, sampled 20 times a second."""

    def __init__(self) -> None:
        # One row per sample: the thread of the node reads what the thread of the bridge appends.
        self._rows: deque[Array] = deque(maxlen=round(_SPAN_S / _PERIOD_S))
        self._next_s = 0.0

    def restart(self) -> None:
        """Forget everything: what follows has another setpoint."""
        self._rows.clear()

    def add(self, now_s: float, wanted: Array, flown: Array) -> None:
        """Take the wanted and the flown velocity (3,) [m/s] of now."""
        if now_s < self._next_s:
            return
        if now_s > self._next_s + 2.0 * _PERIOD_S:
            self.restart()
            self._next_s = now_s
        self._next_s += _PERIOD_S
        self._rows.append(np.concatenate((wanted[0:2], flown[0:2])))

    def found(self) -> Following | None:
        """The lag at which gain times what was wanted fits best what was flown; None while too little has moved."""
        rows = list(self._rows)
        if len(rows) < _LEAST_SPAN_S / _PERIOD_S:
            return None
        wanted, flown = np.array(rows)[:, 0:2], np.array(rows)[:, 2:4]
        best: tuple[float, Following] | None = None
        for steps in range(round(_MOST_LAG_S / _PERIOD_S) + 1):
            before = wanted[: len(wanted) - steps]
            before = before - before.mean(axis=0)
            after = flown[steps:] - flown[steps:].mean(axis=0)
            power = float(np.sum(before * before))
            if power < len(before) * _LEAST_M_S**2:
                return None
            gain = float(np.sum(before * after)) / power
            left = float(np.mean((after - gain * before) ** 2))
            if best is None or left < best[0]:
                best = (left, Following(gain, steps * _PERIOD_S))
        return None if best is None else best[1]
