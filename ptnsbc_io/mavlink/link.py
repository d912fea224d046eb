"""A link to one vehicle: bytes to frames, signatures, and the messages of that vehicle alone.

Other system ids and components are dropped and counted, and so are unsigned or wrongly signed packets on a signed
link, replays, and bytes that are no packet. Neither state nor setpoints depend on them.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import select
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from ptnsbc_io.files import read_key
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.transport import Address, Transport, connect

V2, V1 = 0xFD, 0xFE
SIGNED = 0x01
"""The incompatibility flag of a signed frame; a frame with any other flag must be dropped."""

SIGNATURE_SIZE = 13
_HEADER_V2, _HEADER_V1, _CHECKSUM = 10, 6, 2


class Frame(NamedTuple):
    """One whole frame; its checksum is not verified yet."""

    data: bytes
    message_id: int
    sysid: int
    compid: int
    signed: bool


class BrokenFrame(NamedTuple):
    """Bytes that are not a frame."""

    truncated: bool  # a frame begins, but its end is missing


class Framer:
    """Cuts datagrams or a stream of bytes into frames.

    A frame that a datagram cuts is lost. The cut frame of a stream is kept until more bytes arrive.
    In a stream a frame with a wrong checksum counts as noise: noise that looks like a header must
    not hide the frames behind it.
    """

    def __init__(self, stream: bool) -> None:
        self._stream = stream
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[Frame | BrokenFrame]:
        """Frames of these bytes in order; for each run of bytes between them one `BrokenFrame`."""
        data, self._rest = self._rest + data, b""
        at, junk = 0, False
        while at < len(data):
            size = _size(data, at)
            if size is None or (self._stream and _is_noise(data, at, size)):
                junk, at = True, at + 1
                continue
            if junk:
                junk = False
                yield BrokenFrame(truncated=False)
            if at + size > len(data):
                if self._stream:
                    self._rest = data[at:]
                else:
                    yield BrokenFrame(truncated=True)
                return
            yield _frame(data[at : at + size])
            at += size
        if junk:
            yield BrokenFrame(truncated=False)


def _size(data: bytes, at: int) -> int | None:
    """Length of the frame that begins at `at`; None when no frame begins there."""
    marker, left = data[at], len(data) - at
    if marker == V2:
        if left < 3:
            return _HEADER_V2 + _CHECKSUM
        if data[at + 2] & ~SIGNED:
            return None
        signature = SIGNATURE_SIZE if data[at + 2] & SIGNED else 0
        return _HEADER_V2 + data[at + 1] + _CHECKSUM + signature
    if marker == V1:
        return _HEADER_V1 + (data[at + 1] if left > 1 else 0) + _CHECKSUM
    return None


def _is_noise(data: bytes, at: int, size: int) -> bool:
    """True if noise looks like the beginning of a frame; False while more bytes are needed to tell."""
    if at + size > len(data):
        return False
    frame = _frame(data[at : at + size])
    kind = mavlink.mavlink_map.get(frame.message_id)
    if kind is None:  # without the dialect there is no checksum; another frame must follow
        return at + size < len(data) and data[at + size] not in (V1, V2)
    end = size - _CHECKSUM - (SIGNATURE_SIZE if frame.signed else 0)
    found = mavlink.x25crc(frame.data[1:end] + bytes([kind.crc_extra])).crc
    return bool(found != int.from_bytes(frame.data[end : end + _CHECKSUM], "little"))


def _frame(data: bytes) -> Frame:
    if data[0] == V2:
        number = data[7] | data[8] << 8 | data[9] << 16
        return Frame(data, number, data[5], data[6], bool(data[2] & SIGNED))
    return Frame(data, data[5], data[3], data[4], False)


_EPOCH_2015_S = 1420070400
_TICKS_PER_S = 100_000  # timestamps count 10 us
_NEW_STREAM_AGE = 60 * _TICKS_PER_S


def timestamp_now() -> int:
    """The signing clock: units of 10 us since 2015."""
    return max(int((time.time() - _EPOCH_2015_S) * _TICKS_PER_S), 0)


class Signer:
    """One side of a signed link (mavlink.io, Message Signing).

    pymavlink stores the timestamp of a packet before it verifies the signature, so one forged packet locks the true
    sender out. Here the signature is verified first.
    """

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


OWN_COMPONENT = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1


def companion_heartbeat() -> Any:
    """The sign of life of a companion."""
    kind, autopilot = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
    return mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, mavlink.MAV_STATE_ACTIVE, 3)


_ADDRESS_TIMEOUT_S = 3.0
_MOST_PER_POLL = 200  # packets; a flood must not delay the setpoint stream


_DROPPED = (  # reasons why
    "malformed",  # no frame, wrong checksum, impossible length
    "truncated",
    "other_sysid",
    "other_component",
    "unsigned",
    "wrong_signed",
    "replayed",
    "other_address",  # the same system id from a second address
)


class MavlinkLink:
    """Decoded messages of one vehicle in, packed messages out."""

    def __init__(
        self, transport: Transport, sysid: int, wanted: frozenset[int], signer: Signer | None = None
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
        self.counts: Counter[str] = Counter(dict.fromkeys(_DROPPED, 0))
        self.ignored: frozenset[int] = frozenset()
        """Wanted messages that carry nothing new at present: they are not decoded either."""
        self.resumed = False
        """True if another bridge has left the vehicle in flight; one of MAVLink says its state itself."""
        self.missing = ""
        """The reason why the vehicle cannot be flown, where the link itself knows; a flight controller says it."""
        self.received = self.sent = self.unsent = 0

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
                    self.counts["truncated" if piece.truncated else "malformed"] += 1
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

    def command(self, _request: object, message: Any) -> bool:
        """Send the message of a request of the bridge; False when it could not be sent."""
        return self.send(message)

    def close(self) -> None:
        """Close the port."""
        self._transport.close()

    def _accept(self, frame: Frame, sender: Address | None, now_s: float) -> Any:
        if frame.sysid != self._sysid:
            self.counts["other_sysid"] += 1
            return None
        if frame.compid != AUTOPILOT_COMPONENT:
            self.counts["other_component"] += 1
            return None
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
            self.counts["unsigned"] += 1
            # PX4 begins with MAVLink 1 and changes to signed MAVLink 2 when it receives that. So we
            # send to an unsigned address first; an address alone gives no control of the vehicle.
            if self.peer is None and self._decode(frame) is not None:
                self.peer, self._peer_time_s = sender, now_s - _ADDRESS_TIMEOUT_S
            return False
        if not signer.has_valid_signature(frame):
            self.counts["wrong_signed"] += 1
            return False
        if not signer.is_new(frame):
            self.counts["replayed"] += 1
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
        self.counts["malformed"] += 1
        return None

    def _is_from_peer(self, sender: Address | None, now_s: float) -> bool:
        """True if the sender has the address of the vehicle; after 3 s of silence a new address is taken."""
        if sender is None or self.peer == sender:
            self._peer_time_s = now_s
            return True
        if self.peer is None or now_s - self._peer_time_s >= _ADDRESS_TIMEOUT_S:
            self.peer, self._peer_time_s = sender, now_s
            return True
        self.duplicate_sysid_s = now_s
        self.counts["other_address"] += 1
        return False


def link_to(
    address: str, sysid: int, wanted: frozenset[int], key: str = "", link_id: int = 0
) -> MavlinkLink:
    """The link to the vehicle at an address as `connect` takes it; `key`: path of the key file, empty without signing.

    Raises:
        PtnsbcError: the link cannot be opened, or the key not be read.
    """
    signer = Signer(read_key(Path(key)), link_id) if key else None
    return MavlinkLink(connect(address), sysid, wanted, signer)
