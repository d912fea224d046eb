"""The control step as a process calls it: the inputs packed into one vector, the outputs into another.

A NamedTuple of arrays that crosses from Python into a compiled kernel is unpacked field by field, and packed again
on the way back. That costs more than the laws (`bench --only step` shows both).
"""

from __future__ import annotations

from collections.abc import Callable, MutableSequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import store3
from ptnsbc_core.kernel import KernelList, inline_kernel, kernel, prepared
from ptnsbc_core.kinematics import store_estimate
from ptnsbc_core.step import (
    TaskPoints,
    guided_step,
    initial_state,
    inlined_step,
    task_points,
    tasked_step,
)
from ptnsbc_core.tasks.contract import TaskGeometry
from ptnsbc_core.types import (
    MODE_HOLD,
    NEAR_COLUMNS,
    NEVER_RECEIVED_S,
    ODOMETRY_SIZE,
    AgentConfig,
    AgentDiagnostics,
    AgentInputs,
    AgentOutputs,
    AgentState,
    Array,
    OdometryLike,
    Vector3,
)

# Offsets of the fields of AgentInputs in `PackedInputs.vector`; the estimates (K, 13) and their ages (K,) follow.
OWN, PARENT, LEADER = 0, ODOMETRY_SIZE, 2 * ODOMETRY_SIZE
PARENT_AGE = 3 * ODOMETRY_SIZE
LEADER_AGE, NEAR_AGE, MODE, START_AGE = (PARENT_AGE + k for k in range(1, 5))
ESTIMATES = START_AGE + 1

# Offsets of the fields of AgentOutputs in `PackedOutputs.vector`, and its size.
_VELOCITY, _WRENCH, _ESTIMATE, _REPORTED, _ERROR, _OUTPUT_SIZE = 0, 4, 10, 23, 26, 37


class PackedInputs:
    """Inputs of a step, see `AgentInputs`; at first nothing has been received.

    Attributes:
        vector: (44 + 14 K,) for K neighbours in the estimator graph, filled by the offsets of this module.
        ages: offset of the ages of the estimates in `vector`.
    """

    __slots__ = ("_near", "ages", "vector")

    def __init__(self, neighbours: int, near: Array) -> None:
        self.ages = ESTIMATES + ODOMETRY_SIZE * neighbours
        self.vector = np.zeros(self.ages + neighbours)
        self.vector[[PARENT_AGE, LEADER_AGE, NEAR_AGE]] = NEVER_RECEIVED_S
        self.vector[self.ages :] = NEVER_RECEIVED_S
        self.vector[MODE] = MODE_HOLD
        self.near = near

    @property
    def near(self) -> Array:
        """Near objects (M, 7), as in AgentInputs; an array of another layout or type is converted."""
        return self._near

    @near.setter
    def near(self, near: Array) -> None:
        self._near: Array = np.ascontiguousarray(near, dtype=np.float64)

    @classmethod
    def pack(cls, inputs: AgentInputs) -> PackedInputs:
        """The vector of `inputs`."""
        packed = cls(len(inputs.estimates), inputs.near)
        vector = packed.vector
        vector[OWN:PARENT], vector[PARENT:LEADER] = inputs.own, inputs.parent
        vector[LEADER:PARENT_AGE] = inputs.leader
        vector[PARENT_AGE], vector[LEADER_AGE] = inputs.parent_age_s, inputs.leader_age_s
        vector[NEAR_AGE], vector[MODE] = inputs.near_age_s, inputs.mode
        vector[START_AGE] = inputs.start_age_s
        vector[ESTIMATES : packed.ages] = inputs.estimates.ravel()
        vector[packed.ages :] = inputs.estimate_age_s
        return packed

    def unpack(self) -> AgentInputs:
        """The named inputs; their arrays are views."""
        return _unpack(self.vector, self.near)


class PackedOutputs:
    """Outputs of a step, see `AgentOutputs`: each property reads from `vector` (37,)."""

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
        return self.vector[_ESTIMATE:_REPORTED]

    @property
    def reported(self) -> Array:
        """Velocity (3,) [m/s, body FLU] that the neighbours are told."""
        return self.vector[_REPORTED:_ERROR]

    @property
    def diagnostics(self) -> AgentDiagnostics:
        """Diagnostics of the step."""
        return load_diagnostics(self.vector[_ERROR:])


class _AgentMemory(NamedTuple):
    """Configuration and state, which stay with the kernels from step to step."""

    config: AgentConfig
    states: MutableSequence[AgentState]  # one; apart, because it alone is written at every step


@inline_kernel
def _unpack(vector: Array, near: Array) -> AgentInputs:
    count = (vector.shape[0] - ESTIMATES) // (ODOMETRY_SIZE + 1)
    ages = ESTIMATES + ODOMETRY_SIZE * count
    return AgentInputs(
        vector[OWN:PARENT],
        vector[PARENT:LEADER],
        vector[PARENT_AGE],
        vector[LEADER:PARENT_AGE],
        vector[LEADER_AGE],
        vector[ESTIMATES:ages].reshape(count, ODOMETRY_SIZE),
        vector[ages:],
        near,
        vector[NEAR_AGE],
        int(vector[MODE]),
        vector[START_AGE],
    )


@kernel
def _advance(
    memory: MutableSequence[_AgentMemory],
    inputs: Array,
    near: Array,
    t: float,
    dt: float,
    out: Array,
) -> None:
    config, states = memory[0]
    state, outputs = inlined_step(states[0], _unpack(inputs, near), None, None, t, dt, config)
    states[0] = state
    _pack(outputs, out)


@kernel
def _advance_guided(
    memory: MutableSequence[_AgentMemory],
    inputs: Array,
    near: Array,
    velocity: Vector3,
    t: float,
    dt: float,
    out: Array,
) -> None:
    config, states = memory[0]
    states[0], outputs = guided_step(states[0], _unpack(inputs, near), velocity, t, dt, config)
    _pack(outputs, out)


@kernel
def _advance_tasked(
    memory: MutableSequence[_AgentMemory],
    inputs: Array,
    near: Array,
    task: TaskGeometry,
    t: float,
    dt: float,
    out: Array,
) -> None:
    config, states = memory[0]
    states[0], outputs = tasked_step(states[0], _unpack(inputs, near), task, t, dt, config)
    _pack(outputs, out)


@kernel
def _points(
    memory: MutableSequence[_AgentMemory], inputs: Array, near: Array, t: float, dt: float
) -> TaskPoints:
    config, states = memory[0]
    return task_points(states[0], _unpack(inputs, near), t, dt, config)


@inline_kernel
def _pack(outputs: AgentOutputs, out: Array) -> None:
    store_velocity(out[_VELOCITY:_WRENCH], outputs)
    store_wrench(out[_WRENCH:_ESTIMATE], outputs)
    store_estimate(out[_ESTIMATE:_REPORTED], outputs.estimate, outputs.estimate_valid)
    store3(out, _REPORTED, outputs.reported)
    store_diagnostics(out[_ERROR:], outputs.diagnostics)


@inline_kernel
def store_velocity(out: Array, outputs: AgentOutputs) -> None:
    """Write the velocity setpoint [m/s, ENU] and the yaw rate [rad/s] into (4,)."""
    store3(out, 0, outputs.velocity)
    out[3] = outputs.yaw_rate


@inline_kernel
def store_wrench(out: Array, outputs: AgentOutputs) -> None:
    """Write force [N] and torque [N m], body FLU, into (6,)."""
    store3(out, 0, outputs.force)
    store3(out, 3, outputs.torque)


@inline_kernel
def store_diagnostics(out: Array, diagnostics: AgentDiagnostics) -> None:
    """Write the diagnostics, in the order of their fields, into (11,)."""
    store3(out, 0, diagnostics.error)
    out[3] = diagnostics.gain
    out[4] = diagnostics.singular_value
    out[5] = diagnostics.active_rows
    out[6] = 1.0 if diagnostics.saturated else 0.0
    out[7] = 1.0 if diagnostics.holding else 0.0
    out[8] = diagnostics.priority_violation
    out[9] = diagnostics.velocity_error
    out[10] = 1.0 if diagnostics.deadlock else 0.0


@kernel
def _memory(config: AgentConfig, state: AgentState) -> MutableSequence[_AgentMemory]:
    memory = KernelList()
    states = KernelList()
    states.append(state)
    memory.append(_AgentMemory(config, states))
    return memory


@kernel
def _state(memory: MutableSequence[_AgentMemory]) -> AgentState:
    return memory[0].states[0]


def load_diagnostics(row: Array) -> AgentDiagnostics:
    """The diagnostics that `store_diagnostics` has written into (11,)."""
    x, y, z, gain, singular_value, rows, saturated, holding, violation, error, deadlock = (
        row.tolist()
    )
    return AgentDiagnostics(
        (x, y, z),
        gain,
        singular_value,
        int(rows),
        saturated > 0.0,
        holding > 0.0,
        violation,
        error,
        deadlock > 0.0,
    )


class Agent:
    """One UAV's control step with its configuration and state.

    The outputs of a step are valid until the next one, which writes them into the same vector.
    """

    def __init__(self, config: AgentConfig, own: OdometryLike) -> None:
        """Start from the UAV's own odometry vector (13,)."""
        self._begin(config, initial_state(own, config))

    @classmethod
    def resumed(cls, config: AgentConfig, state: AgentState) -> Agent:
        """An agent that continues from the state of another one."""
        agent = cls.__new__(cls)
        agent._begin(config, state)
        return agent

    def _begin(self, config: AgentConfig, state: AgentState) -> None:
        self._memory, self._outputs = _memory(config, state), PackedOutputs(np.empty(_OUTPUT_SIZE))

    @cached_property
    def _own_advance(self) -> Callable[..., None]:
        empty = PackedInputs(0, np.empty((0, NEAR_COLUMNS)))
        out = self._outputs.vector
        return prepared(_advance, self._memory, empty.vector, empty.near, 0.0, 0.0, out)

    @property
    def state(self) -> AgentState:
        """State from which the next step starts."""
        return _state(self._memory)

    def task_points(self, inputs: PackedInputs, t: float, dt: float) -> TaskPoints:
        """The state at which the step with these inputs evaluates its task."""
        return _points(self._memory, inputs.vector, inputs.near, t, dt)

    def advance(
        self,
        inputs: PackedInputs,
        t: float,
        dt: float,
        guided: Vector3 | None = None,
        task: TaskGeometry | None = None,
    ) -> PackedOutputs:
        """One tick, see `step`: t [s] since the latest epoch, dt [s] the control period.

        `guided` is the velocity [m/s, ENU] of another law, see `guided_step`; `task` is a task of the user, see
        `tasked_step`.
        """
        memory, vector, near, outputs = self._memory, inputs.vector, inputs.near, self._outputs
        if task is not None:
            _advance_tasked(memory, vector, near, task, t, dt, outputs.vector)
        elif guided is not None:
            _advance_guided(memory, vector, near, guided, t, dt, outputs.vector)
        else:
            self._own_advance(memory, vector, near, t, dt, outputs.vector)
        return outputs

    def step(self, inputs: AgentInputs, t: float, dt: float) -> PackedOutputs:
        """The same with named inputs."""
        return self.advance(PackedInputs.pack(inputs), t, dt)
