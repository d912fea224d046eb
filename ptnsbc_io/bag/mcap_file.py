"""One MCAP file: its contents by its summary, or by its records where the summary is missing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import IO, NamedTuple

from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, ChunkIndex, Metadata, Schema

from ptnsbc_io.bag.errors import BagError, DamagedError
from ptnsbc_io.bag.records import (
    MAGIC,
    RECORD_HEAD,
    BagMessage,
    Damage,
    MessageRecord,
    chunk_data,
    chunk_messages,
    walk,
)


class ChunkLocation(NamedTuple):
    """Where a chunk is and what it holds; a long bag keeps thousands of these while it is read."""

    first_ns: int  # log time
    last_ns: int
    start: int  # of its record in the file
    size: int  # with the head of the record
    channels: frozenset[int]  # shared between chunks that hold the same; empty: not known


@dataclass
class Contents:
    """What a file holds besides its messages."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)  # messages by channel
    attachments: list[str] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # by name of the record
    span_ns: tuple[int, int] | None = None  # log time; None without messages
    chunks: list[ChunkLocation] = field(
        default_factory=list
    )  # empty: read in the order of the file
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
        for record in reader.iter_metadata():
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
    with open_mcap(path) as stream:
        if any(a.last_ns > b.first_ns for a, b in pairwise(contents.chunks)):
            # Chunks overlap in time: the library holds those open that do.
            reader = SeekingReader(stream, validate_crcs=True)
            for _, channel, message in reader.iter_messages(wanted):
                yield BagMessage(channel.topic, message.log_time, message.data)
            return
        channels = contents.channels.values()
        topics = {c.id: c.topic for c in channels if wanted is None or c.topic in wanted}
        for chunk in contents.chunks:
            if chunk.channels and chunk.channels.isdisjoint(topics):
                continue
            stream.seek(chunk.start + RECORD_HEAD.size)
            data = chunk_data(stream.read(chunk.size - RECORD_HEAD.size))
            yield from chunk_messages(data, topics)


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


def attachments(path: Path, *, salvage: bool) -> Iterator[Attachment]:
    """The attachments of a file; with `salvage` those that can be read."""
    with open_mcap(path) as stream:
        records: Iterable[object] = walk(stream, Damage())
        if not salvage:
            records = SeekingReader(stream, validate_crcs=True).iter_attachments()
        for record in records:
            if isinstance(record, Attachment):
                yield record


def _check_magic(path: Path, stream: IO[bytes]) -> None:
    start = stream.read(len(MAGIC))
    if not start:
        raise BagError(f"{path} is empty (0 bytes): the recording never started")
    if start != MAGIC and not MAGIC.startswith(start):
        raise BagError(f"{path} is not MCAP: starts with {start.hex(' ')}")


def _chunk_locations(indexes: Iterable[ChunkIndex]) -> list[ChunkLocation]:
    """In order of log time."""
    known: dict[frozenset[int], frozenset[int]] = {}
    found = []
    for index in indexes:
        channels = frozenset(index.message_index_offsets)
        channels = known.setdefault(channels, channels)
        span = index.message_start_time, index.message_end_time
        found.append(ChunkLocation(*span, index.chunk_start_offset, index.chunk_length, channels))
    return sorted(found, key=lambda chunk: chunk.first_ns)
