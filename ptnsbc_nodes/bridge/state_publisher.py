"""The vehicle's state as odometry of the UAV: in the world frame, on our clock, and fresh or not at all."""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.timesync import TimeSync
from ptnsbc_nodes.bridge.controller import ControllerSetpoints, PublishedOdometry
from ptnsbc_nodes.bridge.ports import BridgePorts
from ptnsbc_nodes.bridge.pose import VehicleState
from ptnsbc_nodes.bridge.truth import place_of, true_odometry
from ptnsbc_nodes.bridge.vehicle import VehicleMonitor
from ptnsbc_nodes.bridge.world import WorldFrame

_OLDEST_S = 0.3  # a controller that flies by an older state flies into the past
_AHEAD_S = 0.05  # a clock that is a little fast
_FRESH_S = 0.5
_HEARTBEAT_S = 3.0
_STEP_NS = 1000
_JUMP_BACK_NS = 50_000_000


class SharedVehicleState(NamedTuple):
    """The odometry of this vehicle that the formation has received."""

    messages: int  # odometry
    stamp_ns: int  # of the newest


class StatePublisher:
    """Decides which states of the vehicle are published, and remembers them for the replies."""

    def __init__(
        self,
        vehicle: VehicleMonitor,
        world: WorldFrame,
        sync: TimeSync,
        controller: ControllerSetpoints,
        ports: BridgePorts,
    ) -> None:
        self._vehicle = vehicle
        self.world = world
        self._sync = sync
        self._controller = controller
        self._ports = ports
        self.odometry: Array | None = None  # newest (13,), world frame
        self.sampled_s = float("-inf")  # of it, on the steady clock
        self._local_position: Array | None = None  # (3,) in the vehicle's own frame
        self._ground_m = 0.0
        self._stamp_ns = 0
        self.shared = SharedVehicleState(0, 0)
        self._published_s = float("-inf")
        self._clock_fault_s = float("-inf")
        self.dropped: Counter[str] = Counter(old=0, skewed=0)
        self._present = True

    @property
    def height_m(self) -> float:
        """Height above the place of arming."""
        return 0.0 if self.odometry is None else float(self.odometry[2]) - self._ground_m

    @property
    def height_over_world_m(self) -> float:
        """Height in the world."""
        return 0.0 if self.odometry is None else float(self.odometry[2])

    @property
    def speed_m_s(self) -> float:
        """Speed of the vehicle."""
        if self.odometry is None:
            return 0.0
        return float(np.sqrt(self.odometry[7:10] @ self.odometry[7:10]))

    def clock_jumped(self, now_s: float) -> bool:
        """True if the vehicle's clock did not fit ours just now."""
        return now_s - self._clock_fault_s < _FRESH_S

    def fault(self, now_s: float) -> str:
        """The reason why the vehicle's state is not published; empty when it is."""
        vehicle = self._vehicle
        silence = vehicle.heartbeat_age_s(now_s)
        if silence > _HEARTBEAT_S:
            return f"no heartbeat for {silence:.1f} s"
        if vehicle.fix_lost(now_s):
            return "GPS fix lost"
        position_s = vehicle.pose.position_s
        if position_s is None or now_s - position_s > _FRESH_S:
            return "no LOCAL_POSITION_NED or ODOMETRY from the vehicle"
        if self.world.missing:
            return f"the world frame lacks {self.world.missing}"
        if not self._sync.ready(now_s):
            return "no answers to TIMESYNC yet"
        if self.clock_jumped(now_s):
            return "the vehicle's clock jumped"
        fresh = now_s - self._published_s < _FRESH_S
        return "" if fresh else "no valid, fresh state from the vehicle"

    def update_world(self) -> None:
        """Locate the world frame until the vehicle is armed; the leader's bridge publishes the place."""
        world, vehicle = self.world, self._vehicle
        world.vehicle_at(vehicle.anchor)
        if self._local_position is not None:
            place = world.define_by_leader(self._local_position)
            if place is not None:
                self._ports.outputs.origin(place)
        if self._ports.inputs.leader_origin is not None:
            world.leader_at(self._ports.inputs.leader_origin)
        if vehicle.armed:
            world.freeze()
        elif self.odometry is not None:
            self._ground_m = float(self.odometry[2])

    def report_presence(self, present: bool) -> None:
        """Report the vehicle as lost, once each time it leaves the formation."""
        if self._present and not present:
            self._ports.outputs.lost()
        self._present = present

    def on_state(self, state: VehicleState, in_formation: bool) -> None:
        """Publish a new state, if all about it is known and nothing is wrong with it."""
        clocks, vehicle = self._ports.clocks, self._vehicle
        now_s = clocks.steady_s()
        self._sync.on_boot_time(state.boot_s, now_s)
        self._local_position = state.odometry[0:3].copy()
        self.world.on_height(float(state.odometry[2]))
        offset = self.world.offset
        if (
            offset is None
            or not self._sync.ready(now_s)
            or vehicle.heartbeat_age_s(now_s) > _HEARTBEAT_S
            or vehicle.fix_lost(now_s)
        ):
            return
        sampled_s = self._sync.to_host_time(state.boot_s)
        if sampled_s is None or not self._timely(now_s - sampled_s, now_s):
            return
        odometry = state.odometry.copy()
        # The state is carried to the present with its own velocity, as a UAV does with its neighbours'
        # states. Compared with those at an older instant, the vehicle would fly that little ahead of its place.
        age_s = max(now_s - sampled_s, 0.0)
        odometry[0:3] += offset + age_s * np.array(velocity_enu(odometry))
        self.odometry, self.sampled_s = odometry, min(sampled_s, now_s)
        stamp_ns = self._stamp(clocks.ros_ns())
        self._published_s = now_s
        published = PublishedOdometry(self.sampled_s, now_s, odometry)
        self._controller.remember(stamp_ns, published)
        if in_formation:
            self._ports.outputs.odom(stamp_ns, odometry)
            self.shared = SharedVehicleState(self.shared.messages + 1, stamp_ns)
        else:
            self._ports.outputs.track(stamp_ns, odometry)

    def on_truth(self, message: Any) -> None:
        """Publish where a simulated vehicle really is, for the verdict alone."""
        position = self.world.true_position(place_of(message))
        odometry = None if position is None else true_odometry(message, position)
        if odometry is not None:
            self._ports.outputs.truth(self._ports.clocks.ros_ns(), odometry)

    def _timely(self, age_s: float, now_s: float) -> bool:
        if -_AHEAD_S <= age_s <= _OLDEST_S:
            return True
        if age_s < 0.0 or age_s > 2 * _OLDEST_S:
            self.dropped["skewed"] += 1
            self._clock_fault_s = now_s
        else:
            self.dropped["old"] += 1
        return False

    def _stamp(self, stamp_ns: int) -> int:
        """A stamp later than the last, unless the wall clock itself was set back."""
        behind = self._stamp_ns - stamp_ns
        if 0 <= behind < _JUMP_BACK_NS:
            stamp_ns = self._stamp_ns + _STEP_NS
        self._stamp_ns = stamp_ns
        return stamp_ns
