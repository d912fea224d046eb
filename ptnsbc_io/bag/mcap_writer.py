"""One MCAP file while it is written: the bytes that the MCAP library's Writer makes, at a tenth of its time.

The library makes an object of every message, and keeps the index of every chunk in memory until the end. A recorder
writes hundreds of messages a second for each UAV, and its memory must not grow with the flight (`bench.soak`). So
messages are packed into one buffer here, and the indexes wait on the disk. All other records are the library's.
"""

from __future__ import annotations

import struct
import tempfile
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import CompressionType

from ptnsbc_io.bag.mcap_file import MAGIC, MESSAGE_HEAD, RECORD_HEAD
from ptnsbc_io.bag.metadata import FileSummary, TopicDeclaration, to_yaml

_LIBRARY = "ptnsbc"  # without a version, which would differ between equal bags
_CHUNK_SIZE = 1 << 20  # [bytes], before compression
_INDEX_HEAD = struct.Struct("<BQHI")  # opcode, length of the body, channel, size of the places
_FOOTER_HEAD = struct.Struct("<BQQQ")  # opcode, length of the body, begin of summary and offsets
_MEDIA_TYPES = {
    ".yaml": "application/yaml",
    ".json": "application/json",
    ".txt": "text/plain",
    ".md": "text/markdown",
}


class McapFileWriter:
    """One MCAP file; it is complete in itself, also as a part of a split bag.

    Its arguments are those of the bag, with all metadata records by name.
    """

    def __init__(
        self,
        path: Path,
        topics: Sequence[TopicDeclaration],
        attachments: Mapping[str, bytes],
        metadata: Mapping[str, Mapping[str, str]],
        compression: CompressionType,
    ) -> None:
        self.path = path
        self.start_ns: int | None = None  # log time; None without messages
        self._end_ns = 0
        self._compression = compression
        self._counts: dict[int, int] = {}  # messages by channel
        self._channels: list[records.Channel] = []
        self._schemas: dict[tuple[str, bytes], records.Schema] = {}
        self._attachments: list[records.AttachmentIndex] = []
        self._metadata: list[records.MetadataIndex] = []
        self._chunk = bytearray()  # records of the open chunk
        self._places: dict[int, list[int]] = {}  # in it, by channel: log time and offset in turn
        self._chunks = 0
        self._stream: IO[bytes] = path.open("wb")
        self._indexes = tempfile.TemporaryFile(dir=path.parent)  # noqa: SIM115 - of the chunks
        self._stream.write(MAGIC + _encoded(records.Header("ros2", _LIBRARY)))
        for name, data in sorted(attachments.items()):
            media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
            place = self._append(records.Attachment(0, 0, name, media_type, data))
            about = 0, 0, len(data), name, media_type
            self._attachments.append(records.AttachmentIndex(*place, *about))
        for name, pairs in sorted(metadata.items()):
            self._add_metadata(name, dict(pairs))
        for topic in topics:
            self.declare(topic)
        self.flush()

    def declare(self, topic: TopicDeclaration) -> None:
        """Add a topic; it gets the next number."""
        schema = self._schemas.get((topic.type, topic.schema))
        if schema is None:
            about = topic.schema, topic.schema_encoding, topic.type
            schema = records.Schema(len(self._schemas) + 1, *about)
            self._schemas[topic.type, topic.schema] = schema
            self._chunk += _encoded(schema)
        number, metadata = len(self._channels) + 1, topic.channel_metadata
        channel = records.Channel(number, topic.name, topic.message_encoding, metadata, schema.id)
        self._channels.append(channel)
        self._chunk += _encoded(channel)

    @property
    def counts(self) -> list[int]:
        """Messages of each topic."""
        return [self._counts.get(channel.id, 0) for channel in self._channels]

    @property
    def summary(self) -> FileSummary:
        """Name, times and number of messages so far."""
        return FileSummary(self.path.name, self.start_ns or 0, self._end_ns, sum(self.counts))

    def add(self, topic: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        """Append a message of topic number `topic`."""
        channel, chunk = topic + 1, self._chunk
        if channel not in self._places:
            self._places[channel] = []
        self._places[channel] += log_ns, len(chunk)
        size = MESSAGE_HEAD.size - RECORD_HEAD.size + len(data)
        chunk += MESSAGE_HEAD.pack(Opcode.MESSAGE, size, channel, sequence, log_ns, publish_ns)
        chunk += data
        self._counts[channel] = self._counts.get(channel, 0) + 1
        if self.start_ns is None or log_ns < self.start_ns:
            self.start_ns = log_ns
        if log_ns > self._end_ns:
            self._end_ns = log_ns
        if len(chunk) > _CHUNK_SIZE:
            self._close_chunk()

    def flush(self) -> None:
        """Close the chunk and pass it to the operating system; from then on it survives a crash."""
        self._close_chunk()
        self._stream.flush()

    def finish(self, information: Mapping[str, Any]) -> None:
        """Write rosbag2's record, the index and the summary, and close the file."""
        with self._stream, self._indexes:
            self._add_metadata("rosbag2", {"serialized_metadata": to_yaml(dict(information))})
            self._close_chunk()
            self._append(records.DataEnd(0))
            self._write_summary()

    def _append(self, record: records.McapRecord) -> tuple[int, int]:
        """Write a record to the file; returns its place and its length."""
        place = self._stream.tell()
        return place, self._stream.write(_encoded(record))

    def _add_metadata(self, name: str, pairs: dict[str, str]) -> None:
        place = self._append(records.Metadata(name, pairs))
        self._metadata.append(records.MetadataIndex(*place, name))

    def _close_chunk(self) -> None:
        """Write the chunk and the places of its messages; one without messages stays open."""
        places = self._places
        if not places:
            return
        raw, self._chunk, self._places = self._chunk, bytearray(), {}
        kind, data = _compress(raw, self._compression)
        first_ns = min(min(each[::2]) for each in places.values())
        last_ns = max(max(each[::2]) for each in places.values())
        chunk = records.Chunk(kind, data, last_ns, first_ns, zlib.crc32(raw), len(raw))
        start, length = self._append(chunk)
        tables, offsets = bytearray(), {}
        for channel, each in places.items():
            offsets[channel], size = start + length + len(tables), 8 * len(each)
            tables += _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size)
            tables += struct.pack(f"<{len(each)}Q", *each)
        self._stream.write(tables)
        sizes = kind, len(data), last_ns, len(tables), offsets, first_ns, len(raw)
        self._indexes.write(_encoded(records.ChunkIndex(length, start, *sizes)))
        self._chunks += 1

    def _write_summary(self) -> None:
        """Write everything behind the messages: schemas, channels, statistics and indexes, and where each begins."""
        stream, crc = self._stream, 0
        self._indexes.seek(0)
        statistics = records.Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunks,
            message_count=sum(self._counts.values()),
            message_end_time=self._end_ns,
            message_start_time=self.start_ns or 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups: Sequence[tuple[Opcode, Iterable[bytes]]] = (
            (Opcode.SCHEMA, map(_encoded, self._schemas.values())),
            (Opcode.CHANNEL, map(_encoded, self._channels)),
            (Opcode.STATISTICS, [_encoded(statistics)]),
            (Opcode.CHUNK_INDEX, [self._indexes.read()]),
            (Opcode.ATTACHMENT_INDEX, map(_encoded, self._attachments)),
            (Opcode.METADATA_INDEX, map(_encoded, self._metadata)),
        )
        begin, offsets = stream.tell(), b""
        for opcode, group in groups:
            place = stream.tell()
            for data in group:
                crc = zlib.crc32(data, crc)
                stream.write(data)
            offsets += _encoded(records.SummaryOffset(opcode, place, stream.tell() - place))
        places = begin, stream.tell()
        crc = zlib.crc32(offsets + _FOOTER_HEAD.pack(Opcode.FOOTER, 20, *places), crc)
        stream.write(offsets + _encoded(records.Footer(*places, crc)) + MAGIC)


def _encoded(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def _compress(raw: bytearray, compression: CompressionType) -> tuple[str, bytes]:
    """The name of the compression in a chunk, and the bytes."""
    if compression is CompressionType.ZSTD:
        return "zstd", zstandard.compress(raw)
    if compression is CompressionType.LZ4:
        import lz4.frame

        return "lz4", bytes(lz4.frame.compress(raw))
    return "", bytes(raw)
