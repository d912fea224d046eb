"""The place of a vehicle's local frame in the world frame that the fleet shares."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink import frames
from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_nodes.bridge.vehicle import Anchor
from ptnsbc_sim.scenario import Scenario


class WorldFrame:
    """Offset of a vehicle's local origin, from a survey or from GPS.

    Without `mavlink.world_origin` the leader defines the world: when its position is first known, it stands
    on the ground at its start in the scenario. The leader's bridge publishes that place for the others.
    """

    def __init__(
        self, scenario: Scenario, uav_id: int, earth_radius_m: float, *, alone: bool = False
    ) -> None:
        """`alone`: no leader flies; this vehicle defines the world by its own start."""
        settings = scenario.mavlink
        self._radius_m = earth_radius_m
        self._leads = alone or uav_id == scenario.leader_id
        self._on_ground = settings.height == "ground"
        surveyed = scenario.vehicle_link(uav_id).origin_m
        self._surveyed = None if surveyed is None else np.array(surveyed, dtype=np.float64)
        first = uav_id if alone else scenario.leader_id
        self._start = scenario.uav(first).position * np.array([1.0, 1.0, 0.0])
        given = settings.world_origin
        self._given = given is not None
        self._reference = (
            None
            if given is None
            else GeoPoint(given.latitude_deg, given.longitude_deg, given.altitude_m)
        )
        self._anchor: Anchor | None = None
        self._ground_z_m: float | None = None
        self._true_ground_m: float | None = None
        self.frozen = False
        self.offset: Array | None = None
        """World position of the local origin (3,) [m], ENU; None while it is not known."""
        self._update()  # a surveyed vehicle has nothing to wait for

    @property
    def needs_leader(self) -> bool:
        """True if this bridge needs the leader's place."""
        return not (self._given or self._leads or self._surveyed is not None)

    def leader_at(self, place: GeoPoint) -> None:
        """Take the leader's place on the Earth from its bridge."""
        if not self._given and not self._leads:
            self._reference = place
            self._update()

    def define_by_leader(self, local_enu: Array) -> GeoPoint | None:
        """The leader's place on the Earth at its first position (3,) [m]; None for others and afterwards."""
        if not self._leads or self._anchor is None or self._reference is not None:
            return None
        away = local_enu - self._anchor.local_enu
        self._reference = frames.point_at(away, self._anchor.place, self._radius_m)
        self._update()
        return self._reference

    def vehicle_at(self, anchor: Anchor | None) -> None:
        """Take the place of this vehicle's local frame on the Earth."""
        if anchor is not None and anchor is not self._anchor:
            self._anchor = anchor
            self._update()

    def on_height(self, local_z_m: float) -> None:
        """Take the height that the vehicle reports; until the world is frozen it stands on the ground."""
        if self._on_ground and not self._settled:
            self._ground_z_m = local_z_m
            self._update()

    def true_position(self, place: GeoPoint) -> Array | None:
        """World position (3,) [m] of a true place on the Earth; None while the world is not known, or only surveyed.

        With `height: ground` heights count from the place where the vehicle stood last.
        """
        if self._reference is None or self._surveyed is not None:
            return None
        if not self.frozen:
            self._true_ground_m = place.altitude_m
        away = frames.offset_enu(place, self._reference, self._radius_m)
        position = away if self._given else self._start + away
        if self._on_ground:
            if self._true_ground_m is None:
                return None
            position[2] = place.altitude_m - self._true_ground_m
        return np.asarray(position)

    def freeze(self) -> None:
        """Keep the offset from now on: after arming the world must not move."""
        self.frozen = True

    @property
    def missing(self) -> str:
        """The values that the offset lacks; empty when it has all."""
        if self.offset is not None:
            return ""
        if self._surveyed is None and self._anchor is None:
            return "the vehicle's GPS_GLOBAL_ORIGIN, or mavlink.vehicles.N.origin_m"
        if self._reference is None and self._surveyed is None:
            return "the place of the leader"
        return "the height of the ground"

    @property
    def _settled(self) -> bool:
        return self.frozen and self.offset is not None

    def _update(self) -> None:
        if self._settled:
            return
        if self._surveyed is not None:
            offset = self._surveyed.copy()
        elif self._anchor is not None and self._reference is not None:
            away = frames.offset_enu(self._anchor.place, self._reference, self._radius_m)
            reference_enu = np.zeros(3) if self._given else self._start
            offset = reference_enu + away - self._anchor.local_enu
        else:
            return
        if self._on_ground:
            if self._ground_z_m is None:
                return
            offset[2] = -self._ground_z_m
        self.offset = offset
