"""Lock-step as the sim plays it: a vehicle is told its state, answers with a wrench, and moves on by one tick."""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.types import Array
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm.diagnostics import status_every
from ptnsbc_nodes.sim.lockstep_scheduler import LockstepScheduler
from ptnsbc_nodes.sim.publishers import SimPublishers
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.world import World


class StatePublished(NamedTuple):
    """Some vehicles have been told their state."""

    tick: int
    together: bool  # all of them, at the same tick, which is one of those where the status is due


class LockstepWorld:
    """The vehicles of `world` and their turns; who is lost stays where it is."""

    def __init__(self, scenario: Scenario, world: World, senses: SimPublishers) -> None:
        self._world = world
        self._senses = senses
        self._period_ns = scenario.dt_ns
        self._status_every = status_every(scenario)
        self._turns = LockstepScheduler(
            world.ids, scenario.ticks, (scenario.near_every, self._status_every)
        )
        self._lost: set[int] = set()
        self._time_told = 0  # ticks
        self.answers = 0

    def answer(self, uav_id: int, wrench: Stamped) -> bool:
        """Take the wrench (6,) of one UAV; False when it is not the one that the vehicle waits for."""
        turns = self._turns
        if not turns.awaited(uav_id) or wrench.stamp_ns != turns.at(uav_id) * self._period_ns:
            return False
        self._step(uav_id, wrench.values)
        self.answers += 1
        return True

    def slowest(self) -> list[int]:
        """Those that have been told their state and have not answered, at the earliest tick of all."""
        turns = self._turns
        awaited = [i for i in self._world.ids if turns.awaited(i)]
        first = min((turns.at(i) for i in awaited), default=0)
        return [i for i in awaited if turns.at(i) == first]

    def lose(self, uav_id: int) -> None:
        """Wait for this UAV no longer: its process has ended."""
        self._lost.add(uav_id)
        if self._turns.awaited(uav_id):
            self._step(uav_id, None)

    def tell_time(self, tick: int) -> None:
        """Tell every tick up to this one that has not been told."""
        for k in range(self._time_told, tick + 1):
            self._senses.time(k * self._period_ns)
            self._time_told = k + 1

    def tell(self) -> StatePublished | None:
        """Tell everybody whose turn it is; None if it is nobody's."""
        due = self._turns.due()
        if not due:
            return None
        tick = 0
        for i in due:
            tick = self._turns.at(i)
            self._senses.vehicle(i, tick, tick * self._period_ns)
            self._turns.tell(i)
        together = tick % self._status_every == 0
        if together:
            self._senses.picture(tick * self._period_ns)
        for i in self._lost.intersection(due):
            self._step(i, None)
        return StatePublished(tick, together)

    def _step(self, uav_id: int, wrench: Array | None) -> None:
        self._world.step_one(uav_id, wrench)
        self._turns.step(uav_id)
