"""Recording a flight into a bag: every topic of the given UAVs, as bytes.

/tf is made here, out of odometry (`transforms`).

In real time a message is logged when it arrives. In lock-step it is logged at its own stamp and
sorted (`bag.reorder`), so that the same command gives the same bytes.

The process says `ready` on stderr when it listens, and at SIGINT or SIGTERM completes the bag and
prints one line of JSON on stdout.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes import environment, qos, topics, wire
from ptnsbc_nodes.bag import BagError, BagWriter, TopicInfo
from ptnsbc_nodes.bag.msgdef import has_header
from ptnsbc_nodes.bag.reorder import Held, ReorderBuffer
from ptnsbc_nodes.endpoints import RECORDED, full_name
from ptnsbc_nodes.network import NetworkError
from ptnsbc_nodes.provenance import add_version
from ptnsbc_nodes.rosargs import RosArgumentsError, ros_errors, without_ros
from ptnsbc_nodes.spin import drain, make_executor, spin_for
from ptnsbc_nodes.topics import Topic
from ptnsbc_nodes.transforms import Transforms

if TYPE_CHECKING:
    from ptnsbc_nodes.pictures import Pictures

_FLUSH_CHECK = 0.1  # [s]
_SIGNAL_CHECK = 0.1  # [s]: Python sees a signal only between two calls of the executor
_QUIET = 0.2  # [s] without a message: what was on its way has arrived
_DRAIN_LIMIT = 50.0  # [s]; under load the queues hold seconds, and the launcher waits a minute
_ACK_TICKS = 25

# Published by every UAV: order of arrival between them is chance even within the topic.
_SHARED = frozenset({topics.DIAGNOSTICS.name, topics.TF.name})
_LISTS = frozenset({topics.MARKERS.type, topics.TF.type})


def topic_info(topic: Topic, *, lockstep: bool) -> TopicInfo:
    """How `topic` is described in a bag: the profile that its publishers offer."""
    profile = qos.profile(topic, lockstep=lockstep)
    reliable = profile.reliability == QoSReliabilityPolicy.RELIABLE
    latched = profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL
    return TopicInfo(
        topic.name,
        topic.type,
        "reliable" if reliable else "best_effort",
        "transient_local" if latched else "volatile",
        profile.depth,
    )


class Recorder:
    """Subscriptions of `node` that write into an open `writer`.

    Args:
        node: Its clock gives the log time in real time.
        writer: An open bag with all `recorded` topics and /tf; it stays open at `finish`.
        recorded: What to record.
        transforms: What makes /tf.
        lockstep: Log at the message's own stamp, in an order that does not depend on arrival.
        pictures: In real time, what makes the markers where no simulator does.
    """

    def __init__(
        self,
        node: Node,
        writer: BagWriter,
        recorded: Iterable[Topic],
        transforms: Transforms,
        *,
        lockstep: bool,
        pictures: Pictures | None = None,
    ) -> None:
        self.received = 0
        self.lost = 0  # as far as DDS reports it: gaps in the network, not in our own queue
        self._ticks = 0
        self._acknowledgement = wire.HeaderTemplate("recorder")
        self._node = node
        self._writer = writer
        self._transforms = transforms
        self._pictures = pictures
        self._order = ReorderBuffer(_SHARED) if lockstep else None
        for topic in recorded:
            order = self._order
            record = self._sorted(topic, order) if order else self._as_it_arrives(topic)
            self._subscribe(topic, record, lockstep)
        if lockstep:
            self._acknowledge = node.create_publisher(
                topics.message_class(RECORDED), full_name(node, RECORDED), qos.EVENT
            )
        else:
            # By wall time: in lock-step, where the bytes would depend on it, by stamp.
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            node.create_timer(_FLUSH_CHECK, self._flush, clock=steady)

    @property
    def late(self) -> int:
        """Lock-step messages too late to be sorted in; above zero the bytes may differ."""
        return self._order.late if self._order else 0

    def finish(self) -> None:
        """Write what is still held back; call before the writer is closed."""
        if self._order:
            self._write_sorted(self._order.flush())

    def _subscribe(self, topic: Topic, record: Callable[[bytes], None], lockstep: bool) -> None:
        self._node.create_subscription(
            topics.message_class(topic),
            full_name(self._node, topic),
            record,
            qos.recorder_profile(topic, lockstep=lockstep),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(message_lost=self._count_lost),
        )

    def _as_it_arrives(self, topic: Topic) -> Callable[[bytes], None]:
        clock = self._node.get_clock()

        def record(data: bytes) -> None:
            self.received += 1
            now_ns, stamp_ns = clock.now().nanoseconds, stamp_of(topic, data)
            self._writer.write(topic.name, now_ns, data, stamp_ns)
            transform = self._transforms.of(topic.name, data)
            if transform is not None:
                self._writer.write(topics.TF.name, now_ns, transform, stamp_ns)
            picture = None if self._pictures is None else self._pictures.of(topic.name, data)
            if picture is not None:
                self._writer.write(topics.MARKERS.name, now_ns, picture, stamp_ns)

        return record

    def _sorted(self, topic: Topic, order: ReorderBuffer) -> Callable[[bytes], None]:
        last_ns = 0

        def record(data: bytes) -> None:
            nonlocal last_ns
            self.received += 1
            stamp_ns = stamp_of(topic, data)
            # An empty list has no stamp; that of its predecessor is the same on every run.
            last_ns = last_ns if stamp_ns is None else stamp_ns
            if topic.name == topics.CLOCK.name:
                self._tick(last_ns)
            self._write_sorted(order.push(last_ns, topic.name, data))
            transform = self._transforms.of(topic.name, data)
            if transform is not None:
                self._write_sorted(order.push(last_ns, topics.TF.name, transform))

        return record

    def _tick(self, stamp_ns: int) -> None:
        """Tell the sim how far we are: events are served in order, so with the clock came the rest."""
        self._ticks += 1
        if self._ticks % _ACK_TICKS == 0:
            self._acknowledge.publish(self._acknowledgement.encode(stamp_ns))

    def _write_sorted(self, messages: Iterable[Held]) -> None:
        for message in messages:
            self._writer.write(message.topic, message.stamp_ns, message.data)
            self._writer.flush_if_due(message.stamp_ns * 1e-9)

    def _count_lost(self, event: Any) -> None:
        self.lost += event.total_count_change

    def _flush(self) -> None:
        self._writer.flush_if_due(time.monotonic())


def stamp_of(topic: Topic, data: bytes) -> int | None:
    """The header stamp [ns] of a message, of its first element for a list; None without one."""
    listed = topic.type in _LISTS
    if not listed and not has_header(topic.type):
        return None
    try:
        stamp_ns = wire.peek_sequence_stamp(data) if listed else wire.peek_stamp(data)
    except wire.WireError:
        # Foreign and broken, but it was on the topic: it belongs into the bag.
        return None
    return stamp_ns if stamp_ns is not None and stamp_ns >= 0 else None


def main(argv: Sequence[str] | None = None) -> int:
    """Record until SIGINT or SIGTERM."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    stop = _StopSignal()
    context = Context()
    try:
        environment.prepare()
        options = _parser().parse_args(without_ros(arguments))
        if options.punctual:
            environment.prefer_punctuality(flies=False)
        with ros_errors():
            rclpy.init(
                args=arguments, context=context, signal_handler_options=SignalHandlerOptions.NO
            )
        print(json.dumps(_record(context, options, stop)), flush=True)
    except (RosArgumentsError, NetworkError) as error:
        print(f"recorder: {error}", file=sys.stderr)
        return 2
    except PtnsbcError as error:
        print(f"recorder: {error}", file=sys.stderr)
        return 1
    finally:
        rclpy.try_shutdown(context=context)
    return 0


class _StopSignal:
    """SIGINT or SIGTERM has come; the bag still has to be completed, so neither may raise."""

    def __init__(self) -> None:
        self.came = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.came = True


def _record(context: Context, options: argparse.Namespace, stop: _StopSignal) -> dict[str, Any]:
    kinds = {"lockstep": options.lockstep, "with_truth": options.truth}
    recorded = topics.recorded(options.uavs, **kinds)
    node = rclpy.create_node("recorder", context=context, start_parameter_services=False)
    executor = make_executor(context)
    executor.add_node(node)
    infos = [
        topic_info(topic, lockstep=options.lockstep)
        for topic in topics.in_bag(options.uavs, **kinds)
    ]
    with BagWriter(
        options.bag,
        infos,
        attachments={name: _content(name, path) for name, path in options.attach},
        metadata=dict(options.meta),
        overwrite=options.overwrite,
    ) as writer:
        transforms = Transforms(options.uavs)
        recorder = Recorder(
            node,
            writer,
            recorded,
            transforms,
            lockstep=options.lockstep,
            pictures=_pictures(options.draw),
        )
        print("ready", file=sys.stderr, flush=True)
        while not stop.came:
            spin_for(executor, _SIGNAL_CHECK)
        drain(executor, lambda: recorder.received, _QUIET, _DRAIN_LIMIT)
        recorder.finish()
    executor.remove_node(node)
    executor.shutdown()
    node.destroy_node()
    return _summary(writer, recorder)


def _pictures(scenario: str | None) -> Pictures | None:
    if scenario is None:
        return None
    from ptnsbc_nodes.pictures import Pictures
    from ptnsbc_sim.scenario import load_scenario

    return Pictures(load_scenario(scenario, {}))


def _summary(writer: BagWriter, recorder: Recorder) -> dict[str, Any]:
    counts = writer.counts
    return {
        "bag": str(writer.directory),
        "messages": sum(counts.values()),
        "topics": counts,
        "lost": recorder.lost,
        "late": recorder.late,
    }


def _content(name: str, path: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise BagError(f"--attach {name}={path}: {error.strerror}: expected a file") from error


def _pair(text: str) -> tuple[str, str]:
    key, found, value = text.partition("=")
    if not key or not found:
        raise argparse.ArgumentTypeError(f"{text!r}: expected name=value")
    return key, value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="recorder", description="Record a flight into a bag.")
    add_version(parser)
    parser.add_argument("--bag", type=Path, required=True, help="folder to create")
    parser.add_argument("--uavs", type=int, nargs="+", required=True, metavar="N")
    parser.add_argument("--lockstep", action="store_true", help="same flight, same bytes")
    parser.add_argument("--truth", action="store_true", help="the sim tells true states as well")
    parser.add_argument(
        "--draw",
        metavar="SCENARIO",
        help="record markers of its UAVs, where no simulator draws them",
    )
    parser.add_argument(
        "--punctual", action="store_true", help="run before all that does not fly, where allowed"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an existing bag")
    parser.add_argument("--attach", type=_pair, action="append", default=[], metavar="NAME=PATH")
    parser.add_argument("--meta", type=_pair, action="append", default=[], metavar="KEY=VALUE")
    return parser


if __name__ == "__main__":
    sys.exit(main())
