"""Logs of a stand-in, and its answers to those who fetch them (https://mavlink.io/en/services/log_transfer.html).

Each arming begins a log. Its bytes follow from the system id and the number of the log.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from ptnsbc_autopilot.vehicle import StandInVehicle
from ptnsbc_io.mavlink.dialect import mavlink

_PIECE = 90  # bytes in a LOG_DATA
_SIZE, _GROWTH = 9_000, 123  # of the first log, and from log to log


def log_bytes(system: int, number: int) -> bytes:
    """The log of this number, counted from 1."""
    return np.random.default_rng((system, number)).bytes(_SIZE + _GROWTH * number)


def _may_tell(vehicle: StandInVehicle, t: float) -> bool:
    """ArduPilot refuses while it is armed, with these words; a controller without a card says nothing."""
    if vehicle.armed:
        vehicle.send_text("Disarm for log download", t)
    return vehicle.has_logs and not vehicle.armed


def on_request_list(vehicle: StandInVehicle, message: Any, link: int, t: float) -> None:
    """An entry for each log asked for; one of zeros when there is none."""
    if not _may_tell(vehicle, t):
        return
    first, last = vehicle.first_log, vehicle.first_log + vehicle.flown - 1
    numbers = range(max(first, message.start), min(last, message.end) + 1)
    sizes = {n: len(log_bytes(vehicle.system, n - first + 1)) for n in numbers}
    entry = mavlink.MAVLink_log_entry_message
    listed = [entry(n, vehicle.flown, last, 0, size) for n, size in sizes.items()]
    vehicle.send_slowly(link, listed or [entry(0, 0, 0, 0, 0)])


def on_request_data(vehicle: StandInVehicle, message: Any, link: int, t: float) -> None:
    """The bytes asked for, in pieces; another request takes the place of this one."""
    on_request_end(vehicle, message, link, t)
    number = message.id - vehicle.first_log + 1
    if not _may_tell(vehicle, t) or not 0 < number <= vehicle.flown:
        return
    wanted = log_bytes(vehicle.system, number)[message.ofs :][: message.count]
    offsets = range(0, len(wanted), _PIECE)
    pieces = {message.ofs + k: wanted[k : k + _PIECE] for k in offsets}
    data = mavlink.MAVLink_log_data_message
    answers = [
        data(message.id, at, len(piece), list(piece.ljust(_PIECE, b"\0")))
        for at, piece in pieces.items()
    ]
    vehicle.send_slowly(link, answers or [data(message.id, message.ofs, 0, [0] * _PIECE)])


def on_request_end(vehicle: StandInVehicle, _message: Any, _link: int, _t: float) -> None:
    """Send nothing more."""
    rest = (each for each in vehicle.slow_queue if each.message.get_type() != "LOG_DATA")
    vehicle.slow_queue = deque(rest)
