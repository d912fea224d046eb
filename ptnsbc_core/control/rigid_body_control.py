"""Time-base-generator sliding-mode controller (49)-(52), docs/method.md, for a body with six inputs.

tau = Y Psi_hat - Omega_0 (G V~ + delta_hat sat(V~ / width)), V~ = V - V_r, with Y Psi = Omega V_r_dot +
C V_r - G_g. G is the gain of timebase.py, and G_g the wrench of gravity. All quantities in the body frame FLU;
V = [v; w] [m/s, rad/s], tau = [force; torque] [N, N m].

Before it stands the command filter: first order with limited acceleration. Its rate is the V_r_dot of (49), which would
otherwise be impulsive whenever a task is switched.
"""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.algebra import (
    add3,
    axpy,
    cross3,
    dot3,
    hadamard3,
    load3,
    matvec_transposed,
    norm1,
    norm3,
    saturation,
    scale3,
    sub3,
)
from ptnsbc_core.kernel import formula, inline_kernel, kernel
from ptnsbc_core.kinematics import rotation
from ptnsbc_core.timebase import Clock, loop_gain
from ptnsbc_core.types import (
    AdaptationState,
    ControllerConfig,
    DisturbanceObserver,
    InertialParameters,
    LoopGain,
    OdometryLike,
    Vector2,
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
    """Control input of one tick, body FLU, and the adaptation after it."""

    force: Vector3  # [N]
    torque: Vector3  # [N m]
    adapted: AdaptationState
    saturated: bool
    velocity_error: float  # [m/s]


class SaturatedInput(NamedTuple):
    """A force or torque within its limits, and whether it was outside."""

    value: Vector3
    saturated: bool


class FilterOutput(NamedTuple):
    """Reference after one step, its rate during the step, and whether the rate limit acted."""

    value: Vector3  # [m/s] or [rad/s]
    rate: Vector3  # [m/s^2] or [rad/s^2]
    saturated: bool


@inline_kernel
def filter_step(
    state: Vector3,
    target: Vector3,
    lead: Vector3,
    bandwidth: float,
    limit: float,
    dt: float,
) -> FilterOutput:
    """x_dot = lead + bandwidth (target - x), |x_dot| <= limit; `state` x (3,), `target` (3,), `bandwidth` [1/s].

    `lead` (3,) is the rate of the target. A target that moves at a known rate is followed without the lag
    rate / bandwidth of the filter alone.
    """
    gain = min(bandwidth, 1.0 / dt)
    rate = axpy(gain, sub3(target, state), lead)
    length = norm3(rate)
    saturated = length > limit
    if saturated:
        rate = scale3(limit / length, rate)
    return FilterOutput(axpy(dt, rate, state), rate, saturated)


@inline_kernel
def sliding_term(
    error: Vector3, gain: LoopGain, bound: float, width: float, clock: Clock
) -> Vector3:
    """Specific feedback [m/s^2] or [rad/s^2]: -G V~ - delta_hat sat(V~ / width), G of timebase.py."""
    rate = loop_gain(gain, clock)
    return (
        -rate * error[0] - bound * saturation(error[0], width),
        -rate * error[1] - bound * saturation(error[1], width),
        -rate * error[2] - bound * saturation(error[2], width),
    )


@formula
def torque_model(
    rates: Vector3, reference: Vector3, reference_dot: Vector3, inertia: Vector3
) -> Vector3:
    """I w_r_dot - S(I w) w_r [N m]: the rotational rows of Omega V_r_dot + C V_r."""
    coriolis = cross3(hadamard3(inertia, rates), reference)
    return sub3(hadamard3(inertia, reference_dot), coriolis)


@formula
def _inertia_regressor_error(
    i: int, rates: Vector3, reference: Vector3, reference_dot: Vector3, error: Vector3
) -> float:
    j, k = (i + 1) % 3, (i + 2) % 3
    coriolis = reference[k] * error[j] - reference[j] * error[k]
    return reference_dot[i] * error[i] + rates[i] * coriolis


@formula
def torque_regressor_error(
    rates: Vector3, reference: Vector3, reference_dot: Vector3, error: Vector3
) -> Vector3:
    """Y^T V~ of the inertia columns: derivative of torque_model . error with respect to each inertia."""
    return (
        _inertia_regressor_error(0, rates, reference, reference_dot, error),
        _inertia_regressor_error(1, rates, reference, reference_dot, error),
        _inertia_regressor_error(2, rates, reference, reference_dot, error),
    )


@inline_kernel
def _adapt(
    value: float, nominal: float, gain: float, product: float, dt: float, fraction: float
) -> float:
    span = fraction * nominal
    return min(max(value - dt * gain * product, nominal - span), nominal + span)


@inline_kernel
def adapt_parameters(
    parameters: InertialParameters, product: InertialParameters, dt: float, config: ControllerConfig
) -> InertialParameters:
    """Psi_hat after one step of Psi_dot = -Gamma^-1 Y^T V~, (50), kept within mass_range of nominal.

    `product` is Y^T V~ of each parameter.
    """
    nominal, fraction = config.nominal, config.mass_range
    linear, angular = config.adaptation
    inertia, angular_product = parameters.inertia, product.inertia
    return InertialParameters(
        _adapt(parameters.mass, nominal.mass, linear, product.mass, dt, fraction),
        (
            _adapt(inertia[0], nominal.inertia[0], angular, angular_product[0], dt, fraction),
            _adapt(inertia[1], nominal.inertia[1], angular, angular_product[1], dt, fraction),
            _adapt(inertia[2], nominal.inertia[2], angular, angular_product[2], dt, fraction),
        ),
    )


@inline_kernel
def adapt_bound(
    bound: float, error_norm: float, axis: int, dt: float, config: ControllerConfig
) -> float:
    """delta_hat [m/s^2] or [rad/s^2] of force (axis 0) or torque (1) after one step of (51).

    delta_dot = Upsilon^-1 |V~|_1 - leak delta, with a dead zone of |V~|_1 and a cap; as printed it grows for ever.
    """
    growth = 0.0
    if error_norm > config.bound_dead_zone[axis]:
        growth = config.bound_rate * error_norm
    return min(bound + dt * (growth - config.bound_leak * bound), config.bound_cap[axis])


@formula
def initial_observer(velocity: Vector3) -> DisturbanceObserver:
    """Observer at a velocity [m/s, ENU], with a disturbance of zero."""
    zero = (0.0, 0.0, 0.0)
    return DisturbanceObserver(velocity, zero, zero, zero)


@inline_kernel
def _observer_step_axis(
    axis: int,
    observer: DisturbanceObserver,
    velocity: float,
    frozen: bool,
    dt: float,
    config: ControllerConfig,
) -> Vector3:
    """Velocity, disturbance and trend of one axis after the measurement."""
    pole, cap = config.observer_bandwidth, config.bound_cap[0]
    disturbance, trend = observer.disturbance[axis], observer.trend[axis]
    predicted = observer.velocity[axis] + dt * (observer.acceleration[axis] + disturbance)
    innovation = velocity - predicted
    corrected = predicted + 3.0 * pole * dt * innovation
    if frozen:
        return corrected, disturbance, trend
    integrated = disturbance + dt * (trend + 3.0 * pole * pole * innovation)
    limited = min(max(integrated, -cap), cap)
    if integrated != limited:
        return corrected, limited, 0.0  # at the cap the trend would wind up
    return corrected, limited, trend + dt * pole * pole * pole * innovation


@inline_kernel
def observer_step(
    observer: DisturbanceObserver,
    velocity: Vector3,
    frozen: bool,
    dt: float,
    config: ControllerConfig,
) -> DisturbanceObserver:
    """Disturbance observer after one measurement of the velocity v [m/s, ENU], with e = v - v_hat and the pole p.

    v_hat_dot = a + d + 3 p e,  d_dot = w + 3 p^2 e,  w_dot = p^3 e        (a: the acceleration by the model)

    Not in the paper. The thrust of a quadrotor follows the attitude, so the loop cannot have the gain that keeps
    delta_hat sat() small in (49). The observer compares the measured velocity with the effect that the last
    command should have had, and feeds the difference forward. It models a disturbance that changes steadily, so
    gusts and oscillations of about 1 rad/s leave a lag of second order only. All three poles are at
    `observer_bandwidth` (as dt goes to 0).
    """
    x = _observer_step_axis(0, observer, velocity[0], frozen, dt, config)
    y = _observer_step_axis(1, observer, velocity[1], frozen, dt, config)
    z = _observer_step_axis(2, observer, velocity[2], frozen, dt, config)
    return DisturbanceObserver(
        (x[0], y[0], z[0]), (x[1], y[1], z[1]), observer.acceleration, (x[2], y[2], z[2])
    )


@inline_kernel
def adaptation_step(
    before: AdaptationState,
    observer: DisturbanceObserver,
    product: InertialParameters,
    errors: Vector2,
    force_cut: bool,
    torque_cut: bool,
    dt: float,
    config: ControllerConfig,
) -> AdaptationState:
    """Psi_hat and delta_hat after one step, from Y^T V~ and |V~|_1 of both parts.

    They are frozen while an actuator is at its limit, because the error then tells nothing about them. Only the mass
    goes on while it is the torque: a vehicle whose wrong mass makes it swing would never learn it.
    """
    parameters = adapt_parameters(before.parameters, product, dt, config)
    if force_cut or torque_cut:
        mass = before.parameters.mass if force_cut else parameters.mass
        kept = InertialParameters(mass, before.parameters.inertia)
        return AdaptationState(kept, before.bound, observer)
    bound = (
        adapt_bound(before.bound[0], errors[0], 0, dt, config),
        adapt_bound(before.bound[1], errors[1], 1, dt, config),
    )
    return AdaptationState(parameters, bound, observer)


@kernel
def rigid_body_control(
    own: OdometryLike,
    command: VelocityReference,
    before: AdaptationState,
    clock: Clock,
    config: ControllerConfig,
) -> ControlInput:
    """Wrench of the plant `rigid_body_6dof` from its odometry vector (13,) and the filtered command."""
    r = rotation(own, 3)
    rates = load3(own, 10)
    parameters, nominal = before.parameters, config.nominal
    reference = matvec_transposed(r, command.velocity)
    reference_dot = sub3(matvec_transposed(r, command.acceleration), cross3(rates, reference))
    error = sub3(load3(own, 7), reference)
    rate_error = sub3(rates, command.rates)
    # v_r_dot + w x v_r + g R^T e3: the translational rows of Y Psi over the mass
    model = axpy(config.gravity, r[2], add3(reference_dot, cross3(rates, reference)))
    feedback = sliding_term(error, config.force, before.bound[0], config.boundary[0], clock)
    rate_feedback = sliding_term(
        rate_error, config.torque, before.bound[1], config.boundary[1], clock
    )
    rate_model = torque_model(rates, command.rates, command.rates_dot, parameters.inertia)
    force = saturate_force(axpy(nominal.mass, feedback, scale3(parameters.mass, model)), config)
    torque = saturate_torque(add3(rate_model, hadamard3(nominal.inertia, rate_feedback)), config)
    product = InertialParameters(
        dot3(model, error),
        torque_regressor_error(rates, command.rates, command.rates_dot, rate_error),
    )
    errors = (norm1(error), norm1(rate_error))
    cuts = force.saturated, torque.saturated
    after = adaptation_step(before, before.observer, product, errors, *cuts, clock.dt, config)
    saturated = force.saturated or torque.saturated
    return ControlInput(force.value, torque.value, after, saturated, norm3(error))


@inline_kernel
def saturate_force(force: Vector3, config: ControllerConfig) -> SaturatedInput:
    """Force within the actuators' limit, in the same direction."""
    length = norm3(force)
    if length > config.max_thrust:
        return SaturatedInput(scale3(config.max_thrust / length, force), True)
    return SaturatedInput(force, False)


@inline_kernel
def saturate_torque(torque: Vector3, config: ControllerConfig) -> SaturatedInput:
    """Torque within the limit of each axis."""
    limit = config.max_torque
    value = (
        min(max(torque[0], -limit[0]), limit[0]),
        min(max(torque[1], -limit[1]), limit[1]),
        min(max(torque[2], -limit[2]), limit[2]),
    )
    return SaturatedInput(value, norm3(sub3(torque, value)) > 0.0)
