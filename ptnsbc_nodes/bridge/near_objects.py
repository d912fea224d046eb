"""Near objects of a vehicle without a sensor for them: the scenario's obstacles and the other UAVs.

A bridge receives the odometry of all UAVs: nobody comes too near to it unseen. `mavlink.near` says which of them its
UAV avoids: those that it has an edge with (`links`), or all. Everybody avoids a UAV that has left the formation or has
fallen silent: its vehicle flies on for a while, may have stopped anywhere on that way, and may hover there for good.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import NEAR_COLUMNS, ODOMETRY_SIZE, Array, Odometry
from ptnsbc_sim.plants.build import obstacle_rows
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.sensor import near_objects

_MOVING_S = 0.5
_COASTS_S = 4.0  # ArduCopter follows its last velocity for 3 s, GUID_TIMEOUT, and then brakes
_SILENT_S = 1.0
_MOST_STOPS = 50


class NearObjects:
    """The obstacles, and the newest odometry of the other UAVs."""

    def __init__(self, scenario: Scenario, uav_id: int, linked: Collection[int]) -> None:
        """`linked`: ids of the UAVs that share an edge with this one."""
        self._avoided = frozenset(linked if scenario.mavlink.near == "links" else scenario.uav_ids)
        self._newest: dict[int, tuple[float, Odometry, bool]] = {}
        self._keep_out_m = {uav: scenario.keep_out_between(uav_id, uav) for uav in scenario.uav_ids}
        self._range_m = float(scenario.sensor.range_m)
        self._scenario = scenario
        self._moving = any(one.path is not None for one in scenario.world.bodies)
        self._bodies = obstacle_rows(scenario, np.full(1, -1.0))[0]

    def on_odometry(
        self, uav_id: int, now_s: float, odometry: Array, *, left: bool = False
    ) -> None:
        """Keep the odometry (13,) of another UAV; `left`: it has left the formation."""
        self._newest[uav_id] = (now_s, tuple(odometry.tolist()), left)

    def rows(self, now_s: float, position: Array, mission_s: float = -1.0) -> Array:
        """The rows that its UAV avoids: x y z keep-out vx vy vz above (M, 8) [m, m/s, ENU] within the detection range.

        `position` (3,) is its own [m], `mission_s` counts from the first epoch: before it moving obstacles stand still.
        """
        rows = self._known(now_s, self._avoided | self._out(now_s))
        away = rows[:, 0:3] - position
        near = rows[np.einsum("ij,ij->i", away, away) <= self._range_m**2]
        bodies = self._bodies
        if not len(bodies):
            return near
        if self._moving:
            bodies = obstacle_rows(self._scenario, np.array([mission_s]))[0]
        own = np.zeros((1, ODOMETRY_SIZE))
        own[0, 0:3], own[0, 6] = position, 1.0
        # The obstacles in range, as the simulated sensor tells them.
        return np.vstack([near, near_objects(0, own, bodies, np.zeros((1, 2)), self._range_m)])

    def uavs(self, now_s: float) -> Array:
        """The rows (M, 8) of all other UAVs, at any distance, avoided or not."""
        return self._known(now_s, self._keep_out_m)

    def _out(self, now_s: float) -> set[int]:
        newest = list(self._newest.items())  # a thread adds
        return {uav for uav, (at_s, _, left) in newest if left or now_s - at_s > _SILENT_S}

    def _known(self, now_s: float, which: Collection[int]) -> Array:
        newest = [one for one in list(self._newest.items()) if one[0] in which]
        rows = [
            row
            for uav, (arrived_s, odometry, _) in newest
            for row in self._rows_of(uav, now_s - arrived_s, odometry)
        ]
        return np.array(rows, dtype=np.float64).reshape(-1, NEAR_COLUMNS)

    def _rows_of(self, uav_id: int, age_s: float, odometry: Odometry) -> list[list[float]]:
        """The places where a UAV may be: of a silent one the way that its last velocity has taken it.

        Its vehicle may have stopped anywhere on it, at once or when its failsafe has acted.
        """
        keep_out_m, velocity = self._keep_out_m[uav_id], velocity_enu(odometry)
        way, shares = [min(age_s, _COASTS_S) * speed for speed in velocity], [1.0]
        if age_s > _MOVING_S:
            between_m = 0.5 * keep_out_m  # so that the spheres hold the whole way
            stops = 1 + math.floor(min(math.hypot(*way) / between_m, _MOST_STOPS))
            keep_out_m = math.hypot(keep_out_m, 0.5 * between_m)
            shares = np.linspace(0.0, 1.0, stops + 1).tolist()
        height = self._scenario.formation.keep_out_height
        still = (keep_out_m, 0.0, 0.0, 0.0, keep_out_m * height if height > 1.0 else 0.0)
        path = tuple(zip(odometry[0:3], way, strict=True))
        rows = [[*(at + share * by for at, by in path), *still] for share in shares]
        if age_s < _COASTS_S:
            rows[-1][4:7] = velocity
        return rows
