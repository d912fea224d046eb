"""The messages of one UAV at a tick, as bytes: the same in its process, in a headless bag and in a re-run.

/tf is made of the odometry: in a bag with and without tf2_msgs, in flight where tf2_msgs is installed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np

from ptnsbc_core.agent import PackedOutputs
from ptnsbc_core.types import ODOMETRY_SIZE, Array
from ptnsbc_io.wire import (
    OdometryTemplate,
    Stamped,
    VelocityTemplate,
    WireError,
    WrenchTemplate,
    peek_stamp,
    transform_of,
)
from ptnsbc_nodes.comm import topics

if TYPE_CHECKING:
    # It needs rclpy, which a headless flight does not.
    from ptnsbc_nodes.comm.endpoints import Endpoints

TRANSFORM_HZ = 20
_PERIOD_NS = 10**9 // TRANSFORM_HZ
WORLD_FRAME = "map"
"""All fleets of a domain fly in one world."""


def body_frame(uav_id: int, fleet: str = "") -> str:
    """The frame of a UAV's body; `fleet` is the namespace of its fleet, for example `/blue`."""
    return f"{fleet}/uav{uav_id}/base_link".removeprefix("/")


class AgentMessages:
    """Byte templates of one UAV; each message carries the stamp of the odometry that it was computed from."""

    def __init__(
        self, uav_id: int, fleet: str = "", faults: Callable[[Stamped], Stamped] | None = None
    ) -> None:
        """`fleet`: its namespace; `faults`: changes a state before it is sent, as the injected faults say."""
        self._faults = faults
        body = body_frame(uav_id, fleet)
        self._state = OdometryTemplate(WORLD_FRAME, body)
        # Velocities of an estimate are in the world frame, not in the body frame of the sender.
        self._estimate = OdometryTemplate(WORLD_FRAME, WORLD_FRAME)
        self._velocity = VelocityTemplate(WORLD_FRAME)
        self._wrench = WrenchTemplate(body)
        self._reported = np.zeros(ODOMETRY_SIZE)
        self._twist = np.zeros(6)

    def wrench(self, stamp_ns: int, wrench: Array) -> bytes:
        """geometry_msgs/WrenchStamped of (6,) force and torque, body FLU."""
        return self._wrench.encode(stamp_ns, wrench)

    def odometry(self, own: Stamped) -> bytes:
        """nav_msgs/Odometry of an odometry vector (13,)."""
        return self._state.encode(own.stamp_ns, own.values)

    def state(self, own: Stamped, outputs: PackedOutputs) -> bytes:
        """nav_msgs/Odometry for the neighbours: the own pose, and the velocity that the UAV commands."""
        self._reported[:] = own.values
        self._reported[7:10] = outputs.reported
        return self.reported(own.stamp_ns, self._reported)

    def reported(self, stamp_ns: int, values: Array) -> bytes:
        """The same of (13,), which has the commanded velocity already."""
        if self._faults is not None:
            stamp_ns, values = self._faults(Stamped(stamp_ns, values))
        return self._state.encode(stamp_ns, values)

    def estimate(self, stamp_ns: int, estimate: Array) -> bytes:
        """nav_msgs/Odometry of a leader estimate (13,), velocities in the world frame."""
        if self._faults is not None:
            stamp_ns, estimate = self._faults(Stamped(stamp_ns, estimate))
        return self._estimate.encode(stamp_ns, estimate)

    def velocity(self, stamp_ns: int, velocity: Array) -> bytes:
        """geometry_msgs/TwistStamped of (4,) velocity, ENU, and yaw rate."""
        self._twist[0:3] = velocity[0:3]
        self._twist[5] = velocity[3]
        return self._velocity.encode(stamp_ns, self._twist)

    def all(self, own: Stamped, outputs: PackedOutputs) -> tuple[bytes, bytes, bytes, bytes]:
        """State, estimate, velocity and wrench of one tick, in this order."""
        stamp_ns = own.stamp_ns
        return (
            self.state(own, outputs),
            self.estimate(stamp_ns, outputs.leader_estimate),
            self.velocity(stamp_ns, outputs.velocity),
            self.wrench(stamp_ns, outputs.wrench),
        )


class Transforms:
    """Makes a transform of the first odometry message of each period, by the message's own stamp."""

    def __init__(self, uavs: Iterable[int]) -> None:
        self._period = {topics.odom(uav).name: -1 for uav in uavs}

    def of(self, topic: str, data: bytes) -> bytes | None:
        """The TFMessage to record beside a message, None when none is due."""
        last = self._period.get(topic)
        if last is None:
            return None
        try:
            period = peek_stamp(data) // _PERIOD_NS
            if period == last:
                return None
            self._period[topic] = period
            return transform_of(data)
        except WireError:  # a broken message of another program
            return None


class LiveTransforms:
    """Publishes /tf in flight, beside the odometry of the same process, while something subscribes to it."""

    def __init__(self, endpoints: Endpoints, uavs: Iterable[int]) -> None:
        self._transforms = Transforms(uavs)
        self._send = self._readers = None
        if topics.tf_is_available():
            self._send = endpoints.publisher(topics.TF, 0)
            self._readers = endpoints.readers(topics.TF)

    def publish(self, uav_id: int, odometry: bytes) -> None:
        """Publish the transform of an odometry message of a UAV when one is due."""
        if self._send is None or self._readers is None or not self._readers():
            return
        transform = self._transforms.of(topics.odom(uav_id).name, odometry)
        if transform is not None:
            self._send(transform)
