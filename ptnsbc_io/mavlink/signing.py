"""MAVLink 2 message signing (mavlink.io, Message Signing): signatures made and checked.

pymavlink stores the timestamp of a packet before it verifies the signature, so one forged packet
locks the true sender out. Here the signature is verified first.
"""

from __future__ import annotations

import hashlib
import hmac
import time
from typing import Any

from ptnsbc_io.mavlink.framing import SIGNATURE_SIZE, Frame

_EPOCH_2015_S = 1420070400
_TICKS_PER_S = 100_000  # timestamps count 10 us
_NEW_STREAM_AGE = 60 * _TICKS_PER_S


def timestamp_now() -> int:
    """The signing clock: units of 10 us since 2015."""
    return max(int((time.time() - _EPOCH_2015_S) * _TICKS_PER_S), 0)


class Signer:
    """One side of a signed link."""

    def __init__(self, key: bytes, link_id: int = 0, timestamp: int | None = None) -> None:
        self.key = key
        self.link_id = link_id
        self._newest = timestamp_now() if timestamp is None else timestamp
        self._streams: dict[tuple[int, int, int], int] = {}

    def prepare(self, codec: Any) -> None:
        """Set pymavlink up to sign the next packet that it packs."""
        # Never behind the wall clock, so that a restart does not look like a replay; and never
        # behind what we have sent or accepted.
        self._newest = max(self._newest + 1, timestamp_now())
        codec.signing.secret_key = self.key
        codec.signing.link_id = self.link_id
        codec.signing.timestamp = self._newest
        codec.signing.sign_outgoing = True

    def has_valid_signature(self, frame: Frame) -> bool:
        """True if the signature was made with our key, at any time."""
        digest = hashlib.sha256(self.key + frame.data[:-6]).digest()[:6]
        return hmac.compare_digest(digest, frame.data[-6:])

    def is_new(self, frame: Frame) -> bool:
        """True if a validly signed frame is newer than all before it in its stream; stores its timestamp then."""
        block = frame.data[-SIGNATURE_SIZE:]
        stamp = int.from_bytes(block[1:7], "little")
        stream = (block[0], frame.sysid, frame.compid)
        last = self._streams.get(stream)
        if (stamp + _NEW_STREAM_AGE < self._newest) if last is None else (stamp <= last):
            return False
        self._streams[stream] = stamp
        self._newest = max(self._newest, stamp)
        return True
