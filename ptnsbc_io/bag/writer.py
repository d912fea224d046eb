"""Writing a bag: a rosbag2 folder with MCAP files, the same bytes for the same input.

The folder is written beside its name (`<dir>.part`) and renamed when it is complete. A bag that is
left by an exception or Ctrl-C is completed all the same; one that is killed stays as `<dir>.part`
and is readable up to its last chunk.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

from ptnsbc_io.bag.errors import BagError
from ptnsbc_io.bag.folder import make_part, put_in_place
from ptnsbc_io.bag.interrupt import InterruptGuard
from ptnsbc_io.bag.layout import (
    Declared,
    FileCount,
    TopicCount,
    TopicInfo,
    bag_information,
    declared,
    to_yaml,
)
from ptnsbc_io.bag.pieces import COMPRESSIONS, Piece, SplitLimits

METADATA_RECORD = "ptnsbc"
FLUSH_PERIOD = 0.5  # [s]: with the time it takes to look, and to write, below the promised second


class BagWriter:
    """A bag being written; use it as a context manager.

    Args:
        directory: Folder of the finished bag; it must not exist unless `overwrite` is set.
        topics: Every topic that will be written.
        attachments: Files to carry inside the bag, by name.
        metadata: Key and value pairs of the MCAP metadata record `ptnsbc`.
        compression: `zstd`, `lz4` or `none`, per chunk.
        overwrite: Replace an existing bag, once the new one is complete.
        limits: When to go on in another file.

    Attributes:
        name: What the files are called; changed before `open`, not after.
        records: Further metadata records, by name; the same.
    """

    def __init__(
        self,
        directory: Path,
        topics: Sequence[TopicInfo | Declared],
        *,
        attachments: Mapping[str, bytes] | None = None,
        metadata: Mapping[str, str] | None = None,
        compression: str = "zstd",
        overwrite: bool = False,
        limits: SplitLimits = SplitLimits(),  # noqa: B008 - immutable
    ) -> None:
        if compression not in COMPRESSIONS:
            known = ", ".join(COMPRESSIONS)
            raise BagError(f"compression {compression!r}: expected one of {known}")
        # Absolute, so that `.` has a name and a later chdir changes nothing.
        self.directory = Path(os.path.abspath(directory))
        self._part = self.directory.with_name(self.directory.name + ".part")
        self._asked = tuple(topics)
        self._topics: tuple[Declared, ...] = ()
        self._attachments = dict(attachments or {})
        self.records: dict[str, Mapping[str, str]] = {
            METADATA_RECORD: dict(sorted((metadata or {}).items()))
        }
        self._compression = COMPRESSIONS[compression]
        self._overwrite = overwrite
        self._limits = limits
        self.name = self.directory.name
        self._number: dict[str, int] = {}  # of each topic
        self._counts: list[int] = []  # messages of each topic
        self._files: list[FileCount] = []  # those that are complete
        self._piece: Piece | None = None
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
        return {name: self._counts[number] for name, number in self._number.items()}

    def open(self) -> None:
        """Create the file and write what is known before the first message."""
        # Definitions first: an unknown type must not leave a folder behind.
        self._topics = tuple(
            topic if isinstance(topic, Declared) else declared(topic) for topic in self._asked
        )
        make_part(self.directory, self._part, overwrite=self._overwrite)
        self._number = {topic.name: number for number, topic in enumerate(self._topics)}
        self._counts = [0] * len(self._topics)
        self._guard.install()
        try:
            self._piece = self._next_piece()
        except OSError as error:
            raise self._disk_error(error) from error

    def add(self, topic: TopicInfo) -> None:
        """A topic that was not known at the start."""
        if self._piece is None:
            raise BagError(f"{self.directory}: topic {topic.name}: expected an open bag")
        new = declared(topic)
        if topic.name not in self._number:
            self._number[topic.name] = len(self._topics)
            self._topics = (*self._topics, new)
            self._counts.append(0)
            with self._guard:
                self._piece.declare(new)

    def write(
        self,
        topic: str,
        stamp_ns: int,
        data: bytes,
        publish_ns: int | None = None,
        sequence: int | None = None,
    ) -> None:
        """Append a serialised message.

        Args:
            topic: One of the topics given at the start.
            stamp_ns: Log time [ns]; readers order by it.
            data: The message in CDR.
            publish_ns: Time of publication [ns], the log time when absent.
            sequence: Number of the message; counted per topic when absent.
        """
        number = self._number.get(topic)
        if self._piece is None:
            raise BagError(f"{self.directory}: message on {topic}: expected an open bag")
        if number is None:
            known = ", ".join(self._number)
            raise BagError(f"{self.directory}: topic {topic}: expected one of {known}")
        if stamp_ns < 0 or (publish_ns is not None and publish_ns < 0):
            raise BagError(f"{topic}: time {stamp_ns}, {publish_ns} ns: expected not negative")
        publish_ns = stamp_ns if publish_ns is None else publish_ns
        sequence = self._counts[number] if sequence is None else sequence
        try:
            with self._guard:
                if self._piece.is_full(self._limits, stamp_ns):
                    self._split(self._piece)
                self._piece.add(number, stamp_ns, publish_ns, sequence, data)
                self._counts[number] += 1
                self._unflushed += 1
        except OSError as error:
            raise self._disk_error(error) from error

    def split(self) -> None:
        """Go on in another file, unless this one is still empty."""
        if self._piece is None or self._piece.is_empty:
            return
        try:
            with self._guard:
                self._split(self._piece)
        except OSError as error:
            raise self._disk_error(error) from error

    def flush_if_due(self, now: float) -> None:
        """Close the chunk when FLUSH_PERIOD has passed since the last one.

        Where chunks end decides about the bytes of the file: live recording passes wall time, and
        lock-step, where the same flight gives the same bytes, time of the flight.

        Args:
            now: Any clock that does not jump [s].
        """
        if self._last_flush is None:
            self._last_flush = now
        if now - self._last_flush < FLUSH_PERIOD or not self._unflushed or self._piece is None:
            return
        try:
            with self._guard:
                self._piece.flush()
        except OSError as error:
            raise self._disk_error(error) from error
        self._last_flush = now
        self._unflushed = 0

    def close(self) -> None:
        """Complete the bag and give it its name; does nothing the second time."""
        piece, self._piece = self._piece, None
        if piece is None:
            return
        try:
            with self._guard:
                self._complete(piece)
                self._describe()
                put_in_place(self.directory, self._part, overwrite=self._overwrite)
        except OSError as error:
            raise self._disk_error(error) from error
        finally:
            self._guard.remove()

    def _disk_error(self, error: OSError) -> BagError:
        return BagError(
            f"{self._part} cannot be written ({error.strerror}): "
            "what is in it can be rescued with: ptnsbc bag repair"
        )

    def _split(self, piece: Piece) -> None:
        self._complete(piece)
        self._piece = self._next_piece()

    def _next_piece(self) -> Piece:
        path = self._part / f"{self.name}_{len(self._files)}.mcap"
        return Piece(path, self._topics, self._attachments, self.records, self._compression)

    def _complete(self, piece: Piece) -> None:
        """Close a file; it says of itself what metadata.yaml says of the bag."""
        counts = map(TopicCount, self._topics, piece.counts)
        self._files.append(piece.count)
        piece.finish(bag_information([piece.count], list(counts)))

    def _describe(self) -> None:
        counts = list(map(TopicCount, self._topics, self._counts))
        information = bag_information(self._files, counts)
        text = to_yaml({"rosbag2_bagfile_information": information})
        (self._part / "metadata.yaml").write_text(text, encoding="utf-8")
