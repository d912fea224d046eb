"""Time-base-generator sliding-mode controller (49)-(52), equations.md section 7, for a body with six inputs.

tau = Y Psi_hat - Omega_0 (G V~ + delta_hat sat(V~ / width)), V~ = V - V_r, with Y Psi = Omega V_r_dot +
C V_r - G. All quantities in the body frame FLU; V = [v; w] [m/s, rad/s], tau = [force; torque] [N, N m].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptnsbc_core.adaptation import adapted_bound, adapted_parameters
from ptnsbc_core.algebra import (
    cross3,
    minus,
    moved,
    norm3,
    part,
    plus,
    put,
    saturation,
    transpose_times,
)
from ptnsbc_core.kernel import kernel, leaf
from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.timebase import Clock, loop_gain
from ptnsbc_core.types import Array, ControllerConfig, LoopGain


class Command(NamedTuple):
    """Filtered reference of one tick."""

    velocity: Array  # (3,) [m/s, ENU]
    acceleration: Array  # (3,) [m/s^2, ENU]
    rates: Array  # (3,) [rad/s, FLU]
    rates_dot: Array  # (3,) [rad/s^2, FLU]
    yaw: float  # [rad] desired, for plants that are steered by attitude


class Control(NamedTuple):
    """Input of one tick and the adapted quantities after it."""

    wrench: Array  # (6,) [N, N m] body FLU
    parameters: Array  # (4,)
    bound: Array  # (2,)
    observer: Array  # (12,)
    saturated: bool
    velocity_error: float  # [m/s]


@leaf
def sliding_term(error: Array, gain: LoopGain, bound: float, width: float, clock: Clock) -> Array:
    """Specific feedback (3,) [m/s^2] or [rad/s^2]: -(Xi_3 + kappa) V~ - delta_hat sat(V~ / width)."""
    rate = loop_gain(gain, clock)
    out = np.empty(3)
    for i in range(3):
        out[i] = -rate * error[i] - bound * saturation(error[i], width)
    return out


@leaf
def torque_model(rates: Array, reference: Array, reference_dot: Array, inertia: Array) -> Array:
    """I w_r_dot - S(I w) w_r (3,) [N m]: the rotational rows of Omega V_r_dot + C V_r."""
    momentum = np.empty(3)
    for i in range(3):
        momentum[i] = inertia[i] * rates[i]
    out = cross3(momentum, reference)
    for i in range(3):
        out[i] = inertia[i] * reference_dot[i] - out[i]
    return out


@leaf
def torque_regressor_error(
    rates: Array, reference: Array, reference_dot: Array, error: Array
) -> Array:
    """(3,) Y^T V~ of the inertia columns: derivative of torque_model . error with respect to each inertia."""
    out = np.empty(3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        turning = reference[k] * error[j] - reference[j] * error[k]
        out[i] = reference_dot[i] * error[i] + rates[i] * turning
    return out


@leaf
def one_norm(v: Array) -> float:
    """|v|_1 of a (3,) vector."""
    return abs(v[0]) + abs(v[1]) + abs(v[2])


@kernel
def adapted(
    parameters: Array,
    bound: Array,
    products: Array,
    errors: Array,
    frozen: bool,
    dt: float,
    config: ControllerConfig,
) -> tuple[Array, Array]:
    """Psi_hat (4,) and delta_hat (2,) after one step; products (4,) Y^T V~, errors (2,) |V~|_1 of both parts."""
    new_bound = bound.copy()
    if not frozen:
        for which in range(2):
            new_bound[which] = adapted_bound(bound[which], errors[which], which, dt, config)
    return adapted_parameters(parameters, products, frozen, dt, config), new_bound


@kernel
def rigid_body_control(
    own: Array,
    command: Command,
    parameters: Array,
    bound: Array,
    clock: Clock,
    config: ControllerConfig,
    observer: Array,
) -> Control:
    """Wrench of the plant `rigid_body_6dof` from its odometry vector (13,) and the filtered command."""
    r = rotation_from_quaternion(own[3:7])
    rates = part(own, 10, 3)
    reference = transpose_times(r, command.velocity)
    reference_dot = minus(transpose_times(r, command.acceleration), cross3(rates, reference))
    error = minus(own[7:10], reference)
    rate_error = minus(rates, command.rates)
    # m (v_r_dot + w x v_r + g R^T e3): the translational rows of Y Psi, per kilogram
    model = moved(plus(reference_dot, cross3(rates, reference)), config.gravity, r[2])
    feedback = sliding_term(error, config.force, bound[0], config.boundary[0], clock)
    turning = sliding_term(rate_error, config.torque, bound[1], config.boundary[1], clock)
    torque = torque_model(rates, command.rates, command.rates_dot, parameters[1:4])
    wrench = np.empty(6)
    products = np.empty(4)
    products[0] = model[0] * error[0] + model[1] * error[1] + model[2] * error[2]
    shares = torque_regressor_error(rates, command.rates, command.rates_dot, rate_error)
    put(products, 1, shares)
    errors = np.empty(2)
    errors[0], errors[1] = one_norm(error), one_norm(rate_error)
    for i in range(3):
        wrench[i] = parameters[0] * model[i] + config.nominal[0] * feedback[i]
        wrench[3 + i] = torque[i] + config.nominal[1 + i] * turning[i]
    saturated = limit_wrench(wrench, config)
    new_parameters, new_bound = adapted(
        parameters, bound, products, errors, saturated, clock.dt, config
    )
    return Control(wrench, new_parameters, new_bound, observer.copy(), saturated, norm3(error))


@kernel
def limit_wrench(wrench: Array, config: ControllerConfig) -> bool:
    """Clip the wrench (6,) in place to the actuators' limits; whether it was clipped."""
    force = norm3(wrench[0:3])
    saturated = force > config.max_thrust
    if saturated:
        for i in range(3):
            wrench[i] *= config.max_thrust / force
    return clip_torque(wrench, config) or saturated


@kernel
def clip_torque(wrench: Array, config: ControllerConfig) -> bool:
    """Clip the torque rows of a wrench (6,) in place; whether one was clipped."""
    clipped = False
    for i in range(3):
        limit = config.max_torque[i]
        if abs(wrench[3 + i]) > limit:
            wrench[3 + i] = limit if wrench[3 + i] > 0.0 else -limit
            clipped = True
    return clipped
