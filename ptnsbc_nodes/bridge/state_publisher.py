"""The vehicle's state as odometry of the UAV: in the world frame, on our clock, and fresh or not at all."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.timesync import TimeSync
from ptnsbc_nodes.bridge.controller import ControllerSetpoints, PublishedOdometry
from ptnsbc_nodes.bridge.pose import VehicleState
from ptnsbc_nodes.bridge.vehicle import VehicleMonitor
from ptnsbc_nodes.bridge.world import WorldFrame

OLDEST_S = 0.3
"""A state older than this is not forwarded: whoever flies by it flies into the past."""
_AHEAD_S = 0.05  # a clock that is a little fast
_STATE_S = 0.5
_HEARTBEAT_S = 3.0
_STEP_NS = 1000
_JUMP_BACK_NS = 50_000_000


class Clocks(NamedTuple):
    """Ours: one that never jumps, and the one that stamps messages."""

    steady_s: Callable[[], float]
    ros_ns: Callable[[], int]


Publish = Callable[[int, Array], None]


class StatePublisher:
    """Decides what of the vehicle's state is told, and remembers it for the answers."""

    def __init__(
        self,
        vehicle: VehicleMonitor,
        world: WorldFrame,
        sync: TimeSync,
        controller: ControllerSetpoints,
    ) -> None:
        self._vehicle = vehicle
        self._world = world
        self._sync = sync
        self._controller = controller
        self._stamp_ns = 0
        self._told_s = float("-inf")
        self._clock_fault_s = float("-inf")
        self.odometry: Array | None = None  # newest, world frame
        self.old = 0  # states that came too late
        self.newest_local: Array | None = None  # (3,) position in the vehicle's own frame
        self.skewed = 0  # states whose time does not fit our clock

    def suspicious(self, now_s: float) -> bool:
        """Whether the vehicle's clock did not fit just now."""
        return now_s - self._clock_fault_s < _STATE_S

    def fresh(self, now_s: float) -> bool:
        """Whether a state was told just now."""
        return now_s - self._told_s < _STATE_S

    def lack(self, now_s: float) -> str:
        """What keeps the vehicle's state from being told, empty when nothing does."""
        vehicle = self._vehicle
        silence = vehicle.heartbeat_age_s(now_s)
        if silence > _HEARTBEAT_S:
            return f"no heartbeat for {silence:.1f} s"
        if vehicle.fix_lost(now_s):
            return "GPS fix lost"
        position_s = vehicle.pose.position_s
        if position_s is None or now_s - position_s > _STATE_S:
            return "no LOCAL_POSITION_NED or ODOMETRY from the vehicle"
        if self._world.lack:
            return f"the world frame lacks {self._world.lack}"
        if not self._sync.ready(now_s):
            return "no answers to TIMESYNC yet"
        if self.suspicious(now_s):
            return "the vehicle's clock jumped"
        return "" if self.fresh(now_s) else "no valid, fresh state from the vehicle"

    def hear(self, sample: VehicleState, clocks: Clocks, publish: Publish) -> None:
        """Publish a new state, when everything about it is known and nothing speaks against it."""
        now_s = clocks.steady_s()
        self._sync.heard(sample.boot_s, now_s)
        self.newest_local = sample.odometry[0:3].copy()
        self._world.stands_at(float(sample.odometry[2]))
        offset = self._world.offset
        vehicle = self._vehicle
        if (
            offset is None
            or not self._sync.ready(now_s)
            or vehicle.heartbeat_age_s(now_s) > _HEARTBEAT_S
            or vehicle.fix_lost(now_s)
        ):
            return
        sampled_s = self._sync.ours(sample.boot_s)
        if sampled_s is None or not self._timely(now_s - sampled_s, now_s):
            return
        odometry = sample.odometry.copy()
        # Carried to the present with its own velocity, as a UAV does with what its neighbours say:
        # compared with them a little late, it would fly that little ahead of its place.
        age_s = max(now_s - sampled_s, 0.0)
        odometry[0:3] += offset + age_s * np.array(velocity_enu(odometry))
        self.odometry = odometry
        stamp_ns = self._stamp(clocks.ros_ns())
        self._told_s = now_s
        self._controller.tell(stamp_ns, PublishedOdometry(min(sampled_s, now_s), now_s, odometry))
        publish(stamp_ns, odometry)

    def _timely(self, age_s: float, now_s: float) -> bool:
        if -_AHEAD_S <= age_s <= OLDEST_S:
            return True
        if age_s < 0.0 or age_s > 2 * OLDEST_S:
            self.skewed += 1
            self._clock_fault_s = now_s
        else:
            self.old += 1
        return False

    def _stamp(self, stamp_ns: int) -> int:
        """Rising stamps, unless the wall clock itself was set back."""
        behind = self._stamp_ns - stamp_ns
        if 0 <= behind < _JUMP_BACK_NS:
            stamp_ns = self._stamp_ns + _STEP_NS
        self._stamp_ns = stamp_ns
        return stamp_ns
