"""The inputs and outputs of a bridge, besides the bytes of its vehicle."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ptnsbc_core.types import NEAR_COLUMNS, Array
from ptnsbc_io.mavlink.autopilots import SetpointLimits
from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_io.wire import HeaderFields, Stamped
from ptnsbc_nodes.bridge.procedure.steps import Companion
from ptnsbc_nodes.emergency import Order


@dataclass
class BridgeInputs:
    """The messages that the bridge receives: the thread of the node writes it, the thread of the bridge reads it."""

    setpoint: bytes | None = None  # newest
    wanted: Stamped | None = None  # newest velocity of the planner, where the setpoint is a wrench
    legs: list[HeaderFields] = field(default_factory=list)  # epochs as they are announced
    taken: list[Stamped] = field(default_factory=list)  # setpoints that the leader follows
    near_uavs: Array = field(default_factory=lambda: np.empty((0, NEAR_COLUMNS)))
    """The other vehicles (M, 8), wherever they are: x y z keep-out vx vy vz above."""
    leader_origin: GeoPoint | None = None
    controller_ready: bool = False
    controller_heard_s: float = float("-inf")  # when its process last reported
    companions: list[tuple[int, Companion, float]] = field(default_factory=list)
    """Reports of other bridges: UAV id, report, and when it arrived."""
    order: Order = field(default_factory=Order)  # by the operator, or at the end of this process
    _taking: threading.Lock = field(default_factory=threading.Lock)

    def take(self, order: Order) -> bool:
        """Take an order: a kill is never taken down to a landing. Returns whether it changes anything."""
        with self._taking:  # the node and the port for orders have threads of their own
            before, self.order = self.order, self.order.then(order)
            return self.order != before


class BridgePorts:
    """Everything that connects a bridge to its process; the words of this one reach nobody."""

    def __init__(self, steady_s: Callable[[], float], ros_ns: Callable[[], int]) -> None:
        """The steady clock, which never jumps, and the clock that stamps messages."""
        self.inputs = BridgeInputs()
        self.steady_s, self.ros_ns = steady_s, ros_ns

    def odom(self, stamp_ns: int, odometry: Array) -> None:
        """The odometry (13,) of a vehicle in formation."""

    def track(self, stamp_ns: int, odometry: Array) -> None:
        """The same, of a vehicle that has left the formation."""

    def truth(self, stamp_ns: int, odometry: Array) -> None:
        """The true odometry (13,) of a simulated vehicle, for the verdict."""

    def origin(self, place: GeoPoint) -> None:
        """The leader's place, for all bridges."""

    def limits(self, limits: SetpointLimits) -> None:
        """The limits of the vehicle, for the planner."""

    def lost(self) -> None:
        """This vehicle has left the formation."""

    def apart(self) -> None:
        """This vehicle gives the formation up: all others must as well."""

    def log(self, line: str) -> None:
        """A line for the operator."""
