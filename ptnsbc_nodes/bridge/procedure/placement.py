"""The place of a vehicle among the others: on the ground before it arms, and in its layer after the formation."""

from __future__ import annotations

import math

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_nodes.bridge.procedure.companions import Companions, Position, StandingPlace
from ptnsbc_nodes.bridge.setpoint.setpoint_guard import SetpointGuard
from ptnsbc_nodes.bridge.state_publisher import StatePublisher
from ptnsbc_nodes.bridge.vehicle_monitor import VehicleMonitor
from ptnsbc_sim.scenario import Scenario

ON_GROUND_M = 0.5
"""A vehicle below this height may still stand on the ground."""

_LOWEST_M = 1.5  # of a layer above the world's ground


class Placement:
    """One vehicle's place by its own odometry, judged by the scenario and by the reports of the others."""

    def __init__(
        self,
        scenario: Scenario,
        uav_id: int,
        awaited: frozenset[int],
        vehicle: VehicleMonitor,
        state_publisher: StatePublisher,
    ) -> None:
        """`awaited`: ids of UAVs whose vehicles must be ready before this one arms."""
        self._mavlink, self._uav_ids, self._uav_id = scenario.mavlink, scenario.uav_ids, uav_id
        self._vehicle, self._state_publisher = vehicle, state_publisher
        self.start = scenario.uav(uav_id).position
        keep_outs_m = {
            other: scenario.keep_out_between(uav_id, other) for other in scenario.uav_ids
        }
        self.companions = Companions(uav_id, awaited, keep_outs_m, scenario.mavlink.climb_spacing_m)

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
        odometry = self._state_publisher.odometry
        return "" if odometry is None else "({:.1f}, {:.1f}, {:.1f}) m".format(*odometry[0:3])

    def misplaced(self) -> str:
        """The reason why the vehicle may not arm where it stands: by the scenario, and by the others."""
        standing = self._standing()
        if standing is None:
            return ""
        away_m = math.dist(standing.position[:2], self.start[:2])
        limit_m = self._mavlink.start_tolerance_m + standing.error_m
        if away_m > limit_m:
            x, y = self.start[:2]
            return (
                f"stands at {self.text}, {away_m:.2f} m from its start ({x:g}, {y:g}) m: expected at most "
                f"{limit_m:.2f} m, see uavs and mavlink.start_tolerance_m"
            )
        return self.companions.too_near(standing)

    def climbs_first(self) -> str:
        """The vehicles that must climb before this one; empty when it may climb."""
        standing = self._standing()
        return "" if standing is None else self.companions.climbs_first(standing)

    def below(self, others: Array) -> str:
        """The reason why it cannot land: another vehicle in the air below it, too close beside to land past it.

        `others` (M, 7): x y z keep-out vx vy vz.
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
        apart_m, last = self._mavlink.abort.layer_m, len(self._uav_ids) - 1
        low_m = max(middle_m - 0.5 * last * apart_m, _LOWEST_M, guard.lowest_m)
        high_m = min(low_m + last * apart_m, guard.highest_m)
        low_m = max(min(low_m, high_m - last * apart_m), _LOWEST_M, guard.lowest_m)
        return low_m + (high_m - low_m) * self._uav_ids.index(self._uav_id) / max(last, 1)

    def _standing(self) -> StandingPlace | None:
        position = self.position
        return None if position is None else StandingPlace(position, self.error_m)
