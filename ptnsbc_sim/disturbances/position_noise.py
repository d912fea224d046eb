"""What a UAV believes of itself: satellite fixes, rare, noisy and late, fused with inertial measurements.

A steady-state Kalman filter (the alpha-beta filter of Kalata 1984) carries position and velocity on with
the accelerometer and corrects both at each fix. A fix is compared with what was believed when it was
measured, as far as the latency is known, and the correction is carried to the present. The filter is
linear, so its error has dynamics of its own, whatever the vehicle does:

    e: error now;  h: error `known` ago, by all fixes heard until now
    between fixes:  e_p += e_v dt + a dt^2 / 2,  e_v += a dt;  h the same with the a of then
    at a fix:       r = p(t - latency) + n - (p(t - known) + h_p)
                    h_p += alpha r,  h_v += beta / T r,  e_p += (alpha + known beta / T) r,  e_v += beta / T r

and the UAV sees p + e_p and v + e_v. a is the accelerometer's error, new at each instant that a fix is
measured. What is not known of the latency makes the position lag by velocity times that much. Attitude and
body rates are inertial and exact here.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import Array

DRAWS = 6
"""Random numbers per tick: noise of the fix and error of the accelerometer."""

_NOW, _THEN, _SHAKES = 0, 6, 12


class PositionNoise(NamedTuple):
    """Constants of the estimator; `every` is 0 for one without error."""

    every: int  # control periods between two fixes
    delay: int  # control periods that a fix is late
    known: int  # how many of them the estimator reckons with
    noise_m: float  # standard deviation of a fix, per axis
    shake_m_s2: float  # standard deviation of the accelerometer's error, per axis
    alpha: float
    beta_1_s: float  # beta over the time between two fixes


EXACT = PositionNoise(0, 0, 0, 0.0, 0.0, 0.0, 0.0)


def odometer(
    noise_m: float, shake_m_s2: float, rate_hz: float, every: int, delay: int, known: int
) -> PositionNoise:
    """The estimator with the gains that are best for its noise (Kalata's tracking index)."""
    index = shake_m_s2 / (rate_hz * rate_hz * noise_m)
    root = (4.0 + index - math.sqrt(8.0 * index + index * index)) / 4.0
    alpha = 1.0 - root * root
    beta = 2.0 * (2.0 - alpha) - 4.0 * math.sqrt(1.0 - alpha)
    return PositionNoise(every, delay, known, noise_m, shake_m_s2, alpha, beta * rate_hz)


def spread_m(kind: PositionNoise, dt: float) -> float:
    """Standard deviation per axis of the believed position [m] when a fix has just come in.

    No linear estimator that is given these fixes and this accelerometer has a smaller one: the covariance of
    the steady filter, alpha s^2, beta s^2 / T and beta (2 alpha - beta) s^2 / (2 (1 - alpha) T^2), carried
    from the instant of the measurement to the present.
    """
    period, late = kind.every * dt, kind.delay * dt
    beta, square = kind.beta_1_s * period, kind.noise_m**2
    place, both = kind.alpha * square, kind.beta_1_s * square
    speed = beta * (2.0 * kind.alpha - beta) * square / (2.0 * (1.0 - kind.alpha) * period**2)
    pushed = 0.5 * late * late * kind.shake_m_s2
    return math.sqrt(place + 2.0 * late * both + late * late * speed + pushed * pushed)


def no_error(kind: PositionNoise) -> Array:
    """Error (12 + 3 (known + 1),) before the first tick: e, h, and a of the latest control periods."""
    return np.zeros(_SHAKES + 3 * (kind.known + 1))


@inline_kernel
def _carried_on(error: Array, which: int, shake: int, dt: float) -> None:
    for i in range(3):
        a = error[shake + i]
        error[which + i] += dt * error[which + 3 + i] + 0.5 * dt * dt * a
        error[which + 3 + i] += dt * a


@inline_kernel
def _corrected(
    error: Array, late: Array, reckoned: Array, draws: Array, lag: float, kind: PositionNoise
) -> None:
    for i in range(3):
        miss = late[i] + kind.noise_m * draws[i] - (reckoned[i] + error[_THEN + i])
        place, speed = kind.alpha * miss, kind.beta_1_s * miss
        error[_THEN + i] += place
        error[_THEN + 3 + i] += speed
        error[_NOW + i] += place + lag * speed
        error[_NOW + 3 + i] += speed


@kernel
def believed(
    truth: Array,
    late: Array,
    reckoned: Array,
    error: Array,
    draws: Array,
    tick: int,
    dt: float,
    kind: PositionNoise,
) -> Array:
    """Odometry vector (13,) that the UAV sees at `tick`.

    Args:
        truth: (13,) its true odometry vector.
        late: (3,) [m, ENU] where it was `delay` ticks ago.
        reckoned: (3,) [m, ENU] where it was `known` ticks ago.
        error: see `no_error`; changed in place.
        draws: (6,) standard normal numbers of this tick.
        tick: number of control periods flown.
        dt: control period [s].
        kind: the estimator.
    """
    out = truth.copy()
    if kind.every == 0:
        return out
    slots = kind.known + 1
    last, this = _SHAKES + 3 * ((tick - 1) % slots), _SHAKES + 3 * (tick % slots)
    if tick > 0:
        _carried_on(error, _NOW, last, dt)
    if tick > kind.known:
        _carried_on(error, _THEN, this, dt)  # what is in it until now: `known` + 1 ticks old
    if tick % kind.every == 0:
        lag = min(kind.known, tick) * dt  # before the first tick it stood still
        _corrected(error, late, reckoned, draws, lag, kind)
    measured = (tick + kind.delay) % kind.every == 0  # a fix that comes `delay` later
    for i in range(3):
        error[this + i] = kind.shake_m_s2 * draws[3 + i] if measured else error[last + i]
    rotation = rotation_from_quaternion(truth[3:7])
    for i in range(3):
        out[i] += error[_NOW + i]
        for j in range(3):
            out[7 + i] += rotation[j, i] * error[_NOW + 3 + j]
    return out
