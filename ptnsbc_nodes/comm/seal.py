"""The fleet's seal: with `security: signed` every message between processes carries a time and an authenticator.

A sealed message is the message, zeros up to a multiple of 4 bytes, which DDS adds on the way in any case, and 24 bytes:
a time [ns], and 16 bytes of a keyed BLAKE2b (RFC 7693, a message authentication code) over the topic and all before.
Readers of CDR ignore bytes after a message. A recorder opens the seals, so a bag holds the messages alone.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import struct
import time
from collections.abc import Callable
from pathlib import Path

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_io.files import KEY_BYTES, read_key
from ptnsbc_nodes.comm.topics import CLOCK, EPOCH, Role, Topic
from ptnsbc_sim.scenario import Scenario

KEY_FILE = "PTNSBC_FLEET_KEY"
"""Environment variable: the key file, instead of `fleet.key` in the folder for settings."""
WINDOW_S = 10.0
"""Real time: a sealed message is at most this old, and at most this far ahead of our clock."""
LATCHED_WINDOW_S = 3600.0
"""The same for a latched message, which a process that joins late receives."""

_TIME = struct.Struct("<q")
_CODE_BYTES = 16
SEAL_BYTES = _TIME.size + _CODE_BYTES
_UNSEALED = frozenset({CLOCK.name})
"""DDS gives a message of this type no more bytes than it has. No process of ours flies by it."""
_CONTEXT = b"ptnsbc fleet 1"


class SealError(PtnsbcError):
    """A message without the seal of the fleet, or a fleet without a key."""


class Seal:
    """Closes and opens messages with the key of the fleet, `KEY_BYTES` long, by the clock of all its computers."""

    def __init__(
        self, key: bytes, *, required: bool = True, now_ns: Callable[[], int] = time.time_ns
    ) -> None:
        """`required`: a message without a seal is refused; an operator's program takes both."""
        self._key, self._required, self._now_ns = key, required, now_ns

    def closer(self, topic: Topic) -> Callable[[bytes], bytes]:
        """The function that seals the messages of one topic."""
        if topic.name in _UNSEALED:
            return bytes
        start, now_ns, pack = self._start(topic), self._now_ns, _TIME.pack

        def close(data: bytes) -> bytes:
            sealed = data + bytes(-len(data) % 4) + pack(now_ns())
            code = start.copy()
            code.update(sealed)
            return sealed + code.digest()

        return close

    def opener(self, topic: Topic, *, lockstep: bool = False) -> Callable[[bytes], bytes]:
        """The function that opens the messages of one topic; SealError for one that the fleet has not sealed.

        In lock-step a state may wait longer than any window; there its own stamp says whether it is the right one.
        """
        if topic.name in _UNSEALED:
            return bytes
        start, required, now_ns = self._start(topic), self._required, self._now_ns
        window_s = LATCHED_WINDOW_S if topic.role is Role.LATCHED else WINDOW_S
        timed = not lockstep or topic.role is Role.LATCHED
        newest_ns = -1

        def open_sealed(data: bytes) -> bytes:
            nonlocal newest_ns
            code = start.copy()
            code.update(data[:-_CODE_BYTES])
            if len(data) < SEAL_BYTES or not hmac.compare_digest(
                code.digest(), data[-_CODE_BYTES:]
            ):
                if required:
                    raise SealError("not sealed with the key of the fleet")
                return data
            (sent_ns,) = _TIME.unpack_from(data, len(data) - SEAL_BYTES)
            age_s = seconds(now_ns() - sent_ns)
            if timed and not -WINDOW_S <= age_s <= window_s:
                raise SealError(f"sealed {age_s:.1f} s ago: expected {window_s:g} s at most")
            if topic.name == EPOCH.name:  # of two legs the one announced last counts
                if sent_ns <= newest_ns:
                    raise SealError("a leg that is not newer than the one before")
                newest_ns = sent_ns
            return data[:-SEAL_BYTES]

        return open_sealed

    def _start(self, topic: Topic) -> hashlib.blake2b:
        code = hashlib.blake2b(key=self._key, digest_size=_CODE_BYTES, person=_CONTEXT)
        code.update(topic.name.encode() + b"\0")
        return code


def key_file() -> Path:
    """The path of the key of the fleet: `PTNSBC_FLEET_KEY`, or `ptnsbc/fleet.key` in the folder for settings."""
    given = os.environ.get(KEY_FILE)
    folder = os.environ.get("XDG_CONFIG_HOME") or str(Path.home() / ".config")
    return Path(given) if given else Path(folder) / "ptnsbc" / "fleet.key"


def seal_of(scenario: Scenario) -> Seal | None:
    """The seal that a scenario requires; None when it requires none, PtnsbcError when there is no usable key."""
    return required_seal() if scenario.security == "signed" else None


def required_seal() -> Seal:
    """The seal of the fleet; SealError when there is no key."""
    path = key_file()
    if not path.exists():
        raise SealError(
            f"security: signed: {path}: expected the key of the fleet: ptnsbc network key"
        )
    return Seal(read_key(path))


def operators_seal() -> Seal | None:
    """The seal of a program that knows no scenario: it seals if there is a key, and reads what is not sealed."""
    path = key_file()
    return Seal(read_key(path), required=False) if path.exists() else None


def new_key(path: Path) -> None:
    """Write a new key that only its owner can read; SealError when the file exists, or cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.write(os.urandom(KEY_BYTES).hex() + "\n")
    except FileExistsError:
        raise SealError(f"{path} exists: expected a new file; a key is never overwritten") from None
    except OSError as error:
        raise SealError(f"{path}: {error.strerror}: expected a place for the key") from None
