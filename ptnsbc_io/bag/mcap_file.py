"""One MCAP file: its contents by its summary, or by a walk over its records around their damage.

The MCAP library makes an object of every record and stops at the first damage. Here a message costs
one `struct` call, and the walk goes on behind a damaged chunk. Either way gives the places of the chunks, by which
messages are read in the order of time.

A file may have been made to do harm. Every length is checked before it is used, what a file may unpack to
is bounded by its size, and so is the work that its damage costs.
"""

from __future__ import annotations

import struct
import zlib
from bisect import bisect_left
from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from operator import attrgetter
from pathlib import Path
from typing import IO, Any, NamedTuple, TypeAlias

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, ChunkIndex, Metadata, Schema

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
_COMPRESSIONS = b"\x04\0\0\0zstd", b"\x03\0\0\0lz4"
_BLOCKS = 1 << 12, 1 << 22  # [bytes], read at once in the search for a chunk: first, and at most
_LONGEST_RUN = 1 << 20  # [bytes], of messages outside of chunks that are read together
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
    publish_ns: int | None = None  # None: the log time
    sequence: int | None = None  # None: the number of messages before it on its topic


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
    """What is wrong with a file."""

    chunks: int = 0  # damaged chunks, lost with all their messages
    times: int = 0  # log times that no clock shows
    cut: bool = False  # the file ends inside a record, or before its footer

    def __bool__(self) -> bool:
        return self.cut or self.chunks > 0 or self.times > 0


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
    data: bytes, damage: Damage, channels: Container[int] | None = None
) -> Iterator[Schema | Channel | MessageRecord]:
    """The schemas, channels and messages of a decompressed chunk, in the order of the file.

    With `channels` only their messages: no object is made for another record. A log time that no clock shows becomes
    the time of publication, or where that is none either, that of the message before.
    """
    at, messages, size, before_ns = 0, 0, len(data), 0
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
                    damage.times += 1
                    log_ns = publish_ns if publish_ns <= LAST_NS else before_ns
                before_ns, publish_ns = log_ns, min(publish_ns, LAST_NS)
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


class Place(NamedTuple):
    """The place of a record in a file, or of several messages in a row."""

    opcode: int
    start: int
    size: int  # with the head of the record


def walk(stream: IO[bytes], damage: Damage) -> Iterator[tuple[Place, list[Record]]]:
    """The places of all readable records except indexes, in the order of the file, and what each holds.

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
        records = None
        if known and end <= size:
            records = _read_records(stream, opcode, length, unpacker, damage)
        if records is not None:
            yield Place(opcode, offset, end - offset), records
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
    stream: IO[bytes], opcode: int, length: int, unpacker: Unpacker, damage: Damage
) -> list[Record] | None:
    """The records that a record of the file stands for; None when it is damaged."""
    if opcode not in (*_RECORD_TYPES, Opcode.CHUNK, Opcode.MESSAGE):
        return []
    body = stream.read(length)
    try:
        if opcode == Opcode.CHUNK:
            # The whole list before the first record is used: a chunk counts whole, or not at all.
            # Declarations come first: a reader must know a channel before its messages.
            records = list(chunk_records(unpacker.unpack(body), damage))
            unpacker.count(len(records))
            return sorted(records, key=lambda record: isinstance(record, MessageRecord))
        if opcode == Opcode.MESSAGE:
            return list(chunk_records(RECORD_HEAD.pack(opcode, length) + body, damage))
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
        names = sorted(at for name in _COMPRESSIONS for at in _occurrences(window, name))
        for start in (at - _BEFORE_COMPRESSION for at in names):
            if start >= 0 and window[start] == Opcode.CHUNK:
                return base + start
        kept = window[-2 * _BEFORE_COMPRESSION :]
        base += len(window) - len(kept)
    return None


def _occurrences(window: bytes, part: bytes) -> Iterator[int]:
    """Where a part begins. A regular expression for several takes four times as long."""
    at = window.find(part)
    while at >= 0:
        yield at
        at = window.find(part, at + 1)


class ChunkLocation(NamedTuple):
    """Place and contents of a chunk; a long bag keeps thousands of these while it is read."""

    first_ns: int  # log time
    last_ns: int
    place: Place
    channels: frozenset[int]  # shared between chunks that hold the same; empty: not known


@dataclass
class Contents:
    """The contents of a file besides its messages."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)  # messages by channel
    attachments: dict[str, Place] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # by name of the record
    chunks: list[ChunkLocation] = field(default_factory=list)
    damage: Damage = field(default_factory=Damage)

    def add(self, place: Place, records: Sequence[Record]) -> None:
        """Add the records at a place of the file."""
        times = []
        for record in records:
            if isinstance(record, MessageRecord):
                self.counts[record.channel_id] += 1
                times.append(record.log_ns)
            elif isinstance(record, Schema):
                self.schemas[record.id] = record
            elif isinstance(record, Channel):
                self.channels[record.id] = record
            elif isinstance(record, Attachment):
                self.attachments[record.name] = place
            else:
                self.metadata[record.name] = dict(record.metadata)
        if not times:
            return
        chunk = ChunkLocation(min(times), max(times), place, frozenset())
        if place.opcode == Opcode.MESSAGE and self.chunks:
            # Messages that no chunk holds are read together, as if one did.
            first_ns, last_ns, (opcode, start, size), channels = self.chunks[-1]
            if opcode == place.opcode and start + size == place.start and size < _LONGEST_RUN:
                run = Place(opcode, start, size + place.size)
                span = min(first_ns, chunk.first_ns), max(last_ns, chunk.last_ns)
                self.chunks[-1] = ChunkLocation(*span, run, channels)
                return
        self.chunks.append(chunk)


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
        raise damaged(path, f"{type(error).__name__}: {error}") from error


def damaged(path: Path, what: str) -> DamagedError:
    """The error of a file in which something is damaged."""
    return DamagedError(
        f"{path} is damaged ({what}): expected intact chunks; "
        "copy the file again, or rescue what is left with: ptnsbc bag repair"
    )


def read_summary(path: Path) -> Contents | None:
    """The contents by the summary; None when that lacks them, DamagedError when it is not valid."""
    with open_mcap(path) as stream:
        _check_magic(path, stream)
        size = stream.seek(0, 2)
        stream.seek(max(0, size - len(MAGIC)))
        if size < 2 * len(MAGIC) or stream.read() != MAGIC:
            return None
        stream.seek(0)
        reader = SeekingReader(stream, validate_crcs=True, record_size_limit=size)
        summary = reader.get_summary()
        statistics = None if summary is None else summary.statistics
        if statistics is None or statistics.message_end_time > LAST_NS:
            return None
        if statistics.message_count and not summary.chunk_indexes:
            return None
        found = Contents(
            schemas=dict(summary.schemas),
            channels=dict(summary.channels),
            counts=Counter(statistics.channel_message_counts),
            attachments={
                index.name: Place(Opcode.ATTACHMENT, index.offset, index.length)
                for index in summary.attachment_indexes
            },
            chunks=_chunk_locations(summary.chunk_indexes),
        )
        left = size  # together they cannot be longer than the file
        for index in summary.metadata_indexes:
            left -= index.length
            if left < 0:
                raise ValueError("length of metadata")
            place = Place(Opcode.METADATA, index.offset, index.length)
            found.add(place, [_read_record(stream, place)])
        return found


def scan_records(path: Path) -> Contents:
    """The contents by all readable records, for a file without summary; with its damage."""
    found = Contents()
    with open_mcap(path) as stream:
        _check_magic(path, stream)
        for place, records in walk(stream, found.damage):
            found.add(place, records)
    found.chunks.sort(key=lambda chunk: chunk.first_ns)
    return found


def messages(
    path: Path, contents: Contents, wanted: frozenset[str] | None, damage: Damage | None = None
) -> Iterator[BagMessage]:
    """Messages in the order of log time; those of equal time stay in the order of the file.

    What is damaged is left out and counted in `damage`; without it DamagedError.
    """
    channels = contents.channels.values()
    topics = {c.id: c.topic for c in channels if wanted is None or c.topic in wanted}
    strict, damage = damage is None, Damage() if damage is None else damage
    held: list[BagMessage] = []  # chunks overlap in time
    with open_mcap(path) as stream:
        unpacker = Unpacker(stream.seek(0, 2))
        for chunk in contents.chunks:
            if chunk.channels and chunk.channels.isdisjoint(topics):
                continue
            ready = bisect_left(held, chunk.first_ns, key=_stamp)
            yield from held[:ready]
            del held[:ready]
            try:
                if len(held) > MOST_MESSAGES or sum(len(one.data) for one in held) > LARGEST_CHUNK:
                    raise ValueError("too many chunks at the same time")
                read = _chunk_messages(stream, chunk.place, unpacker, topics, damage)
                if strict and damage:
                    raise ValueError("time of a message")
            except Exception:  # as in `open_mcap`
                if strict:
                    raise
                damage.chunks += 1
            else:
                held = sorted(held + read, key=_stamp)
        yield from held


def _chunk_messages(
    stream: IO[bytes], place: Place, unpacker: Unpacker, topics: Mapping[int, str], damage: Damage
) -> list[BagMessage]:
    """The messages of some topics, by channel, of a chunk or of a run outside of chunks."""
    stream.seek(place.start)
    data = stream.read(place.size)
    if place.opcode == Opcode.CHUNK:
        if RECORD_HEAD.unpack_from(data) != (place.opcode, len(data) - RECORD_HEAD.size):
            raise ValueError("length of a chunk")
        data = unpacker.unpack(data[RECORD_HEAD.size :])
    found = [
        BagMessage(topics[one.channel_id], one.log_ns, one.data, one.publish_ns, one.sequence)
        for one in chunk_records(data, damage, topics)
        if isinstance(one, MessageRecord)
    ]
    unpacker.count(len(found))
    return found


def read_attachment(path: Path, contents: Contents, name: str) -> bytes:
    """The content of an attachment; DamagedError when it cannot be read."""
    with open_mcap(path) as stream:
        return bytes(_read_record(stream, contents.attachments[name]).data)


def _read_record(stream: IO[bytes], place: Place) -> Any:
    """The record at a place; ValueError when there is another one."""
    stream.seek(place.start)
    opcode, length = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
    if (opcode, length) != (place.opcode, place.size - RECORD_HEAD.size):
        raise ValueError(f"an index of {Opcode(place.opcode).name} leads to something else")
    return _RECORD_TYPES[opcode].read(ReadDataStream(BytesIO(stream.read(length))))


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
        place = Place(Opcode.CHUNK, index.chunk_start_offset, index.chunk_length)
        span = index.message_start_time, index.message_end_time
        found.append(ChunkLocation(*span, place, channels))
    return sorted(found, key=lambda chunk: chunk.first_ns)
