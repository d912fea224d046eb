"""The vehicle's state as odometry of the UAV: in the world frame, on our clock, and fresh or not at all."""

from __future__ import annotations

import math
from collections import Counter, OrderedDict
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.kinematics import velocity_enu, yaw_of
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink import frames
from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_io.mavlink.timesync import TimeSync
from ptnsbc_io.wire import Stamped, WireError, decode_velocity, decode_wrench
from ptnsbc_nodes.bridge.ports import BridgePorts
from ptnsbc_nodes.bridge.vehicle_monitor import (
    Anchor,
    VehicleMonitor,
    VehicleState,
    place_of,
    true_odometry,
)
from ptnsbc_sim.scenario import Scenario

_OLDEST_S = 0.3  # a controller that flies by an older state flies into the past
_AHEAD_S = 0.05  # a clock that is a little fast
_FRESH_S = 0.5
_HEARTBEAT_S = 3.0
_STEP_NS = 1000
_JUMP_BACK_NS = 50_000_000


class StatePublisher:
    """Decides which states of the vehicle are published, and remembers them for the replies."""

    def __init__(
        self,
        scenario: Scenario,
        uav_id: int,
        vehicle: VehicleMonitor,
        sync: TimeSync,
        ports: BridgePorts,
    ) -> None:
        attitude = scenario.vehicle_link(uav_id).setpoint == "attitude"
        self.world = WorldFrame(scenario, uav_id)
        self.controller = ControllerSetpoints(decode_wrench if attitude else decode_velocity)
        self._vehicle = vehicle
        self._sync = sync
        self._ports = ports
        self.odometry: Array | None = None  # newest (13,), world frame
        self.velocity = np.zeros(3)  # of it [m/s], world
        self.sampled_s = float("-inf")  # of it, on the steady clock
        self._local_position: Array | None = None  # (3,) in the vehicle's own frame
        self._ground_m = 0.0
        self._stamp_ns = 0
        self.shared = (0, 0)  # odometry that the formation has received, and the newest stamp [ns]
        self._published_s = float("-inf")
        self._clock_fault_s = float("-inf")
        self.dropped: Counter[str] = Counter(old=0, skewed=0)
        self._present = True

    @property
    def height_m(self) -> float:
        """Height above the place of arming."""
        return 0.0 if self.odometry is None else self.height_over_world_m - self._ground_m

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
        if vehicle.missing:
            return vehicle.missing
        silence = vehicle.heartbeat_age_s(now_s)
        if silence > _HEARTBEAT_S:
            return "no heartbeat" + (f" for {silence:.1f} s" if silence < math.inf else "")
        if vehicle.gnss.fix_lost(now_s):
            return "GPS fix lost"
        position_s = vehicle.pose.position_s
        if position_s is None or now_s - position_s > _FRESH_S:
            return "no position from the vehicle: neither LOCAL_POSITION_NED nor ODOMETRY"
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
                self._ports.origin(place)
        if self._ports.inputs.leader_origin is not None:
            world.leader_at(self._ports.inputs.leader_origin)
        if vehicle.armed:
            world.frozen = True
        elif self.odometry is not None:
            self._ground_m = float(self.odometry[2])

    def report_presence(self, present: bool) -> None:
        """Report the vehicle as lost, once each time it leaves the formation."""
        if self._present and not present:
            self._ports.lost()
        self._present = present

    def on_state(self, state: VehicleState, in_formation: bool) -> None:
        """Publish a new state, if all about it is known and nothing is wrong with it."""
        vehicle, now_s = self._vehicle, self._ports.steady_s()
        self._sync.on_boot_time(state.boot_s, now_s)
        self._local_position = state.odometry[0:3].copy()
        self.world.on_height(float(state.odometry[2]))
        offset = self.world.offset
        if (
            offset is None
            or not self._sync.ready(now_s)
            or vehicle.heartbeat_age_s(now_s) > _HEARTBEAT_S
            or vehicle.gnss.fix_lost(now_s)
        ):
            return
        sampled_s = self._sync.to_host_time(state.boot_s)
        if sampled_s is None:
            return
        age_s = now_s - sampled_s
        if not -_AHEAD_S <= age_s <= _OLDEST_S:
            skewed = age_s < 0.0 or age_s > 2 * _OLDEST_S
            self.dropped["skewed" if skewed else "old"] += 1
            self._clock_fault_s = now_s if skewed else self._clock_fault_s
            return
        odometry = state.odometry.copy()
        # The state is carried to the present with its own velocity, as a UAV does with its neighbours'
        # states. Compared with those at an older instant, the vehicle would fly that little ahead of its place.
        self.velocity = np.array(velocity_enu(odometry))
        odometry[0:3] += offset + max(age_s, 0.0) * self.velocity
        self.odometry, self.sampled_s = odometry, min(sampled_s, now_s)
        stamp_ns = self._ports.ros_ns()
        if 0 <= self._stamp_ns - stamp_ns < _JUMP_BACK_NS:
            stamp_ns = self._stamp_ns + _STEP_NS  # later, unless the clock was set back
        self._stamp_ns, self._published_s = stamp_ns, now_s
        published = PublishedOdometry(self.sampled_s, now_s, odometry)
        self.controller.remember(stamp_ns, published)
        if in_formation:
            self._ports.odom(stamp_ns, odometry)
            self.shared = (self.shared[0] + 1, stamp_ns)
        else:
            self._ports.track(stamp_ns, odometry)

    def on_truth(self, message: Any) -> None:
        """Publish where a simulated vehicle really is, for the verdict alone."""
        position = self.world.true_position(place_of(message))
        odometry = None if position is None else true_odometry(message, position)
        if odometry is not None:
            self._ports.truth(self._ports.ros_ns(), odometry)


_REMEMBERED = 300


class PublishedOdometry(NamedTuple):
    """An odometry that went to the UAV process."""

    sampled_s: float  # when the vehicle was there, steady clock
    arrived_s: float  # when the bridge received it
    values: Array  # (13,) world frame


class SetpointReply(NamedTuple):
    """A setpoint and the odometry that it answers."""

    values: Array  # (6,) twist or wrench
    odometry: PublishedOdometry

    def desired_yaw(self, yaw_gain_1_s: float) -> float:
        """Heading [rad, ENU] that a twist asks for.

        The controller gives a yaw rate, `gain * (yaw_d - yaw)`. A heading holds where a rate drifts.
        """
        return yaw_of(self.odometry.values) + float(self.values[5]) / yaw_gain_1_s


class ControllerSetpoints:
    """The newest setpoint of the UAV process and its age."""

    def __init__(self, decode: Callable[[bytes], Stamped]) -> None:
        self._decode = decode
        self._published: OrderedDict[int, PublishedOdometry] = OrderedDict()
        self.newest: SetpointReply | None = None
        self.foreign = 0  # setpoints that answer no odometry of ours
        self.invalid = 0  # setpoints that cannot be decoded or are not finite

    def remember(self, stamp_ns: int, odometry: PublishedOdometry) -> None:
        """Remember an odometry that is being published."""
        self._published[stamp_ns] = odometry
        while len(self._published) > _REMEMBERED:
            self._published.popitem(last=False)

    def on_message(self, data: bytes) -> bool:
        """Take a serialised setpoint; returns whether it is newer than the one before."""
        try:
            setpoint = self._decode(data)
        except WireError:
            self.invalid += 1
            return False
        odometry = self._published.get(setpoint.stamp_ns)
        if odometry is None:
            self.foreign += 1
            return False
        if not np.isfinite(setpoint.values).all():
            self.invalid += 1
            return False
        if self.newest is not None and odometry.sampled_s < self.newest.odometry.sampled_s:
            return False
        self.newest = SetpointReply(setpoint.values, odometry)
        return True

    def age_s(self, now_s: float) -> float:
        """Age of the odometry that the newest setpoint answers; infinite before the first setpoint."""
        return float("inf") if self.newest is None else now_s - self.newest.odometry.sampled_s


class WorldFrame:
    """Offset of a vehicle's local origin, from a survey or from GPS.

    Without `mavlink.world_origin` the leader defines the world: when its position is first known, it stands
    on the ground at its start in the scenario. The leader's bridge publishes that place for the others.
    """

    def __init__(self, scenario: Scenario, uav_id: int) -> None:
        settings, link = scenario.mavlink, scenario.vehicle_link(uav_id)
        self._radius_m = frames.EARTH_RADIUS_M.get(link.autopilot, frames.EARTH_RADIUS_M["generic"])
        self._leads = uav_id == scenario.leader.id
        self._on_ground = settings.height == "ground"
        self._surveyed = None if link.origin_m is None else np.array(link.origin_m)
        self._start = scenario.uav(scenario.leader.id).position * np.array([1.0, 1.0, 0.0])
        given = settings.world_origin
        self._given = given is not None
        self._reference = None if given is None else given.place
        self._anchor: Anchor | None = None
        self._ground_z_m: float | None = None
        self._true_ground_m: float | None = None
        self.frozen = False  # after arming the world must not move
        self.offset: Array | None = None
        """World position of the local origin (3,) [m], ENU; None while it is not known."""
        self.missing = ""
        """The values that the offset lacks; empty when it has all."""
        self._update()  # a surveyed vehicle has nothing to wait for

    @property
    def needs_leader(self) -> bool:
        """True if this bridge needs the leader's place."""
        return not (self._given or self._leads or self._surveyed is not None)

    @property
    def frame(self) -> str:
        """The offset of a vehicle that has been armed, as `resume` takes it; empty before."""
        known = self.offset if self.frozen else None
        return "" if known is None else " ".join(map(repr, known.tolist()))

    def resume(self, frame: str) -> None:
        """Go on with the offset of a bridge that has left its vehicle in flight."""
        self.offset, self.missing, self.frozen = np.array(frame.split(), dtype=float), "", True

    def leader_at(self, place: GeoPoint) -> None:
        """Take the leader's place on the Earth from its bridge."""
        if not self._given and not self._leads:
            self._reference = place
            self._update()

    def define_by_leader(self, local_enu: Array) -> GeoPoint | None:
        """The leader's place on the Earth at its first position (3,) [m]; None for others and afterwards."""
        if not self._leads or self._settled or self._anchor is None or self._reference is not None:
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

    @property
    def _settled(self) -> bool:
        return self.frozen and self.offset is not None

    def _update(self) -> None:
        if self._settled:
            return
        if self._surveyed is not None:
            offset = self._surveyed.copy()
        elif self._anchor is None:
            self.missing = "the vehicle's GPS_GLOBAL_ORIGIN, or mavlink.vehicles.N.origin_m"
            return
        elif self._reference is None:
            self.missing = "the place of the leader"
            return
        else:
            away = frames.offset_enu(self._anchor.place, self._reference, self._radius_m)
            reference_enu = np.zeros(3) if self._given else self._start
            offset = reference_enu + away - self._anchor.local_enu
        if self._on_ground:
            if self._ground_z_m is None:
                self.missing = "the height of the ground"
                return
            offset[2] = -self._ground_z_m
        self.offset, self.missing = offset, ""
