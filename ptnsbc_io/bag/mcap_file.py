"""One MCAP file: its contents by its summary, or by a walk over its records around their damage.

The MCAP library makes an object of every record and stops at the first damage. Here a message costs
one `struct` call, and the walk goes on behind a damaged chunk.

A file may have been made to do harm. Every length is checked before it is used, what a file may unpack to
is bounded by its size, and so is the work that its damage costs.
"""

from __future__ import annotations

import re
import struct
import zlib
from bisect import bisect_left
from collections.abc import Container, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import IO, Any, NamedTuple, TypeAlias

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, ChunkIndex, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from ptnsbc_io.bag.metadata import BagError, DamagedError

MAGIC = b"\x89MCAP0\r\n"
LARGEST_CHUNK = 1 << 25  # [bytes], uncompressed; writers make chunks of one to four megabytes
MOST_MESSAGES = 200_000  # in a chunk; one of ours has some thousand
LAST_NS = 2**63 - 1  # of all times, in the year 2262
RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of the body
# Opcode, length of the body, channel, sequence number, times of the log and of the publication.
MESSAGE_HEAD = struct.Struct("<BQHIQQ")
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


_stamp = attrgetter("stamp_ns")


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


def chunk_records(
    data: bytes, channels: Container[int] | None = None
) -> Iterator[Schema | Channel | MessageRecord]:
    """The schemas, channels and messages of a decompressed chunk, in the order of the file.

    With `channels` only their messages: no object is made for another record.
    """
    at, messages, size = 0, 0, len(data)
    while at < size:
        if data[at] == Opcode.MESSAGE and size - at >= MESSAGE_HEAD.size:
            _, length, channel_id, sequence, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(data, at)
            start, at = at + MESSAGE_HEAD.size, at + RECORD_HEAD.size + length
            if not start <= at <= size:
                raise ValueError("length of a message")
            if channels is None or channel_id in channels:
                messages += 1
                if messages > MOST_MESSAGES:
                    raise ValueError(_CROWDED)
                if log_ns > LAST_NS:
                    raise ValueError("time of a message")
                yield MessageRecord(channel_id, sequence, log_ns, publish_ns, data[start:at])
            continue
        opcode, start = data[at], at + RECORD_HEAD.size
        at = _record_end(data, at)
        if opcode == Opcode.MESSAGE:
            raise ValueError("length of a message")
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and channels is None:
            yield _RECORD_TYPES[opcode].read(ReadDataStream(BytesIO(data[start:at])))


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

    A damaged chunk is left out and counted in `damage`. Behind a damaged length the walk goes on at the next bytes that
    look like a chunk. The magic bytes of the file have been checked.
    """
    size = stream.seek(0, 2)
    unpacker, spare = Unpacker(size), _DAMAGE_RATIO * size
    offset = len(MAGIC)
    following: int | None = offset  # the first chunk that a search found; None: there is none
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
        known = 0 < opcode <= Opcode.DATA_END or opcode >= 0x80  # MCAP's, or left to others
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


class ChunkLocation(NamedTuple):
    """Place and contents of a chunk; a long bag keeps thousands of these while it is read."""

    first_ns: int  # log time
    last_ns: int
    start: int  # of its record in the file
    size: int  # with the head of the record
    channels: frozenset[int]  # shared between chunks that hold the same; empty: not known


@dataclass
class Contents:
    """The contents of a file besides its messages."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)  # messages by channel
    attachments: list[str] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # by name of the record
    span_ns: tuple[int, int] | None = None  # log time; None without messages
    chunks: list[ChunkLocation] = field(default_factory=list)  # empty: read in file order
    damage: Damage = field(default_factory=Damage)

    def add(self, record: object) -> None:
        """Add one record of the file."""
        if isinstance(record, MessageRecord):
            self.counts[record.channel_id] = self.counts.get(record.channel_id, 0) + 1
            first, last = self.span_ns or (record.log_ns, record.log_ns)
            self.span_ns = (min(first, record.log_ns), max(last, record.log_ns))
        elif isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Attachment):
            self.attachments.append(record.name)
        elif isinstance(record, Metadata):
            self.metadata[record.name] = dict(record.metadata)


@contextmanager
def open_mcap(path: Path) -> Iterator[IO[bytes]]:
    """Open a file for reading; whatever error damaged bytes cause becomes a DamagedError."""
    if not path.is_file():  # a pipe would be waited for
        raise BagError(f"{path} cannot be read: expected a file")
    try:
        with path.open("rb") as stream:
            yield stream
    except (BagError, GeneratorExit):
        raise
    except OSError as error:
        raise BagError(f"{path} cannot be read: {error.strerror or error}") from error
    except Exception as error:
        # Broad on purpose: damaged bytes surface as struct, zstd, CRC, key, value or EOF errors.
        raise DamagedError(
            f"{path} is damaged ({type(error).__name__}: {error}): expected intact chunks; "
            "copy the file again, or rescue what is left with: ptnsbc bag repair"
        ) from error


def read_summary(path: Path) -> Contents | None:
    """The contents by the summary; None when it is missing, DamagedError when it is not valid."""
    with open_mcap(path) as stream:
        _check_magic(path, stream)
        size = stream.seek(0, 2)
        stream.seek(max(0, size - len(MAGIC)))
        if size < 2 * len(MAGIC) or stream.read() != MAGIC:
            return None
        stream.seek(0)
        reader = SeekingReader(stream, validate_crcs=True, record_size_limit=size)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            return None
        statistics = summary.statistics
        found = Contents(
            schemas=dict(summary.schemas),
            channels=dict(summary.channels),
            counts=dict(statistics.channel_message_counts),
            attachments=[index.name for index in summary.attachment_indexes],
            chunks=_chunk_locations(summary.chunk_indexes),
        )
        if statistics.message_count:
            found.span_ns = (statistics.message_start_time, statistics.message_end_time)
        left = size  # together they cannot be longer than the file
        for index in summary.metadata_indexes:
            left -= index.length
            stream.seek(index.offset)
            record = next(StreamReader(stream, True, record_size_limit=index.length).records)
            if left < 0 or not isinstance(record, Metadata):
                raise ValueError(f"an index of metadata leads to {type(record).__name__}")
            found.add(record)
        return found


def scan_records(path: Path) -> Contents:
    """The contents by all readable records, for a file without summary; with its damage."""
    found = Contents()
    with open_mcap(path) as stream:
        _check_magic(path, stream)
        for record in walk(stream, found.damage):
            found.add(record)
    return found


def messages_by_time(
    path: Path, contents: Contents, wanted: frozenset[str] | None
) -> Iterator[BagMessage]:
    """Messages in order of log time; DamagedError at the first damage."""
    channels = contents.channels.values()
    topics = {c.id: c.topic for c in channels if wanted is None or c.topic in wanted}
    chunks = [c for c in contents.chunks if not c.channels or not c.channels.isdisjoint(topics)]
    with open_mcap(path) as stream:
        unpacker = Unpacker(stream.seek(0, 2))

        def messages(chunk: ChunkLocation) -> list[BagMessage]:
            """Those of equal time stay in the order of the file."""
            stream.seek(chunk.start + RECORD_HEAD.size)
            records = chunk_records(unpacker.unpack(stream.read(chunk.size)), topics)
            found = [
                BagMessage(topics[record.channel_id], record.log_ns, record.data)
                for record in records
                if isinstance(record, MessageRecord)
            ]
            unpacker.count(len(found))
            return sorted(found, key=_stamp)

        if not any(a.last_ns > b.first_ns for a, b in pairwise(chunks)):
            for chunk in chunks:
                yield from messages(chunk)
            return
        # Chunks overlap in time: those that do are held open.
        open_: list[BagMessage] = []
        for chunk in chunks:
            ready = bisect_left(open_, chunk.first_ns, key=_stamp)
            yield from open_[:ready]
            open_ = sorted(open_[ready:] + messages(chunk), key=_stamp)
            if len(open_) > MOST_MESSAGES or sum(len(one.data) for one in open_) > LARGEST_CHUNK:
                raise ValueError("too many chunks at the same time")
        yield from open_


def messages_in_file_order(
    path: Path, wanted: frozenset[str] | None, *, salvage: bool
) -> Iterator[BagMessage]:
    """Messages in the order of the file; at damage DamagedError, with `salvage` the next chunk."""
    topics: dict[int, str] = {}
    damage = Damage()
    with open_mcap(path) as stream:
        for record in walk(stream, damage):
            if damage and not salvage:
                break
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, MessageRecord):
                topic = topics.get(record.channel_id, "")
                if wanted is None or topic in wanted:
                    yield BagMessage(topic, record.log_ns, record.data)
        if damage and not salvage:
            raise ValueError("a chunk or the end of the file")


def attachments(path: Path) -> Iterator[Attachment]:
    """The attachments of a file that can be read, in the order of the file."""
    with open_mcap(path) as stream:
        for record in walk(stream, Damage()):
            if isinstance(record, Attachment):
                yield record


def _check_magic(path: Path, stream: IO[bytes]) -> None:
    start = stream.read(len(MAGIC))
    if not start:
        raise BagError(f"{path} is empty (0 bytes): the recording never started")
    if start != MAGIC and not MAGIC.startswith(start):
        raise BagError(f"{path} is not MCAP: starts with {start.hex(' ')}")


def _chunk_locations(indexes: Iterable[ChunkIndex]) -> list[ChunkLocation]:
    """In order of log time; each chunk once."""
    known: dict[frozenset[int], frozenset[int]] = {}
    found = []
    for index in {index.chunk_start_offset: index for index in indexes}.values():
        channels = frozenset(index.message_index_offsets)
        channels = known.setdefault(channels, channels)
        span = index.message_start_time, index.message_end_time
        found.append(ChunkLocation(*span, index.chunk_start_offset, index.chunk_length, channels))
    return sorted(found, key=lambda chunk: chunk.first_ns)
