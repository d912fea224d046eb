"""The messages of a streaming bag that steps of a re-run still need, and the UAVs of the re-run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ptnsbc_core.types import LEGS
from ptnsbc_io.bag import Bag, BagMessage
from ptnsbc_io.wire import WireError, decode_diagnostics, decode_floats, decode_header
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import DecidedSlots, keep_recorded
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.comm.legs import Epochs
from ptnsbc_sim.plugins.uav_plugins import UavPlugins
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.legs import number_of
from ptnsbc_tools.replay.topic_buffer import TopicBuffer
from ptnsbc_tools.replay.uav_replay import UavReplay, heard_topics

_KEPT_SNAPSHOTS = 8
_KEPT_STATUSES = 64  # twelve seconds; nobody takes the statuses of steps that are not made


class ReplayState:
    """Buffered messages, epochs and UAVs of one re-run, or of a part of its UAVs."""

    def __init__(
        self,
        scenario: Scenario,
        uavs: Sequence[int],
        fleet: str = "",
    ) -> None:
        edges = CommunicationGraph(scenario, FlightOptions())
        self.scenario = scenario
        self.slots = DecidedSlots(scenario)
        self.uavs = {
            uav: UavReplay(scenario, uav, edges, self.slots, fleet, UavPlugins.of(scenario, uav))
            for uav in uavs
        }
        needed = {topic for uav in uavs for topic in topics.of_uav(uav)}
        for replay in self.uavs.values():
            needed.update(heard_topics(replay.senders))
        self.buffers = {topic.name: TopicBuffer(topic.type) for topic in needed}
        self.epochs = Epochs(scenario)
        self.first_t0_ns: int | None = None
        self._snapshots: dict[int, list[tuple[int, bytes]]] = {uav: [] for uav in uavs}
        self._snapshot_topics = {topics.snapshot(uav).name: uav for uav in uavs}

    def wanted(self, bag: Bag) -> list[str]:
        """Topics of a bag that a re-run reads."""
        ticks = [topics.tick(uav).name for uav in self.uavs]
        common = (topics.EPOCH.name, topics.SLOTS.name, topics.DIAGNOSTICS.name)
        names = (*self.buffers, *self._snapshot_topics, *ticks, *common)
        return [name for name in names if name in bag.topics]

    def put(self, message: BagMessage) -> None:
        """Keep a message until the steps that need it are made; WireError when it is broken."""
        buffer = self.buffers.get(message.topic)
        if buffer is not None:
            buffer.put(message.data)
        elif message.topic == topics.DIAGNOSTICS.name:
            self._put_diagnostics(message.data)
        elif message.topic == topics.EPOCH.name:
            self._put_epoch(message.data)
        elif message.topic == topics.SLOTS.name:
            keep_recorded(self.slots, message.data)
        elif message.topic in self._snapshot_topics:
            numbers = decode_floats(message.data).values
            if not numbers.size or not np.isfinite(numbers[0]):
                raise WireError("snapshot without a number of its step")
            kept = self._snapshots[self._snapshot_topics[message.topic]]
            kept.append((int(numbers[0]), message.data))
            del kept[:-_KEPT_SNAPSHOTS]

    def snapshot(self, uav: int, sequence: int) -> bytes | None:
        """Remove and return the snapshot after step number `sequence`; None when there is none."""
        kept = self._snapshots[uav]
        for place, (number, data) in enumerate(kept):
            if number == sequence:
                del kept[: place + 1]
                return data
        return None

    def seconds(self, stamp_ns: int) -> float:
        """Time after the first epoch; after zero before an epoch is known."""
        return (stamp_ns - (self.first_t0_ns or 0)) * 1e-9

    def _put_epoch(self, data: bytes) -> None:
        epoch = decode_header(data)
        word = number_of(epoch.frame_id) is not None
        if word or epoch.frame_id in LEGS:
            self.epochs.announce(epoch.stamp_ns, epoch.frame_id)
            if not word and self.first_t0_ns is None:
                self.first_t0_ns = epoch.stamp_ns

    def _put_diagnostics(self, data: bytes) -> None:
        for status in decode_diagnostics(data).statuses:
            name, _, kind = status.name.partition(": ")
            uav, ticks = name.removeprefix("uav"), status.values.get("ticks", "")
            if kind == "planner" and uav.isdecimal() and ticks.isdecimal():
                replay = self.uavs.get(int(uav))
                if replay is not None:
                    replay.recorded_counters.setdefault(int(ticks), []).append(status.values)
                    if len(replay.recorded_counters) > _KEPT_STATUSES:
                        del replay.recorded_counters[next(iter(replay.recorded_counters))]
