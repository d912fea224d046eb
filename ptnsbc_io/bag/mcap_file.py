"""One MCAP file: its contents by its summary, or by a walk over its records around damaged chunks.

The MCAP library makes an object of every record and stops at the first damage. Here a message costs
one `struct` call, and the walk goes on behind a damaged chunk. Either way gives the places of the chunks, by which
messages are read in the order of time.

A file may have been made to do harm. Every length is checked before it is used, what a file may unpack to
is bounded by its size.
"""

from __future__ import annotations

import struct
import zlib
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from operator import attrgetter
from pathlib import Path
from typing import IO, Any, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema

from ptnsbc_io.bag.metadata import BagError, DamagedError

MAGIC = b"\x89MCAP0\r\n"
LARGEST_CHUNK = 1 << 25  # [bytes], uncompressed; writers make chunks of one to four megabytes
MOST_MESSAGES = 200_000  # in a chunk; one of ours has some thousand
LAST_NS = 2**63 - 1  # of all times, in the year 2262
RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of the body
# Opcode, length of the body, channel, sequence number, times of the log and of the publication.
MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_LONGEST_RUN = 1 << 20  # [bytes], of messages outside of chunks that are read together
LEAST_UNPACKED = 1 << 27  # [bytes], of a file of any size
UNPACKED_RATIO = 300  # a flight that hovers is compressed to a hundredth
LEAST_PACKED = 4  # [bytes], of a message with its times
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


@dataclass
class Damage:
    """The damage of a file."""

    chunks: int = 0  # damaged chunks, lost with all their messages
    times: int = 0  # log times that no clock shows
    cut: bool = False  # the file ends inside a record, or before its footer

    def __bool__(self) -> bool:
        return self.cut or self.chunks > 0 or self.times > 0


class Unpacker:
    """Decompresses the chunks of one file, up to what a file of its size may hold."""

    def __init__(self, file_size: int) -> None:
        self._left = LEAST_UNPACKED + UNPACKED_RATIO * file_size
        self._messages_left = MOST_MESSAGES + file_size // LEAST_PACKED

    def count(self, messages: int) -> None:
        """Count messages of an unpacked chunk; ValueError when they are too many for the file."""
        self._messages_left -= messages
        if self._messages_left < 0:
            raise ValueError(_CROWDED)

    def unpack(self, body: bytes) -> bytes:
        """The decompressed records of the body of a chunk record; ValueError when it is damaged."""
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


def chunk_messages(
    data: bytes, damage: Damage, topics: Mapping[int, str], contents: Contents | None = None
) -> list[BagMessage]:
    """The messages of some topics, by channel, of the records of a chunk, in the order of the file.

    What the chunk declares goes into `contents`. A log time that no clock shows becomes the time of publication, or
    where that is none either, the log time of the message before.
    """
    found: list[BagMessage] = []
    at, size, before_ns = 0, len(data), 0
    while at < size:
        begin, (opcode, length) = at, RECORD_HEAD.unpack_from(data, at)
        at += RECORD_HEAD.size + length
        if not opcode or at > size:
            raise ValueError("length of a record")
        if opcode == Opcode.MESSAGE:
            start = begin + MESSAGE_HEAD.size
            if start > at:
                raise ValueError("length of a message")
            _, _, channel, sequence, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(data, begin)
            if channel not in topics:
                continue
            if len(found) == MOST_MESSAGES:
                raise ValueError(_CROWDED)
            if log_ns > LAST_NS:
                damage.times += 1
                log_ns = publish_ns if publish_ns <= LAST_NS else before_ns
            before_ns, publish_ns = log_ns, min(publish_ns, LAST_NS)
            found.append(BagMessage(topics[channel], log_ns, data[start:at], publish_ns, sequence))
        elif contents is not None and opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            contents.declare(_read_body(opcode, data[begin + RECORD_HEAD.size : at]))
    return found


def _read_body(opcode: int, body: bytes) -> Any:
    return _RECORD_TYPES[opcode].read(ReadDataStream(BytesIO(body)))


class Place(NamedTuple):
    """The place of a record in a file, or of several messages in a row."""

    opcode: int
    start: int
    size: int  # with the head of the record


class ChunkLocation(NamedTuple):
    """Place and log times of a chunk; a long bag keeps thousands of these while it is read."""

    first_ns: int
    last_ns: int
    place: Place


@dataclass
class Contents:
    """The contents of a file besides its messages."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    topics: dict[int, str] = field(default_factory=dict)  # by channel
    counts: Counter[str] = field(default_factory=Counter)  # messages by topic
    attachments: dict[str, Place] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # by name of the record
    chunks: list[ChunkLocation] = field(default_factory=list)
    damage: Damage = field(default_factory=Damage)

    def declare(self, record: Schema | Channel | Metadata) -> None:
        """Add a schema, a channel or metadata."""
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record
            self.topics[record.id] = record.topic
        else:
            self.metadata[record.name] = dict(record.metadata)

    def add(self, place: Place, body: bytes, unpacker: Unpacker) -> None:
        """Add the record at a place of the file, and what it holds; an error when it is damaged."""
        if place.opcode not in (Opcode.CHUNK, Opcode.MESSAGE):
            record = _read_body(place.opcode, body)
            if isinstance(record, Attachment):
                self.attachments[record.name] = place
            else:
                self.declare(record)
            return
        packed = place.opcode == Opcode.CHUNK
        data = unpacker.unpack(body) if packed else RECORD_HEAD.pack(place.opcode, len(body)) + body
        messages = chunk_messages(data, self.damage, self.topics, self)
        unpacker.count(len(messages))
        if not messages:
            return
        self.counts.update(message.topic for message in messages)
        times = [message.stamp_ns for message in messages]
        if not packed and self.chunks:  # messages that no chunk holds are read together
            first_ns, last_ns, (opcode, start, size) = self.chunks[-1]
            if (opcode, start + size) == place[:2] and size < _LONGEST_RUN:
                times += first_ns, last_ns
                place = Place(opcode, start, size + place.size)
                del self.chunks[-1]
        self.chunks.append(ChunkLocation(min(times), max(times), place))


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
            attachments={
                index.name: Place(Opcode.ATTACHMENT, index.offset, index.length)
                for index in summary.attachment_indexes
            },
        )
        for index in {index.chunk_start_offset: index for index in summary.chunk_indexes}.values():
            place = Place(Opcode.CHUNK, index.chunk_start_offset, index.chunk_length)
            span = index.message_start_time, index.message_end_time
            found.chunks.append(ChunkLocation(*span, place))
        found.chunks.sort(key=attrgetter("first_ns"))
        for record in (*summary.schemas.values(), *summary.channels.values()):
            found.declare(record)
        for channel, count in statistics.channel_message_counts.items():
            found.counts[found.topics[channel]] += count
        left = size  # together they cannot be longer than the file
        for index in summary.metadata_indexes:
            left -= index.length
            if left < 0:
                raise ValueError("length of metadata")
            place = Place(Opcode.METADATA, index.offset, index.length)
            found.declare(_read_record(stream, place))
        return found


def scan_records(path: Path) -> Contents:
    """The contents by all readable records, for a file without summary; with its damage.

    A damaged chunk is left out. A damaged length, or zeros, are the end of the file.
    """
    found = Contents()
    with open_mcap(path) as stream:
        _check_magic(path, stream)
        size = stream.seek(0, 2)
        unpacker, offset = Unpacker(size), len(MAGIC)
        while True:
            stream.seek(offset)
            head = stream.read(RECORD_HEAD.size)
            opcode, length = RECORD_HEAD.unpack(head) if len(head) == RECORD_HEAD.size else (0, 0)
            place = Place(opcode, offset, RECORD_HEAD.size + length)
            offset += place.size
            known = 0 < opcode <= Opcode.DATA_END or opcode >= 0x80  # MCAP's, or left to others
            found.damage.cut = offset > size or not known
            if found.damage.cut or opcode == Opcode.FOOTER:
                break
            if opcode in (*_RECORD_TYPES, Opcode.CHUNK, Opcode.MESSAGE):
                try:
                    found.add(place, stream.read(length), unpacker)
                except Exception:  # as in `open_mcap`
                    found.damage.chunks += 1
    found.chunks.sort(key=attrgetter("first_ns"))
    return found


def messages(
    path: Path, contents: Contents, wanted: frozenset[str] | None, damage: Damage | None = None
) -> Iterator[BagMessage]:
    """Messages in the order of log time; those of equal time stay in the order of the file.

    What is damaged is left out and counted in `damage`; without it DamagedError.
    """
    every = contents.topics.items()
    topics = {channel: topic for channel, topic in every if wanted is None or topic in wanted}
    strict, damage = damage is None, Damage() if damage is None else damage
    held: list[BagMessage] = []  # chunks overlap in time
    with open_mcap(path) as stream:
        unpacker = Unpacker(stream.seek(0, 2))
        for chunk in contents.chunks:
            ready = bisect_left(held, chunk.first_ns, key=_stamp)
            yield from held[:ready]
            del held[:ready]
            try:
                if len(held) > MOST_MESSAGES or sum(len(one.data) for one in held) > LARGEST_CHUNK:
                    raise ValueError("too many chunks at the same time")
                read = chunk_messages(_records(stream, chunk.place, unpacker), damage, topics)
                unpacker.count(len(read))
                if strict and damage:
                    raise ValueError("time of a message")
            except Exception:  # as in `open_mcap`
                if strict:
                    raise
                damage.chunks += 1
            else:
                held = sorted(held + read, key=_stamp)
        yield from held


def _records(stream: IO[bytes], place: Place, unpacker: Unpacker) -> bytes:
    """The records of a chunk, or of a run of messages outside of chunks."""
    stream.seek(place.start)
    data = stream.read(place.size)
    if place.opcode != Opcode.CHUNK:
        return data
    if RECORD_HEAD.unpack_from(data) != (place.opcode, len(data) - RECORD_HEAD.size):
        raise ValueError("length of a chunk")
    return unpacker.unpack(data[RECORD_HEAD.size :])


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
    return _read_body(opcode, stream.read(length))


def _check_magic(path: Path, stream: IO[bytes]) -> None:
    start = stream.read(len(MAGIC))
    if not start:
        raise BagError(f"{path} is empty (0 bytes): the recording never started")
    if start != MAGIC and not MAGIC.startswith(start):
        raise BagError(f"{path} is not MCAP: starts with {start.hex(' ')}")
