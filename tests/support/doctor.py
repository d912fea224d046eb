"""What the MCAP specification asks of a file, checked with the mcap library; for tests of what writes bags."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, MessageIndex, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk


def read_by_another(bag: Path) -> Counter[str]:
    """Messages by topic of a bag, in order and each deserialised, by rosbags; skips where it is missing."""
    highlevel = pytest.importorskip("rosbags.highlevel")
    counts: Counter[str] = Counter()
    with highlevel.AnyReader([bag]) as reader:
        last_ns = 0
        for connection, stamp_ns, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            assert stamp_ns >= last_ns
            last_ns = stamp_ns
            counts[connection.topic] += 1
    return counts


def examine(file: Path) -> Counter[str]:
    """Messages by topic of a file in which everything agrees with everything; AssertionError otherwise."""
    with file.open("rb") as stream:
        # CRCs of chunks, of the data section and of the summary are compared by the library.
        records = list(StreamReader(stream, validate_crcs=True, emit_chunks=True).records)
    with file.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    assert summary is not None and summary.statistics is not None
    assert isinstance(records[0], Header)
    assert records[0].profile == "ros2"
    assert isinstance(records[-1], Footer)
    assert sum(isinstance(record, DataEnd) for record in records) == 1
    chunks = [record for record in records if isinstance(record, Chunk)]
    _chunks_and_their_index(file, chunks, summary)
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    counts: Counter[int] = Counter()
    times = []
    for chunk in chunks:
        inside = []
        for record in breakup_chunk(chunk, validate_crc=True):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                assert record.schema_id in schemas, "a schema comes before its channels"
                channels[record.id] = record
            else:
                assert record.channel_id in channels, "a channel comes before its messages"
                counts[record.channel_id] += 1
                inside.append(record.log_time)
        assert (min(inside), max(inside)) == (chunk.message_start_time, chunk.message_end_time)
        times += inside
    _statistics(summary.statistics, records, counts, times)
    assert summary.channels.keys() == channels.keys()
    assert summary.schemas.keys() == schemas.keys()
    return Counter({channels[number].topic: count for number, count in counts.items()})


def _chunks_and_their_index(file: Path, chunks, summary) -> None:
    assert len(summary.chunk_indexes) == len(chunks)
    content = file.read_bytes()
    for index, chunk in zip(summary.chunk_indexes, chunks, strict=True):
        assert content[index.chunk_start_offset] == 6, "an index points at a chunk"
        assert index.compressed_size == len(chunk.data)
        assert index.uncompressed_size == chunk.uncompressed_size
        assert index.message_start_time == chunk.message_start_time
        assert index.message_end_time == chunk.message_end_time
        for offset in index.message_index_offsets.values():
            assert content[offset] == 7, "and to its message indexes"


def _statistics(told: Statistics, records, counts: Counter[int], times: list[int]) -> None:
    assert {k: v for k, v in told.channel_message_counts.items() if v} == dict(counts)
    assert told.message_count == sum(counts.values()) == len(times)
    assert told.chunk_count == sum(isinstance(record, Chunk) for record in records)
    if times:
        assert (told.message_start_time, told.message_end_time) == (min(times), max(times))
    indexed = sum(len(r.records) for r in records if isinstance(r, MessageIndex))
    assert indexed == len(times), "every message is in an index"
