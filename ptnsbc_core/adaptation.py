"""Adaptive parts of the controller (49)-(51): parameters Psi_hat, disturbance bound delta_hat, observer."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.algebra import put
from ptnsbc_core.kernel import kernel
from ptnsbc_core.types import Array, ControllerConfig


@kernel
def adapted_parameters(
    parameters: Array, regressor_error: Array, frozen: bool, dt: float, config: ControllerConfig
) -> Array:
    """Psi_hat (4,) after one step of Psi_dot = -Gamma^-1 Y^T V~, (50), kept within mass_range of nominal.

    Args:
        parameters: (4,) m [kg], Ixx, Iyy, Izz [kg m^2].
        regressor_error: (4,) Y^T V~.
        frozen: an actuator is at its limit, so the error says nothing about the parameters.
        dt: step [s].
        config: gains and nominal values.
    """
    out = parameters.copy()
    if frozen:
        return out
    for i in range(4):
        gain = config.adaptation[0] if i == 0 else config.adaptation[1]
        nominal = config.nominal[i]
        span = config.mass_range * nominal
        step = out[i] - dt * gain * regressor_error[i]
        out[i] = min(max(step, nominal - span), nominal + span)
    return out


@kernel
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


@kernel
def started(velocity: Array) -> Array:
    """Observer (12,) at a velocity (3,) [m/s, ENU], with no disturbance known."""
    out = np.zeros(12)
    put(out, 0, velocity)
    return out


@kernel
def observed(
    observer: Array, velocity: Array, frozen: bool, dt: float, config: ControllerConfig
) -> Array:
    """Disturbance observer (12,) after one measurement of the velocity (3,) [m/s, ENU].

    Not in the paper. The thrust of a quadrotor follows the attitude, so the gain that keeps delta_hat sat()
    small in (49) is not to be had; the observer compares the measured velocity with what the last
    command should have done and feeds the difference forward. It models a disturbance that changes
    steadily, so that gusts and sway of about 1 rad/s leave a lag of second order only. Three poles at
    `observer_bandwidth` (as dt goes to 0).
    """
    out = observer.copy()
    pole = config.observer_bandwidth
    cap = config.bound_cap[0]
    for i in range(3):
        predicted = observer[i] + dt * (observer[6 + i] + observer[3 + i])
        miss = velocity[i] - predicted
        out[i] = predicted + 3.0 * pole * dt * miss
        if not frozen:
            moved = observer[3 + i] + dt * (observer[9 + i] + 3.0 * pole * pole * miss)
            out[3 + i] = min(max(moved, -cap), cap)
            out[9 + i] = observer[9 + i] + dt * pole * pole * pole * miss
            if moved != out[3 + i]:
                out[9 + i] = 0.0  # at the cap the trend would wind up
    return out
