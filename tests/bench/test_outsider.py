"""The forged messages of the outsider, and what its report calls wrong."""

import pytest

pytest.importorskip("rclpy")

import numpy as np

from bench.outsider import Eavesdropper, Flown, forgeries, heard, summary
from bench.scenarios import grid
from ptnsbc_io import wire
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.seal import Seal, SealError


@pytest.fixture(scope="module")
def scenario():
    return grid(3, 50, 10.0).with_({"security": "signed"})


def test_there_is_a_forgery_for_every_topic_that_the_fleet_hears(scenario):
    forged = {one.topic.name for one in forgeries(scenario, 0)}
    assert heard(scenario) <= forged
    assert {topics.EMERGENCY.name, topics.READY.name, topics.DIAGNOSTICS.name} <= forged


def test_no_forgery_passes_a_seal(scenario):
    seal = Seal(bytes(32))
    for topic, data in forgeries(scenario, 10**18):
        with pytest.raises(SealError):
            seal.opener(topic)(data)


class Air:
    """The subscriptions of the outsider, by topic."""

    def __init__(self):
        self.deliver = {}

    def listen(self, topic, decode, deliver):
        self.deliver[topic] = lambda data: deliver(decode(data))


def test_states_that_are_heard_are_sent_again_moved(scenario):
    air, values = Air(), np.arange(13.0)
    eavesdropper = Eavesdropper(air, scenario)
    assert len(air.deliver) == 9
    template = wire.OdometryTemplate("map", "uav2/base_link")
    air.deliver[topics.odom(2)](template.encode(5, values))
    [(topic, data)] = eavesdropper.moved(7)
    stamp_ns, moved = wire.decode_odometry(data)
    assert (topic, stamp_ns) == (topics.odom(2), 7)
    assert list(moved - values) == [0.5] + [0.0] * 12
    mixed = list(eavesdropper.mixed(scenario))
    assert len(mixed) == 2 * len(list(forgeries(scenario, 0)))


def flown(scenario, error_m=0.01, **changes):
    refused = dict.fromkeys(heard(scenario), 1)
    return Flown(error_m, (), 0, 0, {}, ("/uav1/odom",), refused)._replace(**changes)


def test_the_report_says_what_is_wrong(scenario):
    calm = [flown(scenario)]
    assert summary(scenario, calm, [flown(scenario, 0.0149)])["wrong"] == []
    unheard = dict.fromkeys(heard(scenario) - {topics.EPOCH.name}, 1)
    bad = flown(scenario, 0.016, died=("uav2",), named=(), refused=unheard)
    assert summary(scenario, calm, [bad])["wrong"] == [
        "died: uav2",
        "the outsider was not named",
        f"{topics.EPOCH.name}: nothing refused",
        "the error grew by 6.0 mm",
    ]
