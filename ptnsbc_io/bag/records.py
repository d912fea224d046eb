"""The records of an MCAP file: the messages in a chunk, and a walk through a file around its damage.

The MCAP library makes an object of every record and stops at the first damage. Here a message costs
one `struct` call, and the walk goes on behind a damaged chunk.

A file may have been made to do harm. Every length is checked before it is used, what a file may unpack to
is bounded by its size, and so is the work that its damage costs.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from operator import attrgetter
from typing import IO, Any, NamedTuple, TypeAlias

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Message, Metadata, Schema

MAGIC = b"\x89MCAP0\r\n"
LARGEST_CHUNK = 1 << 25  # [bytes], uncompressed; writers make chunks of one to four megabytes
MOST_MESSAGES = 200_000  # in a chunk; one of ours has some thousand
LAST_NS = 2**63 - 1  # of all times, in the year 2262
RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of the body
_MESSAGE = struct.Struct("<BQHIQQ")
# A chunk before the name of its compression: head, start, end, size, checksum, length of the name.
_BEFORE_COMPRESSION = RECORD_HEAD.size + 8 + 8 + 8 + 4
_COMPRESSION = re.compile(rb"\x04\0\0\0zstd|\x03\0\0\0lz4")
_BLOCKS = 1 << 12, 1 << 22  # [bytes], read at once in the search for a chunk: first, and at most
_LEAST_UNPACKED = 1 << 27  # [bytes], of a file of any size
_UNPACKED_RATIO = 300  # a flight that hovers is compressed to a hundredth
_LEAST_PACKED = 4  # [bytes], of a message with its times
_DAMAGE_RATIO = 4  # how often the bytes of a file may be read in vain
_CROWDED = f"more messages than {MOST_MESSAGES} in a chunk, or than such a file holds"
_RECORD_TYPES: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
}


class BagMessage(NamedTuple):
    """One message of a bag."""

    topic: str
    stamp_ns: int  # log time [ns]
    data: bytes  # CDR


class MessageRecord(NamedTuple):
    """One message of a file."""

    channel_id: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


Record: TypeAlias = Schema | Channel | Attachment | Metadata | MessageRecord


@dataclass
class Damage:
    """The part of a file that a walk could not read."""

    chunks: int = 0  # damaged chunks, lost with all their messages
    cut: bool = False  # the file ends inside a record, or before its footer

    def __bool__(self) -> bool:
        return self.cut or self.chunks > 0


def unpacked_bytes(size: int) -> int:
    """The number of bytes that all chunks of a file of `size` bytes may unpack to."""
    return _LEAST_UNPACKED + _UNPACKED_RATIO * size


def messages_in(size: int) -> int:
    """The number of messages that all chunks of a file of `size` bytes may hold."""
    return MOST_MESSAGES + size // _LEAST_PACKED


class Unpacker:
    """Decompresses the chunks of one file, up to what a file of its size may hold."""

    def __init__(self, file_size: int) -> None:
        self._left = unpacked_bytes(file_size)
        self._messages_left = messages_in(file_size)

    def count(self, messages: int) -> None:
        """Count messages of an unpacked chunk; ValueError when they are too many for the file."""
        self._messages_left -= messages
        if self._messages_left < 0:
            raise ValueError(_CROWDED)

    def unpack(self, body: bytes) -> bytes:
        """The decompressed records of a chunk record; ValueError when the chunk is damaged.

        Args:
            body: the chunk record without opcode and length.
        """
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))
        size = chunk.uncompressed_size
        if self._messages_left < 0:
            raise ValueError(_CROWDED)
        if size > min(LARGEST_CHUNK, self._left):
            raise ValueError(
                f"a chunk that unpacks to {size} bytes: expected {LARGEST_CHUNK} at most"
            )
        self._left -= size
        return _decompressed(chunk)


def _decompressed(chunk: Chunk) -> bytes:
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        if zstandard.frame_content_size(chunk.data) not in (-1, size):
            raise ValueError("size in a compressed frame")
        data = bytes(zstandard.decompress(chunk.data, size))
    elif chunk.compression == "lz4":
        import lz4.frame

        # One byte more than stated is enough to see that the statement is wrong.
        data = bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size + 1))
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"compression {chunk.compression!r}")
    if len(data) != size:
        raise ValueError("size of a chunk")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("checksum of a chunk")
    return data


def chunk_records(data: bytes) -> Iterator[Schema | Channel | MessageRecord]:
    """The schemas, channels and messages of a decompressed chunk, in the order of the file."""
    at = messages = 0
    while at < len(data):
        end = _record_end(data, at)
        opcode = data[at]
        if opcode == Opcode.MESSAGE:
            if end - at < _MESSAGE.size:
                raise ValueError("length of a message")
            messages += 1
            if messages > MOST_MESSAGES:
                raise ValueError(_CROWDED)
            _, _, channel_id, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(data, at)
            if log_ns > LAST_NS:
                raise ValueError("time of a message")
            body = data[at + _MESSAGE.size : end]
            yield MessageRecord(channel_id, sequence, log_ns, publish_ns, body)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            body = data[at + RECORD_HEAD.size : end]
            yield _RECORD_TYPES[opcode].read(ReadDataStream(BytesIO(body)))
        at = end


def chunk_messages(data: bytes, topics: Mapping[int, str]) -> list[BagMessage]:
    """The messages of some channels in a decompressed chunk, in order of log time.

    Messages of equal time stay in the order of the file. This is the fast path of reading: it makes
    no object for a message of another channel.

    Args:
        data: decompressed chunk.
        topics: topic by channel id.
    """
    found = []
    at, end = 0, len(data)
    while at < end:
        if data[at] != Opcode.MESSAGE or end - at < _MESSAGE.size:
            at = _record_end(data, at)
            continue
        _, length, channel_id, _, log_ns, _ = _MESSAGE.unpack_from(data, at)
        start, at = at + _MESSAGE.size, at + RECORD_HEAD.size + length
        if not start <= at <= end:
            raise ValueError("length of a message")
        if channel_id in topics:
            found.append(BagMessage(topics[channel_id], log_ns, data[start:at]))
            if len(found) > MOST_MESSAGES:
                raise ValueError(_CROWDED)
    found.sort(key=attrgetter("stamp_ns"))
    if found and found[-1].stamp_ns > LAST_NS:
        raise ValueError("time of a message")
    return found


def _record_end(data: bytes, at: int) -> int:
    if len(data) - at < RECORD_HEAD.size:
        raise ValueError("end of a chunk")
    if not data[at]:
        raise ValueError("a record without a kind")
    end = at + RECORD_HEAD.size + int(RECORD_HEAD.unpack_from(data, at)[1])
    if end > len(data):
        raise ValueError("length of a record")
    return end


def walk(stream: IO[bytes], damage: Damage) -> Iterator[Record]:
    """All readable records except indexes, in the order of the file.

    A damaged chunk is left out. Behind a damaged length the walk goes on at the next bytes that look
    like a chunk.

    Args:
        stream: an MCAP file whose magic bytes have been checked.
        damage: filled in on the way.
    """
    size = stream.seek(0, 2)
    unpacker, spare = Unpacker(size), _DAMAGE_RATIO * size
    offset = len(MAGIC)
    following: int | None = (
        offset  # the first chunk that a search found; None: there is no further one
    )
    while True:
        stream.seek(offset)
        head = stream.read(RECORD_HEAD.size)
        if len(head) < RECORD_HEAD.size:
            damage.cut = True
            return
        opcode, length = RECORD_HEAD.unpack(head)
        if opcode == Opcode.FOOTER:
            return
        end = offset + RECORD_HEAD.size + length
        known = _is_known(opcode)
        records = _read_records(stream, opcode, length, unpacker) if known and end <= size else None
        if records is not None:
            yield from records
            offset = end
            continue
        spare -= length if end <= size else 0
        if following is not None and following <= offset:
            following = _next_chunk(stream, offset + 1)
        if following is not None or (opcode == Opcode.CHUNK and end <= size):
            damage.chunks += 1
        if spare < 0 or (following is None and (end > size or not known)):
            damage.cut = True
            return
        offset = end if following is None else following


def _is_known(opcode: int) -> bool:
    """True if MCAP has such a record, or leaves it to others."""
    return 0 < opcode <= Opcode.DATA_END or opcode >= 0x80


def _read_records(
    stream: IO[bytes], opcode: int, length: int, unpacker: Unpacker
) -> list[Record] | None:
    """The records that a record of the file stands for; None when it is damaged."""
    if opcode not in (*_RECORD_TYPES, Opcode.CHUNK, Opcode.MESSAGE):
        return []
    body = stream.read(length)
    try:
        if opcode == Opcode.CHUNK:
            # The whole list before the first record is used: a chunk counts whole, or not at all.
            # Declarations come first: a reader must know a channel before its messages.
            records = list(chunk_records(unpacker.unpack(body)))
            unpacker.count(len(records))
            return sorted(records, key=lambda record: isinstance(record, MessageRecord))
        if opcode == Opcode.MESSAGE:
            found = Message.read(ReadDataStream(BytesIO(body)), len(body))
            if found.log_time > LAST_NS:
                return None
            times = found.log_time, found.publish_time
            return [MessageRecord(found.channel_id, found.sequence, *times, found.data)]
        return [_RECORD_TYPES[opcode].read(ReadDataStream(BytesIO(body)))]
    except Exception:
        # Broad on purpose: damaged bytes surface as struct, zstd, CRC, key, value or EOF errors.
        return None


def _next_chunk(stream: IO[bytes], offset: int) -> int | None:
    """Offset of the next chunk, found by the name of its compression; None when there is none."""
    stream.seek(offset)
    kept, base = b"", offset
    length, longest = _BLOCKS
    while block := stream.read(length):
        length = min(2 * length, longest)
        window = kept + block
        for match in _COMPRESSION.finditer(window):
            start = match.start() - _BEFORE_COMPRESSION
            if start >= 0 and window[start] == Opcode.CHUNK:
                return base + start
        kept = window[-2 * _BEFORE_COMPRESSION :]
        base += len(window) - len(kept)
    return None
