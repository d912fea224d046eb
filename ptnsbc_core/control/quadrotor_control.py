"""The controller for a vehicle with one thrust along body z: the force part becomes thrust and attitude.

The law of (49) gives a world-frame force; its direction within the tilt limit, with the heading kept, is
the desired attitude; a geometric attitude error asks for body rates; the same law with tf3 closes the
body-rate loop (equations.md section 7).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ptnsbc_core.algebra import (
    cross3,
    divided,
    dot3,
    minus,
    norm3,
    plus,
    scaled,
    three,
    times,
    transpose_times,
)
from ptnsbc_core.control.adaptation import observed
from ptnsbc_core.control.rigid_body_control import (
    ControlInput,
    VelocityReference,
    axiswise,
    learned,
    limited_torque,
    one_norm,
    sliding_term,
    torque_model,
    torque_regressor_error,
)
from ptnsbc_core.kernel import kernel, leaf
from ptnsbc_core.kinematics import rotation
from ptnsbc_core.timebase import Clock
from ptnsbc_core.types import (
    AdaptationState,
    Array,
    ControllerConfig,
    DisturbanceObserver,
    InertialParameters,
    Matrix3,
    Triple,
    Vector3,
)

_BRAKING_SHARE = 0.5
"""Share of the torque that the rate reference counts on for braking; the rest is for the rate loop."""

_LEAST_LIFT = 0.3
"""Smallest vertical specific force, as a share of gravity: a quadrotor has to keep pulling up to steer."""


@leaf
def tilt_limited(force: Vector3, config: ControllerConfig) -> Vector3:
    """Force [N, ENU] within the tilt limit: the vertical part is kept, the horizontal one gives way."""
    lift = max(force[2], _LEAST_LIFT * config.nominal.mass * config.gravity)
    most = lift * math.tan(config.max_tilt)
    horizontal = math.hypot(force[0], force[1])
    share = most / horizontal if horizontal > most else 1.0
    return share * force[0], share * force[1], lift


@kernel
def desired_rotation(force: Triple, yaw: float) -> Matrix3:
    """R_d: body z along the force, body y square to it and to the heading [rad]."""
    up = divided(force, norm3(force))
    left = cross3(up, (math.cos(yaw), math.sin(yaw), 0.0))
    left = divided(left, norm3(left))
    forward = cross3(left, up)
    return (
        (forward[0], left[0], up[0]),
        (forward[1], left[1], up[1]),
        (forward[2], left[2], up[2]),
    )


@kernel
def half_turn(relative: Matrix3) -> Vector3:
    """Rotation vector of length pi [rad] of a rotation by half a turn: R = 2 a a^T - I."""
    first, second, third = relative
    if first[0] >= second[1] and first[0] >= third[2]:
        axis = (first[0] + 1.0, second[0], third[0])
    elif second[1] >= third[2]:
        axis = (first[1], second[1] + 1.0, third[1])
    else:
        axis = (first[2], second[2], third[2] + 1.0)
    return scaled(math.pi / norm3(axis), axis)


@leaf
def _transposed(m: Array | Matrix3) -> Matrix3:
    return (
        (m[0][0], m[1][0], m[2][0]),
        (m[0][1], m[1][1], m[2][1]),
        (m[0][2], m[1][2], m[2][2]),
    )


@kernel
def attitude_error(present: Array | Matrix3, desired: Array | Matrix3) -> Vector3:
    """Rotation vector [rad], body frame, from R to R_d (both (3, 3))."""
    columns = _transposed(desired)
    # R^T R_d, by columns of R_d
    x = transpose_times(present, columns[0])
    y = transpose_times(present, columns[1])
    z = transpose_times(present, columns[2])
    trace = x[0] + y[1] + z[2]
    twist = (y[2] - z[1], z[0] - x[2], x[1] - y[0])
    sine = 0.5 * norm3(twist)
    angle = math.atan2(sine, 0.5 * (trace - 1.0))
    if sine < 1e-9:
        if trace < 0.0:  # half a turn: the axis is in the symmetric part
            return half_turn(_transposed((x, y, z)))
        return scaled(0.5, twist)
    return scaled(0.5 * angle / sine, twist)


@leaf
def _rate_about(
    turn: float, gain: float, axis: int, max_rate: float, config: ControllerConfig
) -> float:
    braking = _BRAKING_SHARE * config.max_torque[axis] / config.nominal.inertia[axis]
    most = min(max_rate, math.sqrt(2.0 * braking * abs(turn)))
    return min(max(gain * turn, -most), most)


@leaf
def rate_reference(turn: Vector3, max_rate: float, config: ControllerConfig) -> Vector3:
    """Body rates [rad/s] for an attitude error [rad], never faster than the torques can brake.

    A proportional law alone asks, after a large error, for a rate that the limited torque cannot stop in
    time; started tilted by 1 rad the vehicle then swings for ever.
    """
    tilt, yaw = config.attitude_gain
    return (
        _rate_about(turn[0], tilt, 0, max_rate, config),
        _rate_about(turn[1], tilt, 1, max_rate, config),
        _rate_about(turn[2], yaw, 2, max_rate, config),
    )


class _Thrust(NamedTuple):
    """Thrust of one tick and the force it is to give."""

    force: Vector3  # [N, ENU] within the tilt limit
    thrust: float  # [N]
    saturated: bool


@leaf
def _thrust(wanted: Vector3, config: ControllerConfig) -> _Thrust:
    force = tilt_limited(wanted, config)
    length = norm3(force)
    cut = norm3(minus(wanted, force)) > 0.0 or length > config.max_thrust
    return _Thrust(force, min(length, config.max_thrust), cut)


@kernel
def quadrotor_control(
    own: Array,
    command: VelocityReference,
    before: AdaptationState,
    clock: Clock,
    config: ControllerConfig,
    max_rate: float,
) -> ControlInput:
    """Thrust and torques from the odometry vector (13,): force (0, 0, T) and torque in body FLU."""
    attitude = rotation(own, 3)
    rates = three(own, 10)
    velocity = times(attitude, three(own, 7))
    parameters, nominal, bound = before.parameters, config.nominal, before.bound
    error = minus(velocity, command.velocity)
    seen = observed(before.observer, velocity, clock.start_t <= 0.0, clock.dt, config)
    model = plus(command.acceleration, (0.0, 0.0, config.gravity))
    feedback = sliding_term(error, config.force, bound[0], config.boundary[0], clock)
    asked = scaled(nominal.mass, minus(feedback, seen.disturbance))
    lift = _thrust(plus(scaled(parameters.mass, model), asked), config)
    # what this command does to the velocity, along the thrust axis of now
    up = (attitude[0][2], attitude[1][2], attitude[2][2])
    given = divided(scaled(lift.thrust, up), parameters.mass)
    given = minus(given, (0.0, 0.0, config.gravity))
    turn = attitude_error(attitude, desired_rotation(lift.force, command.yaw))
    reference = rate_reference(turn, max_rate, config)
    rate_error = minus(rates, reference)
    still = (0.0, 0.0, 0.0)
    turning = sliding_term(rate_error, config.torque, bound[1], config.boundary[1], clock)
    modelled = torque_model(rates, reference, still, parameters.inertia)
    torque = limited_torque(plus(modelled, axiswise(nominal.inertia, turning)), config)
    saturated = lift.saturated or torque.saturated
    product = InertialParameters(
        dot3(model, error), torque_regressor_error(rates, reference, still, rate_error)
    )
    errors = (one_norm(error), one_norm(rate_error))
    observer = DisturbanceObserver(seen.velocity, seen.disturbance, given, seen.trend)
    after = learned(before, observer, product, errors, saturated, clock.dt, config)
    return ControlInput((0.0, 0.0, lift.thrust), torque.value, after, saturated, norm3(error))
