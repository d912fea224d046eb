"""Files of MCAP, byte for byte as the MCAP library writes them."""

from __future__ import annotations

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from ptnsbc_io.bag.mcap_writer import McapFileWriter
from ptnsbc_io.bag.metadata import declare, to_yaml

TOPICS = [
    declare(f"/t{number}", kind)
    for number, kind in enumerate(3 * ["std_msgs/msg/Header"] + ["rosgraph_msgs/msg/Clock"])
]
ATTACHMENTS = {"scenario.yaml": b"n: 1\n", "b": b"\0"}
RECORDS = {"ptnsbc": {"seed": "7", "mode": "ü"}}
INFORMATION = {"version": 9}
# Topic, log time, time of publication, sequence, data; one topic has none, times are not in order, a chunk is full.
MESSAGES = [(k * k % 3, 10**18 + k * 7 % 40, k, k // 3, bytes(k)) for k in range(40)]
MESSAGES.insert(20, (3, 5, 5, 0, bytes((1 << 20) + 1)))


def library_file(path, messages, compression):
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression)
        writer.start(profile="ros2", library="ptnsbc")
        for name, data in sorted(ATTACHMENTS.items()):
            media_type = "application/yaml" if "." in name else "application/octet-stream"
            writer.add_attachment(0, 0, name, media_type, data)
        for name, pairs in RECORDS.items():
            writer.add_metadata(name, pairs)
        schemas = {}
        channels = []
        for topic in TOPICS:
            if topic.type not in schemas:
                schemas[topic.type] = writer.register_schema(
                    topic.type, topic.schema_encoding, topic.schema
                )
            about = topic.name, "cdr", schemas[topic.type], topic.channel_metadata
            channels.append(writer.register_channel(*about))
        for k, (topic, log_ns, publish_ns, sequence, data) in enumerate(messages):
            writer.add_message(channels[topic], log_ns, data, publish_ns, sequence)
            if k % 7 == 6:
                writer.flush()
        writer.add_metadata("rosbag2", {"serialized_metadata": to_yaml(INFORMATION)})
        writer.finish()


def own_file(path, messages, compression, topics=TOPICS):
    writer = McapFileWriter(path, topics, ATTACHMENTS, RECORDS, compression)
    for k, message in enumerate(messages):
        writer.add(*message)
        if k % 7 == 6:
            writer.flush()
    writer.finish(INFORMATION)
    return writer


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("messages", [MESSAGES, []], ids=["messages", "none"])
def test_same_bytes_as_the_library(tmp_path, messages, compression):
    library_file(tmp_path / "library", messages, compression)
    own_file(tmp_path / "own", messages, compression)
    assert (tmp_path / "own").read_bytes() == (tmp_path / "library").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"own", "library"}  # indexes have no name


def test_a_topic_that_comes_late(tmp_path):
    writer = McapFileWriter(tmp_path / "a", TOPICS[:1], {}, {}, CompressionType.ZSTD)
    writer.add(0, 7, 6, 0, b"first")
    writer.declare(TOPICS[3])
    writer.add(1, 5, 5, 0, b"second")
    assert writer.counts == [1, 1]
    assert (writer.summary.start_ns, writer.summary.messages) == (5, 2)
    writer.finish({})
    with (tmp_path / "a").open("rb") as stream:
        found = [(c.topic, m.log_time, m.data) for _, c, m in make_reader(stream).iter_messages()]
    assert found == [("/t3", 5, b"second"), ("/t0", 7, b"first")]
