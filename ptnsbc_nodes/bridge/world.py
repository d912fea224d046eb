"""Where a vehicle's local frame lies in the world frame that the fleet shares."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink import frames
from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_nodes.bridge.vehicle import Anchor
from ptnsbc_sim.scenario import Scenario


class WorldFrame:
    """Offset of a vehicle's local origin, from a survey or from GPS.

    Without `mavlink.world_origin` the leader tells where the world is: it stands at its start in the
    scenario, on the ground, when its position is first known. Its bridge tells the others.
    """

    def __init__(self, scenario: Scenario, uav_id: int, earth_radius_m: float) -> None:
        block = scenario.mavlink
        self._radius_m = earth_radius_m
        self._leads = uav_id == scenario.leader_id
        self._on_ground = block.height == "ground"
        surveyed = scenario.vehicle_link(uav_id).origin_m
        self._surveyed = None if surveyed is None else np.array(surveyed, dtype=np.float64)
        self._start = scenario.uav(scenario.leader_id).position * np.array([1.0, 1.0, 0.0])
        self._reference: GeoPoint | None = None
        self._reference_enu = np.zeros(3)
        if block.world_origin is not None:
            given = block.world_origin
            self._reference = GeoPoint(given.latitude_deg, given.longitude_deg, given.altitude_m)
        self._given = self._reference is not None
        self._anchor: Anchor | None = None
        self._ground_z_m: float | None = None
        self._frozen = False
        self.offset: Array | None = None
        """World position of the local origin (3,) [m], ENU; None while it is not known."""

    @property
    def needs_leader(self) -> bool:
        """Whether the leader's bridge has to tell where the world is."""
        return not (self._given or self._leads or self._surveyed is not None)

    def leader_at(self, place: GeoPoint) -> None:
        """Where on the Earth the leader stands, that is, where the world has its start."""
        if not self._given:
            self._reference, self._reference_enu = place, self._start
            self._update()

    def stands(self, local_enu: Array) -> GeoPoint | None:
        """The leader's place on the Earth, to tell the others; it is taken once, and by the leader alone."""
        if self._given or not self._leads or self._anchor is None or self._reference is not None:
            return None
        away = local_enu - self._anchor.local_enu
        place = frames.place_at(away, self._anchor.place, self._radius_m)
        self.leader_at(place)
        return place

    def vehicle_at(self, anchor: Anchor | None) -> None:
        """Where this vehicle's local frame is on the Earth."""
        if anchor is None or anchor is self._anchor:
            return
        self._anchor = anchor
        self._update()

    def stands_at(self, local_z_m: float) -> None:
        """Height that the vehicle shows while it stands on the ground."""
        if self._on_ground and not (self._frozen and self.offset is not None):
            self._ground_z_m = local_z_m
            self._update()

    def freeze(self) -> None:
        """From arming on the world must not move."""
        self._frozen = True

    @property
    def lack(self) -> str:
        """What is missing, empty when nothing is."""
        if self.offset is not None:
            return ""
        if self._surveyed is None and self._anchor is None:
            return "the vehicle's GPS_GLOBAL_ORIGIN, or mavlink.vehicles.N.origin_m"
        if self._reference is None and self._surveyed is None:
            return "the place of the leader"
        return "the height of the ground"

    def _update(self) -> None:
        if self._frozen and self.offset is not None:
            return
        offset = self._surveyed
        if offset is None:
            if self._anchor is None or self._reference is None:
                return
            away = frames.offset_enu(self._anchor.place, self._reference, self._radius_m)
            offset = self._reference_enu + away - self._anchor.local_enu
        offset = offset.copy()
        if self._on_ground:
            if self._ground_z_m is None:
                return
            offset[2] = -self._ground_z_m
        self.offset = offset

    def begin(self) -> None:
        """For a surveyed vehicle there is nothing to wait for."""
        if self._surveyed is not None:
            self._update()
