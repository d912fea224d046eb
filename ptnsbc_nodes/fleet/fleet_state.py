"""What a fleet does as a whole: every UAV's place, mode and complaint, from the messages that it sends anyway."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ptnsbc_core.curves.trajectory import reference_positions
from ptnsbc_core.types import Array
from ptnsbc_io.wire import Diagnostics, HeaderFields, Stamped
from ptnsbc_nodes.comm.legs import FIRST_LEG, Epochs, Leg
from ptnsbc_nodes.comm.slots import DecidedSlots, Decision
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.build import leader_trajectory, places_beside_leader
from ptnsbc_sim.scenario.slots import with_slots

STALE_S = 1.0
"""A UAV without a status for so long is silent; five come in a second."""


@dataclass
class UavReport:
    """A UAV by its newest messages."""

    id: int
    level: int = 0  # of DiagnosticStatus
    reason: str = "nothing was heard"
    mode: str = ""
    ready: bool = False
    avoidance_active_s: float = 0.0
    holding_s: float = 0.0
    vehicle: str = ""  # what its bridge does
    position: tuple[float, ...] | None = None  # [m], ENU
    heard_s: float = -math.inf  # of its status, by the steady clock


class FleetReport:
    """The newest messages of a fleet, and what follows from them."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self.leader = scenario.leader_id
        self.epochs = Epochs()
        self.slots = DecidedSlots(scenario)
        self.uavs = {uav: UavReport(uav) for uav in scenario.uav_ids}
        self.now_ns = -1  # time of the flight

    def on_epoch(self, leg: HeaderFields) -> None:
        """A leg was announced."""
        self.epochs.announce(leg.stamp_ns, leg.frame_id)

    def on_slots(self, decision: Decision) -> None:
        """It was decided who takes which slot."""
        self.slots.keep(decision)

    def on_odometry(self, uav: int, own: Stamped) -> None:
        """A UAV told where it is; the leader's clock is the time of the flight."""
        self.uavs[uav].position = tuple(float(number) for number in own.values[:3])
        if uav == self.leader:
            self.now_ns = own.stamp_ns

    def on_status(self, array: Diagnostics, now_s: float) -> None:
        """A UAV or a bridge told how it is; `now_s` is of the steady clock."""
        for status in array.statuses:
            name = status.name.partition(":")[0]
            kind, number = name.rstrip("0123456789"), name.lstrip("abcdefghijklmnopqrstuvwxyz")
            uav = self.uavs.get(int(number)) if number.isdecimal() and len(number) < 6 else None
            if uav is None or status.level > 3:
                continue
            if kind == "bridge":
                uav.vehicle = status.values.get("step", "")
            elif kind == "uav":
                uav.level, uav.reason, uav.heard_s = status.level, status.message, now_s
                uav.mode = status.values.get("mode", "")
                uav.ready = status.values.get("ready") == "true"
                uav.avoidance_active_s = _number(status.values.get("avoidance_active_s"))
                uav.holding_s = _number(status.values.get("holding_s"))

    @property
    def leg(self) -> Leg | None:
        """The leg in force."""
        return self.epochs.at(self.now_ns)

    @property
    def predefined_time_s(self) -> float:
        """Time from the epoch of the leg in force until the formation must be in place [s]; 0: it has no such time."""
        leg = self.leg
        if leg is None or leg.name != FIRST_LEG:
            return 0.0
        return float(self._scenario.file.gains.formation.deadline_s)

    def share_of_time(self) -> float:
        """Share of the predefined time that has passed, 0 to 1."""
        leg, time_s = self.leg, self.predefined_time_s
        if leg is None or time_s <= 0.0:
            return 0.0
        return min((self.now_ns - leg.t0_ns) * 1e-9 / time_s, 1.0)

    def errors_m(self) -> dict[int, float]:
        """Distance of each UAV from its place [m], as the verdict has it: the leader's from its path.

        Empty outside of a leg in formation; without the UAVs whose place is not known.
        """
        leg = self.leg
        leader = self.uavs[self.leader].position
        if leg is None or leg.name != FIRST_LEG or leader is None:
            return {}
        slots = self.slots.of(leg.t0_ns)
        flown = with_slots(self._scenario, slots) if slots else self._scenario
        times = np.array([(self.now_ns - leg.first_t0_ns) * 1e-9])
        found = {}
        for uav, report in self.uavs.items():
            if report.position is None:
                continue
            if uav == flown.leader_id:
                goal: Array = reference_positions(leader_trajectory(flown), times)[0]
            else:
                goal = np.asarray(leader) + places_beside_leader(flown, uav, times)[0]
            found[uav] = float(np.linalg.norm(np.asarray(report.position) - goal))
        return found

    def is_silent(self, uav: int, now_s: float) -> bool:
        """Whether nothing was heard of a UAV for `STALE_S`."""
        return now_s - self.uavs[uav].heard_s > STALE_S

    def not_in_place(self, errors: dict[int, float], now_s: float) -> list[int]:
        """UAVs outside of the tolerance of the scenario, and silent ones; none outside of a leg in formation."""
        if self.leg is None or self.leg.name != FIRST_LEG:
            return []
        limit_m = self._scenario.file.formation.tolerance_m
        return [
            uav
            for uav in self.uavs
            if self.is_silent(uav, now_s) or not errors.get(uav, math.inf) <= limit_m
        ]


def _number(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return math.nan
