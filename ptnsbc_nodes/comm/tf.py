"""/tf of a bag, made of the recorded odometry: the same with and without tf2_msgs."""

from __future__ import annotations

from collections.abc import Iterable

from ptnsbc_io.wire import WireError, peek_stamp, transform_of
from ptnsbc_nodes.comm import topics

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
