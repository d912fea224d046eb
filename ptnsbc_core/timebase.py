"""Time-base generator (12)-(15), (31), (32), (45), (52), docs/method.md.

    h(s) = s^4 (35 - 84 s + 70 s^2 - 20 s^3),  s = t / tf       Xi = h_dot / (1 - h + q)       G = Lambda (Xi + kappa c)

h rises from 0 to 1 on [0, tf] with three vanishing derivatives at both ends. Xi drives x_dot = -Xi x to the residual
q / (1 + q) of its start value at tf, for every start value.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import axpy, div3, scale3, sub3
from ptnsbc_core.errors import GainError
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.types import PROFILE_REFERENCE, PROFILE_SOFT, LoopGain, Vector3


class Clock(NamedTuple):
    """Times of one tick [s]."""

    t: float  # since the latest epoch
    start_t: float  # since the first epoch; the soft profile does not restart at a later one
    dt: float  # control period


@inline_kernel
def h(s: float) -> float:
    """Time base (32) with the sign that converges; s = t / tf [1], clamped to [0, 1].

    h(s) + h(1 - s) = 1: near 1 the polynomial itself would round to values above 1 and fall again.
    """
    s = min(max(s, 0.0), 1.0)
    r = min(s, 1.0 - s)
    rise = (((-20.0 * r + 70.0) * r - 84.0) * r + 35.0) * r * r * r * r
    return rise if s <= 0.5 else 1.0 - rise


@inline_kernel
def h_rate(s: float, duration_s: float) -> float:
    """dh/dt = 140 s^3 (1 - s)^3 / tf [1/s]."""
    s = min(max(s, 0.0), 1.0)
    r = s * (1.0 - s)
    return 140.0 * r * r * r / duration_s


@inline_kernel
def step_gain(t: float, dt: float, duration_s: float, residual: float) -> float:
    """Exact gain of the step from t to t + dt [1/s]: an Euler step with it meets (15) at every dt."""
    now = h(t / duration_s)
    return (h((t + dt) / duration_s) - now) / (dt * (1.0 - now + residual))


@inline_kernel
def soft_start(gain: LoopGain, clock: Clock) -> float:
    """c(t) [1]: 1, or h(t) for the profile `soft`, whose input starts at zero."""
    if gain.profile == PROFILE_SOFT:
        return h(clock.start_t / gain.duration_s)
    return 1.0


@inline_kernel
def loop_gain(gain: LoopGain, clock: Clock) -> float:
    """G(t) = Lambda (Xi(t) + kappa c(t)) [1/s]."""
    xi = step_gain(clock.t, clock.dt, gain.duration_s, gain.residual)
    return gain.scale * (xi + gain.kappa * soft_start(gain, clock))


@inline_kernel
def fallback_gain(gain: LoopGain, clock: Clock) -> float:
    """Gain [1/s] on an error without a planned decay: G(t), or kappa alone for the profile `reference`."""
    if gain.profile == PROFILE_REFERENCE:
        return gain.scale * gain.kappa
    return loop_gain(gain, clock)


@inline_kernel
def task_rate(gain: LoopGain, error: Vector3, start_error: Vector3, clock: Clock) -> Vector3:
    """Task rate [unit/s] for an error: G e, or by the profile `reference` the rate of its plan e(t0)(1 - h).

    `reference` feeds the planned decay forward. Only kappa, never Xi, acts on the deviation and so on noise.
    """
    if gain.profile == PROFILE_REFERENCE:
        now = h(clock.t / gain.duration_s)
        rise = h((clock.t + clock.dt) / gain.duration_s) - now
        planned = div3(scale3(rise, start_error), clock.dt)
        beside = sub3(error, scale3(1.0 - now, start_error))
        return axpy(gain.scale * gain.kappa, beside, planned)
    return scale3(loop_gain(gain, clock), error)


@kernel
def task_acceleration(
    gain: LoopGain, error: Vector3, start_error: Vector3, clock: Clock
) -> Vector3:
    """Rate of `task_rate` [unit/s^2] from this step to the next, on an error that decays by it.

    An Euler step with G_k leaves (1 - dt G_k) of an error, so G e changes by G_(k+1) (1 - dt G_k) e - G_k e.
    """
    later = Clock(clock.t + clock.dt, clock.start_t + clock.dt, clock.dt)
    if gain.profile == PROFILE_REFERENCE:
        return scale3(_rise_change(gain.duration_s, clock) / clock.dt, start_error)
    now = loop_gain(gain, clock)
    change = loop_gain(gain, later) * (1.0 - clock.dt * now) - now
    return scale3(change / clock.dt, error)


@inline_kernel
def _rise_change(duration_s: float, clock: Clock) -> float:
    """Change of the rate of h from this step to the next [1/s]."""
    now = h(clock.t / duration_s)
    then = h((clock.t + clock.dt) / duration_s)
    after = h((clock.t + 2.0 * clock.dt) / duration_s)
    return (after - then - (then - now)) / clock.dt


@inline_kernel
def plan_duration(gain: LoopGain) -> float:
    """Length of the planned approach [s]: it ends one time constant of the feedback before tf."""
    settling = 1.0 / max(gain.scale * gain.kappa, 1e-9)
    return max(gain.duration_s - settling, 0.8 * gain.duration_s)


class PlanStep(NamedTuple):
    """The plan E(t) = E_0 (1 - h) of one step, for E_0 = 1."""

    left: float  # 1 - h at the start of the step
    rate: float  # of h over the step [1/s]
    acceleration: float  # change of that rate to the next step [1/s^2]


@inline_kernel
def plan_step(duration_s: float, clock: Clock) -> PlanStep:
    """The plan of `duration_s` at this tick."""
    now = h(clock.t / duration_s)
    rate = (h((clock.t + clock.dt) / duration_s) - now) / clock.dt
    return PlanStep(1.0 - now, rate, _rise_change(duration_s, clock) / clock.dt)


@lru_cache
def peak_gain(duration_s: float, residual: float) -> float:
    """Largest Xi(t) [1/s] over [0, tf], by sampling (the closed form has no root in radicals).

    Raises:
        GainError: duration or residual out of range.
    """
    if not (duration_s > 0.0 and math.isfinite(duration_s)):
        raise GainError(f"tf={duration_s}: expected a deadline above 0 s")
    if residual == math.inf:
        return 0.0  # a loop without a time base
    if not 0.0 < residual < 1.0:
        raise GainError(f"q={residual}: expected 0 < q < 1 (time-base residual)")
    s = np.linspace(0.0, 1.0, 20001)
    base = s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)
    rate = 140.0 * (s * (1.0 - s)) ** 3 / duration_s
    return float(np.max(rate / (1.0 - base + residual)))


@inline_kernel
def homing_speed(distance: float, gain: float, deceleration: float) -> float:
    """Largest speed [m/s] towards a place `distance` [m] away: gain times it, as far as that can be braked.

    Beyond deceleration / gain^2 the speed is sqrt(2 a (distance - a / (2 gain^2))), whose braking is constant.
    """
    near = deceleration / max(gain * gain, 1e-9)
    if distance <= near:
        return gain * distance
    return math.sqrt(2.0 * deceleration * (distance - 0.5 * near))


@kernel
def feasible_deadline(error_m: float, max_speed: float, max_acceleration: float) -> float:
    """Shortest tf [s] for a start error [m] under limits [m/s], [m/s^2], from the peaks of h_dot and h_ddot.

    inf where a limit is 0, as for a UAV that cannot stop within its sight.
    """
    if max_speed <= 0.0 or max_acceleration <= 0.0:
        return math.inf if error_m > 0.0 else 0.0
    return max(2.1875 * error_m / max_speed, math.sqrt(7.513 * error_m / max_acceleration))
