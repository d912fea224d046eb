"""/tf made of odometry: read back by an independent library, and how often."""

from __future__ import annotations

import json
from importlib.resources import files

import numpy as np
import pytest

from ptnsbc_io import wire
from ptnsbc_io.bag.metadata import definition
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import LiveTransforms, Transforms
from ptnsbc_nodes.comm.endpoints import Endpoints

STATE = np.arange(13.0) + 0.5
MS = 1_000_000


def read(data: bytes):
    """The message as rosbags reads it, by the definition that our bags carry."""
    store = pytest.importorskip("rosbags.typesys")
    typestore = store.get_typestore(store.Stores.EMPTY)
    text = definition(topics.TF.type).text
    typestore.register(store.get_types_from_msg(text, topics.TF.type))
    return typestore.deserialize_cdr(data, topics.TF.type)


@pytest.mark.parametrize("uav", [1, 12])
def test_the_pose_under_both_names(uav):
    odometry = wire.OdometryTemplate("map", f"uav{uav}/base_link").encode(7_000_000_009, STATE)
    (found,) = read(wire.transform_of(odometry)).transforms
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == (7, 9)
    assert (found.header.frame_id, found.child_frame_id) == ("map", f"uav{uav}/base_link")
    place, turn = found.transform.translation, found.transform.rotation
    assert [place.x, place.y, place.z] == STATE[:3].tolist()
    assert [turn.x, turn.y, turn.z, turn.w] == STATE[3:7].tolist()


@pytest.mark.parametrize(("parent", "child"), [("", "uav1/base_link"), ("map", "")])
def test_a_frame_without_a_name_has_no_transform(parent, child):
    assert wire.transform_of(wire.OdometryTemplate(parent, child).encode(0, STATE)) is None


def test_twenty_a_second_whatever_the_rate_of_the_odometry():
    transforms = Transforms([1, 2])
    template = wire.OdometryTemplate("map", "uav1/base_link")
    # 30 Hz with jitter, as a flight controller sends it
    stamps = [round(k * 33.3) * MS + (k % 3) * MS for k in range(90)]
    made = [transforms.of("/uav1/odom", template.encode(t, STATE)) for t in stamps]
    assert sum(one is not None for one in made) == 60
    assert transforms.of("/uav2/odom", template.encode(0, STATE)) is not None


def test_only_odometry_of_these_uavs_that_can_be_read():
    transforms = Transforms([1])
    data = wire.OdometryTemplate("map", "uav3/base_link").encode(0, STATE)
    assert transforms.of("/uav3/odom", data) is None
    assert transforms.of("/uav1/formation_state", data) is None
    assert transforms.of("/uav1/odom", b"rubbish") is None
    assert transforms.of("/uav1/odom", data[:40]) is None


@pytest.mark.ros
@pytest.mark.skipif(not topics.tf_is_available(), reason="tf2_msgs is not installed")
def test_in_flight_only_while_something_listens(ros, sent):
    endpoints = Endpoints(ros.node("sim"), lockstep=False)
    transforms = LiveTransforms(endpoints, [1])
    template = wire.OdometryTemplate("map", "uav1/base_link")
    transforms.publish(1, template.encode(0, STATE))
    assert not sent["/tf"]
    heard = []
    viewer = Endpoints(ros.node("viewer"), lockstep=False)
    viewer.listen(topics.TF, bytes, heard.append)
    ros.spin_until(lambda: endpoints.readers(topics.TF)() == 1)
    for k in range(10):  # 100 Hz
        transforms.publish(1, template.encode(k * 10 * MS, STATE))
    ros.spin_until(lambda: len(heard) == 2)
    assert [read(data).transforms[0].header.stamp.nanosec for data in heard] == [0, 50 * MS]


@pytest.mark.skipif(not topics.tf_is_available(), reason="tf2_msgs is not installed")
def test_the_installed_message_is_the_one_in_bags():
    import ptnsbc_io.bag

    known = json.loads(files(ptnsbc_io.bag).joinpath("definitions.json").read_text())
    expected = known[topics.TF.type]
    found = definition(topics.TF.type)
    assert found.text.startswith(expected["msg"])
    assert found.type_hash == expected["hash"]
