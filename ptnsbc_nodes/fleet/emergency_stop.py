"""An order to all vehicles, repeated on every path until each bridge has answered with its vehicle's state.

The paths: the bridges' sockets on this host, which need no discovery; `/formation/emergency`, which reaches other
hosts; and MAVLink to the vehicle itself where a bridge is dead or silent. A dead bridge has left its port: the order
goes out from there, and the vehicle's HEARTBEAT shows whether it obeyed. The port of a bridge that hangs is taken: the
order goes to the vehicle's address from another port, and nothing comes back.

This module imports no rclpy: an order on this host neither needs the middleware nor waits for its import.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.files import read_key
from ptnsbc_io.mavlink.autopilots import AUTOPILOTS, FlightMode
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import MavlinkLink, Signer
from ptnsbc_io.mavlink.transport import ConnectError, Transport, connect
from ptnsbc_nodes.bridge.commands import Commands
from ptnsbc_nodes.bridge.procedure.steps import CommandRequest
from ptnsbc_nodes.emergency.orders import KILL, LAND, Order, OrderClient, fleet_bridges, latch
from ptnsbc_nodes.emergency.records import VehicleRecord, decode_record, records

_REPEAT_S = 0.05
_LAUNCHER_PATIENCE_S = 3.0
_LOCAL_S = 0.3  # a bridge of this host that has not answered by then is told past itself
_DIRECT_REPEAT_S = 0.1
_LINK_ID = 1  # of signatures: the bridge signs with 0, and each has its own sequence
_WANTED = frozenset({mavlink.MAVLINK_MSG_ID_HEARTBEAT})
_DIRECT_LANDING_S = 2.0  # a landing past a bridge that only hesitates would look like a pilot's


class RemotePath(Protocol):
    """The path through the middleware."""

    @property
    def vehicles(self) -> Mapping[str, VehicleRecord]:
        """The last report of each bridge, by its name."""

    def send(self, order: Order) -> None:
        """Publish the order."""

    def spin(self, seconds: float) -> None:
        """Serve callbacks for a while."""


class VehicleOutcome(NamedTuple):
    """The outcome of an order at one vehicle."""

    name: str  # of the bridge
    obeyed: bool  # it answered and does as it was told, or is left alone as it should be
    text: str
    seconds: float  # until its last answer counted


class EmergencyStop:
    """One order to all vehicles of a domain."""

    def __init__(self, folder: Path, order: Order, remote: RemotePath | None = None) -> None:
        self._folder, self._order, self.remote = folder, order, remote
        self._client = OrderClient(folder)
        self._known: dict[str, VehicleRecord] = {}  # the newest state of each bridge
        self._answered: dict[str, float] = {}  # when a bridge first answered
        self._done: dict[str, float] = {}  # when its answer was enough
        self._direct: dict[str, DirectOrder] = {}
        self._began = time.monotonic()
        self._next_s = self._began
        self.look_up()

    @property
    def bridges(self) -> list[str]:
        """The bridges that must answer: those of the fleet, those that left a record, those that were heard."""
        return sorted({*self._known, *fleet_bridges(self._folder)})

    @property
    def local(self) -> bool:
        """True if every bridge of the fleet has a record on this host, so that no other path is needed."""
        fleet = fleet_bridges(self._folder)
        return bool(fleet) and set(fleet) <= set(self._known)

    def begin(self) -> None:
        """Latch the order, and count the time from now on."""
        latch(self._folder, self._order)
        self._began = time.monotonic()
        self._next_s = self._began

    def look(self) -> bool:
        """One round on every path; returns whether all is done."""
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = now_s + _REPEAT_S
            self.look_up()
            for name in self._pending():
                self._client.send(name, self._order)
            if self.remote is not None and self._pending():
                self.remote.send(self._order)
        if self.remote is None:
            time.sleep(0.005)
        else:
            self.remote.spin(0.01)
            self._take_remote()
        for data in self._client.answers():
            record_or_none = decode_record(data)
            if record_or_none is not None:
                self._on_answer(record_or_none.name, record_or_none)
        self._tell_directly()
        return bool(self.bridges) and not self._pending()

    def run(self, patience_s: float) -> bool:
        """Rounds until all is done; False when `patience_s` is over before that."""
        deadline = time.monotonic() + patience_s
        while time.monotonic() < deadline:
            if self.look():
                return True
        return False

    def discover(self, seconds: float) -> None:
        """Rounds while the middleware finds bridges; no longer than needed where all of them are known."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not (self.look() and fleet_bridges(self._folder)):
            pass

    def outcomes(self) -> list[VehicleOutcome]:
        """The outcome of the order, per bridge."""
        return [self._outcome(name) for name in self.bridges]

    def close(self) -> None:
        """Close all sockets."""
        self._client.close()
        for direct in self._direct.values():
            direct.close()

    def _pending(self) -> list[str]:
        return [name for name in self.bridges if name not in self._done]

    def _take_remote(self) -> None:
        """States of bridges that have not answered on this host."""
        vehicles = {} if self.remote is None else dict(self.remote.vehicles)
        for name, record in vehicles.items():
            if name not in self._answered or not self._known[name].pid:
                self._on_answer(name, record)

    def look_up(self) -> None:
        """Find the bridges of this host, also those that start meanwhile, and those that were heard."""
        for name, record in ({} if self.remote is None else self.remote.vehicles).items():
            self._known.setdefault(name, record)
        fleet = fleet_bridges(self._folder)
        for record in records(self._folder):
            unheard = record.name not in self._answered
            over = record.ended or (not record.alive and record.name not in fleet)
            if over and unheard and not record.armed:
                continue  # of a flight that is over
            if unheard or record.ended:
                self._known[record.name] = record
            if record.ended and not unheard and self._enough(record):
                self._done.setdefault(record.name, self._elapsed())

    def _on_answer(self, name: str, record: VehicleRecord) -> None:
        self._known[name] = record
        self._answered.setdefault(name, self._elapsed())
        if self._enough(record):
            self._done.setdefault(name, self._elapsed())

    def _enough(self, record: VehicleRecord) -> bool:
        """True if this answer shows that the vehicle does as it was told."""
        if record.order and record.in_pilots_hands and not self._order.pilots_too:
            return True
        took = self._order.what in record.order.partition(" ")[0] or KILL in record.order
        if self._order.what == KILL:
            return took and not record.armed and (record.heard or not record.mode)
        return took and (record.heard or not record.armed)

    def _tell_directly(self) -> None:
        """Order vehicles past bridges that are dead or do not answer; a pilot's vehicle is left alone."""
        elapsed_s = self._elapsed()
        for name in self._pending():
            record = self._known.get(name)
            if record is None or not record.pid or (record.alive and not record.armed):
                continue
            if record.in_pilots_hands and not self._order.pilots_too:
                continue
            dead = not record.alive
            wait_s = _LOCAL_S if self._order.what == KILL else _DIRECT_LANDING_S
            silent = name not in self._answered
            if name not in self._direct and (dead or (silent and elapsed_s > wait_s)):
                self._direct[name] = DirectOrder(record, self._order)
            if name in self._direct:
                self._look_directly(name, record)

    def _look_directly(self, name: str, record: VehicleRecord) -> None:
        direct = self._direct[name]
        direct.look()
        landing = direct.lands and self._order.what == LAND
        if direct.armed is False or landing:
            self._known[name] = replace(record, armed=bool(direct.armed), heard=True)
            if not record.alive:
                self._done.setdefault(name, self._elapsed())

    def _elapsed(self) -> float:
        return time.monotonic() - self._began

    def _outcome(self, name: str) -> VehicleOutcome:
        record, direct = self._known.get(name), self._direct.get(name)
        done_s = self._done.get(name)
        seconds = self._elapsed() if done_s is None else done_s
        if record is None:
            return VehicleOutcome(name, False, "silent: it was never heard of", seconds)
        if record.in_pilots_hands and not self._order.pilots_too:
            text = f"in a pilot's hands, left alone ({record.state}); --all orders it as well"
            return VehicleOutcome(name, done_s is not None, text, seconds)
        if done_s is not None and direct is None:
            return VehicleOutcome(name, True, f"{_doing(record)} after {seconds:.2f} s", seconds)
        past = "" if direct is None else f"; {_told(direct)}"
        if done_s is not None:
            state = "lands" if record.armed else "is disarmed"
            text = f"its bridge has ended, the vehicle {state} after {seconds:.2f} s{past}"
            return VehicleOutcome(name, True, text, seconds)
        if name in self._answered:
            text = f"answers, but the vehicle does not obey: {record.state}{past}"
        elif record.alive:
            text = (
                f"silent: the bridge (pid {record.pid}) does not answer; last: {record.state}{past}"
            )
        else:
            text = f"silent: the bridge has ended; last: {record.state}{past}"
        fate = f"; {record.fate}" if record.fate and record.armed else ""
        return VehicleOutcome(name, False, text + fate, seconds)


def order_landing(folder: Path, remote: RemotePath) -> list[str]:
    """Order every bridge to land, for a launcher whose leader does not answer; one line for each that did not obey."""
    operation = EmergencyStop(folder, Order(LAND), remote)
    try:
        operation.begin()
        operation.run(_LAUNCHER_PATIENCE_S)
        return [f"{one.name}: {one.text}" for one in operation.outcomes() if not one.obeyed]
    finally:
        operation.close()


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
            self._next_s = now_s + _DIRECT_REPEAT_S
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


def _doing(record: VehicleRecord) -> str:
    if not record.armed:
        killed = KILL in record.order and "motors stopped" in record.fault
        return "motors stopped" if killed else f"not flying ({record.state})"
    return f"landing, {record.state}"


def _told(direct: DirectOrder) -> str:
    if direct.problem:
        return f"not reached past it: {direct.problem}"
    if direct.armed is None:
        return "told past it by MAVLink, without an answer"
    return f"told past it by MAVLink: {'armed' if direct.armed else 'disarmed'}"
