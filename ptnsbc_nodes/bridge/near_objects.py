"""Near objects of a vehicle without a sensor for them: the scenario's obstacles and the other UAVs.

A bridge receives the odometry of all UAVs: nobody comes too near to it unseen. `mavlink.near` says which of them its
UAV avoids: those that it has an edge with (`links`), or all. A UAV that falls silent stays where it was for a while;
then it is forgotten.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import NEAR_COLUMNS, ODOMETRY_SIZE, Array
from ptnsbc_io.wire import WireError, decode_odometry
from ptnsbc_sim.plants.build import obstacle_rows
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.sensor import near_objects

_MOVING_S = 0.5
_FORGET_S = 5.0


class NearObjects:
    """The obstacles, and the newest odometry of the other UAVs as bytes until it is needed."""

    def __init__(self, scenario: Scenario, uav_id: int, linked: Collection[int]) -> None:
        """`linked`: ids of the UAVs that share an edge with this one."""
        self._avoided = frozenset(linked if scenario.mavlink.near == "links" else scenario.uav_ids)
        self._newest: dict[int, tuple[float, bytes]] = {}
        self._keep_out_m = {uav: scenario.keep_out_between(uav_id, uav) for uav in scenario.uav_ids}
        self._range_m = float(scenario.sensor.range_m)
        self._scenario = scenario
        self._moving = any(one.path is not None for one in scenario.obstacles)
        self._bodies = obstacle_rows(scenario, np.full(1, -1.0))[0]

    def on_odometry(self, uav_id: int, now_s: float, data: bytes) -> None:
        """Keep the odometry of another UAV."""
        self._newest[uav_id] = (now_s, data)

    def rows(self, now_s: float, position: Array, mission_s: float = -1.0) -> Array:
        """The rows that its UAV avoids: x y z keep-out vx vy vz (M, 7) [m, m/s, ENU] within the detection range.

        Args:
            now_s: time of `on_odometry`.
            position: (3,) own position [m].
            mission_s: time since the first epoch [s], negative before it: moving obstacles stand still then.
        """
        rows = self._known(now_s, self._avoided)
        away = rows[:, 0:3] - position
        near = rows[np.einsum("ij,ij->i", away, away) <= self._range_m**2]
        return np.vstack([near, self._obstacles(position, mission_s)])

    def _obstacles(self, position: Array, mission_s: float) -> Array:
        """The rows (M, 7) of the obstacles in range, as the simulated sensor tells them."""
        if not len(self._bodies):
            return self._bodies[:, :NEAR_COLUMNS]
        bodies = self._bodies
        if self._moving:
            bodies = obstacle_rows(self._scenario, np.array([mission_s]))[0]
        own = np.zeros((1, ODOMETRY_SIZE))
        own[0, 0:3], own[0, 6] = position, 1.0
        return near_objects(0, own, bodies, np.zeros(1), self._range_m)

    def uavs(self, now_s: float) -> Array:
        """The rows (M, 7) of all other UAVs, at any distance, avoided or not."""
        return self._known(now_s, self._keep_out_m)

    def _known(self, now_s: float, which: Collection[int]) -> Array:
        newest = [one for one in list(self._newest.items()) if one[0] in which]  # a thread adds
        rows = [self._row(uav, now_s - arrived_s, data) for uav, (arrived_s, data) in newest]
        known = [row for row in rows if row is not None]
        return np.array(known, dtype=np.float64).reshape(-1, NEAR_COLUMNS)

    def _row(self, uav_id: int, age_s: float, data: bytes) -> Array | None:
        if age_s > _FORGET_S:
            return None
        try:
            odometry = decode_odometry(data).values
        except WireError:
            return None
        row = np.zeros(NEAR_COLUMNS)
        row[0:3], row[3] = odometry[0:3], self._keep_out_m[uav_id]
        if age_s <= _MOVING_S:
            row[4:7] = velocity_enu(odometry)
            row[0:3] += age_s * row[4:7]
        return row if np.isfinite(row).all() else None
