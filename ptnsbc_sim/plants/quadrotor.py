"""Plant `quadrotor`: one thrust along body z and three torques through motors with lag and limits.

State (17,): position [m, ENU] 0:3, quaternion x y z w 3:7, velocity [m/s, ENU] 7:10, body rates [rad/s]
10:13, actual thrust [N] 13, actual torques [N m] 14:17. Drag is linear in the air speed, so wind pushes.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any, NamedTuple, cast

from ptnsbc_core.algebra import load3, matvec_transposed, store3
from ptnsbc_core.kernel import formula, inline_kernel
from ptnsbc_core.kinematics import rotation
from ptnsbc_core.types import Array, Vector3
from ptnsbc_sim.plants.contract import PlantConfig, Six, disturbance

Quaternion = tuple[float, float, float, float]


class QuadrotorState(NamedTuple):
    """A state by its parts, or its rate of change: an array would be read again after every write to another."""

    position: Vector3  # [m, ENU]
    quaternion: Quaternion  # x y z w
    velocity: Vector3  # [m/s, ENU]
    rates: Vector3  # [rad/s] of the body
    thrust: float  # [N]
    torque: Vector3  # [N m]


@formula
def from_array(x: Array) -> QuadrotorState:
    """The parts of a state (17,)."""
    quaternion = (x[3], x[4], x[5], x[6])
    return QuadrotorState(load3(x, 0), quaternion, load3(x, 7), load3(x, 10), x[13], load3(x, 14))


@formula
def store_state(out: Array, x: QuadrotorState) -> None:
    """Write a state into `out` (17,)."""
    store3(out, 0, x.position)
    out[3], out[4], out[5], out[6] = x.quaternion
    store3(out, 7, x.velocity)
    store3(out, 10, x.rates)
    out[13] = x.thrust
    store3(out, 14, x.torque)


@formula
def derivative(
    x: QuadrotorState, thrust: float, torque: Vector3, config: PlantConfig, push: Six
) -> QuadrotorState:
    """x_dot under a commanded thrust [N] and torque [N m], within the limits, and a disturbance acceleration.

    p_dot = v,  q_dot = q (w, 0) / 2,  v_dot = R e_z T / m - g e_z - drag (v - wind) + d_v,
    I w_dot = tau - w x I w + I d_w,  T_dot = (T_c - T) / lag,  tau_dot = (tau_c - tau) / lag
    """
    a, b, c, d = x.quaternion
    p, q, r = x.rates
    u, v, w = x.velocity
    lift, drag, wind = x.thrust / config.mass, config.drag, config.wind
    up = 1.0 - 2.0 * (a * a + b * b)
    ix, iy, iz = config.inertia[0], config.inertia[1], config.inertia[2]
    rate = 1.0 / config.motor_lag_s
    return QuadrotorState(
        x.velocity,
        (
            0.5 * (d * p + b * r - c * q),
            0.5 * (d * q + c * p - a * r),
            0.5 * (d * r + a * q - b * p),
            -0.5 * (a * p + b * q + c * r),
        ),
        (
            2.0 * (a * c + d * b) * lift - drag * (u - wind[0]) + push[0],
            2.0 * (b * c - d * a) * lift - drag * (v - wind[1]) + push[1],
            up * lift - config.gravity - drag * (w - wind[2]) + push[2],
        ),
        (
            (x.torque[0] + (iy - iz) * q * r) / ix + push[3],
            (x.torque[1] + (iz - ix) * r * p) / iy + push[4],
            (x.torque[2] + (ix - iy) * p * q) / iz + push[5],
        ),
        (thrust - x.thrust) * rate,
        (
            (torque[0] - x.torque[0]) * rate,
            (torque[1] - x.torque[1]) * rate,
            (torque[2] - x.torque[2]) * rate,
        ),
    )


def _each(law: Callable[[Any, Any], Any], x: Any, y: Any) -> Any:
    """What has `law` of the numbers of x and y in the place of each number of x."""
    if not isinstance(x, tuple):
        return law(x, y)
    parts = [_each(law, a, b) for a, b in zip(x, y, strict=True)]
    return QuadrotorState(*parts) if isinstance(x, QuadrotorState) else tuple(parts)


@formula
def _ahead(x: QuadrotorState, factor: float, slope: QuadrotorState) -> QuadrotorState:
    """x + factor slope."""
    return cast(QuadrotorState, _each(lambda a, b: a + factor * b, x, slope))


@formula
def _sum(a: QuadrotorState, b: QuadrotorState) -> QuadrotorState:
    return cast(QuadrotorState, _each(operator.add, a, b))


@formula
def _normalised(x: QuadrotorState) -> QuadrotorState:
    """`x` with its quaternion brought back to unit length."""
    a, b, c, d = x.quaternion
    length = math.sqrt(a * a + b * b + c * c + d * d)
    unit = (a / length, b / length, c / length, d / length)
    return QuadrotorState(x.position, unit, x.velocity, x.rates, x.thrust, x.torque)


@inline_kernel
def _limited(value: float, most: float) -> float:
    return min(max(value, -most), most)


@inline_kernel
def advance(out: Array, wrench: Array, step_s: float, config: PlantConfig, sines: Array) -> None:
    """State `out` (17,), in place, by one control period; `sines` as in `Waves`.

    Runge-Kutta of fourth order, with the disturbances at the start, middle and end of a step.
    """
    x, most, half = from_array(out), config.max_torque, 0.5 * step_s
    thrust = min(max(wrench[2], 0.0), config.max_thrust)
    torque = (
        _limited(wrench[3], most[0]),
        _limited(wrench[4], most[1]),
        _limited(wrench[5], most[2]),
    )
    now = disturbance(config, sines, 0)
    for n in range(sines.shape[0] // 2):
        middle, end = disturbance(config, sines, 2 * n + 1), disturbance(config, sines, 2 * n + 2)
        first = derivative(x, thrust, torque, config, now)
        second = derivative(_ahead(x, half, first), thrust, torque, config, middle)
        third = derivative(_ahead(x, half, second), thrust, torque, config, middle)
        fourth = derivative(_ahead(x, step_s, third), thrust, torque, config, end)
        both = _sum(second, third)
        slope = _sum(_sum(first, _sum(both, both)), fourth)
        x = _normalised(_ahead(x, step_s / 6.0, slope))
        now = end
    store_state(out, x)


@inline_kernel
def store_odometry(out: Array, x: Array) -> None:
    """Odometry vector of a state (17,) into `out` (13,): the velocity turned into the body frame."""
    for i in range(7):
        out[i] = x[i]
    store3(out, 7, matvec_transposed(rotation(x, 3), load3(x, 7)))
    store3(out, 10, load3(x, 10))
