"""One MCAP file while it is written: complete in itself, also as a piece of a bag that was split."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

from mcap.writer import CompressionType, Writer

from ptnsbc_io.bag.layout import Declared, FileCount, TimeSpan, to_yaml

LIBRARY = "ptnsbc"  # no version: it would be a byte that differs between equal bags
_CHUNK_SIZE = 1 << 20  # [bytes], before compression
_MEDIA_TYPES = {
    ".yaml": "application/yaml",
    ".json": "application/json",
    ".txt": "text/plain",
    ".md": "text/markdown",
}


COMPRESSIONS = {
    "zstd": CompressionType.ZSTD,
    "lz4": CompressionType.LZ4,
    "none": CompressionType.NONE,
}


class SplitLimits(NamedTuple):
    """When a bag goes on in another file; None: never."""

    size_bytes: int | None = None
    duration_ns: int | None = None  # in log time


class Piece:
    """A file with its channels; nobody else writes into it.

    Args:
        path: File to create.
        topics: Every topic that will be written.
        attachments: Files to carry inside, by name.
        metadata: Metadata records by name.
        compression: Of the chunks.
    """

    def __init__(
        self,
        path: Path,
        topics: Sequence[Declared],
        attachments: Mapping[str, bytes],
        metadata: Mapping[str, Mapping[str, str]],
        compression: CompressionType,
    ) -> None:
        self.path = path
        self.counts: list[int] = []  # messages of each topic
        self._channels: list[int] = []
        self._schemas: dict[tuple[str, bytes], int] = {}
        self._start_ns: int | None = None
        self._end_ns = 0
        self._stream: IO[bytes] = path.open("wb")
        self._writer = Writer(self._stream, chunk_size=_CHUNK_SIZE, compression=compression)
        self._writer.start(profile="ros2", library=LIBRARY)
        for name, data in sorted(attachments.items()):
            media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
            self._writer.add_attachment(0, 0, name, media_type, data)
        for name, pairs in sorted(metadata.items()):
            self._writer.add_metadata(name, dict(pairs))
        for topic in topics:
            self.declare(topic)
        self.flush()

    def declare(self, topic: Declared) -> None:
        """Add a topic; it gets the next number."""
        key = (topic.type, topic.schema)
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(
                name=topic.type, encoding=topic.schema_encoding, data=topic.schema
            )
        self._channels.append(
            self._writer.register_channel(
                topic=topic.name,
                message_encoding=topic.message_encoding,
                schema_id=self._schemas[key],
                metadata=topic.channel_metadata,
            )
        )
        self.counts.append(0)

    @property
    def count(self) -> FileCount:
        """What is in it so far."""
        span = TimeSpan(self._start_ns or 0, self._end_ns)
        return FileCount(self.path.name, span, sum(self.counts))

    @property
    def is_empty(self) -> bool:
        """Whether it has no message yet."""
        return self._start_ns is None

    def is_full(self, limits: SplitLimits, log_ns: int) -> bool:
        """Whether a message logged at `log_ns` belongs into the next file."""
        if self._start_ns is None:
            return False
        if limits.duration_ns is not None and log_ns - self._start_ns >= limits.duration_ns:
            return True
        # The chunk in hand is not in the file yet: it may exceed the limit by one.
        return limits.size_bytes is not None and self._stream.tell() >= limits.size_bytes

    def add(self, topic: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        """Append a message of topic number `topic`."""
        self._writer.add_message(self._channels[topic], log_ns, data, publish_ns, sequence)
        self.counts[topic] += 1
        self._start_ns = log_ns if self._start_ns is None else min(log_ns, self._start_ns)
        self._end_ns = max(log_ns, self._end_ns)

    def flush(self) -> None:
        """Close the chunk and hand it to the system: what is there survives this process."""
        self._writer.flush()
        self._stream.flush()

    def finish(self, information: Mapping[str, Any]) -> None:
        """Write index, summary and rosbag2's record, and close."""
        with self._stream:
            record = {"serialized_metadata": to_yaml(dict(information))}
            self._writer.add_metadata("rosbag2", record)
            self._writer.finish()
