"""A link to one vehicle: messages of that vehicle are passed on, everything else is dropped and counted.

Dropped are other system ids and components, unsigned or wrongly signed packets on a signed link,
replays, and bytes that are no packet. Neither state nor setpoints depend on them.
"""

from __future__ import annotations

import contextlib
import select
from collections import Counter
from collections.abc import Iterator
from enum import Enum
from typing import Any

from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.framing import BrokenFrame, Frame, Framer
from ptnsbc_io.mavlink.signing import Signer
from ptnsbc_io.mavlink.transport import Address, Transport

OWN_COMPONENT = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1

_ADDRESS_TIMEOUT_S = 3.0
_MOST_PER_POLL = 200  # packets; a flood must not delay the setpoint stream


class Dropped(Enum):
    """The reason why a packet was dropped; the values are names of counters."""

    MALFORMED = "malformed"  # no frame, wrong checksum, impossible length
    TRUNCATED = "truncated"
    OTHER_SYSID = "other_sysid"
    OTHER_COMPONENT = "other_component"
    UNSIGNED = "unsigned"
    WRONG_SIGNED = "wrong_signed"
    REPLAYED = "replayed"
    OTHER_ADDRESS = "other_address"  # the same system id from a second address


class MavlinkLink:
    """Decoded messages of one vehicle in, packed messages out."""

    def __init__(
        self,
        transport: Transport,
        sysid: int,
        wanted: frozenset[int],
        signer: Signer | None = None,
    ) -> None:
        """`wanted`: message ids to decode; the others are only counted as received."""
        self._transport = transport
        self._sysid = sysid
        self._wanted = wanted
        self._signer = signer
        self._framer = Framer(transport.stream)
        # One system id for vehicle and companion: the companion is a component of the vehicle.
        self.codec: Any = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=OWN_COMPONENT)
        self._decoder: Any = mavlink.MAVLink(None)
        self.peer: Address | None = None
        """Address of the vehicle, from its first message on; None on a serial line."""
        self._peer_time_s = 0.0
        self.duplicate_sysid_s: float | None = None
        """Time of the last message from a second sender with the same system id; None without any."""
        self.counts: Counter[str] = Counter({reason.value: 0 for reason in Dropped})
        self.ignored: frozenset[int] = frozenset()
        """Wanted messages that carry nothing new at present: they are not decoded either."""
        self.received = 0
        self.sent = 0
        self.unsent = 0

    @property
    def signed(self) -> bool:
        """True if only signed packets are accepted."""
        return self._signer is not None

    def fileno(self) -> int:
        """For select()."""
        return self._transport.fileno()

    def wait(self, timeout_s: float) -> None:
        """Return when something has arrived, at the latest after `timeout_s`."""
        select.select([self], [], [], max(timeout_s, 0.0))

    def poll(self, now_s: float) -> Iterator[Any]:
        """Accepted messages that have arrived, in order."""
        for _ in range(_MOST_PER_POLL):
            packet = self._transport.receive()
            if packet is None:
                return
            for piece in self._framer.feed(packet.data):
                if isinstance(piece, BrokenFrame):
                    self._drop(Dropped.TRUNCATED if piece.truncated else Dropped.MALFORMED)
                    continue
                message = self._accept(piece, packet.sender, now_s)
                if message is not None:
                    yield message

    def send(self, message: Any) -> bool:
        """Pack, sign where the link is signed, and send; False when it could not be sent."""
        if self._signer is not None:
            self._signer.prepare(self.codec)
        done = self._transport.send(message.pack(self.codec), self.peer)
        self.codec.seq = (self.codec.seq + 1) % 256
        self.sent += done
        self.unsent += not done
        return done

    def close(self) -> None:
        """Close the port."""
        self._transport.close()

    def _drop(self, reason: Dropped) -> None:
        self.counts[reason.value] += 1

    def _accept(self, frame: Frame, sender: Address | None, now_s: float) -> Any:
        """The message, when it passes all checks."""
        if frame.sysid != self._sysid:
            return self._drop(Dropped.OTHER_SYSID)
        if frame.compid != AUTOPILOT_COMPONENT:
            return self._drop(Dropped.OTHER_COMPONENT)
        if not self._is_authentic(frame, sender, now_s):
            return None
        if frame.message_id not in self._wanted or frame.message_id in self.ignored:
            self.received += 1
            return None
        message = self._decode(frame)
        if message is None or not self._is_from_peer(sender, now_s):
            return None
        self.received += 1
        return message

    def _is_authentic(self, frame: Frame, sender: Address | None, now_s: float) -> bool:
        signer = self._signer
        if signer is None:
            return True
        if not frame.signed:
            self._drop(Dropped.UNSIGNED)
            # PX4 begins with MAVLink 1 and changes to signed MAVLink 2 when it receives that. So we
            # send to an unsigned address first; an address alone gives no control of the vehicle.
            if self.peer is None and self._decode(frame) is not None:
                self.peer, self._peer_time_s = sender, now_s - _ADDRESS_TIMEOUT_S
            return False
        if not signer.has_valid_signature(frame):
            self._drop(Dropped.WRONG_SIGNED)
            return False
        if not signer.is_new(frame):
            self._drop(Dropped.REPLAYED)
            return False
        return True

    def _decode(self, frame: Frame) -> Any:
        """The message; None, counted, when its checksum or its length is wrong."""
        # pymavlink raises MAVError, struct.error, UnicodeDecodeError or IndexError on unexpected
        # bytes. A packet that cannot be decoded counts as malformed.
        with contextlib.suppress(Exception):
            message = self._decoder.decode(bytearray(frame.data))
            if message.get_msgId() == frame.message_id and message.get_type() != "UNKNOWN":
                return message
        return self._drop(Dropped.MALFORMED)

    def _is_from_peer(self, sender: Address | None, now_s: float) -> bool:
        """True if the sender has the address of the vehicle; after 3 s of silence a new address is taken."""
        if sender is None or self.peer == sender:
            self._peer_time_s = now_s
            return True
        if self.peer is None or now_s - self._peer_time_s >= _ADDRESS_TIMEOUT_S:
            self.peer, self._peer_time_s = sender, now_s
            return True
        self.duplicate_sysid_s = now_s
        self._drop(Dropped.OTHER_ADDRESS)
        return False
