"""Writing a bag: a rosbag2 folder with one MCAP file, the same bytes for the same input.

The folder is written beside its name (`<dir>.part`) and renamed when it is complete. A bag that is
left by an exception or Ctrl-C is completed all the same; one that is killed stays as `<dir>.part`
and is readable up to its last chunk.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO

from mcap.writer import CompressionType, Writer

from ptnsbc_nodes.bag.errors import BagError
from ptnsbc_nodes.bag.interrupt import InterruptGuard
from ptnsbc_nodes.bag.layout import (
    TimeSpan,
    TopicCount,
    TopicInfo,
    bag_information,
    qos_profiles,
    to_yaml,
)
from ptnsbc_nodes.bag.msgdef import definition

METADATA_RECORD = "ptnsbc"
FLUSH_PERIOD = 1.0  # [s]: what a killed recording may lose

_LIBRARY = "ptnsbc"  # no version: it would be a byte that differs between equal bags
_CHUNK_SIZE = 1 << 20  # [bytes], before compression
_COMPRESSIONS = {
    "zstd": CompressionType.ZSTD,
    "lz4": CompressionType.LZ4,
    "none": CompressionType.NONE,
}
_MEDIA_TYPES = {
    ".yaml": "application/yaml",
    ".json": "application/json",
    ".txt": "text/plain",
    ".md": "text/markdown",
}


class _Channel:
    """One topic while the bag is open."""

    def __init__(self, info: TopicInfo, channel_id: int) -> None:
        self.info = info
        self.id = channel_id
        self.messages = 0


class BagWriter:
    """A bag being written; use it as a context manager.

    Args:
        directory: Folder of the finished bag; it must not exist unless `overwrite` is set.
        topics: Every topic that will be written.
        attachments: Files to carry inside the bag, by name.
        metadata: Key and value pairs of the MCAP metadata record `ptnsbc`.
        compression: `zstd`, `lz4` or `none`, per chunk.
        overwrite: Replace an existing bag, once the new one is complete.
    """

    def __init__(
        self,
        directory: Path,
        topics: Sequence[TopicInfo],
        *,
        attachments: Mapping[str, bytes] | None = None,
        metadata: Mapping[str, str] | None = None,
        compression: str = "zstd",
        overwrite: bool = False,
    ) -> None:
        if compression not in _COMPRESSIONS:
            known = ", ".join(_COMPRESSIONS)
            raise BagError(f"compression {compression!r}: expected one of {known}")
        # Absolute, so that `.` has a name and a later chdir changes nothing.
        self.directory = Path(os.path.abspath(directory))
        self._part = self.directory.with_name(self.directory.name + ".part")
        self._filename = f"{self.directory.name}_0.mcap"
        self._topics = tuple(topics)
        self._attachments = dict(sorted((attachments or {}).items()))
        self._metadata = dict(sorted((metadata or {}).items()))
        self._compression = _COMPRESSIONS[compression]
        self._overwrite = overwrite
        self._channels: dict[str, _Channel] = {}
        self._stream: IO[bytes] | None = None
        self._start_ns: int | None = None
        self._end_ns = 0
        self._unflushed = 0
        self._last_flush: float | None = None
        self._guard = InterruptGuard()

    def __enter__(self) -> BagWriter:
        self.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # Completed whatever happened: the last seconds before a crash are the ones wanted.
        self.close()

    @property
    def counts(self) -> dict[str, int]:
        """Messages written so far, by topic."""
        return {name: channel.messages for name, channel in self._channels.items()}

    def open(self) -> None:
        """Create the file and write what is known before the first message."""
        # Definitions first: an unknown type must not leave a folder behind.
        for topic in self._topics:
            definition(topic.type)
            qos_profiles(topic)
        self._make_folder()
        self._guard.install()
        try:
            self._begin()
        except OSError as error:
            raise self._disk_error(error) from error

    def _begin(self) -> None:
        self._stream = (self._part / self._filename).open("wb")
        self._writer = Writer(self._stream, chunk_size=_CHUNK_SIZE, compression=self._compression)
        self._writer.start(profile="ros2", library=_LIBRARY)
        for name, data in self._attachments.items():
            media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
            self._writer.add_attachment(0, 0, name, media_type, data)
        self._writer.add_metadata(METADATA_RECORD, self._metadata)
        self._add_channels()
        self._stream.flush()

    def write(self, topic: str, stamp_ns: int, data: bytes, publish_ns: int | None = None) -> None:
        """Append a serialised message.

        Args:
            topic: One of the topics given at the start.
            stamp_ns: Log time [ns]; readers order by it.
            data: The message in CDR.
            publish_ns: Time of publication [ns], the log time when absent.
        """
        channel = self._channels.get(topic)
        if self._stream is None:
            raise BagError(f"{self.directory}: message on {topic}: expected an open bag")
        if channel is None:
            known = ", ".join(self._channels)
            raise BagError(f"{self.directory}: topic {topic}: expected one of {known}")
        if stamp_ns < 0 or (publish_ns is not None and publish_ns < 0):
            raise BagError(f"{topic}: time {stamp_ns}, {publish_ns} ns: expected not negative")
        try:
            with self._guard:
                self._append(channel, stamp_ns, data, publish_ns)
        except OSError as error:
            raise self._disk_error(error) from error

    def flush_if_due(self, now: float) -> None:
        """Close the chunk when a second has passed since the last one.

        For live recording only: where chunks end is then a matter of wall time, and with it the
        bytes of the file.

        Args:
            now: Any clock that does not jump [s].
        """
        if self._last_flush is None:
            self._last_flush = now
        if now - self._last_flush < FLUSH_PERIOD or not self._unflushed or self._stream is None:
            return
        try:
            with self._guard:
                self._writer.flush()
        except OSError as error:
            raise self._disk_error(error) from error
        self._last_flush = now
        self._unflushed = 0

    def close(self) -> None:
        """Complete the bag and give it its name; does nothing the second time."""
        if self._stream is None:
            return
        try:
            with self._guard:
                self._finish(self._stream)
        except OSError as error:
            raise self._disk_error(error) from error
        finally:
            self._guard.remove()

    def _disk_error(self, error: OSError) -> BagError:
        return BagError(
            f"{self._part} cannot be written ({error.strerror}): "
            "what is in it can be read with salvage"
        )

    def _append(self, channel: _Channel, log_ns: int, data: bytes, publish_ns: int | None) -> None:
        self._writer.add_message(
            channel_id=channel.id,
            log_time=log_ns,
            data=data,
            publish_time=log_ns if publish_ns is None else publish_ns,
            sequence=channel.messages,
        )
        channel.messages += 1
        self._unflushed += 1
        self._start_ns = log_ns if self._start_ns is None else min(log_ns, self._start_ns)
        self._end_ns = max(log_ns, self._end_ns)

    def _finish(self, stream: IO[bytes]) -> None:
        self._stream = None
        span = TimeSpan(self._start_ns or 0, self._end_ns)
        counts = [
            TopicCount(c.info, definition(c.info.type).type_hash, c.messages)
            for c in self._channels.values()
        ]
        information = bag_information(self._filename, span, counts)
        with stream:
            self._writer.add_metadata("rosbag2", {"serialized_metadata": to_yaml(information)})
            self._writer.finish()
        text = to_yaml({"rosbag2_bagfile_information": information})
        (self._part / "metadata.yaml").write_text(text, encoding="utf-8")
        self._rename()

    def _make_folder(self) -> None:
        way_out = "choose another name or pass --overwrite"
        if self.directory.exists() and not self._overwrite:
            raise BagError(f"{self.directory} exists: {way_out}")
        if self._part.exists():
            if not self._overwrite:
                raise BagError(
                    f"{self._part} exists, a recording that was killed or still runs: {way_out}"
                )
            shutil.rmtree(self._part)
        try:
            self._part.mkdir(parents=True)
        except OSError as error:
            raise BagError(f"{self._part}: cannot be created: {error.strerror}") from error

    def _add_channels(self) -> None:
        schemas: dict[str, int] = {}
        for topic in self._topics:
            text, type_hash = definition(topic.type)
            if topic.type not in schemas:
                schemas[topic.type] = self._writer.register_schema(
                    name=topic.type, encoding="ros2msg", data=text.encode()
                )
            channel_id = self._writer.register_channel(
                topic=topic.name,
                message_encoding="cdr",
                schema_id=schemas[topic.type],
                metadata={
                    "offered_qos_profiles": to_yaml(qos_profiles(topic)),
                    "topic_type_hash": type_hash,
                },
            )
            self._channels[topic.name] = _Channel(topic, channel_id)

    def _rename(self) -> None:
        old = self.directory.with_name(self.directory.name + ".old")
        try:
            if self._overwrite and self.directory.exists():
                # Moved away first: at no time is there neither the old bag nor the new one.
                self.directory.rename(old)
            self._part.rename(self.directory)
        except OSError as error:
            raise BagError(
                f"{self.directory} appeared while the bag was written ({error.strerror}): "
                f"the bag is complete in {self._part}"
            ) from error
        shutil.rmtree(old, ignore_errors=True)
