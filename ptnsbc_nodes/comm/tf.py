"""/tf, made of the odometry: in a bag with and without tf2_msgs, in flight where tf2_msgs is installed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from ptnsbc_io.wire import WireError, peek_stamp, transform_of
from ptnsbc_nodes.comm import topics

if TYPE_CHECKING:
    # It needs rclpy, which a headless flight does not.
    from ptnsbc_nodes.comm.endpoints import Endpoints

TRANSFORM_HZ = 20
_PERIOD_NS = 10**9 // TRANSFORM_HZ


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
