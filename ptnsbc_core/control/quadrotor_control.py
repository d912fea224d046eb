"""The controller for a vehicle with one thrust along body z: the force part becomes thrust and attitude.

    f = m_hat (a_r + g e_z - G v~ - delta_hat sat(v~ / width) - d_hat),  T = |f| within the tilt limit
    R_d: body z along f, the heading kept;  w_r = gains log(R^T R_d), as far as the torques can brake
    tau = -(I_hat w) x w_r + I_0 (-G w~ - delta_hat sat(w~ / width)),  w~ = w - w_r

v~ = v - v_r is in the world frame, w~ in the body frame. Force part and rate loop are those of (49), docs/method.md,
but for the mass before the feedback: m_0 would give a light vehicle the gain G m_0 / m, too much for its attitude.
"""

from __future__ import annotations

import math

from ptnsbc_core.algebra import (
    add3,
    cross3,
    div3,
    dot3,
    hadamard3,
    load3,
    matvec,
    matvec_transposed,
    norm1,
    norm3,
    scale3,
    sub3,
    transpose,
)
from ptnsbc_core.control.rigid_body_control import (
    ControlInput,
    VelocityReference,
    adaptation_step,
    observer_step,
    saturate_torque,
    sliding_term,
    torque_model,
    torque_regressor_error,
)
from ptnsbc_core.kernel import formula, inline_kernel, kernel
from ptnsbc_core.kinematics import rotation
from ptnsbc_core.timebase import Clock, homing_speed
from ptnsbc_core.types import (
    AdaptationState,
    Array,
    ControllerConfig,
    DisturbanceObserver,
    InertialParameters,
    Matrix3,
    OdometryLike,
    Vector3,
    Vector3Like,
)

_BRAKING_FRACTION = 0.5
"""Fraction of the torque that the rate reference may use for braking. It has to be below 1 / (1 + gain T): the rate is
late by the lag T of its loop, so it is too large by the braking times T where the reference becomes proportional."""

MIN_LIFT_FRACTION = 0.3
"""Least vertical specific force, as a fraction of gravity: without thrust a quadrotor cannot steer."""


@inline_kernel
def limit_tilt(force: Vector3, config: ControllerConfig) -> Vector3:
    """Force [N, ENU] within the tilt limit: the horizontal part is reduced, the vertical part is kept."""
    lift = max(force[2], MIN_LIFT_FRACTION * config.nominal.mass * config.gravity)
    limit = lift * math.tan(config.max_tilt)
    horizontal = math.hypot(force[0], force[1])
    scale = limit / horizontal if horizontal > limit else 1.0
    return scale * force[0], scale * force[1], lift


@formula
def desired_rotation(force: Vector3Like, yaw: float) -> Matrix3:
    """R_d: body z along the force, body y perpendicular to it and to the heading [rad]."""
    up = div3(force, norm3(force))
    left = cross3(up, (math.cos(yaw), math.sin(yaw), 0.0))
    left = div3(left, norm3(left))
    forward = cross3(left, up)
    return (
        (forward[0], left[0], up[0]),
        (forward[1], left[1], up[1]),
        (forward[2], left[2], up[2]),
    )


@kernel
def half_turn_vector(relative: Matrix3) -> Vector3:
    """Rotation vector of length pi [rad] of a rotation by half a turn: R = 2 a a^T - I."""
    first, second, third = relative
    if first[0] >= second[1] and first[0] >= third[2]:
        axis = (first[0] + 1.0, second[0], third[0])
    elif second[1] >= third[2]:
        axis = (first[1], second[1] + 1.0, third[1])
    else:
        axis = (first[2], second[2], third[2] + 1.0)
    return scale3(math.pi / norm3(axis), axis)


@inline_kernel
def attitude_error(present: Array | Matrix3, desired: Array | Matrix3) -> Vector3:
    """Rotation vector [rad], body frame, from R to R_d (both (3, 3))."""
    columns = transpose(desired)
    # R^T R_d, by columns of R_d
    x = matvec_transposed(present, columns[0])
    y = matvec_transposed(present, columns[1])
    z = matvec_transposed(present, columns[2])
    trace = x[0] + y[1] + z[2]
    twist = (y[2] - z[1], z[0] - x[2], x[1] - y[0])
    sine = 0.5 * norm3(twist)
    angle = math.atan2(sine, 0.5 * (trace - 1.0))
    if sine < 1e-9:
        if trace < 0.0:  # half a turn: the axis is in the symmetric part
            return half_turn_vector(transpose((x, y, z)))
        return scale3(0.5, twist)
    return scale3(0.5 * angle / sine, twist)


@inline_kernel
def _axis_rate(
    error: float, gain: float, axis: int, max_rate: float, config: ControllerConfig
) -> float:
    heaviest = (1.0 + config.mass_range) * config.nominal.inertia[axis]
    braking = _BRAKING_FRACTION * config.max_torque[axis] / heaviest
    return math.copysign(min(max_rate, homing_speed(abs(error), gain, braking)), error)


@inline_kernel
def rate_reference(error: Vector3, max_rate: float, config: ControllerConfig) -> Vector3:
    """w_r = min(homing_speed(|e|), max_rate) sign(e) [rad/s] of each axis, e [rad] the attitude error.

    It comes to rest with the braking b [rad/s^2] that a fraction of the largest torque gives the heaviest inertia
    which the adaptation admits. A law that asks for more than the torque can brake lets a vehicle that starts with a
    tilt of 1 rad oscillate for ever.
    """
    tilt, yaw = config.attitude_gain
    return (
        _axis_rate(error[0], tilt, 0, max_rate, config),
        _axis_rate(error[1], tilt, 1, max_rate, config),
        _axis_rate(error[2], yaw, 2, max_rate, config),
    )


@kernel
def quadrotor_control(
    own: OdometryLike,
    command: VelocityReference,
    before: AdaptationState,
    clock: Clock,
    config: ControllerConfig,
    max_rate: float,
) -> ControlInput:
    """Thrust and torques from the odometry vector (13,): force (0, 0, T) and torque in body FLU."""
    attitude = rotation(own, 3)
    rates = load3(own, 10)
    velocity = matvec(attitude, load3(own, 7))
    parameters, nominal, bound = before.parameters, config.nominal, before.bound
    error = sub3(velocity, command.velocity)
    observer = observer_step(before.observer, velocity, clock.start_t <= 0.0, clock.dt, config)
    model = add3(command.acceleration, (0.0, 0.0, config.gravity))
    feedback = sliding_term(error, config.force, bound[0], config.boundary[0], clock)
    wanted = add3(model, sub3(feedback, observer.disturbance))
    desired = scale3(parameters.mass, wanted)
    force = limit_tilt(desired, config)
    thrust = min(norm3(force), config.max_thrust)
    cut = norm3(sub3(desired, force)) > 0.0 or norm3(force) > config.max_thrust
    # the acceleration that this command gives, along the present thrust axis
    up = (attitude[0][2], attitude[1][2], attitude[2][2])
    acceleration = div3(scale3(thrust, up), parameters.mass)
    acceleration = sub3(acceleration, (0.0, 0.0, config.gravity))
    rotation_error = attitude_error(attitude, desired_rotation(force, command.yaw))
    reference = rate_reference(rotation_error, max_rate, config)
    rate_error = sub3(rates, reference)
    zero = (0.0, 0.0, 0.0)
    rate_feedback = sliding_term(rate_error, config.torque, bound[1], config.boundary[1], clock)
    rate_model = torque_model(rates, reference, zero, parameters.inertia)
    torque = saturate_torque(add3(rate_model, hadamard3(nominal.inertia, rate_feedback)), config)
    product = InertialParameters(
        dot3(model, error), torque_regressor_error(rates, reference, zero, rate_error)
    )
    errors, cuts = (norm1(error), norm1(rate_error)), (cut, torque.saturated)
    predicted = DisturbanceObserver(
        observer.velocity, observer.disturbance, acceleration, observer.trend
    )
    after = adaptation_step(before, predicted, product, errors, *cuts, clock.dt, config)
    saturated = cut or torque.saturated
    return ControlInput((0.0, 0.0, thrust), torque.value, after, saturated, norm3(error))
