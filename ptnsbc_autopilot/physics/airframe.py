"""Inner loops and physics of one vehicle as one kernel: estimate, position, velocity, attitude, rates, plant, ground.

All kernels of the stand-in are in this file: numba notices edits here by the file's date, edits of the plant
by the digest of `ptnsbc_core.kernel`. Everything is ENU/FLU; MAVLink's frames end in `frames`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import wrap_angle
from ptnsbc_core.control.quadrotor_control import attitude_error, desired_rotation
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.kinematics import rotation, yaw_of
from ptnsbc_core.types import Array, Matrix3
from ptnsbc_sim.plants.contract import PlantConfig
from ptnsbc_sim.plants.integrate import advance

PHYSICS_HZ = 250

# Kinds of targets.
OFF, IDLE, TRAJECTORY, ATTITUDE, RATES = 0.0, 1.0, 2.0, 3.0, 4.0

# Rows of a target. NaN: not commanded.
KIND = 0
POSITION, VELOCITY, ACCELERATION = slice(1, 4), slice(4, 7), slice(7, 10)  # ENU, position local
YAW, YAW_RATE, THRUST, THRUST_CAP = 10, 11, 12, 13  # ENU; thrusts as shares of the largest
QUATERNION, BODY_RATES = slice(14, 18), slice(18, 21)  # x y z w; FLU
CLIMB = 21  # with an attitude: climb rate [m/s] instead of a thrust
TARGET_SIZE = 22

# Rows of the loop state.
INTEGRAL, HEADING, CONTACT, THRUST_OUT = slice(0, 3), 3, 4, 5
FILTERED, LAST, SLOPE, PULL = slice(6, 8), slice(8, 10), slice(10, 12), slice(12, 14)  # horizontal
LOOP_SIZE = 14

# Rows of the errors of the estimate: position less origin, velocity [ENU], yaw.
ERROR_POSITION, ERROR_VELOCITY, ERROR_YAW = slice(0, 3), slice(3, 6), 6
ERROR_SIZE = 7

_IDLE_SHARE = 0.08
_LIFT_OFF_M = 0.02
_RATE_GAIN = 25.0  # [1/s]
_DERIVATIVE_S = 0.032  # low pass of the derivative in the velocity loops, 5 Hz
_MOST_INTEGRAL = 3.0  # [m/s^2]


class LoopGains(NamedTuple):
    """Gains and limits of the loops, from the autopilot's parameters."""

    position: float  # [1/s] horizontal
    height: float  # [1/s]
    velocity: float  # [1/s] horizontal
    climb: float  # [1/s]
    velocity_integral: float  # [1/s^2]
    climb_integral: float  # [1/s^2]
    max_speed: float  # [m/s]
    max_up: float  # [m/s]
    max_down: float  # [m/s]
    max_acceleration: float  # [m/s^2] horizontal
    max_tilt: float  # [rad]
    tilt_gain: float  # [1/s]
    yaw_gain: float  # [1/s]
    max_rate: float  # [rad/s]
    max_yaw_rate: float  # [rad/s]
    # The horizontal velocity loop beyond its proportional and integral part.
    derivative: float = 0.0
    of_error: bool = False  # the derivative is that of the error, otherwise that of the velocity
    error_s: float = 0.0  # low pass of the error
    tilt_s: float = 0.0  # low pass of the tilt that the velocity loop asks for
    path_tilt_gain: float = 0.0  # [1/s] of the tilt below the velocity loop; 0: `tilt_gain`


def no_target() -> Array:
    """A target with nothing commanded and the motors off."""
    target = np.full(TARGET_SIZE, np.nan)
    target[KIND], target[THRUST_CAP] = OFF, 1.0
    return target


@inline_kernel
def _estimate(body: Array, errors: Array, nav: Array) -> None:
    """The estimated state, as an odometry vector (13,) with the velocity in ENU."""
    for i in range(3):
        nav[i] = body[i] + errors[i]
        nav[7 + i] = body[7 + i] + errors[3 + i]
        nav[10 + i] = body[10 + i]
    c, s = math.cos(0.5 * errors[6]), math.sin(0.5 * errors[6])
    x, y, z, w = body[3], body[4], body[5], body[6]
    nav[3], nav[4] = c * x - s * y, c * y + s * x
    nav[5], nav[6] = c * z + s * w, c * w - s * z


@inline_kernel
def _velocity_setpoint(nav: Array, target: Array, gains: LoopGains) -> Array:
    """Velocity setpoint (3,) of the position loop, NaN where an axis has neither position nor velocity."""
    out = target[4:7].copy()
    for i in range(3):
        place = target[1 + i]
        if math.isfinite(place):
            gain = gains.height if i == 2 else gains.position
            ahead = out[i] if math.isfinite(out[i]) else 0.0
            out[i] = ahead + gain * (place - nav[i])
    speed = math.hypot(out[0], out[1])
    if speed > gains.max_speed:
        out[0] *= gains.max_speed / speed
        out[1] *= gains.max_speed / speed
    if math.isfinite(out[2]):
        out[2] = min(max(out[2], -gains.max_down), gains.max_up)
    return out


@inline_kernel
def _low_pass(value: float, towards: float, time_s: float, dt: float) -> float:
    """One step of a first-order low pass; a time of zero passes everything, NaN begins at `towards`."""
    return value + dt / (time_s + dt) * (towards - value) if math.isfinite(value) else towards


@inline_kernel
def _damped(
    loop: Array, axis: int, error: float, speed: float, gains: LoopGains, dt: float
) -> float:
    """Proportional and derivative part [m/s^2] of the horizontal velocity loop, with its low passes."""
    loop[6 + axis] = _low_pass(loop[6 + axis], error, gains.error_s, dt)
    signal = loop[6 + axis] if gains.of_error else -speed
    slope = (signal - loop[8 + axis]) / dt if math.isfinite(loop[8 + axis]) else 0.0
    loop[8 + axis] = signal
    loop[10 + axis] = _low_pass(loop[10 + axis], slope, _DERIVATIVE_S, dt)
    return gains.velocity * loop[6 + axis] + gains.derivative * loop[10 + axis]


@inline_kernel
def _force_setpoint(
    nav: Array, loop: Array, target: Array, gains: LoopGains, plant: PlantConfig, dt: float
) -> Array:
    """Force (3,) [N, ENU] of the velocity loop, within the tilt limit."""
    velocity = _velocity_setpoint(nav, target, gains)
    force = np.zeros(3)
    for i in range(3):
        ahead = target[7 + i]
        pull = ahead if math.isfinite(ahead) else 0.0
        if math.isfinite(velocity[i]):
            error = velocity[i] - nav[7 + i]
            if i == 2:
                pull += gains.climb * error
            else:
                pull += _damped(loop, i, error, nav[7 + i], gains, dt)
                error = loop[6 + i]
            step = gains.climb_integral if i == 2 else gains.velocity_integral
            grown = loop[i] + step * error * dt
            loop[i] = min(max(grown, -_MOST_INTEGRAL), _MOST_INTEGRAL)
            pull += loop[i]
        elif i < 2:
            loop[8 + i] = math.nan
        force[i] = pull
    sideways = math.hypot(force[0], force[1])
    if sideways > gains.max_acceleration:
        force[0] *= gains.max_acceleration / sideways
        force[1] *= gains.max_acceleration / sideways
    force[2] = max(force[2] + plant.gravity, 0.3 * plant.gravity)
    most = force[2] * math.tan(gains.max_tilt)
    sideways = math.hypot(force[0], force[1])
    if sideways > most:
        force[0] *= most / sideways
        force[1] *= most / sideways
    for i in range(2):
        loop[12 + i] = _low_pass(loop[12 + i], force[i], gains.tilt_s, dt)
        force[i] = loop[12 + i]
    return force * plant.mass


@inline_kernel
def _advance_heading(nav: Array, loop: Array, target: Array, gains: LoopGains, dt: float) -> None:
    """Move the heading setpoint towards the commanded one, or with the commanded rate."""
    if math.isfinite(target[10]):
        most = gains.max_yaw_rate * dt
        loop[3] = wrap_angle(loop[3] + min(max(wrap_angle(target[10] - loop[3]), -most), most))
    elif math.isfinite(target[11]):
        loop[3] = wrap_angle(loop[3] + target[11] * dt)
        lead = wrap_angle(loop[3] - yaw_of(nav))
        loop[3] = wrap_angle(yaw_of(nav) + min(max(lead, -0.5), 0.5))


@inline_kernel
def _rate_setpoint(
    present: Matrix3, desired: Matrix3, target: Array, gains: LoopGains, tilt_gain: float
) -> Array:
    """Body rates (3,) [rad/s] that turn R to R_d, plus those commanded."""
    turn = attitude_error(present, desired)
    out = np.empty(3)
    for i in range(3):
        gain = gains.yaw_gain if i == 2 else tilt_gain
        most = gains.max_yaw_rate if i == 2 else gains.max_rate
        out[i] = min(max(gain * turn[i], -most), most)
        if math.isfinite(target[18 + i]):
            out[i] = min(max(out[i] + target[18 + i], -most), most)
    return out


@inline_kernel
def _attitude_thrust(
    nav: Array, loop: Array, target: Array, gains: LoopGains, plant: PlantConfig, dt: float
) -> float:
    """Thrust [N] with a commanded attitude: the commanded one, or what the climb rate needs at this tilt."""
    climb = target[21]
    if not math.isfinite(climb):
        return target[12] * plant.max_thrust
    error = climb - nav[9]
    grown = loop[2] + gains.climb_integral * error * dt
    loop[2] = min(max(grown, -_MOST_INTEGRAL), _MOST_INTEGRAL)
    upright = 1.0 - 2.0 * (nav[3] * nav[3] + nav[4] * nav[4])
    return plant.mass * (plant.gravity + gains.climb * error + loop[2]) / max(upright, 0.5)


@kernel
def _wrench(
    nav: Array, loop: Array, target: Array, gains: LoopGains, plant: PlantConfig, dt: float
) -> Array:
    """Thrust and torques (6,) for the target, from the estimated state."""
    out = np.zeros(6)
    kind = target[0]
    most = plant.max_thrust * min(max(target[13], 0.0), 1.0)
    present = rotation(nav, 3)
    rates = np.zeros(3)
    if kind == TRAJECTORY:
        _advance_heading(nav, loop, target, gains, dt)
        force = _force_setpoint(nav, loop, target, gains, plant, dt)
        out[2] = force[0] * present[0][2] + force[1] * present[1][2] + force[2] * present[2][2]
        tilt_gain = gains.path_tilt_gain if gains.path_tilt_gain > 0.0 else gains.tilt_gain
        rates = _rate_setpoint(present, desired_rotation(force, loop[3]), target, gains, tilt_gain)
    elif kind == ATTITUDE:
        out[2] = _attitude_thrust(nav, loop, target, gains, plant, dt)
        rates = _rate_setpoint(present, rotation(target, 14), target, gains, gains.tilt_gain)
    elif kind == RATES:
        out[2] = target[12] * plant.max_thrust
        for i in range(3):
            rates[i] = min(max(target[18 + i], -gains.max_rate), gains.max_rate)
    elif kind == IDLE:
        out[2] = _IDLE_SHARE * plant.max_thrust
    if kind != TRAJECTORY:
        loop[0:2] = 0.0
        loop[6:14] = math.nan
        loop[3] = yaw_of(nav)
        if not math.isfinite(target[21]):
            loop[2] = 0.0
    out[2] = min(max(out[2], 0.0), most)
    if kind >= TRAJECTORY:
        for i in range(3):
            out[3 + i] = plant.inertia[i] * _RATE_GAIN * (rates[i] - nav[10 + i])
    loop[5] = out[2] / plant.max_thrust
    return out


@inline_kernel
def _ground_contact(body: Array, loop: Array) -> None:
    """The ground at z = 0: a body below it is put on it, level and at rest."""
    if body[2] <= 0.0:
        half = 0.5 * math.atan2(
            2.0 * (body[3] * body[4] + body[6] * body[5]),
            1.0 - 2.0 * (body[4] * body[4] + body[5] * body[5]),
        )
        body[2:5] = 0.0
        body[5], body[6] = math.sin(half), math.cos(half)
        body[7], body[8], body[9] = 0.0, 0.0, max(body[9], 0.0)
        body[10:13] = 0.0
        loop[0:3] = 0.0
        loop[6:14] = math.nan
        loop[4] = 1.0
    elif body[2] > _LIFT_OFF_M:
        loop[4] = 0.0


class AirframeState(NamedTuple):
    """The state of one vehicle between periods; changed in place."""

    body: Array  # (17,) plant state of the quadrotor
    loop: Array  # (14,) state of the loops
    nav: Array  # (13,) estimate: local ENU position, quaternion x y z w, ENU velocity, FLU rates
    errors: Array  # (7,) of the estimate
    target: Array  # (22,)


@kernel
def fly(
    craft: AirframeState,
    gains: LoopGains,
    plants: Sequence[PlantConfig],
    t: float,
    dt: float,
    steps: int,
) -> None:
    """Advance a vehicle by `steps` periods dt [s] from t [s], in place; errors and target are held.

    `plants` is a list with the vehicle's plant: numba passes a list as one pointer.
    """
    plant = plants[0]
    body, nav = craft.body, craft.nav
    for n in range(steps):
        _estimate(body, craft.errors, nav)
        wrench = _wrench(nav, craft.loop, craft.target, gains, plant, dt)
        advance(body, wrench, t + n * dt, dt, 1, plant)
        _ground_contact(body, craft.loop)
    _estimate(body, craft.errors, nav)


def hover_share(plant: PlantConfig) -> float:
    """Share of the largest thrust that carries the weight."""
    return plant.mass * plant.gravity / plant.max_thrust
