"""What a process says it has sent."""

import pytest

pytest.importorskip("rclpy")

from ptnsbc_io import wire
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import Endpoints, sent_in

pytestmark = pytest.mark.ros

HEADER = wire.HeaderTemplate("form")


def test_every_message_counts_and_those_before_the_first_leg_apart(ros):
    endpoints = Endpoints(ros.node("sender"), lockstep=False)
    announce = endpoints.publisher(topics.EPOCH, 0)
    tell_time = endpoints.publisher(topics.CLOCK, 0)
    announce(HEADER.encode(1))
    assert sent_in([endpoints.account()]).since_ns == -1
    endpoints.begin(77)
    endpoints.begin(99)  # a second leg changes nothing
    for stamp in range(3):
        tell_time(wire.ClockTemplate().encode(stamp))
    found = sent_in(["something else", endpoints.account(), "the end"])
    assert (found.since_ns, found.before) == (77, {"/formation/epoch": 1, "/clock": 0})
    assert found.sent == {"/formation/epoch": 1, "/clock": 3}


def test_a_process_that_was_killed_says_nothing():
    assert sent_in(["ready", "sent"]) is None
