"""Definitions and type hashes of messages, from the installed packages and from the table."""

from __future__ import annotations

import json

import pytest

from ptnsbc_io.bag import BagError, BagWriter, TopicInfo, definitions

TYPES = tuple(json.loads(definitions._TABLE_FILE.read_text()))


def test_without_ros_the_same_definitions(monkeypatch):
    """The table holds what the installed packages say."""
    installed = [definitions.definition(name) for name in TYPES]
    monkeypatch.setattr(definitions, "_share_file", lambda *_: None)
    definitions.definition.cache_clear()
    shipped = [definitions.definition(name) for name in TYPES]
    definitions.definition.cache_clear()
    assert installed == shipped


def test_shipped_definitions_are_jazzys():
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    for name, entry in json.loads(definitions._TABLE_FILE.read_text()).items():
        assert entry["hash"] == store.hash_rihs01(name)
        package, _, short = name.split("/")
        path = definitions._share_file(package, f"{short}.msg")
        if path is not None:
            assert entry["msg"] == path.read_text()
            assert entry["hash"] == definitions._type_hash(package, short)


@pytest.mark.parametrize("type_name", ["no_such_msgs/msg/Thing", "nav_msgs/Odometry"])
def test_unknown_type_leaves_nothing_behind(tmp_path, type_name):
    with pytest.raises(BagError, match=r"no definition of no_such|expected package/msg/Name"):
        BagWriter(tmp_path / "x", [TopicInfo("/a", type_name)]).open()
    assert list(tmp_path.iterdir()) == []
