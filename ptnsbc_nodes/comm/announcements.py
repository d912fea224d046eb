"""Messages that are one word and a time (std_msgs/Header): legs, ended processes, orders of the operator."""

from __future__ import annotations

import re
from typing import NamedTuple

from ptnsbc_core.types import LEGS
from ptnsbc_io.wire import HeaderFields, WireError, decode_header
from ptnsbc_nodes.comm.topics import RECORDER, SIM
from ptnsbc_nodes.emergency.orders import Order, parse_order

_PROCESS = re.compile(rf"(uav|bridge)([1-9][0-9]{{0,5}})|{RECORDER}|{SIM}", re.ASCII)
_SHOWN = 40


class LostProcess(NamedTuple):
    """A process that has ended."""

    name: str  # "uav3"
    uav: int | None  # its number, for the process of a UAV's controller


def decode_leg(data: bytes) -> HeaderFields:
    """Epoch [ns] and name of a leg; WireError when no UAV can fly it."""
    leg = decode_header(data)
    if leg.frame_id not in LEGS:
        raise WireError(f"leg {leg.frame_id[:_SHOWN]!r}: expected one of {', '.join(LEGS)}")
    if leg.stamp_ns < 0:
        raise WireError(f"leg {leg.frame_id}: epoch {leg.stamp_ns} ns: expected 0 or later")
    return leg


def decode_lost(data: bytes) -> LostProcess:
    """The process that has ended; WireError for a name that no process has."""
    name = decode_header(data).frame_id
    found = _PROCESS.fullmatch(name)
    if found is None:
        raise WireError(f"process {name[:_SHOWN]!r}: expected uavN, bridgeN, {SIM} or {RECORDER}")
    return LostProcess(name, int(found[2]) if found[1] == "uav" else None)


def decode_order(data: bytes) -> Order:
    """An order of the operator, or of a bridge that gives the formation up; WireError for any other words."""
    text = decode_header(data).frame_id
    order = parse_order(text)
    if order is None:
        raise WireError(
            f"order {text[:_SHOWN]!r}: expected land, kill, land all, kill all or apart"
        )
    return order
