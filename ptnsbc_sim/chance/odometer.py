"""What a UAV believes of itself: satellite fixes, rare, noisy and late, fused with inertial measurements.

A steady-state Kalman filter (the alpha-beta filter of Kalata 1984) carries position and velocity on with
the accelerometer and corrects both at each fix. It is linear, so its error has dynamics of its own,
whatever the vehicle does:

    between fixes:  e_p += e_v dt + a dt^2 / 2,  e_v += a dt        a: accelerometer error, new at each fix
    at a fix:       r = p(t - latency) + n - (p + e_p),  e_p += alpha r,  e_v += beta / T r

and the UAV sees p + e_p and v + e_v. The fix is taken for fresh, as by an estimator that gets no time stamps
with it: at constant velocity the position lags by velocity times latency. Attitude and body rates are
inertial and exact here.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.kernel import kernel, leaf
from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import Array

DRAWS = 6
"""Random numbers per tick: noise of the fix and error of the accelerometer."""

ERROR_SIZE = 9


class Odometer(NamedTuple):
    """Constants of the estimator; `every` is 0 for one without error."""

    every: int  # control periods between two fixes
    delay: int  # control periods that a fix is late
    noise_m: float  # standard deviation of a fix, per axis
    shake_m_s2: float  # standard deviation of the accelerometer's error, per axis
    alpha: float
    beta_1_s: float  # beta over the time between two fixes


def odometer(noise_m: float, shake_m_s2: float, rate_hz: float, every: int, delay: int) -> Odometer:
    """The estimator with the gains that are best for its noise (Kalata's tracking index)."""
    index = shake_m_s2 / (rate_hz * rate_hz * noise_m)
    root = (4.0 + index - math.sqrt(8.0 * index + index * index)) / 4.0
    alpha = 1.0 - root * root
    beta = 2.0 * (2.0 - alpha) - 4.0 * math.sqrt(1.0 - alpha)
    return Odometer(every, delay, noise_m, shake_m_s2, alpha, beta * rate_hz)


@leaf
def _carried_on(error: Array, dt: float) -> None:
    for i in range(3):
        error[i] += dt * error[3 + i] + 0.5 * dt * dt * error[6 + i]
        error[3 + i] += dt * error[6 + i]


@leaf
def _corrected(error: Array, truth: Array, late: Array, draws: Array, kind: Odometer) -> None:
    for i in range(3):
        miss = late[i] + kind.noise_m * draws[i] - (truth[i] + error[i])
        error[i] += kind.alpha * miss
        error[3 + i] += kind.beta_1_s * miss
        error[6 + i] = kind.shake_m_s2 * draws[3 + i]


@kernel
def believed(
    truth: Array, late: Array, error: Array, draws: Array, tick: int, dt: float, kind: Odometer
) -> Array:
    """Odometry vector (13,) that the UAV sees at `tick`.

    Args:
        truth: (13,) its true odometry vector.
        late: (3,) [m, ENU] where it was `delay` ticks ago.
        error: (9,) e_p [m], e_v [m/s], a [m/s^2], ENU; changed in place.
        draws: (6,) standard normal numbers of this tick.
        tick: number of control periods flown.
        dt: control period [s].
        kind: the estimator.
    """
    out = truth.copy()
    if kind.every == 0:
        return out
    if tick > 0:
        _carried_on(error, dt)
    if tick % kind.every == 0:
        _corrected(error, truth, late, draws, kind)
    rotation = rotation_from_quaternion(truth[3:7])
    for i in range(3):
        out[i] += error[i]
        for j in range(3):
            out[7 + i] += rotation[j, i] * error[3 + j]
    return out


@kernel
def beside(near: Array, truth: Array, seen: Array) -> Array:
    """Near objects (M, 7) as a UAV places them that measures from itself and believes itself elsewhere.

    The sensor measures where something is from here: distances stay true. Rounded to float32 like
    everything that the sensor tells.
    """
    out = near.copy()
    for row in range(out.shape[0]):
        for i in range(3):
            out[row, i] = np.float32(out[row, i] + (seen[i] - truth[i]))
    return out
