"""The controller for a vehicle with one thrust along body z: the force part becomes thrust and attitude.

The law of (49) gives a world-frame force; its direction within the tilt limit, with the heading kept, is
the desired attitude; a geometric attitude error asks for body rates; the same law with tf3 closes the
body-rate loop (equations.md section 7).
"""

from __future__ import annotations

import math

import numpy as np

from ptnsbc_core.adaptation import observed
from ptnsbc_core.algebra import cross3, divided, minus, norm3, part, put, scaled
from ptnsbc_core.controller import (
    Command,
    Control,
    adapted,
    clip_torque,
    one_norm,
    sliding_term,
    torque_model,
    torque_regressor_error,
)
from ptnsbc_core.kernel import kernel, leaf
from ptnsbc_core.kinematics import rotation_from_quaternion, velocity_enu
from ptnsbc_core.timebase import Clock
from ptnsbc_core.types import Array, ControllerConfig

_BRAKING_SHARE = 0.5
"""Share of the torque that the rate reference counts on for braking; the rest is for the rate loop."""

_LEAST_LIFT = 0.3
"""Smallest vertical specific force, as a share of gravity: a quadrotor has to keep pulling up to steer."""


@leaf
def tilt_limited(force: Array, config: ControllerConfig) -> Array:
    """Force (3,) [N, ENU] within the tilt limit: the vertical part is kept, the horizontal one gives way."""
    out = force.copy()
    out[2] = max(force[2], _LEAST_LIFT * config.nominal[0] * config.gravity)
    most = out[2] * math.tan(config.max_tilt)
    horizontal = math.hypot(force[0], force[1])
    if horizontal > most:
        out[0] *= most / horizontal
        out[1] *= most / horizontal
    return out


@kernel
def desired_rotation(force: Array, yaw: float) -> Array:
    """R_d (3, 3): body z along the force (3,), body y square to it and to the heading [rad]."""
    up = divided(force, norm3(force))
    heading = np.zeros(3)
    heading[0], heading[1] = math.cos(yaw), math.sin(yaw)
    left = cross3(up, heading)
    left = divided(left, norm3(left))
    out = np.empty((3, 3))
    forward = cross3(left, up)
    for i in range(3):
        out[i, 0], out[i, 1], out[i, 2] = forward[i], left[i], up[i]
    return out


@kernel
def half_turn(relative: Array) -> Array:
    """Rotation vector (3,) of length pi [rad] of a rotation (3, 3) by half a turn: R = 2 a a^T - I."""
    longest = 0
    for i in range(1, 3):
        if relative[i, i] > relative[longest, longest]:
            longest = i
    axis = part(relative[:, longest], 0, 3)
    axis[longest] += 1.0
    return scaled(math.pi / norm3(axis), axis)


@kernel
def attitude_error(rotation: Array, desired: Array) -> Array:
    """Rotation vector (3,) [rad], body frame, from R to R_d (both (3, 3))."""
    trace = 0.0
    twist = np.zeros(3)
    relative = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                relative[i, j] += rotation[k, i] * desired[k, j]
    for i in range(3):
        trace += relative[i, i]
    twist[0] = relative[2, 1] - relative[1, 2]
    twist[1] = relative[0, 2] - relative[2, 0]
    twist[2] = relative[1, 0] - relative[0, 1]
    sine = 0.5 * norm3(twist)
    angle = math.atan2(sine, 0.5 * (trace - 1.0))
    if sine < 1e-9:
        if trace < 0.0:  # half a turn: the axis is in the symmetric part
            return half_turn(relative)
        return scaled(0.5, twist)
    return scaled(0.5 * angle / sine, twist)


@leaf
def rate_reference(turn: Array, max_rate: float, config: ControllerConfig) -> Array:
    """Body rates (3,) [rad/s] for an attitude error (3,) [rad], never faster than the torques can brake.

    A proportional law alone asks, after a large error, for a rate that the limited torque cannot stop in
    time; started tilted by 1 rad the vehicle then swings for ever.
    """
    out = np.empty(3)
    for i in range(3):
        gain = config.attitude_gain[1] if i == 2 else config.attitude_gain[0]
        braking = _BRAKING_SHARE * config.max_torque[i] / config.nominal[1 + i]
        most = min(max_rate, math.sqrt(2.0 * braking * abs(turn[i])))
        out[i] = min(max(gain * turn[i], -most), most)
    return out


@kernel
def quadrotor_control(
    own: Array,
    command: Command,
    parameters: Array,
    bound: Array,
    clock: Clock,
    config: ControllerConfig,
    observer: Array,
    max_rate: float,
) -> Control:
    """Thrust and torques from the odometry vector (13,): wrench (0, 0, T, torque) in body FLU."""
    rotation = rotation_from_quaternion(own[3:7])
    rates = part(own, 10, 3)
    velocity = velocity_enu(own)
    error = minus(velocity, command.velocity)
    observer = observed(observer, velocity, clock.start_t <= 0.0, clock.dt, config)
    model = command.acceleration.copy()
    model[2] += config.gravity
    feedback = sliding_term(error, config.force, bound[0], config.boundary[0], clock)
    wanted = np.empty(3)
    for i in range(3):
        wanted[i] = parameters[0] * model[i] + config.nominal[0] * (feedback[i] - observer[3 + i])
    force = tilt_limited(wanted, config)
    wrench = np.zeros(6)
    wrench[2] = min(norm3(force), config.max_thrust)
    saturated = norm3(minus(wanted, force)) > 0.0 or norm3(force) > config.max_thrust
    for i in range(3):  # what this command does to the velocity, along the thrust axis of now
        observer[6 + i] = rotation[i, 2] * wrench[2] / parameters[0]
    observer[8] -= config.gravity
    turn = attitude_error(rotation, desired_rotation(force, command.yaw))
    reference = rate_reference(turn, max_rate, config)
    rate_error = minus(rates, reference)
    still = np.zeros(3)
    turning = sliding_term(rate_error, config.torque, bound[1], config.boundary[1], clock)
    torque = torque_model(rates, reference, still, parameters[1:4])
    for i in range(3):
        wrench[3 + i] = torque[i] + config.nominal[1 + i] * turning[i]
    clipped = clip_torque(wrench, config)
    products = np.empty(4)
    products[0] = model[0] * error[0] + model[1] * error[1] + model[2] * error[2]
    put(products, 1, torque_regressor_error(rates, reference, still, rate_error))
    errors = np.empty(2)
    errors[0], errors[1] = one_norm(error), one_norm(rate_error)
    new_parameters, new_bound = adapted(
        parameters, bound, products, errors, saturated or clipped, clock.dt, config
    )
    return Control(wrench, new_parameters, new_bound, observer, saturated or clipped, norm3(error))
