"""Behaviour of the leader: it tracks its trajectory. The paper does not give this law."""

from __future__ import annotations

from ptnsbc_core.algebra import axpy, norm3, sub3
from ptnsbc_core.behaviours.contract import Behaviour, EpochErrors
from ptnsbc_core.behaviours.formation import braked
from ptnsbc_core.curves.trajectory import Reference
from ptnsbc_core.kernel import kernel
from ptnsbc_core.timebase import Clock, loop_gain, soft_start, task_acceleration, task_rate
from ptnsbc_core.types import AgentConfig, Vector3


@kernel
def leader_tracking(
    position: Vector3, desired: Reference, epoch: EpochErrors, clock: Clock, config: AgentConfig
) -> Behaviour:
    """p_dot = c p_r_dot + Lambda G (p_r - p_1): sigma = p_1, J = I.

    The trajectory may already move at t = 0. c(t) keeps its feed-forward from being a step. The error that c(t)
    leaves decays by tf, because the gain acts until then.
    """
    error = sub3(desired.position, position)
    start_error = error if epoch.at_epoch else epoch.start.task
    gain = config.formation
    onset = soft_start(gain, clock)
    closing = task_rate(gain, error, start_error, clock)
    if clock.t >= gain.duration_s:  # only avoidance leads it away from its trajectory after tf
        closing = braked(closing, (0.0, 0.0, 0.0), norm3(error), loop_gain(gain, clock), config)
    velocity = axpy(onset, desired.velocity, closing)
    # The error grows by what c(t) leaves of the feed-forward, and G acts on that too.
    later = Clock(clock.t + clock.dt, clock.start_t + clock.dt, clock.dt)
    onset_after = soft_start(gain, later)
    on_velocity = loop_gain(gain, later) * (1.0 - onset) + (onset_after - onset) / clock.dt
    acceleration = task_acceleration(gain, error, start_error, clock)
    acceleration = axpy(on_velocity, desired.velocity, acceleration)
    acceleration = axpy(onset_after, desired.acceleration, acceleration)
    return Behaviour(velocity, error, 1.0, acceleration, error, error)
