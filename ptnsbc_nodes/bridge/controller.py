"""Setpoints of the UAV process as the bridge receives them: only replies to our own odometry count.

A setpoint carries the stamp of the odometry it was computed from. The bridge remembers when it published
each odometry, on the steady clock. So the age of a setpoint is known whatever the wall clock does, and a
setpoint that answers no odometry of ours is dropped.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ptnsbc_core.kinematics import yaw_of
from ptnsbc_core.types import Array
from ptnsbc_io.wire import Stamped, WireError

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

    def published(self, stamp_ns: int) -> PublishedOdometry | None:
        """The odometry that was published with this stamp; None when it is forgotten."""
        return self._published.get(stamp_ns)

    def on_message(self, data: bytes) -> bool:
        """Take a serialised setpoint; returns whether it is newer than the one before."""
        try:
            setpoint = self._decode(data)
        except WireError:
            self.invalid += 1
            return False
        odometry = self.published(setpoint.stamp_ns)
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
