"""Behaviour of a follower: the formation law."""

from __future__ import annotations

from ptnsbc_core.algebra import add3, axpy, hadamard3, matvec, scale3, sub3
from ptnsbc_core.behaviours.contract import Behaviour, EpochErrors, Neighbour
from ptnsbc_core.kernel import kernel
from ptnsbc_core.nullspace import damped_solve
from ptnsbc_core.tasks.registry import evaluate, task_error
from ptnsbc_core.timebase import Clock, fallback_gain, task_rate
from ptnsbc_core.types import AgentConfig, Vector3


@kernel
def formation(
    position: Vector3,
    parent: Neighbour,
    leader: Neighbour,
    epoch: EpochErrors,
    clock: Clock,
    config: AgentConfig,
) -> Behaviour:
    """v_L + J^+ [Lambda G e - J_j (v_j - v_L)], in place of (30).

    The reference k is the leader's estimated position plus the anchor. It moves with v_L, so its own term
    vanishes. v_L stays outside the pseudo-inverse: damping must not slow the feed-forward. Task (23) can be close
    to singular (UAV 4 starts so in Table 2). In the directions that it cannot steer, a lower task in its null
    space follows the desired offset from the parent.
    """
    reference = add3(leader.position, config.anchor)
    geometry = evaluate(config.task, position, parent.position, reference)
    error = task_error(geometry, config.desired)
    start_error = error if epoch.at_epoch else epoch.task
    rate = task_rate(config.formation, error, start_error, clock)
    relative_velocity = sub3(parent.velocity, leader.velocity)
    rate = sub3(rate, matvec(geometry.parent, relative_velocity))
    scale, own = config.row_scale, geometry.own
    jacobian = (scale3(scale[0], own[0]), scale3(scale[1], own[1]), scale3(scale[2], own[2]))
    offset_error = sub3(config.offset, sub3(position, parent.position))
    fallback = axpy(fallback_gain(config.formation, clock), offset_error, relative_velocity)
    solution = damped_solve(
        jacobian,
        hadamard3(scale, rate),
        fallback,
        config.damping_threshold,
        config.damping_max,
    )
    return Behaviour(add3(leader.velocity, solution.velocity), error, solution.singular_value)
