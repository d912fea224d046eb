"""Bytes to MAVLink frames: where a frame begins and ends. Its checksum is verified later."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from ptnsbc_io.mavlink.dialect import mavlink

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
    sequence: int
    signed: bool
    version: int  # 1 or 2


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
        return Frame(data, number, data[5], data[6], data[4], bool(data[2] & SIGNED), 2)
    return Frame(data, data[5], data[3], data[4], data[2], False, 1)
