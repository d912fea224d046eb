"""The control step as a process calls it: what is known in one vector, what is told in another.

A NamedTuple of arrays that crosses from Python into a compiled kernel and back is taken apart and put
together field by field, which costs more than the laws (`bench --only step` shows both).
"""

from __future__ import annotations

from collections.abc import MutableSequence
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import put3
from ptnsbc_core.kernel import kernel, kernel_list, leaf
from ptnsbc_core.kinematics import put_estimate
from ptnsbc_core.step import initial_state, step
from ptnsbc_core.types import (
    MODE_HOLD,
    NEVER_HEARD_S,
    ODOMETRY_SIZE,
    AgentConfig,
    AgentDiagnostics,
    AgentInputs,
    AgentOutputs,
    AgentState,
    Array,
)

# Where the fields of AgentInputs stand in `PackedInputs.vector`; the estimates (K, 13) and their ages (K,) follow.
OWN, PARENT, LEADER = 0, ODOMETRY_SIZE, 2 * ODOMETRY_SIZE
PARENT_AGE = 3 * ODOMETRY_SIZE
LEADER_AGE, NEAR_AGE, MODE, START_AGE = (PARENT_AGE + k for k in range(1, 5))
ESTIMATES = START_AGE + 1

# Where the fields of AgentOutputs stand in `PackedOutputs.vector`.
_VELOCITY, _WRENCH, _ESTIMATE, _ERROR, _TOLD_SIZE = 0, 4, 10, 23, 33


class PackedInputs:
    """What goes into a step, see `AgentInputs`; nothing has been heard at first.

    Attributes:
        vector: (44 + 14 K,) for K neighbours in the estimator graph, filled by the offsets of this module.
        ages: where in it the ages of the estimates begin.
        near: (M, 7), as in AgentInputs.
    """

    __slots__ = ("ages", "near", "vector")

    def __init__(self, neighbours: int, near: Array) -> None:
        self.ages = ESTIMATES + ODOMETRY_SIZE * neighbours
        self.vector = np.zeros(self.ages + neighbours)
        self.vector[[PARENT_AGE, LEADER_AGE, NEAR_AGE]] = NEVER_HEARD_S
        self.vector[self.ages :] = NEVER_HEARD_S
        self.vector[MODE] = MODE_HOLD
        self.near = near

    @classmethod
    def of(cls, inputs: AgentInputs) -> PackedInputs:
        """The vector of `inputs`."""
        known = cls(len(inputs.estimates), inputs.near)
        vector = known.vector
        vector[OWN:PARENT], vector[PARENT:LEADER] = inputs.own, inputs.parent
        vector[LEADER:PARENT_AGE] = inputs.leader
        vector[PARENT_AGE], vector[LEADER_AGE] = inputs.parent_age_s, inputs.leader_age_s
        vector[NEAR_AGE], vector[MODE] = inputs.near_age_s, inputs.mode
        vector[START_AGE] = inputs.start_age_s
        vector[ESTIMATES : known.ages] = inputs.estimates.ravel()
        vector[known.ages :] = inputs.estimate_age_s
        return known

    @property
    def inputs(self) -> AgentInputs:
        """The same with names; its arrays are views."""
        return _inputs(self.vector, self.near)


class PackedOutputs:
    """What a step gave, see `AgentOutputs`: each property reads it from `vector` (33,)."""

    __slots__ = ("vector",)

    def __init__(self, vector: Array) -> None:
        self.vector = vector

    @property
    def velocity(self) -> Array:
        """Velocity setpoint (4,) [m/s, ENU] and yaw rate [rad/s]."""
        return self.vector[_VELOCITY:_WRENCH]

    @property
    def wrench(self) -> Array:
        """Force and torque (6,) [N], [N m], body FLU."""
        return self.vector[_WRENCH:_ESTIMATE]

    @property
    def leader_estimate(self) -> Array:
        """Odometry vector (13,), velocities in the world frame."""
        return self.vector[_ESTIMATE:_ERROR]

    @property
    def diagnostics(self) -> AgentDiagnostics:
        """Why the UAV does what it does."""
        return diagnostics_of(self.vector[_ERROR:])


class _AgentMemory(NamedTuple):
    """What stays with the kernels from step to step."""

    config: AgentConfig
    state: AgentState


@leaf
def _inputs(known: Array, near: Array) -> AgentInputs:
    count = (known.shape[0] - ESTIMATES) // (ODOMETRY_SIZE + 1)
    ages = ESTIMATES + ODOMETRY_SIZE * count
    return AgentInputs(
        known[OWN:PARENT],
        known[PARENT:LEADER],
        known[PARENT_AGE],
        known[LEADER:PARENT_AGE],
        known[LEADER_AGE],
        known[ESTIMATES:ages].reshape(count, ODOMETRY_SIZE),
        known[ages:],
        near,
        known[NEAR_AGE],
        int(known[MODE]),
        known[START_AGE],
    )


@kernel
def _advance(
    flights: MutableSequence[_AgentMemory], known: Array, near: Array, t: float, dt: float
) -> Array:
    flight = flights[0]
    state, outputs = step(flight.state, _inputs(known, near), t, dt, flight.config)
    flights[0] = _AgentMemory(flight.config, state)
    told = np.empty(_TOLD_SIZE)
    put_velocity(told[_VELOCITY:_WRENCH], outputs)
    put_wrench(told[_WRENCH:_ESTIMATE], outputs)
    put_estimate(told[_ESTIMATE:_ERROR], outputs.estimate)
    put_diagnostics(told[_ERROR:], outputs.diagnostics)
    return told


@leaf
def put_velocity(out: Array, outputs: AgentOutputs) -> None:
    """The velocity setpoint into (4,): [m/s, ENU] and yaw rate [rad/s]."""
    put3(out, 0, outputs.velocity)
    out[3] = outputs.yaw_rate


@leaf
def put_wrench(out: Array, outputs: AgentOutputs) -> None:
    """Force and torque into (6,): [N], [N m], body FLU."""
    put3(out, 0, outputs.force)
    put3(out, 3, outputs.torque)


@leaf
def put_diagnostics(out: Array, why: AgentDiagnostics) -> None:
    """Diagnostics in the order of their fields into (10,)."""
    put3(out, 0, why.error)
    out[3] = why.gain
    out[4] = why.singular_value
    out[5] = why.active_rows
    out[6] = 1.0 if why.saturated else 0.0
    out[7] = 1.0 if why.holding else 0.0
    out[8] = why.priority_violation
    out[9] = why.velocity_error


@kernel
def _first(flights: MutableSequence[_AgentMemory]) -> AgentState:
    return flights[0].state


def diagnostics_of(row: Array) -> AgentDiagnostics:
    """The diagnostics that `put_diagnostics` has put into (10,)."""
    x, y, z, gain, singular_value, rows, saturated, holding, *rest = row.tolist()
    return AgentDiagnostics(
        (x, y, z), gain, singular_value, int(rows), saturated > 0.0, holding > 0.0, *rest
    )


class Agent:
    """One UAV's control step with its configuration and state kept where the kernels can reach them."""

    def __init__(self, config: AgentConfig, own: Array) -> None:
        """Start from the UAV's own odometry vector (13,)."""
        self._flights = kernel_list([_AgentMemory(config, initial_state(own, config))])

    @classmethod
    def resumed(cls, config: AgentConfig, state: AgentState) -> Agent:
        """An agent that goes on where another one was."""
        agent = cls.__new__(cls)
        agent._flights = kernel_list([_AgentMemory(config, state)])
        return agent

    @property
    def state(self) -> AgentState:
        """What the next step starts from."""
        return _first(self._flights)

    def advance(self, known: PackedInputs, t: float, dt: float) -> PackedOutputs:
        """One tick, see `step`: t [s] since the latest epoch, dt [s] the control period."""
        return PackedOutputs(_advance(self._flights, known.vector, known.near, t, dt))

    def step(self, inputs: AgentInputs, t: float, dt: float) -> PackedOutputs:
        """The same with a name for every number that goes in."""
        return self.advance(PackedInputs.of(inputs), t, dt)
