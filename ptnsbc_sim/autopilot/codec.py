"""MAVLink 2 bytes of one vehicle on one link, signed when there is a key."""

from __future__ import annotations

from typing import Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.signing import timestamp_now


class AutopilotError(PtnsbcError):
    """A stand-in that cannot be started as asked."""


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
            signing.timestamp = timestamp_now()

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
