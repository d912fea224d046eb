"""Adaptive parts of the controller (49)-(51): parameters Psi_hat, disturbance bound delta_hat, observer."""

from __future__ import annotations

from ptnsbc_core.kernel import formula, inline_kernel
from ptnsbc_core.types import ControllerConfig, DisturbanceObserver, InertialParameters, Vector3


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

    Args:
        parameters: before the step.
        product: Y^T V~ of each parameter.
        dt: step [s].
        config: gains and nominal values.
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
    """delta_hat after one step of (51) with dead zone, leak and cap; as printed it grows for ever.

    Args:
        bound: delta_hat [m/s^2] or [rad/s^2].
        error_norm: |V~|_1 of the part [m/s] or [rad/s].
        axis: 0 force, 1 torque.
        dt: step [s].
        config: rates and limits.
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
    """Disturbance observer after one measurement of the velocity [m/s, ENU].

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
