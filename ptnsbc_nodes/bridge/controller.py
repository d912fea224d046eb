"""What the UAV process wants, as the bridge has heard it: only answers to our own odometry count.

A setpoint carries the stamp of the odometry it was computed from. The bridge remembers what it told
when, on the steady clock: so the age of a setpoint is known whatever the wall clock does, and one
that answers nothing we said is dropped.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import NamedTuple

import numpy as np

from ptnsbc_core.kinematics import yaw_of
from ptnsbc_core.types import Array
from ptnsbc_io.wire import Stamped

_REMEMBERED = 300
_NEVER = float("-inf")


class PublishedOdometry(NamedTuple):
    """An odometry that went to the UAV process."""

    sampled_s: float  # when the vehicle was there, steady clock
    arrived_s: float  # when the bridge heard of it
    odometry: Array  # (13,) world frame


class SetpointReply(NamedTuple):
    """A setpoint and the odometry that it answers."""

    values: Array  # (6,) twist or wrench
    told: PublishedOdometry


class ControllerSetpoints:
    """The newest setpoint of each kind and how old it is."""

    def __init__(self) -> None:
        self._told: OrderedDict[int, PublishedOdometry] = OrderedDict()
        self.newest: SetpointReply | None = None
        self.foreign = 0  # setpoints that answer no odometry of ours
        self.nonsense = 0  # setpoints that are not finite

    def tell(self, stamp_ns: int, told: PublishedOdometry) -> None:
        """Remember an odometry that is being sent."""
        self._told[stamp_ns] = told
        while len(self._told) > _REMEMBERED:
            self._told.popitem(last=False)

    def hear(self, setpoint: Stamped) -> bool:
        """Take a setpoint in; whether it is newer than the one we have."""
        told = self._told.get(setpoint.stamp_ns)
        if told is None:
            self.foreign += 1
            return False
        if not np.isfinite(setpoint.values).all():
            self.nonsense += 1
            return False
        if self.newest is not None and told.sampled_s < self.newest.told.sampled_s:
            return False
        self.newest = SetpointReply(setpoint.values, told)
        return True

    def age_s(self, now_s: float) -> float:
        """Age of the newest setpoint, from the instant at which the vehicle was where it assumes."""
        sampled_s = _NEVER if self.newest is None else self.newest.told.sampled_s
        return now_s - sampled_s


def wanted_yaw(wanted: SetpointReply, yaw_gain_1_s: float) -> float:
    """Heading [rad, ENU] that a twist (6,) asks for.

    The controller tells a yaw rate, `gain * (yaw_d - yaw)`; a heading holds where a rate drifts.
    """
    return yaw_of(wanted.told.odometry) + float(wanted.values[5]) / yaw_gain_1_s
