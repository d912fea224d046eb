"""Definitions and type hashes of messages, from the installed packages and from the table."""

from __future__ import annotations

import json

import pytest

from ptnsbc_io.bag import BagError, BagWriter, declare, metadata

TYPES = tuple(json.loads(metadata._TABLE_FILE.read_text()))


def test_without_ros_the_same_definitions(monkeypatch):
    """The table holds what the installed packages say."""
    installed = [metadata.definition(name) for name in TYPES]
    monkeypatch.setattr(metadata, "_share_file", lambda *_: None)
    metadata.definition.cache_clear()
    shipped = [metadata.definition(name) for name in TYPES]
    metadata.definition.cache_clear()
    assert installed == shipped


def test_shipped_definitions_are_jazzys():
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    for name, entry in json.loads(metadata._TABLE_FILE.read_text()).items():
        assert entry["hash"] == store.hash_rihs01(name)
        package, _, short = name.split("/")
        path = metadata._share_file(package, f"{short}.msg")
        if path is not None:
            assert entry["msg"] == path.read_text()
            assert entry["hash"] == metadata._type_hash(package, short)


@pytest.mark.parametrize("type_name", ["no_such_msgs/msg/Thing", "nav_msgs/Odometry"])
def test_unknown_type_leaves_nothing_behind(tmp_path, type_name):
    with pytest.raises(BagError, match=r"no definition of no_such|expected package/msg/Name"):
        BagWriter(tmp_path / "x", [declare("/a", type_name)]).open()
    assert list(tmp_path.iterdir()) == []


def test_a_bag_of_anybodys_messages_carries_their_definitions(tmp_path):
    """rosbags knows no lab_msgs: it reads them by what the bag says, nested types and all."""
    messages = pytest.importorskip("lab_msgs.msg")
    serialization = pytest.importorskip("rclpy.serialization")
    highlevel = pytest.importorskip("rosbags.highlevel")
    vehicle = messages.Vehicle(id=3, mode="form")
    vehicle.position.y = 7.0
    state = messages.Vehicles(share_of_time=0.5, late=[3, 5], vehicles=[vehicle])
    topic = declare("/lab/state", "lab_msgs/msg/Vehicles")
    with BagWriter(tmp_path / "state", [topic]) as writer:
        writer.write(topic.name, 7, serialization.serialize_message(state))
    with highlevel.AnyReader([tmp_path / "state"]) as reader:
        ((connection, stamp, data),) = reader.messages()
        read = reader.deserialize(data, connection.msgtype)
    assert (stamp, read.share_of_time, list(read.late)) == (7, 0.5, [3, 5])
    assert read.vehicles[0].mode == "form"
    assert read.vehicles[0].position.y == 7.0
