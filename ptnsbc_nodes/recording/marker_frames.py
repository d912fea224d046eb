"""/formation/markers for a bag of real vehicles, where no simulator draws: made of the odometry that is recorded."""

from __future__ import annotations

from ptnsbc_core.types import Array
from ptnsbc_io.wire import WireError, decode_odometry
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.diagnostics import STATUS_HZ
from ptnsbc_nodes.comm.markers import Scene
from ptnsbc_sim.scenario import Scenario

_PERIOD_NS = 10**9 // STATUS_HZ


class MarkerFrames:
    """One picture at the first odometry of the leader in each period, once everybody has been heard."""

    def __init__(self, scenario: Scenario) -> None:
        self.ids = scenario.uav_ids
        self._uav = {topics.odom(uav).name: uav for uav in self.ids}
        self._leader = scenario.leader_id
        self._newest: dict[int, Array] = {}
        self._period = -1
        # Only `ids` and `odometry` of a World are read.
        self._scene = Scene(scenario, self)  # type: ignore[arg-type]

    def odometry(self, uav_id: int) -> Array:
        """Newest odometry vector (13,) of one UAV."""
        return self._newest[uav_id]

    def of(self, topic: str, data: bytes) -> bytes | None:
        """The MarkerArray to record beside a message, None when none is due."""
        uav = self._uav.get(topic)
        if uav is None:
            return None
        try:
            stamp_ns, self._newest[uav] = decode_odometry(data)
        except WireError:  # foreign and broken: it has no place
            return None
        period = stamp_ns // _PERIOD_NS
        if uav != self._leader or period == self._period or len(self._newest) < len(self.ids):
            return None
        self._period = period
        return self._scene.markers(stamp_ns)
