"""The other vehicles before the flight: whether all are ready, armed, and stand where they may climb.

Bridges report to each other on /diagnostics. No vehicle arms before all are ready, and none climbs before all are
armed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_nodes.bridge.procedure.steps import OVER, Companion, Position, Step
from ptnsbc_nodes.bridge.setpoint.setpoint_guard import SetpointGuard
from ptnsbc_nodes.bridge.state_publisher import StatePublisher
from ptnsbc_nodes.bridge.vehicle_monitor import VehicleMonitor
from ptnsbc_sim.scenario import Scenario

HEARD_S = 2.0
"""A report that is older does not count."""

_UP = (Step.TAKEOFF, Step.AIRBORNE, Step.FLY)
_ARMED = frozenset(step.value for step in (Step.ARMED, *_UP))
_READY = frozenset(step.value for step in (Step.READY, Step.ARM, Step.ARMED, *_UP))
_OUT = frozenset(step.value for step in (*OVER, Step.LAND, Step.RETURN, Step.YIELDED, Step.DISARM))
_CLEAR_M = 1.5  # a vehicle so high above the ground has left room for the next one to lift off


ON_GROUND_M = 0.5
"""A vehicle below this height may still stand on the ground."""

_LOWEST_M = 1.5  # of a layer above the world's ground


class Placement:
    """One vehicle's place by its own odometry, among those that the bridges of the others report."""

    def __init__(
        self,
        scenario: Scenario,
        uav_id: int,
        awaited: frozenset[int],
        vehicle: VehicleMonitor,
        state_publisher: StatePublisher,
    ) -> None:
        """`awaited`: ids of UAVs whose vehicles must be ready before this one arms; others count once heard."""
        self._scenario, self._mavlink, self._uav_id = scenario, scenario.mavlink, uav_id
        self._vehicle, self._state_publisher = vehicle, state_publisher
        self._awaited = awaited - {uav_id}
        self._heard: dict[int, tuple[Companion, float]] = {}
        self.start = scenario.uav(uav_id).position

    def report(self, uav_id: int, companion: Companion, now_s: float) -> None:
        """Take the report of another bridge."""
        if uav_id != self._uav_id:
            self._heard[uav_id] = (companion, now_s)

    def not_ready(self, now_s: float) -> str:
        """The vehicles that are not ready to arm; empty when all are."""
        return ", ".join(self._missing(_READY, now_s))

    def not_armed(self, now_s: float) -> str:
        """The vehicles that are not armed; empty when all are."""
        return ", ".join(self._missing(_ARMED, now_s))

    def out(self) -> str:
        """The vehicles that will not fly, and why; empty while all may."""
        for uav_id, (companion, _) in sorted(self._heard.items()):
            if companion.step in _OUT:
                why = f": {companion.fault}" if companion.fault else ""
                return f"bridge{uav_id} {companion.step}{why}"
        return ""

    @property
    def position(self) -> Position | None:
        """The last known position in the world [m]; None while none is known."""
        odometry = self._state_publisher.odometry
        return None if odometry is None else tuple(map(float, odometry[0:3]))  # type: ignore[return-value]

    @property
    def error_m(self) -> float:
        """Uncertainty of the position, horizontally."""
        error_m = self._vehicle.gnss.error_m
        return self._mavlink.position_error_m if error_m is None else error_m

    @property
    def text(self) -> str:
        """The position in words; empty while none is known."""
        position = self.position
        return "" if position is None else "({:.1f}, {:.1f}, {:.1f}) m".format(*position)

    def inexact(self) -> str:
        """The reason why its position is not known well enough for the scenario; empty when it is."""
        others = set(self._scenario.uav_ids) - {self._uav_id}
        keep_outs_m = (self._scenario.keep_out_between(self._uav_id, uav) for uav in others)
        keep_out_m = min(keep_outs_m, default=math.inf)
        # Of two that keep their distance one more error must fit in before the formation is given up.
        room_m = (1.0 - self._mavlink.abort.separation_share) * keep_out_m / math.sqrt(2.0)
        tolerance_m = self._scenario.formation.tolerance_m
        if self.error_m <= min(tolerance_m, room_m):
            return ""
        return (
            f"its position is known to {self.error_m:.2f} m: expected at most {min(tolerance_m, room_m):.2f} m, for "
            f"formation.tolerance_m {tolerance_m:g} and a keep-out of {keep_out_m:g} m: a scenario for this receiver, "
            "or a better one (docs/positioning.md)"
        )

    def misplaced(self) -> str:
        """The reason why the vehicle may not arm where it stands: by the scenario, and by the others."""
        position = self.position
        if position is None:
            return ""
        away_m = math.dist(position[:2], self.start[:2])
        limit_m = self._mavlink.start_tolerance_m + self.error_m
        if away_m > limit_m:
            x, y = self.start[:2]
            return (
                f"stands at {self.text}, {away_m:.2f} m from its start ({x:g}, {y:g}) m: expected at most "
                f"{limit_m:.2f} m, see uavs and mavlink.start_tolerance_m"
            )
        for uav_id, _, apart_m, keep_out_m, off_m in self._apart():
            if apart_m < keep_out_m + off_m:
                return (
                    f"stands {apart_m:.2f} m from the vehicle of bridge{uav_id}: expected at least "
                    f"{keep_out_m + off_m:.2f} m, the keep-out of {keep_out_m:g} m and {off_m:.2f} m of position error"
                )
        return ""

    def climbs_first(self) -> str:
        """The vehicles that must climb before this one, because both stand close; empty when it may climb."""
        waits = []
        for uav_id, other, apart_m, keep_out_m, off_m in self._apart():
            close = apart_m < keep_out_m + self._mavlink.climb_spacing_m + off_m
            if uav_id < self._uav_id and close and other.height_m < _CLEAR_M:
                waits.append(f"bridge{uav_id}")
        return ", ".join(waits)

    def _apart(self) -> Iterator[tuple[int, Companion, float, float, float]]:
        """The others: horizontal distance to each, the keep-out from it, and the error of that distance [m]."""
        position, error_m = self.position, self.error_m
        for uav_id, (other, _) in sorted(self._heard.items()):
            if position is not None and other.position is not None:
                apart_m = math.dist(position[:2], other.position[:2])
                keep_out_m = self._scenario.keep_out_between(self._uav_id, uav_id)
                yield uav_id, other, apart_m, keep_out_m, math.hypot(error_m, other.error_m)

    def _missing(self, steps: frozenset[str], now_s: float) -> Iterator[str]:
        for uav_id in sorted(self._awaited | set(self._heard)):
            companion, heard_s = self._heard.get(uav_id, (None, -math.inf))
            if companion is None or now_s - heard_s > HEARD_S:
                yield f"bridge{uav_id} (not heard)"
            elif companion.step not in steps:
                yield f"bridge{uav_id} ({companion.step})"

    def below(self, others: Array) -> str:
        """The reason why it cannot land: another vehicle in the air below it, too close beside to land past it.

        `others` (M, 8): x y z keep-out vx vy vz above.
        """
        odometry = self._state_publisher.odometry
        if odometry is None:
            return ""
        beside_m = others[:, 3] + self._mavlink.climb_spacing_m
        apart_m = np.hypot(others[:, 0] - odometry[0], others[:, 1] - odometry[1])
        blocks = (apart_m < beside_m) & (others[:, 2] < odometry[2]) & (others[:, 2] > ON_GROUND_M)
        return "a vehicle below" if blocks.any() else ""

    def layer_m(self, middle_m: float, guard: SetpointGuard) -> float:
        """The height of this vehicle's layer; all bridges compute the same layers about the leader's height."""
        uav_ids, apart_m = self._scenario.uav_ids, self._mavlink.abort.layer_m
        last = len(uav_ids) - 1
        low_m = max(middle_m - 0.5 * last * apart_m, _LOWEST_M, float(guard.low[2]))
        high_m = min(low_m + last * apart_m, float(guard.high[2]))
        low_m = max(min(low_m, high_m - last * apart_m), _LOWEST_M, float(guard.low[2]))
        return low_m + (high_m - low_m) * uav_ids.index(self._uav_id) / max(last, 1)


def strayed(placement: Placement, start_tolerance_m: float) -> str:
    """The way that the wind, or drift, has carried a vehicle off its start; empty while it is above it."""
    position, limit_m = placement.position, 2.0 * (start_tolerance_m + placement.error_m)
    away_m = 0.0 if position is None else math.dist(position[:2], placement.start[:2])
    if away_m <= limit_m:
        return ""
    return f"carried {away_m:.1f} m off its start before the formation: expected at most {limit_m:.1f} m"
