"""The index of the chunks on the disk, and the file that it makes: the library's own, byte for byte."""

from __future__ import annotations

from io import BytesIO

import pytest
from mcap.reader import make_reader
from mcap.records import ChunkIndex
from mcap.writer import Writer

from ptnsbc_io.bag.chunk_index import ChunkIndexFile, keep_on_disk


def write(on_disk) -> bytes:
    stream = BytesIO()
    writer = Writer(stream)
    indexes = keep_on_disk(writer, on_disk) if on_disk else None
    writer.start()
    schema = writer.register_schema("a", "ros2msg", b"")
    channels = [writer.register_channel(f"/t{k}", "cdr", schema) for k in range(5)]
    for k in range(40):
        writer.add_message(channels[k % 5], k, bytes(k), k)
        if k % 7 == 6:
            writer.flush()
    writer.finish()
    if indexes:
        assert len(list(indexes)) == 6
        indexes.close()
    return stream.getvalue()


def test_same_bytes_as_from_memory(tmp_path):
    assert write(tmp_path) == write(None)
    summary = make_reader(BytesIO(write(tmp_path))).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) == 6


def test_nothing_is_left_in_the_folder(tmp_path):
    indexes = ChunkIndexFile(tmp_path)
    assert list(indexes) == []
    indexes.append(ChunkIndex(9, 8, "zstd", 7, 6, 5, {1: 2, 3: 1 << 40}, 4, 3))
    assert [index.message_index_offsets for index in indexes] == [{1: 2, 3: 1 << 40}]
    assert list(tmp_path.iterdir()) == []
    indexes.close()
    with pytest.raises(ValueError, match="closed"):
        list(indexes)
