"""Flights for tests: synthetic ones, whose positions are known in closed form, and bags of real ones.

The bags are of a headless flight and of a real-time flight with jitter, losses and repeats, without processes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest
from synthetic_flights import counters, flight, thinned

from ptnsbc_io.bag import BagMessage, BagWriter, TopicDeclaration, declare, read_bag
from ptnsbc_io.wire import HeaderTemplate, Stamped, decode_near, decode_odometry, encode_near
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import AgentMessages
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.comm.legs import Epochs
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS
from ptnsbc_nodes.uav.step_log import SnapshotTemplate, TickTemplate
from ptnsbc_nodes.uav.uav_controller import UavController, step_time
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.scenario.constants import PlannerLimits
from ptnsbc_sim.verdict import Recording, Track
from ptnsbc_sim.world import World
from ptnsbc_tools import console


@pytest.fixture(autouse=True)
def no_lines_about_slowness(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a command says does not depend on the load of the machine."""
    monkeypatch.setattr(console, "_PATIENCE_S", 600.0)


@pytest.fixture
def without() -> Callable[..., Track]:
    return thinned


@pytest.fixture
def fly() -> Callable[..., Recording]:
    return flight


@pytest.fixture
def count() -> Callable[..., Track]:
    return counters


Change = Callable[[BagMessage], Iterable[BagMessage]]

CARRIED = 2  # UAV whose controller begins anew with the first leg, under limits of its vehicle
PERIOD_NS = 10_000_000
START_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="session")
def scenario() -> Scenario:
    return load_scenario("paper_5", {"timing.duration_s": 1.5})


@pytest.fixture(scope="session")
def headless(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("rclpy")  # for the messages of /diagnostics and the markers
    from ptnsbc_sim.swarm import fly
    from ptnsbc_tools.reading.headless import write_flight

    return write_flight(fly(scenario), tmp_path_factory.mktemp("headless") / "flight")


class _Process:
    """One UAV as its process ticks in real time, without ROS around it."""

    def __init__(self, scenario: Scenario, uav: int) -> None:
        edges = CommunicationGraph(scenario, FlightOptions())
        senders = edges.senders(uav)
        self.uav = uav
        self.senders = senders
        self.wrench = np.zeros(6)
        self._carried = uav == CARRIED
        self.epochs = Epochs(scenario)
        self._pilot = UavController(scenario, uav, edges)
        self.inbox = self._pilot.inbox
        if self._carried:
            slow = PlannerLimits(0.8, 1.1)  # [m/s], [m/s^2]: what its vehicle allows
            self._pilot.config = slow.applied_to(self._pilot.config)
        self._letters = AgentMessages(uav)
        self._tick = TickTemplate(senders)
        self._snapshot: SnapshotTemplate | None = None

    def step(self, now_ns: int) -> dict[topics.Topic, bytes]:
        at = step_time(now_ns, PERIOD_NS, self.epochs.at(now_ns), START_NS)
        if at.flying and self._carried:  # as a bridge does it that has brought its vehicle here
            self._carried = False
            self._pilot.restart()
        outputs = self._pilot.step(at, NO_CUTOFF_NS)
        own = self.inbox.own
        assert own is not None
        self.wrench = outputs.wrench
        names = (topics.formation_state, topics.leader_estimate)
        names += (topics.velocity_setpoint, topics.wrench_setpoint)
        said = {
            of(self.uav): data + bytes(-len(data) % 4)
            for of, data in zip(names, self._letters.all(own, outputs), strict=True)
        }
        held = self.inbox.held(NO_CUTOFF_NS, NO_CUTOFF_NS)
        sequence = self._pilot.steps - 1
        said[topics.tick(self.uav)] = self._tick.encode(sequence, at, held)
        if sequence % 50 == 0:
            self._snapshot = self._snapshot or SnapshotTemplate(self._pilot)
            data = self._snapshot.encode(sequence, self._pilot)
            said[topics.snapshot(self.uav)] = data
        return said


def _real_time(scenario: Scenario, writer: BagWriter) -> None:
    """A world and five processes by a clock that jitters, on links that lose one message in ten."""
    rng = np.random.default_rng(7)
    world = World(scenario)
    crew = [_Process(scenario, uav) for uav in world.ids]
    letters = {uav: AgentMessages(uav) for uav in world.ids}
    on_air: dict[str, bytes] = {}
    writer.write(topics.EPOCH.name, START_NS, HeaderTemplate("form").encode(START_NS + 10**8))
    for k in range(scenario.timing.ticks):
        stamp_ns = START_NS + k * PERIOD_NS + int(rng.integers(0, 200_000))
        for one in crew:
            odom = letters[one.uav].odometry(Stamped(stamp_ns, world.odometry(one.uav)))
            writer.write(topics.odom(one.uav).name, stamp_ns, odom)
            if rng.random() > 0.1 or one.inbox.own is None:
                one.inbox.own = decode_odometry(odom)
            if k % 5 == 0:
                near = encode_near(stamp_ns, "map", world.near(one.uav))
                writer.write(topics.near(one.uav).name, stamp_ns, near)
                one.inbox.near = decode_near(near)
            if k == 2:
                one.epochs.announce(START_NS + 10**8, "form")
        for one in rng.permutation(crew):
            now_ns = stamp_ns + 1_000_000 * int(rng.integers(1, 8))
            for i in one.senders.states:
                data = on_air.get(topics.formation_state(i).name)
                if data is not None and rng.random() > 0.1:
                    one.inbox.state_queues[i].put(decode_odometry(data))
            for i in one.senders.estimators:
                data = on_air.get(topics.leader_estimate(i).name)
                if data is not None and rng.random() > 0.1:
                    one.inbox.estimate_queues[i].put(decode_odometry(data))
            for _ in range(2 if rng.random() < 0.05 else 1):  # a late timer ticks twice
                for topic, data in one.step(now_ns).items():
                    writer.write(topic.name, now_ns, data)
                    on_air[topic.name] = data
                now_ns += 500_000
        world.step({one.uav: one.wrench for one in crew})


@pytest.fixture(scope="session")
def realtime(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("realtime") / "flight"
    recorded = topics.recorded(scenario.uav_ids, lockstep=False)
    infos = [declare(topic.name, topic.type) for topic in recorded]
    with BagWriter(path, infos, attachments={"scenario.yaml": scenario.text.encode()}) as writer:
        _real_time(scenario, writer)
    return path


@pytest.fixture
def rewritten(tmp_path: Path) -> Callable[[Path, Change], Path]:
    """A bag whose messages went through a function: changed, dropped, doubled."""

    def rewrite(path: Path, change: Change, *more: TopicDeclaration) -> Path:
        new_path = tmp_path / f"changed{len(list(tmp_path.iterdir()))}"
        old = read_bag(path)
        infos = [declare(topic.name, topic.type) for topic in old.topics.values()]
        infos += more
        attachments = {name: old.attachment(name) for name in old.attachments}
        with BagWriter(new_path, infos, attachments=attachments) as writer:
            for message in old.messages():
                for new in change(message):
                    writer.write(*new)
        return new_path

    return rewrite
