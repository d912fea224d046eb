"""The records of an MCAP file in the order of the file, around whatever is damaged.

For files without an index: killed recordings, copies that were cut, flipped bytes. A damaged chunk costs
that chunk; after a damaged length the walk goes on at the next thing that looks like a chunk.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import IO, Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Message, Metadata, Schema

from ptnsbc_io.bag.chunk import RECORD_HEAD, Entry, declarations, entries, parse_chunk, unpacked

MAGIC = b"\x89MCAP0\r\n"

_LAST_OPCODE = Opcode.DATA_END
# Opcode to compression: start, end, size, checksum; then the length of what we look for, and that.
_BEFORE_COMPRESSION = RECORD_HEAD.size + 8 + 8 + 8 + 4
_COMPRESSION = re.compile(rb"\x04\0\0\0zstd|\x03\0\0\0lz4")
_BLOCK = 1 << 22
_PLAIN: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
}


@dataclass
class Damage:
    """What a walk had to leave out."""

    chunks: int = 0  # damaged, with all messages in them
    cut: bool = False  # the file ends inside a record, or before its footer

    def __bool__(self) -> bool:
        return self.cut or self.chunks > 0


class _Place(NamedTuple):
    offset: int
    opcode: int
    length: int  # of the body; -1 where the file has no room for it


def walk(
    stream: IO[bytes], damage: Damage
) -> Iterator[Schema | Channel | Attachment | Metadata | Entry]:
    """Everything readable that is not an index; `damage` tells afterwards what was not.

    Args:
        stream: an MCAP file whose start has been checked.
        damage: filled in on the way.
    """
    size = stream.seek(0, 2)
    offset: int | None = len(MAGIC)
    while offset is not None:
        place = _look(stream, offset, size)
        if place is None:
            damage.cut = True
            return
        if place.opcode == Opcode.FOOTER:
            return
        found = _contents(stream, place)
        if found is None:
            offset = _after_damage(stream, place, damage)
            continue
        yield from found
        offset = place.offset + RECORD_HEAD.size + place.length


def _look(stream: IO[bytes], offset: int, size: int) -> _Place | None:
    stream.seek(offset)
    head = stream.read(RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        return None
    opcode, length = RECORD_HEAD.unpack(head)
    room = size - offset - RECORD_HEAD.size
    return _Place(offset, opcode, length if length <= room else -1)


def _contents(stream: IO[bytes], place: _Place) -> list[Any] | Iterator[Any] | None:
    """What a record holds; None when it is damaged."""
    known = 0 < place.opcode <= _LAST_OPCODE or place.opcode >= 0x80
    if place.length < 0 or not known:
        return None
    if place.opcode not in (*_PLAIN, Opcode.CHUNK, Opcode.MESSAGE):
        return []
    body = stream.read(place.length)
    try:
        if place.opcode == Opcode.CHUNK:
            data = unpacked(parse_chunk(body))
            # Both lists before the first is used: a chunk counts as a whole, or not at all.
            return [*declarations(data), *entries(data)]
        if place.opcode == Opcode.MESSAGE:
            found = Message.read(ReadDataStream(BytesIO(body)), len(body))
            return [
                Entry(
                    found.channel_id, found.sequence, found.log_time, found.publish_time, found.data
                )
            ]
        return [_PLAIN[place.opcode].read(ReadDataStream(BytesIO(body)))]
    except Exception:
        # Broad on purpose: damaged bytes surface as struct, zstd, CRC, key, value or EOF errors.
        return None


def _after_damage(stream: IO[bytes], place: _Place, damage: Damage) -> int | None:
    """Where to go on behind a damaged record; None at the end of the file."""
    if place.opcode == Opcode.CHUNK and place.length >= 0:
        damage.chunks += 1
    following = _next_chunk(stream, place.offset + 1)
    if following is not None:
        if not (place.opcode == Opcode.CHUNK and place.length >= 0):
            damage.chunks += 1
        return following
    if place.length >= 0:
        return place.offset + RECORD_HEAD.size + place.length
    damage.cut = True
    return None


def _next_chunk(stream: IO[bytes], offset: int) -> int | None:
    """Offset of the next chunk, found by the name of its compression; None when there is none."""
    stream.seek(offset)
    kept, base = b"", offset
    while block := stream.read(_BLOCK):
        window = kept + block
        for match in _COMPRESSION.finditer(window):
            start = match.start() - _BEFORE_COMPRESSION
            if start >= 0 and window[start] == Opcode.CHUNK:
                return base + start
        kept = window[-2 * _BEFORE_COMPRESSION :]
        base += len(window) - len(kept)
    return None
