"""One UAV's control step with what it remembers: a UAV process and a re-run of its bag call the same.

No ROS in here.
"""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.agent import Agent, PackedOutputs
from ptnsbc_core.types import MODE_HOLD, AgentConfig, AgentState, Array
from ptnsbc_nodes.comm.graph import Senders
from ptnsbc_nodes.comm.legs import Leg
from ptnsbc_nodes.uav.counters import UavCounters
from ptnsbc_nodes.uav.inbox import Inbox


class StepTime(NamedTuple):
    """When a step is made, how long it lasts, and on which leg."""

    now_ns: int
    elapsed_ns: int  # since the previous step: whole control periods
    mode: int  # MODE_*
    t0_ns: int  # epoch of the leg, or when the process began
    first_t0_ns: int  # epoch of the first leg
    flying: bool  # a leg is in force: the step counts


def moment(now_ns: int, elapsed_ns: int, leg: Leg | None, born_ns: int) -> StepTime:
    """The step at `now_ns`; before the first leg the UAV hovers where it is."""
    if leg is None:
        return StepTime(now_ns, elapsed_ns, MODE_HOLD, born_ns, born_ns, False)
    return StepTime(now_ns, elapsed_ns, leg.mode, leg.t0_ns, leg.first_t0_ns, True)


class VehicleSpeedLimits(NamedTuple):
    """Constants that do not follow from the scenario alone: a vehicle may allow less."""

    max_speed: float  # [m/s]
    max_acceleration: float  # [m/s^2]

    def on(self, config: AgentConfig) -> AgentConfig:
        """The constants with these limits in place."""
        return config._replace(filter=config.filter._replace(**self._asdict()))


class UavController:
    """Inbox, control law and counters of one UAV."""

    def __init__(self, config: AgentConfig, senders: Senders) -> None:
        self.config = config
        self.inbox = Inbox(senders)
        self.tally = UavCounters()
        self.steps = 0  # since the agent began
        self._agent: Agent | None = None
        self._flown = config  # what the agent began with

    @property
    def limits(self) -> VehicleSpeedLimits:
        """What of the constants may be set by the vehicle, as the agent flies with it."""
        flown = self._flown.filter
        return VehicleSpeedLimits(flown.max_speed, flown.max_acceleration)

    @property
    def state(self) -> AgentState:
        """What the next step starts from; there must have been one."""
        if self._agent is None:
            raise ValueError("state asked for before the first step")
        return self._agent.state

    def restart(self) -> None:
        """Forget all steps: the next one begins where the vehicle is then."""
        self._agent = None

    def resume(self, state: AgentState, counters: Array) -> None:
        """Go on from what another pilot remembered."""
        self._agent = Agent.resumed(self.config, state)
        self.tally.restore(counters)
        self._flown = self.config

    def step(self, at: StepTime, cutoff_ns: int) -> PackedOutputs:
        """One control step on what the inbox holds; the own odometry must be there."""
        start_age_s = (at.now_ns - at.first_t0_ns) * 1e-9
        known = self.inbox.known(at.now_ns, cutoff_ns, at.mode, start_age_s)
        if self._agent is None:
            self._agent = Agent(self.config, known.unpack().own)
            self._flown = self.config
            self.steps = 0
        self.steps += 1
        dt = at.elapsed_ns * 1e-9
        told = self._agent.advance(known, (at.now_ns - at.t0_ns) * 1e-9, dt)
        if at.flying:
            self.tally.add(told.diagnostics, dt)
        return told
