"""The operator's order to all vehicles, and what their bridges know of them: a folder of this host, and sockets.

The folder is `ptnsbc/<domain>` below `$XDG_RUNTIME_DIR`, or `ptnsbc-<user>/<domain>` in the folder for temporary files;
for a fleet in the namespace `/blue` its name is `<domain>.blue`. It belongs to one user. It holds the latched order, a
socket and a record per bridge, and the list of a fleet's bridges.

On its socket a bridge takes orders from processes of this host: no discovery, no middleware, no leader. A datagram
holds an order as text, or nothing for a question. Each is answered with the vehicle's record. The thread of the port
stores the order for the thread of the bridge, and works also while the executor of the node is busy. The record in
the file outlives the bridge: it tells others how to reach the vehicle, and what the vehicle was doing.
"""

from __future__ import annotations

import json
import os
import socket
import stat
import tempfile
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.files import replacing

RETURN, APART, LAND, KILL = "return", "apart", "land", "kill"
_RANKS = {"": 0, RETURN: 1, APART: 2, LAND: 3, KILL: 4}
PASSING = (RETURN, APART)
"""Orders that no bridge obeys after its restart."""

_ALL = "all"
_ORDER_FILE, _FLEET_FILE = "order.json", "fleet.json"
_LARGEST_FILE = 1 << 16  # [bytes]
_LARGEST_ORDER = 256  # [bytes]
_LOOK_S = 0.5
_RECORD_SUFFIX = ".vehicle.json"
# What the status of a bridge says of its vehicle as well.
_STATUS = (
    "label",
    "step",
    "fault",
    "mode",
    "place",
    "order",
    "armed",
    "heard",
    "landed",
    "in_pilots_hands",
)


class RuntimeFolderError(PtnsbcError):
    """The folder for orders cannot be used."""


class Order(NamedTuple):
    """The action that every vehicle must take."""

    # "land", "kill", "apart" (from a bridge: hold apart by height, then land), "return" (one vehicle alone) or nothing
    what: str = ""
    pilots_too: bool = False  # also a vehicle in a pilot's hands

    @property
    def text(self) -> str:
        """As `parse_order` reads it."""
        return f"{self.what} {_ALL}" if self.what and self.pilots_too else self.what

    def then(self, other: Order) -> Order:
        """The order that holds after another one has come: a kill is never taken down to a landing."""
        if _RANKS[self.what] > _RANKS[other.what]:
            return self
        both = self.what == other.what
        return Order(other.what, other.pilots_too or (both and self.pilots_too))


def parse_order(text: str) -> Order | None:
    """`return`, `apart`, `land`, `kill`, `land all`, `kill all`; None for anything else."""
    what, _, rest = text.partition(" ")
    if not what or what not in _RANKS or rest not in ("", _ALL) or (what in PASSING and rest):
        return None
    return Order(what, bool(rest))


def runtime_folder(domain: int, fleet: str = "") -> Path:
    """The folder on this host of a fleet in a ROS domain and a namespace, made if it is missing.

    Raises:
        RuntimeFolderError: somebody else owns it, or it cannot be made.
    """
    runtime, user = os.environ.get("XDG_RUNTIME_DIR", ""), os.getuid()
    base = Path(tempfile.gettempdir()) / f"ptnsbc-{user}"
    if runtime and Path(runtime).is_dir():
        base = Path(runtime) / "ptnsbc"
    # A namespace may hold `_` and never `.`: /a/b and /a_b have folders of their own.
    folder = base / f"{domain}{fleet.replace('/', '.')}"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = os.lstat(base)
    except OSError as error:
        raise RuntimeFolderError(
            f"{folder}: {error.strerror}: expected a folder that this user may write; set XDG_RUNTIME_DIR"
        ) from None
    if found.st_uid != user or not stat.S_ISDIR(found.st_mode):
        raise RuntimeFolderError(
            f"{base}: not a folder of this user: expected one; set XDG_RUNTIME_DIR"
        )
    return folder


def latch(folder: Path, order: Order) -> Order:
    """Keep an order for bridges that start later; returns the order that holds now."""
    before = latched(folder)
    holds = before.then(order)
    if holds != before:
        write_json(folder / _ORDER_FILE, {"order": holds.text, "since": time.time()})
    return holds


def latched(folder: Path) -> Order:
    """The order that holds; an empty one when there is none."""
    text = read_json(folder / _ORDER_FILE).get("order")
    return (parse_order(text) if isinstance(text, str) else None) or Order()


def release(folder: Path) -> Order:
    """Release the latch; returns the order that held."""
    held = latched(folder)
    (folder / _ORDER_FILE).unlink(missing_ok=True)
    return held


def list_fleet(folder: Path, bridges: Sequence[str]) -> None:
    """Keep the names of all bridges of a fleet, those of other computers too; an empty list removes it."""
    if bridges:
        write_json(folder / _FLEET_FILE, {"bridges": list(bridges)})
    else:
        (folder / _FLEET_FILE).unlink(missing_ok=True)


def fleet_bridges(folder: Path) -> list[str]:
    """The names of all bridges of the fleet that a launcher of this host flies."""
    names = read_json(folder / _FLEET_FILE).get("bridges")
    return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []


def write_json(path: Path, value: dict[str, object]) -> None:
    """Write an object into a file; OSError when that fails."""
    with replacing(path) as part:
        part.write_text(json.dumps(value), encoding="utf-8")


def read_json(path: Path) -> dict[str, object]:
    """The object in a file; empty when there is none, or anything else."""
    try:
        if path.stat().st_size > _LARGEST_FILE:
            return {}
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def socket_path(folder: Path, name: str) -> Path:
    """The socket of a bridge."""
    return folder / f"{name}.sock"


class OrderPort:
    """The bridge's end: a thread that takes orders and answers each."""

    def __init__(
        self, folder: Path, name: str, take: Callable[[Order], object], state: Callable[[], bytes]
    ) -> None:
        """Open the socket.

        `name`: of the bridge; `take` stores an order, in the thread of the port; `state`: the answer, a record.

        Raises:
            RuntimeFolderError: the socket cannot be opened.
        """
        self._path = socket_path(folder, name)
        self._take, self._state = take, state
        self._open = True
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self._path.unlink(missing_ok=True)  # of a bridge of this name that was killed
            self._socket.bind(str(self._path))
        except OSError as error:
            self._socket.close()
            raise RuntimeFolderError(
                f"{self._path}: {error.strerror or error}: expected a place for a socket; set XDG_RUNTIME_DIR"
            ) from None
        self._socket.settimeout(_LOOK_S)
        self._inode = os.stat(self._path).st_ino
        self._thread = threading.Thread(target=self._serve, name=f"{name} orders", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close the socket, and remove it unless a bridge of the same name has replaced it."""
        self._open = False
        self._thread.join(timeout=2 * _LOOK_S)
        self._socket.close()
        with suppress(OSError):
            if os.stat(self._path).st_ino == self._inode:
                self._path.unlink()

    def _serve(self) -> None:
        while self._open:
            try:
                data, sender = self._socket.recvfrom(_LARGEST_ORDER)
            except TimeoutError:
                continue
            except OSError:
                return
            order = parse_order(data.decode(errors="replace")) if data.strip() else None
            if order is not None:
                self._take(order)
            elif data.strip():
                continue
            if sender:
                with suppress(OSError):  # who asked may be gone
                    self._socket.sendto(self._state(), socket.MSG_DONTWAIT, sender)


class OrderClient:
    """The operator's end: sends to many bridges and takes their answers, without waiting."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind("")  # Linux gives it an abstract name

    def fileno(self) -> int:
        """For select()."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def send(self, name: str, order: Order) -> bool:
        """Send an order, or a question when it is empty; False when no bridge listens or its queue is full."""
        try:
            self._socket.sendto(order.text.encode() or b"\n", str(socket_path(self._folder, name)))
        except OSError:
            return False
        return True

    def answers(self) -> list[bytes]:
        """The answers that have arrived, a record each."""
        found = []
        with suppress(OSError):
            while True:
                found.append(self._socket.recv(1 << 16))
        return found


@dataclass(frozen=True)
class VehicleRecord:
    """One vehicle as its bridge knew it last."""

    name: str  # of the bridge
    pid: int
    sysid: int
    autopilot: str
    connect: str  # the bridge's link
    peer: str = ""  # "host:port" of the vehicle, once it is known
    signing_key: str = ""  # path of the key file
    label: str = ""  # of the vehicle, for people
    step: str = ""
    order: str = ""  # the order that the bridge obeys
    heard: bool = False  # whether the vehicle sends HEARTBEAT
    armed: bool = False
    landed: bool = False
    in_pilots_hands: bool = False
    mode: str = ""
    place: str = ""  # "(x, y, z) m" in the world
    fate: str = ""  # what the vehicle does without its bridge
    frame: str = ""  # "x y z" [m]: the origin of its local frame in the world, once it was armed
    fault: str = ""
    ended: bool = False  # the bridge has ended in order
    written_s: float = 0.0  # wall time

    @property
    def called(self) -> str:
        """The name of its bridge, with the vehicle's label."""
        return f"{self.name} ({self.label})" if self.label else self.name

    @property
    def state(self) -> str:
        """The vehicle's state in a few words."""
        if self.heard:
            return self._where
        return f"silent, last {self._where}" if self.mode else "never heard"

    @property
    def _where(self) -> str:
        armed, rotors = ("armed", ", rotors turning") if self.armed else ("disarmed", "")
        on_ground = f", on the ground{rotors}" if self.landed else ""
        place = f" at {self.place}" if self.place else ""
        return f"{armed}{on_ground}{place} in {self.mode or 'no mode'}"

    @property
    def alive(self) -> bool:
        """True if the bridge's process still exists on this host."""
        if self.ended:
            return False
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            return True
        with suppress(OSError):  # a dead process whose parent has not looked yet
            return ") Z " not in Path(f"/proc/{self.pid}/stat").read_text()
        return True

    @property
    def orphaned(self) -> bool:
        """True if its bridge has ended and has left it armed, and no pilot flies it."""
        return self.armed and not (self.in_pilots_hands or self.alive)

    @property
    def status(self) -> dict[str, str]:
        """The values of a status that `reported` reads."""
        values = {name: getattr(self, name) for name in _STATUS}
        return {name: str(v).lower() if v in (True, False) else v for name, v in values.items()}

    def encode(self) -> bytes:
        """As `decode_record` reads it."""
        return json.dumps(asdict(self)).encode()


_TYPES = get_type_hints(VehicleRecord)


def decode_record(data: bytes) -> VehicleRecord | None:
    """A record from bytes; None when it is not one."""
    try:
        values = json.loads(data)
        if not all(isinstance(values[name], kind) for name, kind in _TYPES.items()):
            return None
        return VehicleRecord(**{name: values[name] for name in _TYPES})
    except (KeyError, TypeError, ValueError, RecursionError):
        return None


def record_path(folder: Path, name: str) -> Path:
    """The file of a bridge's record."""
    return folder / f"{name}{_RECORD_SUFFIX}"


def write_record(folder: Path, record: VehicleRecord) -> None:
    """Replace the bridge's record."""
    values = {**asdict(record), "written_s": time.time()}
    write_json(record_path(folder, record.name), values)


def records(folder: Path) -> Iterator[VehicleRecord]:
    """All records of the folder, by name; broken ones are left out."""
    for path in sorted(folder.glob(f"*{_RECORD_SUFFIX}")):
        with suppress(OSError):
            if (record := decode_record(path.read_bytes())) is not None:
                yield record


def forget_dead(folder: Path) -> None:
    """Remove the records of bridges that have ended."""
    for record in list(records(folder)):
        if not record.alive:
            record_path(folder, record.name).unlink(missing_ok=True)


def summary(folder: Path, names: Collection[str]) -> str:
    """One line after the flight: where the vehicles of these bridges are, who is armed, and what to do; or nothing."""
    states, armed = [], []
    for each in (record for record in records(folder) if record.name in names):
        states.append(f"{each.called} {each.state}{f': {each.fate}' if each.fate else ''}")
        armed += [each.called] if each.armed else []
    advice = f"keep away from {', '.join(armed)}: a pilot lands it, or ptnsbc stop"
    text = f"after the flight: {'; '.join(states)}: {advice if armed else 'all disarmed'}"
    return text if states else ""


def in_pilots_hands(folder: Path, names: Iterable[str]) -> bool:
    """True if pilots fly all of these vehicles, as far as their bridges know."""
    known = {record.name: record for record in records(folder)}
    return all(name in known and known[name].in_pilots_hands for name in names)


def reported(name: str, values: Mapping[str, str]) -> VehicleRecord:
    """The record of a vehicle, as its bridge on any host reports it now."""
    texts = {key: values.get(key, "") for key in _STATUS}
    known: dict[str, Any] = {k: v == "true" if _TYPES[k] is bool else v for k, v in texts.items()}
    return VehicleRecord(name, 0, 0, "", "", written_s=time.time(), **known)
