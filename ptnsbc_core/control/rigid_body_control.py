"""Time-base-generator sliding-mode controller (49)-(52), equations.md section 7, for a body with six inputs.

tau = Y Psi_hat - Omega_0 (G V~ + delta_hat sat(V~ / width)), V~ = V - V_r, with Y Psi = Omega V_r_dot +
C V_r - G. All quantities in the body frame FLU; V = [v; w] [m/s, rad/s], tau = [force; torque] [N, N m].
"""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.algebra import (
    cross3,
    dot3,
    minus,
    moved,
    norm3,
    plus,
    saturation,
    scaled,
    three,
    transpose_times,
)
from ptnsbc_core.control.adaptation import adapted_bound, adapted_parameters
from ptnsbc_core.kernel import kernel, leaf
from ptnsbc_core.kinematics import rotation
from ptnsbc_core.timebase import Clock, loop_gain
from ptnsbc_core.types import (
    AdaptationState,
    Array,
    ControllerConfig,
    DisturbanceObserver,
    InertialParameters,
    LoopGain,
    Pair,
    Vector3,
)


class VelocityReference(NamedTuple):
    """Filtered reference of one tick."""

    velocity: Vector3  # [m/s, ENU]
    acceleration: Vector3  # [m/s^2, ENU]
    rates: Vector3  # [rad/s, FLU]
    rates_dot: Vector3  # [rad/s^2, FLU]
    yaw: float  # [rad] desired, for plants that are steered by attitude


class ControlInput(NamedTuple):
    """Input of one tick, body FLU, and what has been learned after it."""

    force: Vector3  # [N]
    torque: Vector3  # [N m]
    adapted: AdaptationState
    saturated: bool
    velocity_error: float  # [m/s]


class LimitedInput(NamedTuple):
    """A force or torque within its limits, and whether it was outside."""

    value: Vector3
    saturated: bool


@leaf
def sliding_term(
    error: Vector3, gain: LoopGain, bound: float, width: float, clock: Clock
) -> Vector3:
    """Specific feedback [m/s^2] or [rad/s^2]: -(Xi_3 + kappa) V~ - delta_hat sat(V~ / width)."""
    rate = loop_gain(gain, clock)
    return (
        -rate * error[0] - bound * saturation(error[0], width),
        -rate * error[1] - bound * saturation(error[1], width),
        -rate * error[2] - bound * saturation(error[2], width),
    )


@leaf
def axiswise(a: Vector3, b: Vector3) -> Vector3:
    """Products of each axis."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@leaf
def torque_model(
    rates: Vector3, reference: Vector3, reference_dot: Vector3, inertia: Vector3
) -> Vector3:
    """I w_r_dot - S(I w) w_r [N m]: the rotational rows of Omega V_r_dot + C V_r."""
    turning = cross3(axiswise(inertia, rates), reference)
    return minus(axiswise(inertia, reference_dot), turning)


@leaf
def _inertia_share(
    i: int, rates: Vector3, reference: Vector3, reference_dot: Vector3, error: Vector3
) -> float:
    j, k = (i + 1) % 3, (i + 2) % 3
    turning = reference[k] * error[j] - reference[j] * error[k]
    return reference_dot[i] * error[i] + rates[i] * turning


@leaf
def torque_regressor_error(
    rates: Vector3, reference: Vector3, reference_dot: Vector3, error: Vector3
) -> Vector3:
    """Y^T V~ of the inertia columns: derivative of torque_model . error with respect to each inertia."""
    return (
        _inertia_share(0, rates, reference, reference_dot, error),
        _inertia_share(1, rates, reference, reference_dot, error),
        _inertia_share(2, rates, reference, reference_dot, error),
    )


@leaf
def one_norm(v: Vector3) -> float:
    """|v|_1."""
    return abs(v[0]) + abs(v[1]) + abs(v[2])


@leaf
def learned(
    before: AdaptationState,
    observer: DisturbanceObserver,
    product: InertialParameters,
    errors: Pair,
    frozen: bool,
    dt: float,
    config: ControllerConfig,
) -> AdaptationState:
    """Psi_hat and delta_hat after one step, from Y^T V~ and |V~|_1 of both parts; as they were when `frozen`.

    An actuator at its limit says nothing about the parameters.
    """
    if frozen:
        return AdaptationState(before.parameters, before.bound, observer)
    bound = (
        adapted_bound(before.bound[0], errors[0], 0, dt, config),
        adapted_bound(before.bound[1], errors[1], 1, dt, config),
    )
    return AdaptationState(
        adapted_parameters(before.parameters, product, dt, config), bound, observer
    )


@kernel
def rigid_body_control(
    own: Array,
    command: VelocityReference,
    before: AdaptationState,
    clock: Clock,
    config: ControllerConfig,
) -> ControlInput:
    """Wrench of the plant `rigid_body_6dof` from its odometry vector (13,) and the filtered command."""
    r = rotation(own, 3)
    rates = three(own, 10)
    parameters, nominal = before.parameters, config.nominal
    reference = transpose_times(r, command.velocity)
    reference_dot = minus(transpose_times(r, command.acceleration), cross3(rates, reference))
    error = minus(three(own, 7), reference)
    rate_error = minus(rates, command.rates)
    # m (v_r_dot + w x v_r + g R^T e3): the translational rows of Y Psi, per kilogram
    model = moved(plus(reference_dot, cross3(rates, reference)), config.gravity, r[2])
    feedback = sliding_term(error, config.force, before.bound[0], config.boundary[0], clock)
    turning = sliding_term(rate_error, config.torque, before.bound[1], config.boundary[1], clock)
    modelled = torque_model(rates, command.rates, command.rates_dot, parameters.inertia)
    force = limited_force(moved(scaled(parameters.mass, model), nominal.mass, feedback), config)
    torque = limited_torque(plus(modelled, axiswise(nominal.inertia, turning)), config)
    saturated = force.saturated or torque.saturated
    product = InertialParameters(
        dot3(model, error),
        torque_regressor_error(rates, command.rates, command.rates_dot, rate_error),
    )
    errors = (one_norm(error), one_norm(rate_error))
    after = learned(before, before.observer, product, errors, saturated, clock.dt, config)
    return ControlInput(force.value, torque.value, after, saturated, norm3(error))


@leaf
def limited_force(force: Vector3, config: ControllerConfig) -> LimitedInput:
    """Force within the actuators' limit, its direction kept."""
    length = norm3(force)
    if length > config.max_thrust:
        return LimitedInput(scaled(config.max_thrust / length, force), True)
    return LimitedInput(force, False)


@leaf
def limited_torque(torque: Vector3, config: ControllerConfig) -> LimitedInput:
    """Torque within the limit of each axis."""
    most = config.max_torque
    value = (
        min(max(torque[0], -most[0]), most[0]),
        min(max(torque[1], -most[1]), most[1]),
        min(max(torque[2], -most[2]), most[2]),
    )
    return LimitedInput(value, norm3(minus(torque, value)) > 0.0)
