"""The sim node, with the UAVs played by the test; how vehicles step, and what a wrench that is late does to them."""

import time
from collections.abc import Sequence

import numpy as np
import pytest

pytest.importorskip("rclpy")

from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import Marker, MarkerArray

from ptnsbc_io import wire
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import LEAD_TICKS, CommunicationGraph, FlightOptions
from ptnsbc_nodes.comm.topics import LOST
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.sim import sim_main
from ptnsbc_nodes.sim.sim_node import LockstepScheduler, RealTimeWorld, recorder_lead_ns, sim_node
from ptnsbc_sim.plants.build import plant_config
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.world import World

pytestmark = pytest.mark.ros

TICKS = 12
OWN_WORLD = """
import numpy as np


def disturbance(inputs):
    return 9.0, 0.0, 0.0, 0.0, 0.0, 0.0


def sensor(inputs):
    x, y, z = inputs.odometry[:3]
    return np.array([[x, y, z + 1.0, 0.25, 0.0, 0.0, 0.0, 0.0]])
"""


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("paper_5", {"timing.duration_s": TICKS / 100})


class Uavs:
    """All UAVs in one node; `hands_off` do not answer."""

    def __init__(self, ros, scenario, *, lockstep=True, recorded=False):
        self.ros, self.scenario = ros, scenario
        self.ended = self.mute = False
        self.hands_off = set()
        self.odometry = {i: [] for i in scenario.uav_ids}
        self.near = {i: [] for i in scenario.uav_ids}
        self.clock, self.markers = [], []
        node = ros.node("uavs", namespace="/uav1")
        ends = Endpoints(node, lockstep)
        self.send = {i: ends.publisher(topics.wrench_setpoint(i), 1) for i in scenario.uav_ids}
        self.announce = ends.publisher(topics.EPOCH, 1)
        self.lose = ends.publisher(LOST, 1)
        if recorded:
            self.acknowledge = ends.publisher(topics.RECORDED, 1)
            for topic in topics.recorded(scenario.uav_ids):
                ends.listen(topic, bytes, lambda data: None, required=False)
        for i in scenario.uav_ids:
            ends.listen(
                topics.odom(i), bytes, lambda data, i=i: self.fly(i, wire.decode_odometry(data))
            )
            ends.listen(
                topics.near(i), bytes, lambda data, i=i: self.near[i].append(wire.decode_near(data))
            )
        ends.listen(topics.CLOCK, bytes, lambda data: self.clock.append(wire.peek_stamp(data)))
        ends.listen(topics.MARKERS, bytes, self.markers.append)
        self.sim = sim_node(
            ros.node("sim"),
            scenario,
            CommunicationGraph(scenario, FlightOptions(lockstep=lockstep, recorded=recorded)),
            self.end,
        )
        ros.spin_until(lambda: not ends.unread() and not ends.unheard())
        ros.spin_until(lambda: not self.sim.waiting_for())

    def end(self):
        self.ended = True

    def settle(self):
        """Let everything sent so far arrive and be answered."""
        self.ros.spin_for(0.2)

    def fly(self, i, message):
        self.odometry[i].append(message)
        if i not in self.hands_off:
            self.push(i, message.stamp_ns)

    def push(self, i, stamp_ns):
        self.send[i](wire.WrenchTemplate("x").encode(stamp_ns, wrench(i)))

    def start(self):
        self.announce(wire.HeaderTemplate("form").encode(0))

    def ticks(self, i):
        return [message.stamp_ns // self.scenario.timing.dt_ns for message in self.odometry[i]]


def wrench(i):
    return np.array([0.0, 0.0, 11.0 + i, 0.01 * i, 0.0, 0.0])


def test_lockstep_flight_is_that_of_the_world(ros, scenario):
    uavs = Uavs(ros, scenario)
    ros.spin_for(0.05)
    assert not uavs.clock  # nothing before the epoch
    uavs.start()
    ros.spin_until(lambda: uavs.ended)
    ros.spin_until(lambda: len(uavs.clock) == TICKS)
    world = World(scenario)
    for tick in range(TICKS):
        for i in world.ids:
            assert uavs.ticks(i)[tick] == tick
            assert uavs.odometry[i][tick].values.tobytes() == world.odometry(i).tobytes()
            if tick % scenario.near_every == 0:
                near = uavs.near[i][tick // scenario.near_every]
                assert near.stamp_ns == tick * scenario.timing.dt_ns
                assert near.values.tobytes() == world.near(i).tobytes()
        world.step({i: wrench(i) for i in world.ids})
    assert len(uavs.odometry[1]) == TICKS


def test_lockstep_waits_for_the_wrench_of_the_tick(ros, scenario):
    uavs = Uavs(ros, scenario)
    uavs.hands_off = {4}
    uavs.start()
    ros.spin_until(lambda: uavs.ticks(4) == [0])
    uavs.push(4, 7 * scenario.timing.dt_ns)  # of another tick
    ros.spin_for(0.1)
    assert uavs.ticks(4) == [0]
    # the others go on to where near objects would need UAV 4, and the time that all have reached is 0
    assert uavs.ticks(1) == list(range(scenario.near_every))
    assert uavs.clock == [0]
    uavs.push(4, 0)
    ros.spin_until(lambda: uavs.clock == [0, scenario.timing.dt_ns])


def test_lockstep_never_runs_farther_ahead_of_a_slow_recorder_than_its_queues_reach(ros):
    """A recorder under overload once lost messages, and their order."""
    scenario = load_scenario("paper_5", {"timing.duration_s": 2.0})
    uavs = Uavs(ros, scenario, recorded=True)
    lead = recorder_lead_ns(scenario) // scenario.timing.dt_ns
    uavs.start()
    ros.spin_until(lambda: uavs.clock and uavs.clock[-1] >= lead * scenario.timing.dt_ns)
    uavs.settle()
    assert uavs.clock[-1] <= (lead + 1) * scenario.timing.dt_ns
    uavs.acknowledge(wire.HeaderTemplate("recorder").encode(60 * scenario.timing.dt_ns))
    ros.spin_until(lambda: uavs.clock[-1] >= (lead + 60) * scenario.timing.dt_ns)
    uavs.settle()
    assert (
        uavs.clock[-1]
        <= (lead + 61) * scenario.timing.dt_ns
        < scenario.timing.ticks * scenario.timing.dt_ns
    )
    uavs.lose(wire.HeaderTemplate("recorder").encode(0))  # nobody waits for one that has ended
    ros.spin_until(lambda: uavs.ended)


def test_lockstep_goes_on_without_a_lost_uav_which_stays_in_place(ros, scenario):
    uavs = Uavs(ros, scenario)
    uavs.hands_off = {4}
    uavs.start()
    ros.spin_until(lambda: uavs.ticks(4) == [0])
    uavs.lose(wire.HeaderTemplate("uav4").encode(0))
    ros.spin_until(lambda: uavs.ended)
    ros.spin_until(lambda: len(uavs.odometry[4]) == TICKS)
    assert np.ptp([m.values[0:3] for m in uavs.odometry[4]], axis=0).max() == 0.0
    assert np.ptp([m.values[2] for m in uavs.odometry[1]]) > 0.0


def test_real_time_runs_by_the_clock_and_hovers_without_wrenches(ros, scenario):
    uavs = Uavs(ros, scenario, lockstep=False)
    uavs.hands_off = set(scenario.uav_ids)

    def keeps_time():
        """Over the last 20 periods; a machine under load may have missed others before."""
        stamps = np.diff([message.stamp_ns for message in uavs.odometry[1][-21:]])
        return len(stamps) == 20 and np.median(stamps) == pytest.approx(
            scenario.timing.dt_ns, rel=0.2
        )

    ros.spin_until(keeps_time)
    assert np.ptp([m.values[0:3] for m in uavs.odometry[1]], axis=0).max() == 0.0
    assert not uavs.ended
    now = uavs.odometry[1][-1].stamp_ns
    uavs.announce(wire.HeaderTemplate("form").encode(now))
    ros.spin_until(lambda: uavs.ended)


def broken_wrench(value):
    values = wrench(4)
    values[2] = value
    return values


@pytest.mark.parametrize("value", [np.nan, 1e308])
def test_a_broken_wrench_is_dropped_and_its_vehicle_waits_for_a_good_one(ros, scenario, value):
    uavs = Uavs(ros, scenario)
    uavs.hands_off = {4}
    uavs.start()
    ros.spin_until(lambda: uavs.ticks(4) == [0])
    uavs.send[4](wire.WrenchTemplate("x").encode(0, broken_wrench(value)))
    ros.spin_for(0.1)
    assert uavs.ticks(4) == [0]
    assert uavs.sim.endpoints.refusals.counts == {"/uav4/setpoint/wrench": 1}
    uavs.hands_off = set()
    uavs.push(4, 0)
    ros.spin_until(lambda: uavs.ended)
    ros.spin_until(lambda: len(uavs.odometry[4]) == TICKS)
    assert all(np.isfinite(m.values).all() for i in scenario.uav_ids for m in uavs.odometry[i])


@pytest.mark.parametrize("lockstep", [True, False])
def test_no_message_ends_the_sim(ros, scenario, lockstep):
    uavs = Uavs(ros, scenario, lockstep=lockstep)
    uavs.announce(wire.HeaderTemplate("dance").encode(0))
    uavs.lose(wire.HeaderTemplate("uav" + 5000 * "9").encode(0))
    uavs.send[1](b"\0\1")
    ros.spin_until(lambda: len(uavs.sim.endpoints.refusals.counts) == 3)
    uavs.announce(wire.HeaderTemplate("form").encode(time.time_ns()))
    ros.spin_until(lambda: uavs.ended)


@pytest.mark.parametrize("lockstep", [False, True])
def test_in_real_time_the_last_word_is_a_status(ros, sent, scenario, lockstep):
    """The readers of states that nobody acknowledges have them once they have it."""
    ends = Uavs(ros, scenario, lockstep=lockstep).sim.endpoints
    sent.clear()
    ends.last_word()
    assert sent == ({} if lockstep else {"/diagnostics": 1})


def test_a_uav_that_comes_back_in_real_time_flies_its_vehicle_again(ros, scenario):
    uavs = Uavs(ros, scenario, lockstep=False)
    ros.spin_until(lambda: "hovering" not in hovering(uavs))
    uavs.hands_off = {4}
    uavs.lose(wire.HeaderTemplate("uav4").encode(0))
    ros.spin_until(lambda: "uav4" in hovering(uavs))
    uavs.hands_off = set()
    ros.spin_until(lambda: "uav4" not in hovering(uavs))


@pytest.mark.slow
def test_functions_of_the_user_are_the_world_in_real_time(ros, tmp_path):
    """The disturbance pushes each vehicle east, where no wrench does; the sensor sees a thing above it."""
    (tmp_path / "mine.py").write_text(OWN_WORLD, "utf-8")
    keys = {f"plugins.{kind}": f"{tmp_path}/mine.py:{kind}" for kind in ("disturbance", "sensor")}
    uavs = Uavs(ros, load_scenario("paper_5", {**keys, "plant.kind": "quadrotor"}), lockstep=False)
    uavs.announce(wire.HeaderTemplate("form").encode(time.time_ns()))
    ros.spin_until(lambda: uavs.odometry[4] and uavs.near[4])
    began_m = uavs.odometry[4][0].values[0]
    ros.spin_until(lambda: uavs.odometry[4][-1].values[0] > began_m + 0.2)
    np.testing.assert_array_equal(uavs.near[4][-1].values[:, 3:], [[0.25, 0.0, 0.0, 0.0, 0.0]])


def hovering(uavs):
    return uavs.sim.vehicles.hovering(time.time_ns())


def test_markers_show_uavs_obstacles_edges_and_path(ros, scenario):
    uavs = Uavs(ros, scenario)
    uavs.start()
    ros.spin_until(lambda: uavs.markers)
    markers = deserialize_message(uavs.markers[0], MarkerArray).markers
    kinds = {}
    for marker in markers:
        kinds.setdefault(marker.ns, []).append(marker)
        assert marker.header.frame_id == "map"
        assert marker.color.a > 0
    assert [marker.id for marker in kinds["uavs"]] == list(scenario.uav_ids)
    assert [marker.scale.x for marker in kinds["obstacles"]] == [3.0, 3.0]
    (tree,) = kinds["tree"]
    assert tree.type == Marker.LINE_LIST
    assert len(tree.points) == 2 * 4
    (path,) = kinds["leader_path"]
    assert path.type == Marker.LINE_STRIP
    assert max(point.x for point in path.points) <= 5.0


def test_a_users_error_is_one_line_and_exit_2(capsys):
    assert sim_main.main(["--scenario", "nowhere.yaml"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("sim: ")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "wanted"), [([], "punctuality"), (["--lockstep"], "throughput")]
)
def test_the_world_of_a_fleet_that_fills_the_cores_is_never_late(monkeypatch, arguments, wanted):
    class AskedError(Exception):
        pass

    def ask(name):
        def asked(*_, **__):
            raise AskedError(name)

        return asked

    for name in ("punctuality", "throughput"):
        monkeypatch.setattr(environment, f"prefer_{name}", ask(name))
    monkeypatch.setattr("ptnsbc_nodes.comm.graph.CommunicationGraph", ask("nothing"))
    with pytest.raises(AskedError, match=wanted):
        sim_main.main(["--scenario", "paper_20", *arguments])


IDS = (1, 2, 3)


class Vehicles(LockstepScheduler):
    """The scheduler with vehicles that do nothing but count."""

    def __init__(self, end: int, meetings: Sequence[int]) -> None:
        self.ticks = dict.fromkeys(IDS, 0)
        super().__init__(self.ticks, end, meetings)

    def step(self, uav: int) -> None:
        self.ticks[uav] += 1
        self.mark_moved(uav)

    def publish_all(self) -> list[int]:
        due = self.due()
        for i in due:
            self.mark_published(i)
        return due


def test_one_vehicle_need_not_wait_for_another():
    vehicles = Vehicles(9, (5,))
    assert vehicles.publish_all() == [1, 2, 3]
    assert vehicles.due() == []
    vehicles.step(2)
    assert vehicles.publish_all() == [2]
    assert vehicles.awaited(2)


def test_all_wait_at_a_meeting():
    vehicles = Vehicles(9, (2, 3))
    for _ in range(2):
        vehicles.publish_all()
        vehicles.step(1)
    assert (vehicles.ticks[1], vehicles.publish_all()) == (2, [])
    for i in (2, 3):
        vehicles.step(i)
        vehicles.publish_all()
        vehicles.step(i)
    assert sorted(vehicles.publish_all()) == [1, 2, 3]


@given(
    st.lists(st.sampled_from(IDS), min_size=30, max_size=200),
    st.lists(st.integers(1, 9), min_size=0, max_size=2),
)
def test_any_order_of_answers(answers: list[int], meetings: list[int]):
    vehicles = Vehicles(1000, meetings)
    ticks = vehicles.ticks
    for uav in answers:
        for i in vehicles.publish_all():
            assert ticks[i] - min(ticks.values()) <= LEAD_TICKS
            if any(ticks[i] % period == 0 for period in meetings):
                assert set(ticks.values()) == {ticks[i]}
        assert any(vehicles.awaited(i) for i in IDS)  # some UAV can always answer
        if vehicles.awaited(uav):
            vehicles.step(uav)
    vehicles.publish_all()
    assert vehicles.awaited(min(IDS, key=ticks.__getitem__))  # the slowest is never kept waiting


def test_the_state_at_the_end_is_not_published():
    vehicles = Vehicles(2, ())
    for _ in range(2):
        for i in vehicles.publish_all():
            vehicles.step(i)
    assert set(vehicles.ticks.values()) == {2}
    assert vehicles.due() == []


STALLED = 12  # control periods of 10 ms


@pytest.fixture
def figure_eight() -> Scenario:
    return load_scenario("figure_eight")


def turning(scenario: Scenario) -> np.ndarray:
    """A wrench (6,) that carries the weight and turns the vehicle."""
    plant = plant_config(scenario, 1)
    return np.array([0.0, 0.0, plant.mass * plant.gravity, 0.4, 0.0, 0.0])


def flown(scenario: Scenario) -> tuple[World, RealTimeWorld]:
    world = World(scenario)
    real_time = RealTimeWorld(scenario, world, lambda _now_ns: None)
    for tick in range(3):
        now_ns = tick * scenario.timing.dt_ns
        real_time.wrenches[1] = Stamped(now_ns, turning(scenario))
        real_time.tick(now_ns)
    return world, real_time


def tilt(world: World) -> float:
    """Angle [rad] of UAV 1 from the vertical."""
    x, y = world.truth(1)[3:5]
    return float(np.arccos(1.0 - 2.0 * (x * x + y * y)))


def held(scenario: Scenario, periods: int) -> World:
    """A world in which the wrench is held for so long."""
    world = World(scenario)
    for _ in range(periods):
        world.step({1: turning(scenario)})
    return world


def test_a_wrench_in_time_or_one_period_late_acts_as_it_is(figure_eight: Scenario) -> None:
    world, real_time = flown(figure_eight)
    for tick in (3, 4):
        real_time.tick(tick * figure_eight.timing.dt_ns)
    np.testing.assert_array_equal(world.truth(1), held(figure_eight, 5).truth(1))


@pytest.mark.parametrize("at_once", [False, True], ids=["the UAV", "the sim as well"])
def test_a_vehicle_keeps_its_attitude_while_a_process_stands_still(
    figure_eight: Scenario, at_once: bool
) -> None:
    """Its last torque turned it by 10 degrees in 0.12 s, and on at 3 rad/s."""
    world, real_time = flown(figure_eight)
    last = 2 + STALLED
    for tick in [last] if at_once else range(3, last + 1):
        real_time.tick(tick * figure_eight.timing.dt_ns)
    assert world.tick == last + 1
    over = held(figure_eight, last + 1)
    assert tilt(over) > 3.0 * tilt(world)
    assert over.truth(1)[10] > 2.0
    assert abs(world.truth(1)[10]) < 0.05
    assert "uav1" not in real_time.hovering(last * figure_eight.timing.dt_ns)
