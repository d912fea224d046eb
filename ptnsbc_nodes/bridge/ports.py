"""What goes in and out of a bridge, besides the bytes of its vehicle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_io.wire import HeaderFields
from ptnsbc_nodes.bridge.setpoint.guard import SetpointLimits


class BridgeOutputs(NamedTuple):
    """Where a bridge tells what."""

    odom: Callable[[int, Array], None]  # stamp [ns], odometry (13,)
    track: Callable[[int, Array], None]  # the same, of a vehicle that has left the formation
    origin: Callable[[GeoPoint], None]  # of the leader, for all
    limits: Callable[[SetpointLimits], None]  # for the planner
    lost: Callable[[], None]  # this vehicle has left the formation
    say: Callable[[str], None]


class SharedVehicleState(NamedTuple):
    """What the formation has heard of this vehicle."""

    messages: int  # odometry
    stamp_ns: int  # of the newest


@dataclass
class BridgeInputs:
    """What others say; written by the thread of the node, read by that of the bridge."""

    setpoint: bytes | None = None  # newest
    legs: list[HeaderFields] = field(default_factory=list)  # epochs as they are announced
    leader_origin: GeoPoint | None = None
    controller_ready: bool = False
    halt: str = ""  # "land" or "kill"
