"""Noise of what a UAV senses, and of the wind around it: position, near objects, gusts.

Position: the navigation filter of a UAV fuses rare, noisy, late satellite fixes with inertial data. A steady-state
Kalman filter (the alpha-beta filter of Kalata 1984) predicts position and velocity with the accelerometer and corrects
both at each fix. A fix is compared with the estimate for the time of its measurement, as far as the latency is
compensated, and the correction is carried to the present. The filter is linear, so its error has dynamics of its own,
independent of the vehicle's motion:

    e: error now;  h: error `compensated` ago, with all fixes received until now
    between fixes:  e_p += e_v dt + a dt^2 / 2,  e_v += a dt;  h the same with the a of then
    at a fix:       r = p(t - latency) + n - (p(t - compensated) + h_p)
                    h_p += alpha r,  h_v += beta / T r,
                    e_p += (alpha + compensated beta / T) r,  e_v += beta / T r

The UAV measures p + e_p and v + e_v. a is the accelerometer's error, new whenever a fix is measured. A latency that
is not compensated makes the position lag by velocity times that latency. Attitude and body rates are inertial and
exact here.

Gusts: coloured noise around the mean wind, independent for each UAV. First order with a correlation time, stationary
from the start: the longitudinal form of Dryden's model, on all three axes. Independent gusts are the hard case for a
formation: a common gust would move all UAVs alike.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.kinematics import rotation_from_quaternion, velocity_enu
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario

POSITION_SAMPLES = 6
"""Random numbers per tick: noise of the fix and error of the accelerometer."""

SENSOR_SAMPLES = 6
"""Random numbers per object: noise of its position and of its velocity."""

GUST_SAMPLES = 3
"""Random numbers per tick."""

_NOW, _DELAYED, _ACCELERATION = 0, 6, 12


class PositionNoise(NamedTuple):
    """Constants of the estimator; `period` is 0 for one without error."""

    period: int  # control periods between two fixes
    delay: int  # control periods that a fix is late
    compensated: int  # how many of them the estimator compensates
    noise_m: float  # standard deviation of a fix, per axis
    acceleration_noise_m_s2: float  # standard deviation of the accelerometer's error, per axis
    alpha: float
    beta_1_s: float  # beta over the time between two fixes


EXACT = PositionNoise(0, 0, 0, 0.0, 0.0, 0.0, 0.0)


def position_noise_of(scenario: Scenario) -> PositionNoise:
    """The estimator of every UAV, with the gains that are best for its noise (Kalata's tracking index)."""
    block, hz = scenario.sensor.positioning, scenario.timing.control_hz
    if block is None:
        return EXACT
    noise_m, shake, rate_hz = block.noise_m, block.acceleration_noise_m_s2, float(block.rate_hz)
    index = shake / (rate_hz * rate_hz * noise_m)
    root = (4.0 + index - math.sqrt(8.0 * index + index * index)) / 4.0
    alpha = 1.0 - root * root
    beta = 2.0 * (2.0 - alpha) - 4.0 * math.sqrt(1.0 - alpha)
    compensated = round((block.latency_s - block.unknown_latency_s) * hz)
    delay, period = round(block.latency_s * hz), hz // block.rate_hz
    return PositionNoise(
        period, delay, compensated, float(noise_m), float(shake), alpha, beta * rate_hz
    )


def position_std_m(kind: PositionNoise, dt: float) -> float:
    """Standard deviation per axis of the measured position [m] just after a fix.

    No linear estimator with these fixes and this accelerometer has a smaller one. It is the covariance of the
    steady filter, alpha s^2, beta s^2 / T and beta (2 alpha - beta) s^2 / (2 (1 - alpha) T^2), carried
    from the instant of the measurement to the present.
    """
    period_s, late = kind.period * dt, kind.delay * dt
    beta, square = kind.beta_1_s * period_s, kind.noise_m**2
    place, both = kind.alpha * square, kind.beta_1_s * square
    speed = beta * (2.0 * kind.alpha - beta) * square / (2.0 * (1.0 - kind.alpha) * period_s**2)
    pushed = 0.5 * late * late * kind.acceleration_noise_m_s2
    return math.sqrt(place + 2.0 * late * both + late * late * speed + pushed * pushed)


def correction_std_m(kind: PositionNoise, dt: float) -> float:
    """Standard deviation per axis of what a fix changes the measured position by [m].

    The innovation has the variance s^2 / (1 - alpha); the correction is carried from the measurement to the present.
    """
    gain = kind.alpha + kind.compensated * dt * kind.beta_1_s
    return gain * kind.noise_m / math.sqrt(1.0 - kind.alpha)


def initial_error(kind: PositionNoise) -> Array:
    """Error (12 + 3 (compensated + 1),) before the first tick: e, h, and a of the latest control periods."""
    return np.zeros(_ACCELERATION + 3 * (kind.compensated + 1))


@inline_kernel
def _predict(error: Array, which: int, acceleration: int, dt: float) -> None:
    for i in range(3):
        a = error[acceleration + i]
        error[which + i] += dt * error[which + 3 + i] + 0.5 * dt * dt * a
        error[which + 3 + i] += dt * a


@inline_kernel
def _correct(
    error: Array,
    late: Array,
    compensated_position: Array,
    samples: Array,
    lag: float,
    kind: PositionNoise,
) -> None:
    for i in range(3):
        innovation = (
            late[i] + kind.noise_m * samples[i] - (compensated_position[i] + error[_DELAYED + i])
        )
        place, speed = kind.alpha * innovation, kind.beta_1_s * innovation
        error[_DELAYED + i] += place
        error[_DELAYED + 3 + i] += speed
        error[_NOW + i] += place + lag * speed
        error[_NOW + 3 + i] += speed


@kernel
def measured_odometry(
    truth: Array,
    late: Array,
    compensated_position: Array,
    error: Array,
    samples: Array,
    tick: int,
    dt: float,
    kind: PositionNoise,
) -> Array:
    """Measured odometry vector (13,) at `tick`.

    Args:
        truth: (13,) its true odometry vector.
        late: (3,) [m, ENU] where it was `delay` ticks ago.
        compensated_position: (3,) [m, ENU] where it was `compensated` ticks ago.
        error: see `initial_error`; changed in place.
        samples: (6,) standard normal numbers of this tick.
        tick: number of control periods flown.
        dt: control period [s].
        kind: the estimator.
    """
    out = truth.copy()
    if kind.period == 0:
        return out
    slots = kind.compensated + 1
    last, this = _ACCELERATION + 3 * ((tick - 1) % slots), _ACCELERATION + 3 * (tick % slots)
    if tick > 0:
        _predict(error, _NOW, last, dt)
    if tick > kind.compensated:
        _predict(error, _DELAYED, this, dt)  # with the fixes until now: `compensated` + 1 ticks old
    if tick % kind.period == 0:
        lag = min(kind.compensated, tick) * dt  # before the first tick it stood still
        _correct(error, late, compensated_position, samples, lag, kind)
    measured = (tick + kind.delay) % kind.period == 0  # a fix that comes `delay` later
    for i in range(3):
        error[this + i] = (
            kind.acceleration_noise_m_s2 * samples[3 + i] if measured else error[last + i]
        )
    rotation = rotation_from_quaternion(truth[3:7])
    for i in range(3):
        out[i] += error[_NOW + i]
        for j in range(3):
            out[7 + i] += rotation[j, i] * error[_NOW + 3 + j]
    return out


class SensorNoise(NamedTuple):
    """Standard deviations of the near-object sensor, per axis."""

    noise_m: float
    velocity_noise_m_s: float


def sensor_noise_of(scenario: Scenario) -> SensorNoise:
    """The near-object sensor of every UAV."""
    return SensorNoise(float(scenario.sensor.noise_m), float(scenario.sensor.velocity_noise_m_s))


@kernel
def add_sensor_noise(
    near: Array, truth: Array, measured: Array, samples: Array, kind: SensorNoise
) -> Array:
    """Near objects (M, 8) as a UAV measures them.

    The sensor measures relative position and velocity. Converted to the world frame they contain the errors of
    the UAV's own position and velocity.

    Args:
        near: (M, 8) the true near objects.
        truth: (13,) the UAV's true odometry vector.
        measured: (13,) its measured odometry vector.
        samples: (6 M,) standard normal numbers, or more.
        kind: the sensor.
    """
    out = near.copy()
    true_velocity, measured_velocity = velocity_enu(truth), velocity_enu(measured)
    for row in range(out.shape[0]):
        for i in range(3):
            noise = kind.noise_m * samples[6 * row + i]
            out[row, i] += (measured[i] - truth[i]) + noise
            noise = kind.velocity_noise_m_s * samples[6 * row + 3 + i]
            out[row, 4 + i] += (measured_velocity[i] - true_velocity[i]) + noise
    return out


class Gusts(NamedTuple):
    """Constants of the wind."""

    mean: Array  # (3,) [m/s, ENU]
    deviation: Array  # (3,) [m/s]
    decay: float  # factor of a gust from one control period to the next
    innovation: float  # factor of the deviation for the new noise


def gusts_of(scenario: Scenario) -> Gusts:
    """The wind around every UAV."""
    world, dt = scenario.world, seconds(scenario.timing.dt_ns)
    decay = math.exp(-dt / world.gust_time_s)
    mean, deviation = np.array((world.wind_m_s, world.gust_m_s), dtype=np.float64)
    return Gusts(mean, deviation, decay, math.sqrt(1.0 - decay * decay))


@kernel
def gust_step(gust: Array, wind: Array, samples: Array, tick: int, kind: Gusts) -> None:
    """Gust (3,) and wind (3,) [m/s, ENU] of the control period that begins at `tick`, both in place."""
    for i in range(3):
        if tick == 0:
            gust[i] = kind.deviation[i] * samples[i]
        else:
            gust[i] = kind.decay * gust[i] + kind.innovation * kind.deviation[i] * samples[i]
        wind[i] = kind.mean[i] + gust[i]
