"""The vehicles of the simulation in real time: all step at the control rate with the newest wrenches."""

from __future__ import annotations

from collections.abc import Mapping

from ptnsbc_core.types import Array
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.runtime.pacing import Latency, Pace
from ptnsbc_nodes.sim.publishers import SimPublishers
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.world import World

_MAX_CATCH_UP_S = 0.5
_LATE_PERIODS = 2.5  # a wrench in time is one period old, and two where its UAV has missed one tick


class RealTimeWorld:
    """The vehicles of `world` in real time; one keeps its attitude while its wrench is late, and hovers without one.

    Torques are right for a control period. Held for a tenth of a second while a computer is busy, they turn a
    vehicle over; the flight controllers of real ones do not let that happen.
    """

    def __init__(self, scenario: Scenario, world: World, publishers: SimPublishers) -> None:
        self._world = world
        self._publishers = publishers
        self._stale_ns = round(scenario.communication.stale_s * 1e9)
        self._late_ns = round(_LATE_PERIODS * scenario.timing.dt_ns)
        self._dt_ns = scenario.timing.dt_ns
        self._catch_up = max(round(_MAX_CATCH_UP_S * scenario.timing.control_hz), 1)
        self._wrenches: dict[int, Stamped] = {}
        self.pace = Pace(scenario.timing.dt_ns)
        self.latency = Latency()

    def begin(self) -> None:
        """The flight begins: delays by the start of other processes do not count."""
        self.pace.missed = 0
        self.latency = Latency()

    def on_wrench(self, uav_id: int, wrench: Stamped, now_ns: int) -> None:
        """Take the wrench (6,) of one UAV."""
        self._wrenches[uav_id] = wrench
        self.latency.add((now_ns - wrench.stamp_ns) * 1e-9)

    def lose(self, uav_id: int) -> None:
        """Forget the wrench of this UAV, whose process has ended; a process that takes its place flies it again."""
        self._wrenches.pop(uav_id, None)

    def tick(self, now_ns: int) -> None:
        """Step all vehicles to now, and publish their states."""
        periods = min(self.pace.tick(now_ns), self._catch_up)
        fresh = self._fresh(now_ns)
        for left in range(periods - 1, -1, -1):
            self._world.step(self._acting(fresh, now_ns - left * self._dt_ns))
        self._publishers.publish(now_ns)

    def hovering(self, now_ns: int) -> str:
        """The vehicles that hover because their UAVs send no setpoints; empty when none does."""
        fresh = self._fresh(now_ns)
        names = [f"uav{i}" for i in self._world.ids if i not in fresh]
        return f"hovering without setpoints: {' '.join(names)}" if names else ""

    def _acting(self, fresh: Mapping[int, Stamped], at_ns: int) -> dict[int, Array]:
        """The wrenches (6,) of one control period."""
        late = self._world.with_late_setpoint
        return {
            i: late(i, one.values) if at_ns - one.stamp_ns > self._late_ns else one.values
            for i, one in fresh.items()
        }

    def _fresh(self, now_ns: int) -> dict[int, Stamped]:
        return {
            i: wrench
            for i, wrench in self._wrenches.items()
            if now_ns - wrench.stamp_ns <= self._stale_ns
        }
