"""The state of a vehicle by its bridge: in its answers to orders, and in a file that outlives it.

The file tells others how to reach the vehicle when the bridge is dead, and what the vehicle was doing.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from ptnsbc_nodes.emergency.orders import read_json, write_json

_SUFFIX = ".vehicle.json"
# What the status of a bridge says of its vehicle as well: texts, and what is true or false.
_TEXTS = ("step", "fault", "mode", "place", "order")
_FLAGS = ("armed", "heard", "landed", "in_pilots_hands")


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
    step: str = ""
    order: str = ""  # the order that the bridge obeys
    heard: bool = False  # whether the vehicle sends HEARTBEAT
    armed: bool = False
    landed: bool = False
    in_pilots_hands: bool = False
    mode: str = ""
    place: str = ""  # "(x, y, z) m" in the world
    fate: str = ""  # what the vehicle does without its bridge
    fault: str = ""
    ended: bool = False  # the bridge has ended in order
    written_s: float = 0.0  # wall time

    @property
    def state(self) -> str:
        """The vehicle's state in a few words."""
        if not self.heard:
            return f"the vehicle is silent, last {self._where}" if self.armed else "no vehicle"
        return self._where

    @property
    def _where(self) -> str:
        armed = "armed" if self.armed else "disarmed"
        on_ground = ", on the ground" if self.landed else ""
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
    def status(self) -> dict[str, str]:
        """The values of a status that `reported` reads."""
        return {name: str(getattr(self, name)) for name in _TEXTS} | {
            name: str(getattr(self, name)).lower() for name in _FLAGS
        }

    def encode(self) -> bytes:
        """As `parse_record` reads it."""
        return json.dumps(asdict(self)).encode()


_KINDS: Mapping[object, tuple[type, ...]]
_KINDS = {"str": (str,), "int": (int,), "bool": (bool,), "float": (int, float)}
_TYPES = {field.name: _KINDS[field.type] for field in fields(VehicleRecord)}


def parse_record(found: object) -> VehicleRecord | None:
    """A record from decoded JSON; None when it is not one."""
    if not isinstance(found, dict):
        return None
    if not all(isinstance(found.get(name), kinds) for name, kinds in _TYPES.items()):
        return None
    return VehicleRecord(**{name: found[name] for name in _TYPES})


def decode_record(data: bytes) -> VehicleRecord | None:
    """A record from bytes; None when it is not one."""
    try:
        return parse_record(json.loads(data))
    except (ValueError, RecursionError):
        return None


def record_path(folder: Path, name: str) -> Path:
    """The file of a bridge's record."""
    return folder / f"{name}{_SUFFIX}"


def write_record(folder: Path, record: VehicleRecord) -> None:
    """Replace the bridge's record."""
    values = {**asdict(record), "written_s": time.time()}
    write_json(record_path(folder, record.name), values)


def records(folder: Path) -> Iterator[VehicleRecord]:
    """All records of the folder, by name; broken ones are left out."""
    for path in sorted(folder.glob(f"*{_SUFFIX}")):
        found = parse_record(read_json(path))
        if found is not None:
            yield found


def forget_dead(folder: Path) -> None:
    """Remove the records of bridges that have ended."""
    for record in list(records(folder)):
        if not record.alive:
            record_path(folder, record.name).unlink(missing_ok=True)


def last_word(folder: Path, name: str) -> str:
    """Place and present action of a vehicle whose bridge has ended; empty when it is not armed or not known."""
    record = parse_record(read_json(record_path(folder, name)))
    if record is None or not record.armed:
        return ""
    fate = f": {record.fate}" if record.fate else ""
    return f"its vehicle was {record.state}{fate}; ptnsbc stop reaches it past its bridge"


def in_pilots_hands(folder: Path, names: Iterable[str]) -> bool:
    """True if pilots fly all of these vehicles, as far as their bridges know."""
    known = {record.name: record for record in records(folder)}
    return all(name in known and known[name].in_pilots_hands for name in names)


def reported(name: str, values: Mapping[str, str]) -> VehicleRecord:
    """The record of a vehicle, as its bridge on any host reports it now."""
    texts = {key: values.get(key, "") for key in _TEXTS}
    flags = {key: values.get(key) == "true" for key in _FLAGS}
    return VehicleRecord(name, 0, 0, "", "", written_s=time.time(), **texts, **flags)  # type: ignore[arg-type]
