"""Lock-step of the simulation: which vehicle publishes its next state, and when it moves on by one tick.

A vehicle publishes its state, receives a wrench for it, and steps. A barrier at every tick would leave the machine
idle while the last UAV computes. A barrier is needed only where the world looks at all vehicles at once (near
objects, status, markers): a *meeting*. Between meetings a vehicle moves on as soon as its own wrench is here, so
that no UAV waits for one that does not concern it. The UAVs themselves wait for their neighbours' messages. The
result is the same, bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from ptnsbc_core.types import Array
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm.diagnostics import status_every
from ptnsbc_nodes.comm.graph import LEAD_TICKS
from ptnsbc_nodes.sim.publishers import SimPublishers
from ptnsbc_sim.disturbances.faults import gone
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.world import World


class LockstepScheduler:
    """The tick of each vehicle, and which vehicles may publish their next state.

    Args:
        uav_ids: all vehicles.
        end: the tick at which the flight is over; its state is not published.
        meetings: periods [ticks] at whose multiples all vehicles meet.
    """

    def __init__(self, uav_ids: Iterable[int], end: int, meetings: Sequence[int]) -> None:
        self._at = dict.fromkeys(uav_ids, 0)
        self._unpublished = list(self._at)
        self._slowest = 0
        self._end = end
        self._meetings = tuple(meetings)

    @property
    def slowest(self) -> int:
        """The tick that every vehicle has reached."""
        return self._slowest

    def at(self, uav_id: int) -> int:
        """The tick of one vehicle's state."""
        return self._at[uav_id]

    def awaited(self, uav_id: int) -> bool:
        """True if the state of this UAV is published and its wrench is not here yet."""
        return uav_id not in self._unpublished

    def mark_published(self, uav_id: int) -> None:
        """The state of this UAV is published."""
        self._unpublished.remove(uav_id)

    def step(self, uav_id: int) -> None:
        """The vehicle has moved on by one tick."""
        tick = self._at[uav_id]
        self._at[uav_id] = tick + 1
        self._unpublished.append(uav_id)
        if tick == self._slowest:
            self._slowest = min(self._at.values())

    def due(self) -> list[int]:
        """UAVs whose state may be published now, in the order in which they became ready."""
        return [i for i in self._unpublished if self._may_go(self._at[i])]

    def _may_go(self, tick: int) -> bool:
        for period in self._meetings:
            if tick % period == 0:
                return (
                    tick == self._slowest
                )  # no vehicle passes a meeting before the last one arrives
        return tick < self._end and tick <= self._slowest + LEAD_TICKS


class StatePublished(NamedTuple):
    """The states of some vehicles were published."""

    tick: int
    together: bool  # of all vehicles, at a tick at which the status is due


class LockstepWorld:
    """The vehicles of `world` in lock-step; a vehicle whose UAV is lost stays where it is."""

    def __init__(self, scenario: Scenario, world: World, publishers: SimPublishers) -> None:
        self._world = world
        self._publishers = publishers
        self._period_ns = scenario.timing.dt_ns
        self._status_every = status_every(scenario)
        self._scheduler = LockstepScheduler(
            world.ids, scenario.timing.ticks, (scenario.near_every, self._status_every)
        )
        self._lost: set[int] = set()
        silent = gone(scenario, ("restart",))
        self._silent = {uav: silent[:, row] for row, uav in enumerate(scenario.uav_ids)}
        self._next_clock_tick = 0
        self.wrenches = 0

    def on_wrench(self, uav_id: int, wrench: Stamped) -> bool:
        """Take the wrench (6,) of one UAV; returns whether its vehicle waits for it."""
        scheduler = self._scheduler
        if (
            not scheduler.awaited(uav_id)
            or wrench.stamp_ns != scheduler.at(uav_id) * self._period_ns
        ):
            return False
        self._step(uav_id, wrench.values)
        self.wrenches += 1
        return True

    def slowest(self) -> list[int]:
        """UAVs whose wrench is missing at the earliest tick."""
        scheduler = self._scheduler
        awaited = [i for i in self._world.ids if scheduler.awaited(i)]
        first = min((scheduler.at(i) for i in awaited), default=0)
        return [i for i in awaited if scheduler.at(i) == first]

    def lose(self, uav_id: int) -> None:
        """Stop waiting for this UAV, whose process has ended."""
        self._lost.add(uav_id)
        if self._scheduler.awaited(uav_id):
            self._step(uav_id, None)

    def publish_clock(self, tick: int) -> None:
        """Publish the time of every tick up to this one, each once."""
        for k in range(self._next_clock_tick, tick + 1):
            self._publishers.clock(k * self._period_ns)
            self._next_clock_tick = k + 1

    def publish_due(self) -> StatePublished | None:
        """Publish the states that may be published now; None if there are none."""
        due = self._scheduler.due()
        if not due:
            return None
        tick = 0
        for i in due:
            tick = self._scheduler.at(i)
            self._publishers.vehicle(i, tick, tick * self._period_ns)
            self._scheduler.mark_published(i)
        together = tick % self._status_every == 0
        if together:
            self._publishers.markers(tick * self._period_ns)
        for i in due:
            if i in self._lost or self._silent[i][self._scheduler.at(i)]:
                self._step(i, None)
        return StatePublished(tick, together)

    def _step(self, uav_id: int, wrench: Array | None) -> None:
        self._world.step_one(uav_id, wrench)
        self._scheduler.step(uav_id)
