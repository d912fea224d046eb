"""The index of an MCAP file's chunks, kept on the disk while the file is written.

The promise: the memory of a recorder does not grow with the flight (`bench.soak` measures it). An entry names the
place of every topic in its chunk. Twenty UAVs have 180 topics, and a chunk ends twice a second: as objects of the MCAP
library ten minutes of entries take 24 MB. The library has no option to keep them elsewhere (foxglove/mcap: its Writer
collects them for the summary), so its private list is replaced, here and nowhere else.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.records import ChunkIndex
from mcap.writer import Writer

from ptnsbc_io.bag.mcap_file import RECORD_HEAD


class ChunkIndexFile:
    """Chunk indexes in a file without a name, which ends with the process; appended, then iterated.

    Args:
        folder: Where the file lies.
    """

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - closed by `close`

    def append(self, index: ChunkIndex) -> None:
        """Write an index behind the others; OSError when the disk is full."""
        record = RecordBuilder()
        index.write(record)
        self._file.write(record.end())

    def __iter__(self) -> Iterator[ChunkIndex]:
        self._file.seek(0)
        while head := self._file.read(RECORD_HEAD.size):
            _, length = RECORD_HEAD.unpack(head)
            yield ChunkIndex.read(ReadDataStream(BytesIO(self._file.read(length))))

    def close(self) -> None:
        """Give the disk back."""
        self._file.close()


def keep_on_disk(writer: Writer, folder: Path) -> ChunkIndexFile:
    """Let a writer that has no chunk yet keep the index of its chunks in a file.

    `tests/io/bag/test_chunk_index.py` fails when a version of the library no longer has its private list.
    """
    indexes = ChunkIndexFile(folder)
    writer._Writer__chunk_indices = indexes
    return indexes
