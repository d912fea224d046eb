"""Behaviour of the leader: it tracks its trajectory. The paper does not give this law."""

from __future__ import annotations

from ptnsbc_core.algebra import add3, axpy, norm3, scale3, sub3
from ptnsbc_core.behaviours.contract import Behaviour, Beside, EpochErrors, FormationPlace
from ptnsbc_core.behaviours.formation import braked
from ptnsbc_core.behaviours.recovery import way_back
from ptnsbc_core.curves.trajectory import Reference
from ptnsbc_core.kernel import kernel
from ptnsbc_core.timebase import Clock, loop_gain, soft_start, task_acceleration, task_rate
from ptnsbc_core.types import APPROACH_PLANNED, AgentConfig, Vector3


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
    back = way_back(epoch.recovery, clock, gain.scale * gain.kappa)
    beside = sub3(error, back.deviation)
    closing = task_rate(gain, beside, start_error, clock)
    over = clock.t >= gain.duration_s
    if over:  # only avoidance leads it away from its trajectory after tf
        closing = braked(closing, (0.0, 0.0, 0.0), norm3(beside), loop_gain(gain, clock), config)
    free = scale3(onset, desired.velocity)
    velocity = add3(axpy(onset, desired.velocity, closing), back.velocity)
    # The error grows by what c(t) leaves of the feed-forward, and G acts on that too.
    later = Clock(clock.t + clock.dt, clock.start_t + clock.dt, clock.dt)
    onset_after = soft_start(gain, later)
    on_velocity = loop_gain(gain, later) * (1.0 - onset) + (onset_after - onset) / clock.dt
    acceleration = add3(task_acceleration(gain, beside, start_error, clock), back.acceleration)
    acceleration = axpy(on_velocity, desired.velocity, acceleration)
    acceleration = axpy(onset_after, desired.acceleration, acceleration)
    planned = over and config.approach == APPROACH_PLANNED
    return Behaviour(
        velocity,
        error,
        1.0,
        acceleration,
        error,
        error,
        Beside(error, free, planned),
        FormationPlace(error, desired.velocity),
    )
