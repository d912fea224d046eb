"""An order to all vehicles, repeated on every path until each bridge has answered with its vehicle's state.

The paths: the bridges' sockets on this host, which need no discovery; `/formation/emergency`, which reaches other
hosts; and MAVLink to the vehicle itself where a bridge is dead or silent. A dead bridge has left its port: the order
goes out from there, and the vehicle's HEARTBEAT shows whether it obeyed. The port of a bridge that hangs is taken: the
order goes to the vehicle's address from another port, and nothing comes back.

This module imports no rclpy: an order on this host neither needs the middleware nor waits for its import.
"""

from __future__ import annotations

import fcntl
import select
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.mavlink.autopilots import AUTOPILOTS
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_io.mavlink.link import MavlinkLink, companion_heartbeat, link_to
from ptnsbc_io.mavlink.transport import ConnectError
from ptnsbc_nodes.bridge.commands import Commands
from ptnsbc_nodes.bridge.procedure.steps import SILENT_S, CommandRequest, Step
from ptnsbc_nodes.emergency import (
    KILL,
    LAND,
    RETURN,
    Order,
    OrderClient,
    VehicleRecord,
    decode_record,
    fleet_bridges,
    latch,
    records,
    write_record,
)

if TYPE_CHECKING:
    from ptnsbc_nodes.fleet.fleet_node import LauncherNode

_REPEAT_S = 0.05
_REHEARSE_S = 2.0
_LAUNCHER_PATIENCE_S = 3.0
# A bridge of this host that has not answered by then is passed by. A landing past one that only hesitates would look
# like a pilot's.
_KILL_WAIT_S, _LANDING_WAIT_S = 0.3, 1.0
_DIRECT_REPEAT_S = 0.1
_PILOT_S = 10.0  # a pilot lands when it suits the pilot
_SAY_S = 5.0
_LINK_ID = 1  # of signatures: the bridge signs with 0, and each has its own sequence
_WANTED = frozenset({mavlink.MAVLINK_MSG_ID_HEARTBEAT})


class VehicleOutcome(NamedTuple):
    """The outcome of an order at one vehicle."""

    name: str  # of the bridge, with the label of the vehicle
    obeyed: bool  # it answered and does as it was told, or is left alone as it should be
    text: str


@dataclass
class _Bridge:
    """The order at one bridge, and what is known of its vehicle."""

    name: str
    order: Order
    # The record that the bridge keeps on this host: its process, the way to the vehicle.
    local: VehicleRecord | None = None
    state: VehicleRecord | None = None  # the newest of the vehicle, from wherever
    answered: bool = False  # this order
    asked_s: float | None = None  # since when it has not answered
    remote_s: float = 0.0  # wall time of the newest answer by the network
    done_s: float | None = None  # when it, or the vehicle, showed that the vehicle does as told
    direct: DirectOrder | None = None  # past the bridge

    @property
    def dead(self) -> bool:
        """True if its process on this host has ended."""
        return self.local is not None and not self.local.alive

    def silent(self, wait_s: float) -> bool:
        """True if it has not answered for so long."""
        return self.asked_s is not None and time.monotonic() - self.asked_s > wait_s

    def ask(self, client: OrderClient, order: Order) -> None:
        """Send it an order on this host, or a question."""
        client.send(self.name, order)
        self.asked_s = time.monotonic() if self.asked_s is None else self.asked_s

    def take(self, record: VehicleRecord) -> None:
        """Its answer."""
        self.state, self.answered = record, True
        if record.heard or not record.armed:  # else it cannot tell its vehicle, and is passed by
            self.asked_s = None
        if self.done_s is None and _obeys(record, self.order):
            self.done_s = time.monotonic()

    def go_past(self) -> None:
        """Order its vehicle past it if it is dead or does not answer; a pilot's vehicle is left alone."""
        local, state, order = self.local, self.state, self.order
        if local is None or state is None or (state.in_pilots_hands and not order.pilots_too):
            return
        wait_s = _KILL_WAIT_S if order.what == KILL else _LANDING_WAIT_S
        if self.direct is None and (self.dead or self.silent(wait_s)):
            self.direct = DirectOrder(local, order)
        if (direct := self.direct) is None:
            return
        direct.look()
        if direct.armed is False or (direct.mode is FlightMode.LAND and order.what == LAND):
            since = time.strftime("%H:%M:%S", time.localtime(local.written_s))
            place = f"a place unknown since {since}"
            seen = replace(state, armed=bool(direct.armed), heard=True, mode=direct.mode_name)
            self.state = replace(seen, place=place)  # of the record: older than what was seen
            if self.dead:
                self.done_s = time.monotonic()

    def way(self) -> str:
        """The way on which an order would reach its vehicle now."""
        if self.local is None:
            heard = self.state is not None and time.time() - self.state.written_s < _REHEARSE_S
            return "by the network" if heard else "NOT REACHED: it is not heard"
        if self.asked_s is None and not self.dead:
            return "by its socket"
        direct = DirectOrder(self.local, self.order)
        direct.close()
        return f"NOT REACHED: {direct.problem}" if direct.problem else "past its bridge"


class EmergencyStop:
    """One order to all vehicles of a domain."""

    def __init__(self, folder: Path, order: Order, remote: LauncherNode | None = None) -> None:
        self._folder, self._order, self.remote = folder, order, remote
        self._client = OrderClient(folder)
        self._bridges: dict[str, _Bridge] = {}
        self._began_s = self._next_s = time.monotonic()
        self._began_wall_s = time.time()
        self.look_up()

    def rehearse(self) -> dict[str, str] | None:
        """By bridge the way on which the order would reach its vehicle now; None while an answer is awaited."""
        if time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + _REHEARSE_S
            self.look_up()
            for bridge in self._bridges.values():
                bridge.ask(self._client, Order())
        self._hear()
        known = [self._bridges[name] for name in self.bridges]
        asked = [each for each in known if each.local and each.asked_s and not each.dead]
        if not all(each.silent(_LANDING_WAIT_S) for each in asked):
            return None
        return {each.name: each.way() for each in known}

    @property
    def bridges(self) -> list[str]:
        """The bridges that must answer: those of the fleet, those that left a record, those that were heard."""
        return sorted(self._bridges)

    @property
    def local(self) -> bool:
        """True if every bridge of the fleet has a record on this host, so that no other path is needed."""
        fleet = fleet_bridges(self._folder)
        return bool(fleet) and all(self._bridge(name).local is not None for name in fleet)

    def begin(self) -> None:
        """Latch the order, and count the time from now on."""
        latch(self._folder, self._order)
        self._began_s = self._next_s = time.monotonic()
        self._began_wall_s = time.time()
        for bridge in self._bridges.values():
            bridge.answered, bridge.asked_s, bridge.done_s = False, None, None

    def look(self) -> bool:
        """One round on every path; returns whether all is done."""
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = now_s + _REPEAT_S
            self.look_up()
            for bridge in self._pending():
                bridge.ask(self._client, self._order)
            if self.remote is not None and self._pending():
                self.remote.send(self._order)
        if self.remote is None:
            time.sleep(0.005)
        else:
            self.remote.spin(0.01)
            self._take_remote(self.remote)
        self._hear()
        for bridge in self._pending():
            bridge.go_past()
        return bool(self._bridges) and not self._pending()

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
        return [_outcome(self._bridges[name], self._began_s) for name in self.bridges]

    def close(self) -> None:
        """Close all sockets."""
        self._client.close()
        for bridge in self._bridges.values():
            if bridge.direct is not None:
                bridge.direct.close()

    def look_up(self) -> None:
        """Find the bridges of this host, also those that start meanwhile, and those that were heard."""
        for name, state in ({} if self.remote is None else self.remote.status.vehicles).items():
            bridge = self._bridge(name)
            bridge.state = bridge.state if bridge.local is not None else state
        fleet = fleet_bridges(self._folder)
        for name in fleet:
            self._bridge(name)
        for record in records(self._folder):
            unheard = record.name not in self._bridges or not self._bridges[record.name].answered
            down = record.ended and not record.armed  # there is nobody to answer, and nothing to do
            lost = not (record.alive or record.armed)
            if lost and unheard and record.name not in fleet:
                continue  # of a flight that is over
            bridge = self._bridge(record.name)
            bridge.local = record
            if bridge.done_s is None and (unheard or record.ended):
                bridge.state = record
                if down or (not unheard and _obeys(record, self._order)):
                    bridge.done_s = time.monotonic()

    def _bridge(self, name: str) -> _Bridge:
        return self._bridges.setdefault(name, _Bridge(name, self._order))

    def _pending(self) -> list[_Bridge]:
        return [self._bridges[name] for name in self.bridges if self._bridges[name].done_s is None]

    def _take_remote(self, remote: LauncherNode) -> None:
        """Answers by the network: states that are newer than the order, and of a bridge of this host only one with it.

        A bridge that was heard before may have died since. Of a bridge that is dead nothing is an answer.
        """
        for name, record in remote.status.vehicles.items():
            bridge = self._bridge(name)
            newer = record.written_s > max(bridge.remote_s, self._began_wall_s)
            counts = bridge.local is None or _bears(record, self._order)
            if newer and counts and not bridge.dead:
                bridge.remote_s = record.written_s
                bridge.take(record)

    def _hear(self) -> None:
        """Take the answers that have come on this host."""
        for data in self._client.answers():
            if (record := decode_record(data)) is not None:
                self._bridge(record.name).take(record)


def _bears(record: VehicleRecord, order: Order) -> bool:
    """True if the bridge has taken the order, or a harder one; it leaves a pilot's vehicle alone."""
    if record.order and record.in_pilots_hands and not order.pilots_too:
        return True
    return order.what in record.order.partition(" ")[0] or KILL in record.order


def _obeys(record: VehicleRecord, order: Order) -> bool:
    """True if this answer shows that the vehicle does as it was told."""
    if record.in_pilots_hands and not order.pilots_too:
        return _bears(record, order)
    if order.what == KILL:
        obeys = not record.armed and (record.heard or not record.mode)
    else:
        obeys = record.heard or not record.armed
    return _bears(record, order) and obeys


def _outcome(bridge: _Bridge, began_s: float) -> VehicleOutcome:
    record, direct, obeyed = bridge.state, bridge.direct, bridge.done_s is not None
    order, seconds = bridge.order, (bridge.done_s or time.monotonic()) - began_s
    if record is None:
        return VehicleOutcome(bridge.name, False, "silent: it was never heard of")
    past = ""
    if direct is not None:
        answers = {None: ", without an answer", True: ": armed", False: ": disarmed"}
        told = f"told past it by MAVLink{answers[direct.armed]}"
        past = f"; not reached past it: {direct.problem}" if direct.problem else f"; {told}"
    if record.in_pilots_hands and not order.pilots_too:
        text = f"in a pilot's hands, left alone ({record.state}); --all orders it as well"
    elif obeyed and direct is not None:
        state = "lands" if record.armed else "is disarmed"
        text = f"its bridge has ended, the vehicle {state} after {seconds:.2f} s{past}"
    elif obeyed and record.armed:
        text = f"landing, {record.state} after {seconds:.2f} s"
    elif obeyed:
        killed = KILL in record.order and "motors stopped" in record.fault
        text = "motors stopped" if killed else f"not flying ({record.state})"
        text = f"{text} after {seconds:.2f} s"
    else:
        if bridge.answered and not bridge.dead and (direct is None or not record.heard):
            text = f"answers, but the vehicle does not obey: {record.state}{past}"
        elif bridge.dead:
            text = f"silent: the bridge has ended; last: {record.state}{past}"
        else:
            pid = "" if bridge.local is None else f" (pid {bridge.local.pid})"
            text = f"silent: the bridge{pid} does not answer; last: {record.state}{past}"
        text += f"; {record.fate}" if record.fate and record.armed else ""
    return VehicleOutcome(record.called, obeyed, text)


_BUSY = {step.value for step in (Step.ARM, Step.ARMED, Step.TAKEOFF, Step.LAND)}


def order_return(folder: Path, uav: int, patience_s: float) -> str:
    """Send one vehicle home by its autopilot's own mode, by its bridge on this host; what it does in words.

    Raises:
        PtnsbcError: it cannot return, another one does, or it has not obeyed in time.
    """
    name = f"bridge{uav}"
    with (folder / "return.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # of two terminals the second sees what the first has done
        return _returned(folder, name, patience_s)


def _returned(folder: Path, name: str, patience_s: float) -> str:
    known = {record.name: record for record in records(folder)}
    record = known.get(name)
    if record is None or not record.alive:
        raise PtnsbcError(
            f"{name}: no bridge of this host: expected the computer of that bridge, or its pilot"
        )
    home = [each.called for each in known.values() if _goes_home(each) and each.name != name]
    problem = {
        f"{record.autopilot} has no mode that returns": not AUTOPILOTS[record.autopilot].returns,
        f"another one returns, {', '.join(home)}, and ways home cross": bool(home),
        "its pilot flies it": record.in_pilots_hands,
        f"it is {record.step}": record.step in _BUSY,
        "it is not in the air": not record.armed or record.landed,
    }
    if why := next((text for text, holds in problem.items() if holds), ""):
        raise PtnsbcError(f"{record.called}: told nothing: {why}")
    client, until_s = OrderClient(folder), time.monotonic() + patience_s
    try:
        while not _goes_home(record) and time.monotonic() < until_s:
            client.send(name, Order(RETURN))
            time.sleep(_REPEAT_S)  # a bridge writes its record several times a second, unasked
            record = next((each for each in records(folder) if each.name == name), record)
    finally:
        client.close()
    if not _goes_home(record):
        raise PtnsbcError(
            f"{record.called}: not obeyed after {patience_s:g} s, and asked on: {record.state}: "
            "expected its pilot to take it, or ptnsbc stop, which lands all"
        )
    return f"{record.called}: returns, {record.state}: {record.fate}"


def _goes_home(record: VehicleRecord) -> bool:
    return record.armed and FlightMode.named(record.mode) is FlightMode.RETURN


def order_landing(folder: Path, remote: LauncherNode) -> list[str]:
    """Order every bridge to land, for a launcher whose leader does not answer; one line for each that did not obey."""
    operation = EmergencyStop(folder, Order(LAND), remote)
    try:
        operation.begin()
        operation.run(_LAUNCHER_PATIENCE_S)
        return [f"{one.name}: {one.text}" for one in operation.outcomes() if not one.obeyed]
    finally:
        operation.close()


def land_left_behind(
    folder: Path, names: Collection[str], told: Callable[[], bool], progress: Callable[[str], None]
) -> None:
    """Land the vehicles that bridges of these names have left armed, and wait until all are disarmed.

    A vehicle in a pilot's hands is left alone. `told`: whether the operator wants to wait no longer.
    """
    left = {
        record.name: (record, DirectOrder(record, Order(LAND)))
        for record in records(folder)
        # A vehicle that was told to arm may have done so after the end of its bridge.
        if record.name in names
        and (replace(record, armed=True) if record.step == Step.ARM.value else record).orphaned
    }
    began_s = say_s = time.monotonic()
    while left and not told():
        links = [direct.link for _, direct in left.values() if direct.link is not None]
        select.select(links, [], [], _DIRECT_REPEAT_S)
        now_s = time.monotonic()
        for name, (record, direct) in list(left.items()):
            flown = direct.mode is FlightMode.OTHER
            direct.look(ordering=direct.armed is True and not flown)
            if direct.armed is False:
                # Place and fate are of the time when its bridge ended.
                down = replace(record, mode=direct.mode_name, place="", fate="")
                write_record(folder, replace(down, armed=False, landed=True, heard=True))
                word = "its vehicle is disarmed"
            elif now_s - max(direct.heard_s, began_s) > SILENT_S:
                word = f"not reached, {direct.problem or 'silent'}; its vehicle was {record.state}"
            elif flown and now_s - began_s > _PILOT_S:
                word = "its vehicle is left to its pilot"
            else:
                continue
            progress(f"{name}: {word}")
            direct.close()
            del left[name]
        if left and now_s >= say_s:
            say_s = now_s + _SAY_S
            progress(f"armed without a bridge, told to land: {', '.join(left)}; interrupt to end")
    for _, direct in left.values():
        direct.close()


class DirectOrder:
    """Sends one order to one vehicle, again and again; use `close` at the end."""

    def __init__(self, record: VehicleRecord, order: Order) -> None:
        self.armed: bool | None = None
        """As the vehicle's HEARTBEAT said it; None before the first."""
        self.mode: FlightMode | None = None
        self.mode_name = ""  # as the autopilot calls it
        self.heard_s = 0.0
        self.problem = ""  # why the vehicle cannot be reached
        requests = [CommandRequest.KILL if order.what == KILL else CommandRequest.LAND]
        if order.what == LAND and record.landed and record.step != Step.TAKEOFF.value:
            requests.append(CommandRequest.DISARM)
        self._requests = cycle(requests)
        self._autopilot = AUTOPILOTS[record.autopilot]
        self._commands = Commands(self._autopilot, record.sysid)
        self._record = record
        self._next_s = 0.0
        self.link = self._open()

    def _open(self) -> MavlinkLink | None:
        """The link to the vehicle; None while it cannot be opened, as the port of a bridge that is just ending."""
        record, self.problem = self._record, ""
        try:
            if record.alive and not record.peer:
                raise ConnectError(f"{record.connect}: the address of the vehicle is not known")
            # A dead bridge has left its own link.
            address = f"udpout:{record.peer}" if record.alive else record.connect
            return link_to(address, record.sysid, _WANTED, record.signing_key, _LINK_ID)
        except PtnsbcError as error:
            self.problem = " ".join(str(error).split())
            return None

    def look(self, *, ordering: bool = True) -> None:
        """Take in what has arrived; when it is time send the order, or only a sign of life."""
        now_s = time.monotonic()
        due = now_s >= self._next_s
        if due:
            self._next_s = now_s + _DIRECT_REPEAT_S
            self.link = self.link or self._open()
        if self.link is None:
            return
        for heartbeat in self.link.poll(now_s):
            if heartbeat.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
                self.armed = bool(heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
                base, custom = heartbeat.base_mode, heartbeat.custom_mode
                self.mode_name = self._autopilot.mode_name(base, custom)
                self.mode = FlightMode.named(self.mode_name)
                self.heard_s = now_s
        if due and ordering:
            self.link.send(self._commands.message(next(self._requests), 0.0))
        elif due:
            self.link.send(companion_heartbeat())

    def close(self) -> None:
        """Close the port."""
        if self.link is not None:
            self.link.close()
