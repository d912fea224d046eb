"""Writing a bag: a rosbag2 folder with MCAP files, the same bytes for the same input.

The writer fills `<dir>.part` and renames it to `<dir>` when the bag is complete. An exception or Ctrl-C
completes the bag too. A killed writer leaves `<dir>.part`, readable up to its last chunk.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import FrameType

from mcap.writer import CompressionType

from ptnsbc_io.bag.mcap_writer import McapFileWriter
from ptnsbc_io.bag.metadata import (
    METADATA_FILE,
    METADATA_RECORD,
    BagError,
    FileSummary,
    TopicDeclaration,
    bag_information,
    to_yaml,
)

FLUSH_PERIOD = 0.5  # [s]: with the time to notice and to write, below the promised second

_OF_A_BAG = re.compile(r"metadata\.yaml|.*\.(mcap|db3)(\.zstd)?")


def check_replaceable(directory: Path, *, overwrite: bool) -> None:
    """Raise BagError when a bag cannot take the place of what is there, or nothing can be made there.

    With `overwrite` it may replace a folder that holds nothing but the files of a bag.
    """
    if not directory.exists():
        above = next(path for path in directory.absolute().parents if path.exists())
        if not (above.is_dir() and os.access(above, os.W_OK | os.X_OK)):
            raise BagError(f"{directory}: cannot be created: {above} is no folder to write into")
        return
    if not overwrite:
        raise BagError(f"{directory} exists: choose another name, or overwrite it")
    names = [path.name for path in directory.iterdir()] if directory.is_dir() else [directory.name]
    foreign = [name for name in sorted(names) if not _OF_A_BAG.fullmatch(name)]
    if foreign or not directory.is_dir():
        raise BagError(
            f"{directory} holds {', '.join(foreign[:3]) or 'no bag'}: a bag replaces bags only: "
            "move it away or choose another name"
        )


class _WriteGuard:
    """Delays Ctrl-C while its block writes a record, and turns an error of the disk into a BagError.

    A KeyboardInterrupt between two steps leaves half a record in the chunk, and the bag is unreadable from there
    on. Under full load that happened with a quarter of all Ctrl-C. The guard acts only where Python's default handler
    would: in the main thread, when the program has no handler of its own, and rclpy has installed none in C.
    """

    def __init__(self, part: Path) -> None:
        self._part = part
        self._installed = self._busy = self._pending = False

    def install(self) -> None:
        """Replace Python's default handler of SIGINT."""
        default = signal.getsignal(signal.SIGINT) is signal.default_int_handler
        main = threading.current_thread() is threading.main_thread()
        rclpy = sys.modules.get("rclpy.signals")
        ours = rclpy is None or rclpy.get_current_signal_handlers_options().name == "NO"
        if default and main and ours:
            signal.signal(signal.SIGINT, self._on_signal)
            self._installed = True

    def remove(self) -> None:
        if self._installed and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.default_int_handler)
        self._installed = False

    def __enter__(self) -> None:
        self._busy = True

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self._busy = False
        if self._pending:
            self._pending = False
            raise KeyboardInterrupt
        if isinstance(error, OSError):
            raise BagError(
                f"{self._part} cannot be written ({error.strerror}): "
                "what is in it can be rescued with: ptnsbc bag repair"
            ) from error

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self._busy:
            self._pending = True
        else:
            signal.default_int_handler(number, frame)


class BagWriter:
    """A bag being written; use it as a context manager.

    Args:
        directory: Folder of the finished bag; it must not exist unless `overwrite` is set.
        attachments: Files to carry inside the bag, by name.
        metadata: Key and value pairs of the MCAP metadata record `ptnsbc`.

    Attributes:
        name: Prefix of the file names; it may be changed before `open`.
        records: Metadata records by name; more may be added before `open`.
    """

    def __init__(
        self,
        directory: Path,
        topics: Sequence[TopicDeclaration],
        *,
        attachments: Mapping[str, bytes] | None = None,
        metadata: Mapping[str, str] | None = None,
        compression: CompressionType = CompressionType.ZSTD,
        overwrite: bool = False,
    ) -> None:
        # Absolute, so that `.` has a name and a later chdir changes nothing.
        self.directory = Path(os.path.abspath(directory))
        self.name = self.directory.name
        self.records: dict[str, Mapping[str, str]] = {
            METADATA_RECORD: dict(sorted((metadata or {}).items()))
        }
        self._part = self.directory.with_name(self.directory.name + ".part")
        self._topics = list(topics)
        self._attachments = dict(attachments or {})
        self._compression = compression
        self._overwrite = overwrite
        self._numbers = {topic.name: number for number, topic in enumerate(self._topics)}
        self._counts = [0] * len(self._topics)  # messages of each topic
        self._finished: list[FileSummary] = []
        self._file: McapFileWriter | None = None
        self._unflushed = 0  # messages
        self._first_look: float | None = None  # of `flush_if_due`
        self._last_flush = 0.0
        self._guard = _WriteGuard(self._part)

    def __enter__(self) -> BagWriter:
        self.open()
        return self

    def __exit__(self, *error: object) -> None:
        # Completed after an error too: the last seconds before a crash are wanted most.
        self.close()

    @property
    def counts(self) -> dict[str, int]:
        """Messages written so far, by topic."""
        return {name: self._counts[number] for name, number in self._numbers.items()}

    def open(self) -> None:
        """Create `<dir>.part` with its first file, and write what is known before the first message.

        BagError when it or `<dir>` exists.
        """
        way_out = "choose another name, or overwrite it"
        check_replaceable(self.directory, overwrite=self._overwrite)
        try:
            if self._part.exists():
                if not self._overwrite:
                    raise BagError(
                        f"{self._part} exists, a recording that was killed or still runs: "
                        f"rescue it with ptnsbc bag repair, {way_out}"
                    )
                check_replaceable(self._part, overwrite=True)
                shutil.rmtree(self._part)
            self._part.mkdir(parents=True)
        except OSError as error:
            raise BagError(f"{self._part}: cannot be created: {error.strerror}") from error
        self._guard.install()
        with self._guard:
            self._file = self._next_file()

    def write(
        self,
        topic: str,
        stamp_ns: int,
        data: bytes,
        publish_ns: int | None = None,
        sequence: int | None = None,
    ) -> None:
        """Append a serialised message (CDR) of a topic of the bag.

        Readers order by the log time `stamp_ns`. By default the time of publication is the same, and the sequence
        number is counted per topic.
        """
        number = self._numbers.get(topic)
        if self._file is None:
            raise BagError(f"{self.directory}: message on {topic}: expected an open bag")
        if number is None:
            known = ", ".join(self._numbers)
            raise BagError(f"{self.directory}: topic {topic}: expected one of {known}")
        if stamp_ns < 0 or (publish_ns is not None and publish_ns < 0):
            raise BagError(f"{topic}: time {stamp_ns}, {publish_ns} ns: expected not negative")
        publish_ns = stamp_ns if publish_ns is None else publish_ns
        sequence = self._counts[number] if sequence is None else sequence
        with self._guard:
            self._file.add(number, stamp_ns, publish_ns, sequence, data)
            self._counts[number] += 1
            self._unflushed += 1

    def split(self) -> None:
        """Go on in another file, unless this one has no message yet."""
        if self._file is not None and self._file.start_ns is not None:
            with self._guard:
                self._finish_file(self._file)
                self._file = self._next_file()

    def flush_if_due(self, now: float) -> None:
        """Close the chunk when it is as old as the recording was at its begin, after FLUSH_PERIOD at the latest.

        So a recording that is killed soon after its start can be read too: its chunks end at 1, 2, 4, 8, ... times
        the first step of `now` [s], until they last FLUSH_PERIOD. The ends of chunks show in the bytes of the file.
        Live recording passes wall time. Lock-step, where the same flight gives the same bytes, passes its own time.
        """
        if self._first_look is None:
            self._first_look = self._last_flush = now
        age = now - self._last_flush
        long = age > 0.0 and age >= min(FLUSH_PERIOD, self._last_flush - self._first_look)
        if long and self._unflushed:
            self.flush()
            self._last_flush = now

    def flush(self) -> None:
        """Close the chunk, so that a crash does not take what has been written."""
        if self._unflushed and self._file is not None:
            with self._guard:
                self._file.flush()
            self._unflushed = 0

    def close(self) -> None:
        """Complete the bag and rename its folder; does nothing the second time."""
        file, self._file = self._file, None
        if file is None:
            return
        try:
            with self._guard:
                self._finish_file(file)
                topics = zip(self._topics, self._counts, strict=True)
                information = bag_information(self._finished, topics)
                text = to_yaml({"rosbag2_bagfile_information": information})
                (self._part / METADATA_FILE).write_text(text, encoding="utf-8")
                self._rename_part()
        finally:
            self._guard.remove()

    def _next_file(self) -> McapFileWriter:
        path = self._part / f"{self.name}_{len(self._finished)}.mcap"
        return McapFileWriter(
            path, self._topics, self._attachments, self.records, self._compression
        )

    def _finish_file(self, file: McapFileWriter) -> None:
        """Close a file, with a record that describes it as metadata.yaml describes the bag."""
        self._finished.append(file.summary)
        file.finish(bag_information([file.summary], zip(self._topics, file.counts, strict=False)))

    def _rename_part(self) -> None:
        """Rename `<dir>.part` to `<dir>`; with `overwrite` the old bag is removed only then."""
        old = self.directory.with_name(f".{self.directory.name}.{os.getpid()}.old")
        try:
            if self._overwrite and self.directory.exists():
                # Moved away first: the old bag or the new one exists at any time.
                self.directory.rename(old)
            self._part.rename(self.directory)
        except OSError as error:
            raise BagError(
                f"{self.directory} appeared while the bag was written ({error.strerror}): "
                f"the bag is complete in {self._part}"
            ) from error
        shutil.rmtree(old, ignore_errors=True)
