"""MAVLink 2 bytes of one vehicle on one link, signed when there is a key."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ptnsbc_core.errors import PtnsbcError

KEY_BYTES = 32
_SIGNING_EPOCH_S = 1420070400  # 2015-01-01, https://mavlink.io/en/guide/message_signing.html


class AutopilotError(PtnsbcError):
    """A stand-in that cannot be started as asked."""


def read_key(path: Path) -> bytes:
    """A signing key: 32 bytes, or 64 hexadecimal digits.

    Raises:
        AutopilotError: the file is missing or holds neither.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise AutopilotError(f"key {path}: {error.strerror}; expected a readable file") from None
    if len(data) == KEY_BYTES:
        return data
    try:
        key = bytes.fromhex(data.decode("ascii").strip())
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise AutopilotError(
            f"key {path}: {len(data)} bytes; expected 32 bytes or 64 hexadecimal digits, "
            "as from: head -c 32 /dev/urandom"
        )
    return key


class Codec:
    """Encoder and decoder with the sequence number and the signature of one link."""

    def __init__(
        self, system: int, component: int = 1, *, key: bytes | None = None, link_id: int = 0
    ) -> None:
        self._mavlink = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self._mavlink.robust_parsing = True
        self.dropped = 0
        if key is not None:
            signing = self._mavlink.signing
            signing.secret_key = key
            signing.sign_outgoing = True
            signing.link_id = link_id
            signing.timestamp = int((time.time() - _SIGNING_EPOCH_S) * 1e5)

    def encode(self, message: Any) -> bytes:
        """One packet."""
        packet = bytes(message.pack(self._mavlink))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
        return packet

    def decode(self, datagram: bytes) -> list[Any]:
        """The messages in a datagram; what is broken, unknown or not signed as it must be is counted and left out."""
        out = []
        for message in self._mavlink.parse_buffer(datagram) or ():
            if message.get_type() == "BAD_DATA" or message.get_type().startswith("UNKNOWN"):
                self.dropped += 1
            else:
                out.append(message)
        return out
