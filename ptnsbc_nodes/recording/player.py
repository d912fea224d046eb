"""Plays a bag back onto its topics: recorded bytes, types and quality of service, at the recorded times."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_io.bag import Bag, BagMessage, BagTopic
from ptnsbc_io.bag.metadata import is_latched, offered_profiles
from ptnsbc_io.wire import encode_clock
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import wait_for_readers
from ptnsbc_nodes.comm.qos import keep_last
from ptnsbc_nodes.comm.topics import CLOCK, Role, Topic
from ptnsbc_nodes.runtime.node_process import plain_node
from ptnsbc_nodes.runtime.signals import StopRequest

_LOOK_S = 0.05
_HISTORY = 1000  # of reliable topics: a reader that is slow for a moment loses nothing
_DEEPEST = 100_000  # whatever the bag says
_FLUSH_S = 1.0
_REPORT_S = 0.5


@dataclass(frozen=True)
class PlayOptions:
    """The bag to play, and how it is played."""

    topics: Sequence[str] = ("*",)  # patterns
    rate: float = 1.0
    start_s: float = 0.0  # after the first message of the bag
    loop: bool = False
    clock_hz: float | None = None  # publish /clock of the bag's time instead of the recorded one
    wait_s: float = 1.0  # for readers, before the first message


@dataclass
class Played:
    """The outcome of playing a bag."""

    messages: int = 0
    rounds: int = 0
    latest_s: float = 0.0  # by how much a message came too late at most
    interrupted: bool = False


def play(
    bag: Bag,
    options: PlayOptions,
    say: Callable[[str], None],
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> Played:
    """Play a bag; SIGINT and SIGTERM end the playback in order.

    Raises:
        PtnsbcError: no topic of it can be published, or it ends before `start_s`.
    """
    with StopRequest() as stop, plain_node("player") as (node, _):
        player = _Player(node, bag, options, stop, say)
        player.wait()
        return player.play(advance)


class _Player:
    def __init__(
        self,
        node: Node,
        bag: Bag,
        options: PlayOptions,
        stop: StopRequest,
        say: Callable[[str], None],
    ) -> None:
        self._bag = bag
        self._options = options
        self._stop = stop
        self._played = Played()
        self._publishers: dict[str, Publisher] = dict(_publishers(node, bag, options, say))
        if not self._publishers:
            raise PtnsbcError(f"{bag.path}: no topic to play: {', '.join(options.topics)} chosen")
        self._start_ns = bag.start_ns + nanoseconds(options.start_s)
        if self._start_ns > bag.end_ns:
            length = seconds(bag.end_ns - bag.start_ns)
            raise PtnsbcError(
                f"start {options.start_s:g} s: expected less than the {length:.3f} s of the bag"
            )
        self._clock = None
        if options.clock_hz is not None:
            self._clock = node.create_publisher(topics.message_class(CLOCK), CLOCK.name, 10)

    def wait(self) -> None:
        """Wait until every topic has a reader, for `wait_s` at most."""
        end = time.monotonic() + self._options.wait_s
        publishers = self._publishers.values()
        # Polled: a match is an event of an executor, and there is none here.
        while time.monotonic() < end and not self._stop.wait(_LOOK_S):
            if all(publisher.get_subscription_count() for publisher in publishers):
                return

    def play(self, advance: Callable[[int, int], None]) -> Played:
        played = self._played
        while not self._stop.came:
            self._round(advance)
            played.rounds += 1
            if not self._options.loop:
                break
        played.interrupted = self._stop.came
        wait_for_readers(self._publishers.values(), _FLUSH_S)
        return played

    def _round(self, advance: Callable[[int, int], None]) -> None:
        """Play the bag once. Due times count from the start, so that no error adds up."""
        length_ns = self._bag.end_ns - self._start_ns
        began, reported = time.monotonic(), 0.0
        for message in self._events():
            after_ns = message.stamp_ns - self._start_ns
            due = began + seconds(after_ns) / self._options.rate
            if self._stop.wait(due - time.monotonic()):
                return
            self._played.latest_s = max(self._played.latest_s, time.monotonic() - due)
            publisher = self._clock if message.topic == "" else self._publishers[message.topic]
            if publisher is not None:
                publisher.publish(message.data)
            self._played.messages += message.topic != ""
            if time.monotonic() - reported > _REPORT_S:
                reported = time.monotonic()
                advance(after_ns // 1_000_000, max(length_ns // 1_000_000, 1))

    def _events(self) -> Iterator[BagMessage]:
        """Messages to publish, and between them ticks of the clock (topic "")."""
        period_ns = None
        if self._clock is not None and self._options.clock_hz:
            period_ns = max(round(1e9 * self._options.rate / self._options.clock_hz), 1)
        next_ns = self._start_ns
        for message in self._bag.messages(self._publishers):
            if message.stamp_ns < self._start_ns:
                continue
            while period_ns is not None and next_ns <= message.stamp_ns:
                yield BagMessage("", next_ns, encode_clock(next_ns))
                next_ns += period_ns
            yield message


def _publishers(
    node: Node, bag: Bag, options: PlayOptions, say: Callable[[str], None]
) -> Iterator[tuple[str, Publisher]]:
    for topic in bag.topics.values():
        matches = any(fnmatchcase(topic.name, pattern) for pattern in options.topics)
        replaced = options.clock_hz is not None and topic.name == CLOCK.name
        if not matches or replaced or not topic.messages:
            continue
        try:
            kind = topics.message_class(Topic(topic.name, topic.type, Role.STATE))
            publisher = node.create_publisher(kind, topic.name, profile(topic))
        except (ImportError, AttributeError, ValueError):
            say(f"{topic.name} is left out: {topic.type} is not installed")
        except NameValidationException as error:
            say(f"{topic.name} is left out: {' '.join(str(error).split())}")
        else:
            yield topic.name, publisher


def profile(topic: BagTopic) -> QoSProfile:
    """The profile that the publishers of a recorded topic offered; reliable where the bag does not say."""
    first = next(iter(offered_profiles(topic.offered_qos)), {})
    # Words since version 9 of rosbag2, numbers before.
    reliable = str(first.get("reliability", "reliable")).lower() in ("reliable", "1")
    latched, depth = is_latched(topic.offered_qos), first.get("depth")
    least = _HISTORY if reliable and not latched else 1
    depth = min(max(depth, least), _DEEPEST) if isinstance(depth, int) else least
    return keep_last(depth, reliable=reliable, latched=latched)
