"""An order to a vehicle past its bridge, by MAVLink: for a bridge that is dead or does not answer.

A dead bridge has left its port: the order goes out from there, and the vehicle's HEARTBEAT shows whether it obeyed.
The port of a bridge that hangs is taken: the order goes to the vehicle's address from another port, and nothing comes
back.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.files import read_key
from ptnsbc_io.mavlink.autopilots import AUTOPILOTS, FlightMode
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import MavlinkLink, Signer
from ptnsbc_io.mavlink.transport import ConnectError, Transport, connect
from ptnsbc_nodes.bridge.commands import Commands
from ptnsbc_nodes.bridge.procedure.steps import CommandRequest
from ptnsbc_nodes.emergency.orders import KILL, Order
from ptnsbc_nodes.emergency.records import VehicleRecord

_REPEAT_S = 0.1
_LINK_ID = 1  # of signatures: the bridge signs with 0, and each has its own sequence
_WANTED = frozenset({mavlink.MAVLINK_MSG_ID_HEARTBEAT})


class DirectOrder:
    """Sends one order to one vehicle, again and again; use `close` at the end."""

    def __init__(self, record: VehicleRecord, order: Order) -> None:
        self.armed: bool | None = None
        """As the vehicle's HEARTBEAT said it; None before the first."""
        self.lands = False
        """True if its HEARTBEAT shows that it lands by itself."""
        self.problem = ""
        """The reason why the vehicle cannot be reached; empty when it can."""
        self.sent = 0
        self._request = CommandRequest.KILL if order.what == KILL else CommandRequest.LAND
        self._autopilot = AUTOPILOTS[record.autopilot]
        self._commands = Commands(self._autopilot, record.sysid)
        self._record = record
        self._next_s = 0.0
        self._link = self._open()

    def _open(self) -> MavlinkLink | None:
        """The link to the vehicle; None while it cannot be opened, as the port of a bridge that is just ending."""
        record, self.problem = self._record, ""
        try:
            signer = (
                Signer(read_key(Path(record.signing_key)), _LINK_ID) if record.signing_key else None
            )
            return MavlinkLink(_transport(record), record.sysid, _WANTED, signer)
        except PtnsbcError as error:
            self.problem = " ".join(str(error).split())
            return None

    def look(self) -> None:
        """Take in what has arrived, and send when it is time."""
        now_s = time.monotonic()
        due = now_s >= self._next_s
        if due:
            self._next_s = now_s + _REPEAT_S
            self._link = self._link or self._open()
        if self._link is None:
            return
        for message in self._link.poll(now_s):
            self._on_heartbeat(message)
        if due:
            self.sent += self._link.send(self._commands.message(self._request, 0.0))

    def close(self) -> None:
        """Close the port."""
        if self._link is not None:
            self._link.close()

    def _on_heartbeat(self, message: Any) -> None:
        if message.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            mode = self._autopilot.mode(message.base_mode, message.custom_mode)
            self.lands = mode is FlightMode.LAND


def _transport(record: VehicleRecord) -> Transport:
    """The bridge's own link, if the bridge is dead; otherwise the vehicle's address."""
    if not record.alive:
        return connect(record.connect)
    if not record.peer:
        raise ConnectError(f"{record.connect}: the address of the vehicle is not known")
    return connect(f"udpout:{record.peer}")
