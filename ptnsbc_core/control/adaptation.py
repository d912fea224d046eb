"""Adaptive parts of the controller (49)-(51): parameters Psi_hat, disturbance bound delta_hat, observer."""

from __future__ import annotations

from ptnsbc_core.kernel import leaf
from ptnsbc_core.types import ControllerConfig, DisturbanceObserver, InertialParameters, Vector3


@leaf
def _adapted(
    value: float, nominal: float, gain: float, product: float, dt: float, share: float
) -> float:
    span = share * nominal
    return min(max(value - dt * gain * product, nominal - span), nominal + span)


@leaf
def adapted_parameters(
    parameters: InertialParameters, product: InertialParameters, dt: float, config: ControllerConfig
) -> InertialParameters:
    """Psi_hat after one step of Psi_dot = -Gamma^-1 Y^T V~, (50), kept within mass_range of nominal.

    Args:
        parameters: before the step.
        product: Y^T V~ of each parameter.
        dt: step [s].
        config: gains and nominal values.
    """
    nominal, share = config.nominal, config.mass_range
    linear, angular = config.adaptation
    inertia, turn = parameters.inertia, product.inertia
    return InertialParameters(
        _adapted(parameters.mass, nominal.mass, linear, product.mass, dt, share),
        (
            _adapted(inertia[0], nominal.inertia[0], angular, turn[0], dt, share),
            _adapted(inertia[1], nominal.inertia[1], angular, turn[1], dt, share),
            _adapted(inertia[2], nominal.inertia[2], angular, turn[2], dt, share),
        ),
    )


@leaf
def adapted_bound(
    bound: float, error_norm: float, which: int, dt: float, config: ControllerConfig
) -> float:
    """delta_hat after one step of (51) with dead zone, leak and cap: the printed one grows for ever.

    Args:
        bound: delta_hat [m/s^2] or [rad/s^2].
        error_norm: |V~|_1 of the part [m/s] or [rad/s].
        which: 0 force, 1 torque.
        dt: step [s].
        config: rates and limits.
    """
    growth = 0.0
    if error_norm > config.bound_dead_zone[which]:
        growth = config.bound_rate * error_norm
    return min(bound + dt * (growth - config.bound_leak * bound), config.bound_cap[which])


@leaf
def started(velocity: Vector3) -> DisturbanceObserver:
    """Observer at a velocity [m/s, ENU], with no disturbance known."""
    zero = (0.0, 0.0, 0.0)
    return DisturbanceObserver(velocity, zero, zero, zero)


@leaf
def _observed_axis(
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
    miss = velocity - predicted
    corrected = predicted + 3.0 * pole * dt * miss
    if frozen:
        return corrected, disturbance, trend
    moved = disturbance + dt * (trend + 3.0 * pole * pole * miss)
    kept = min(max(moved, -cap), cap)
    if moved != kept:
        return corrected, kept, 0.0  # at the cap the trend would wind up
    return corrected, kept, trend + dt * pole * pole * pole * miss


@leaf
def observed(
    observer: DisturbanceObserver,
    velocity: Vector3,
    frozen: bool,
    dt: float,
    config: ControllerConfig,
) -> DisturbanceObserver:
    """Disturbance observer after one measurement of the velocity [m/s, ENU].

    Not in the paper. The thrust of a quadrotor follows the attitude, so the gain that keeps delta_hat sat()
    small in (49) is not to be had; the observer compares the measured velocity with what the last
    command should have done and feeds the difference forward. It models a disturbance that changes
    steadily, so that gusts and sway of about 1 rad/s leave a lag of second order only. Three poles at
    `observer_bandwidth` (as dt goes to 0).
    """
    x = _observed_axis(0, observer, velocity[0], frozen, dt, config)
    y = _observed_axis(1, observer, velocity[1], frozen, dt, config)
    z = _observed_axis(2, observer, velocity[2], frozen, dt, config)
    return DisturbanceObserver(
        (x[0], y[0], z[0]), (x[1], y[1], z[1]), observer.acceleration, (x[2], y[2], z[2])
    )
