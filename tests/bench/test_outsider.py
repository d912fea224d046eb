"""The forged messages of the outsider, and what its report calls wrong."""

import pytest

pytest.importorskip("rclpy")

from bench.outsider import Flown, forgeries, heard, summary
from bench.scenarios import grid
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.seal import Seal, SealError


@pytest.fixture(scope="module")
def scenario():
    return grid(3, 50, 10.0)


def test_there_is_a_forgery_for_every_topic_that_the_fleet_hears(scenario):
    forged = {one.topic.name for one in forgeries(scenario, 0)}
    assert heard(scenario) <= forged
    assert {topics.EMERGENCY.name, topics.READY.name, topics.DIAGNOSTICS.name} <= forged


def test_no_forgery_passes_a_seal(scenario):
    seal = Seal(bytes(32))
    for topic, data in forgeries(scenario, 10**18):
        with pytest.raises(SealError):
            seal.opener(topic)(data)


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
