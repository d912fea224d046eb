"""The control step as a process calls it: the inputs packed into one vector, the outputs into another.

A NamedTuple of arrays that crosses from Python into a compiled kernel is unpacked field by field, and packed again
on the way back. That costs more than the laws (`bench --only step` shows both).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableSequence, Sequence
from functools import cached_property
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import odometry_tuple, store3
from ptnsbc_core.kernel import inline_kernel, kernel, kernel_list, prepared, referred
from ptnsbc_core.kinematics import store_estimate
from ptnsbc_core.step import TaskPoints, initial_state, step, task_points
from ptnsbc_core.tasks.formation_tasks import TaskGeometry
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


def offsets(widths: Mapping[str, int]) -> tuple[int, ...]:
    """Offset of each column group in a vector, and the size of the vector."""
    return tuple(accumulate(widths.values(), initial=0))


INPUT_WIDTHS = {
    "own": ODOMETRY_SIZE,
    "parent": ODOMETRY_SIZE,
    "leader": ODOMETRY_SIZE,
    "parent_age_s": 1,
    "leader_age_s": 1,
    "near_age_s": 1,
    "mode": 1,
    "start_age_s": 1,
}
"""Fields of `AgentInputs` in `PackedInputs.vector`; K estimates (K, 13) and their ages (K,) follow."""

OWN, PARENT, LEADER, PARENT_AGE, LEADER_AGE, NEAR_AGE, MODE, START_AGE, ESTIMATES = offsets(
    INPUT_WIDTHS
)

_WIDTHS = {name: 3 if name == "error" else 1 for name in AgentDiagnostics._fields}
ERROR, GAIN, SINGULAR_VALUE, ACTIVE_ROWS, SATURATED, HOLDING, *_REST, DIAGNOSTICS_SIZE = offsets(
    _WIDTHS
)
PRIORITY_VIOLATION, VELOCITY_ERROR, DEADLOCK = _REST
"""Columns of `AgentDiagnostics` in a row of numbers."""

OUTPUT_WIDTHS = {
    "velocity": 4,
    "wrench": 6,
    "leader_estimate": ODOMETRY_SIZE,
    "reported": 3,
    "diagnostics": DIAGNOSTICS_SIZE,
}
"""Parts of `PackedOutputs.vector`."""

_VELOCITY, _WRENCH, _ESTIMATE, _REPORTED, _DIAGNOSTICS, _OUTPUT_SIZE = offsets(OUTPUT_WIDTHS)


class _Arrays(NamedTuple):
    """The inputs of a step in memory."""

    vector: Array  # (44 + 14 K,)
    estimates: Array  # (K, 13), a part of the vector
    near: Array  # (M, 8)


class PackedInputs:
    """Inputs of a step, see `AgentInputs`; at first nothing has been received.

    Attributes:
        vector: (44 + 14 K,) for K neighbours in the estimator graph, filled by the offsets of this module.
        arrays: what a step reads, as one pointer.
        ages: offset of the ages of the estimates in `vector`.
    """

    __slots__ = ("ages", "arrays", "vector")

    def __init__(self, neighbours: int, near: Array) -> None:
        self.ages = ESTIMATES + ODOMETRY_SIZE * neighbours
        self.vector = np.zeros(self.ages + neighbours)
        self.vector[[PARENT_AGE, LEADER_AGE, NEAR_AGE]] = NEVER_RECEIVED_S
        self.vector[self.ages :] = NEVER_RECEIVED_S
        self.vector[MODE] = MODE_HOLD
        self.near = near

    @property
    def near(self) -> Array:
        """Near objects (M, 8), as in AgentInputs; an array of another layout or type is converted."""
        return self.arrays.near

    @near.setter
    def near(self, near: Array) -> None:
        near = np.ascontiguousarray(near, dtype=np.float64)
        estimates = self.vector[ESTIMATES : self.ages].reshape(-1, ODOMETRY_SIZE)
        self.arrays = referred(_Arrays(self.vector, estimates, near))

    @classmethod
    def pack(cls, inputs: AgentInputs) -> PackedInputs:
        """The vector of `inputs`."""
        packed = cls(len(inputs.estimates), inputs.near)
        for (name, width), at in zip(INPUT_WIDTHS.items(), offsets(INPUT_WIDTHS), strict=False):
            packed.vector[at : at + width] = getattr(inputs, name)
        packed.arrays.estimates[:] = inputs.estimates
        packed.vector[packed.ages :] = inputs.estimate_age_s
        return packed

    def unpack(self) -> AgentInputs:
        """The named inputs; their arrays are views."""
        return _unpack(self.arrays)


class PackedOutputs:
    """Outputs of a step, see `AgentOutputs`.

    Attributes:
        vector: (37,) all of them; the other attributes are parts of it.
        velocity: (4,) velocity setpoint [m/s, ENU] and yaw rate [rad/s].
        wrench: (6,) force and torque [N], [N m], body FLU.
        leader_estimate: (13,) odometry vector, velocities in the world frame.
        reported: (3,) velocity [m/s, body FLU] that the neighbours are told.
    """

    __slots__ = ("_diagnostics", "leader_estimate", "reported", "vector", "velocity", "wrench")

    def __init__(self, vector: Array) -> None:
        self.vector = vector
        self.velocity = vector[_VELOCITY:_WRENCH]
        self.wrench = vector[_WRENCH:_ESTIMATE]
        self.leader_estimate = vector[_ESTIMATE:_REPORTED]
        self.reported = vector[_REPORTED:_DIAGNOSTICS]
        self._diagnostics = vector[_DIAGNOSTICS:]

    @property
    def diagnostics(self) -> AgentDiagnostics:
        """Diagnostics of the step."""
        return load_diagnostics(self._diagnostics)


@inline_kernel
def _unpack(inputs: _Arrays) -> AgentInputs:
    vector, estimates = inputs.vector, inputs.estimates
    return AgentInputs(
        odometry_tuple(vector[OWN:PARENT]),
        odometry_tuple(vector[PARENT:LEADER]),
        vector[PARENT_AGE],
        odometry_tuple(vector[LEADER:PARENT_AGE]),
        vector[LEADER_AGE],
        estimates,
        vector[ESTIMATES + ODOMETRY_SIZE * estimates.shape[0] :],
        inputs.near,
        vector[NEAR_AGE],
        int(vector[MODE]),
        vector[START_AGE],
    )


class _Memory(NamedTuple):
    """One UAV in memory: it stays with the kernels from step to step."""

    configs: Sequence[AgentConfig]  # one
    states: MutableSequence[AgentState]  # one
    out: Array  # `PackedOutputs.vector`


@kernel
def _advance(
    memory: _Memory,
    inputs: _Arrays,
    t: float,
    dt: float,
    guided: Vector3 | None,
    task: TaskGeometry | None,
) -> None:
    states, out = memory.states, memory.out
    received = _unpack(inputs)
    states[0], outputs = step(states[0], received, t, dt, memory.configs[0], guided, task)
    store_outputs(
        outputs,
        out[_VELOCITY:],
        out[_WRENCH:],
        out[_ESTIMATE:],
        out[_REPORTED:],
        out[_DIAGNOSTICS:],
    )


@kernel
def _points(memory: _Memory, inputs: _Arrays, t: float, dt: float) -> TaskPoints:
    return task_points(memory.states[0], _unpack(inputs), t, dt, memory.configs[0])


@inline_kernel
def store_outputs(
    outputs: AgentOutputs,
    velocity: Array,
    wrench: Array,
    estimate: Array,
    reported: Array,
    diagnostics: Array,
) -> None:
    """Write the outputs of a step into vectors of the widths `OUTPUT_WIDTHS`."""
    store3(velocity, 0, outputs.velocity)
    velocity[3] = outputs.yaw_rate
    store3(wrench, 0, outputs.force)
    store3(wrench, 3, outputs.torque)
    store_estimate(estimate, outputs.estimate, outputs.estimate_valid)
    store3(reported, 0, outputs.reported)
    figures = outputs.diagnostics
    store3(diagnostics, ERROR, figures.error)
    diagnostics[GAIN], diagnostics[SINGULAR_VALUE] = figures.gain, figures.singular_value
    diagnostics[ACTIVE_ROWS] = figures.active_rows
    diagnostics[SATURATED] = 1.0 if figures.saturated else 0.0
    diagnostics[HOLDING] = 1.0 if figures.holding else 0.0
    diagnostics[PRIORITY_VIOLATION] = figures.priority_violation
    diagnostics[VELOCITY_ERROR] = figures.velocity_error
    diagnostics[DEADLOCK] = 1.0 if figures.deadlock else 0.0


def load_diagnostics(row: Array) -> AgentDiagnostics:
    """The diagnostics that `store_outputs` has written into (11,)."""
    x, y, z, gain, singular, rows, saturated, holding, violation, error, deadlock = row.tolist()
    limits = int(rows), saturated > 0.0, holding > 0.0
    return AgentDiagnostics((x, y, z), gain, singular, *limits, violation, error, deadlock > 0.0)


def _copied(state: AgentState) -> AgentState:
    """The state with an obstacle memory of its own."""
    return state._replace(obstacle_memory=state.obstacle_memory.copy())


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
        self._outputs = PackedOutputs(np.empty(_OUTPUT_SIZE))
        states = kernel_list([_copied(state)])
        self._memory = referred(_Memory(kernel_list([config]), states, self._outputs.vector))

    @cached_property
    def _own_advance(self) -> Callable[..., None]:
        """`_advance` by our own law and task, without a look at the types of its arguments."""
        empty = PackedInputs(0, np.empty((0, NEAR_COLUMNS)))
        return prepared(_advance, self._memory, empty.arrays, 0.0, 0.0, None, None)

    @property
    def state(self) -> AgentState:
        """State from which the next step starts."""
        return _copied(self._memory.states[0])

    def task_points(self, inputs: PackedInputs, t: float, dt: float) -> TaskPoints:
        """The state at which the step with these inputs evaluates its task."""
        return _points(self._memory, inputs.arrays, t, dt)

    def advance(
        self,
        inputs: PackedInputs,
        t: float,
        dt: float,
        guided: Vector3 | None = None,
        task: TaskGeometry | None = None,
    ) -> PackedOutputs:
        """One tick, see `step`: t [s] since the latest epoch, dt [s] the control period."""
        advance = self._own_advance if guided is None and task is None else _advance
        advance(self._memory, inputs.arrays, t, dt, guided, task)
        return self._outputs

    def step(self, inputs: AgentInputs, t: float, dt: float) -> PackedOutputs:
        """The same with named inputs."""
        return self.advance(PackedInputs.pack(inputs), t, dt)
