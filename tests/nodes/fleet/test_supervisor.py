"""The judgement of a flight on processes that end, that are stuck, or that it has to kill."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from ptnsbc_nodes.emergency import (
    Order,
    VehicleRecord,
    latch,
    record_path,
    runtime_folder,
    summary,
    write_record,
)
from ptnsbc_nodes.fleet import child_process, emergency_stop
from ptnsbc_nodes.fleet import supervisor as flights
from ptnsbc_nodes.fleet.child_process import ChildProcess, Crew, FleetOptions, ProcessCommand
from ptnsbc_nodes.fleet.fault_injector import FaultInjector
from ptnsbc_nodes.fleet.fleet_node import LauncherNode
from ptnsbc_nodes.fleet.supervisor import Supervisor
from ptnsbc_nodes.fleet.takeoff import Launch
from ptnsbc_nodes.runtime.watchdog import ENDED_S, SIM_ENDED_S
from ptnsbc_sim.scenario import load_scenario

ROOT = Path(__file__).resolve().parents[3]

_STAYS = """
import signal, sys
from ptnsbc_nodes.runtime.node_process import report_finished
if sys.argv[1] == "finished":
    report_finished("5 messages")
print("here", flush=True)
signal.pause()
"""


def supervisor_of(options, node, children=(), stop=None, progress=print):
    """A supervisor of these processes; `node` is all parts of the launcher's node."""
    node.status = node.leader = node.news = node
    node.folder = getattr(node, "folder", Path("no folder"))
    crew = Crew({}, Path())
    crew.children.extend(children)
    faults = FaultInjector(options, progress, crew.start_again)
    return Supervisor(Launch(options, crew, node, stop, progress), faults)


def kill(children, _patience_s=0.0):
    for child in children:
        if child.exit_code is None:
            child.send(signal.SIGKILL)
            child.wait(10.0)


@pytest.fixture
def ended(tmp_path, monkeypatch):
    """Names of the processes that died, and what was said, when a process must be killed."""
    (tmp_path / "stays.py").write_text(_STAYS)
    monkeypatch.setattr(flights, "end", kill)

    def end(name: str, state: str) -> tuple[list[str], list[str]]:
        said: list[str] = []
        node = SimpleNamespace(end=lambda _seconds: None, leave=lambda: None)
        folders = os.pathsep.join([str(ROOT), str(tmp_path)])
        environment = {**os.environ, "PYTHONPATH": folders}
        child = ChildProcess(ProcessCommand(name, "stays", (state,)), environment, Path(tmp_path))
        options = FleetOptions(load_scenario("paper_5"))
        flight = supervisor_of(options, node, [child], progress=said.append)
        while not child.log_lines():
            assert child.wait(0.02) is None, child.tail()
        flight.end()
        return [child.name for child in flight.died], said

    return end


@pytest.mark.ros
@pytest.mark.parametrize("name", ["uav2", "recorder"])
def test_a_process_that_has_finished_but_does_not_exit_is_killed_and_has_not_died(ended, name):
    died, (line,) = ended(name, "finished")
    assert died == []
    assert line.startswith(f"{name} (pid ")
    assert line.endswith("had finished its work but did not exit: killed")


@pytest.mark.ros
def test_the_launcher_has_left_the_network_before_its_processes_leave_it(monkeypatch):
    """Fast DDS hung a launcher for good that heard them leave (its issue 6502)."""
    done: list[object] = []
    node = SimpleNamespace(
        end=lambda _seconds: done.append("tells"), leave=lambda: done.append("leaves")
    )
    monkeypatch.setattr(flights, "end", lambda children, *_: done.append(list(children)))
    uav, recorder = Child("uav1", 1), Child("recorder")
    flight = supervisor_of(FleetOptions(load_scenario("paper_5")), node, [uav, recorder])
    uav.exit_code = recorder.exit_code = 0
    flight.end()
    assert done == ["tells", "leaves", [uav], [uav, recorder]]


@pytest.mark.ros
@pytest.mark.parametrize("name", ["uav2", "recorder"])
def test_a_process_that_is_killed_at_work_has_died(ended, name):
    died, (line,) = ended(name, "working")
    assert died == [name]
    assert "signal SIGKILL" in line


class Child:
    def __init__(self, name, *uavs):
        self.name, self.pid, self.exit_code, self.signals = name, 7, None, []
        self.log_size, self.log, self.fault = 0, Path("logs", f"{name}.log"), ""
        self.reports = SimpleNamespace(running=False)
        self.command = ProcessCommand(name, "module", (), uavs)

    def send(self, number):
        self.signals.append(number)


@pytest.mark.ros
@pytest.mark.parametrize("lockstep", [True, False])
def test_a_process_that_is_stuck_is_ended(lockstep):
    """A UAV after 10 s, a recorder after 60 s; in real time none, because no process waits for another."""
    waited = {"uav1": 10.1, "uav2": 9.9, "recorder": 59.0, "sim": 100.0}
    node = SimpleNamespace(stuck=lambda: waited)
    options = FleetOptions(load_scenario("paper_5"), lockstep=lockstep)
    children = [
        Child("uav1", 1),
        Child("uav2", 2),
        Child("uav3", 3),
        Child("recorder"),
        Child("sim"),
    ]
    flight = supervisor_of(options, node, children)
    flight._end_stuck()
    assert [c.name for c in children if c.signals] == (["uav1"] if lockstep else [])
    waited["recorder"] = 60.1
    flight._end_stuck()
    assert children[3].signals == ([signal.SIGKILL] if lockstep else [])
    assert children[4].signals == []


@pytest.mark.ros
def test_a_sim_without_a_sign_of_life_is_ended():
    """Each line of its log and each status counts; so long as they come it may take as long as it likes."""
    node, uav, sim = SimpleNamespace(last_s={}), Child("uav1", 1), Child("sim")
    flight = supervisor_of(FleetOptions(load_scenario("paper_5")), node, [uav, sim])
    looks = round(SIM_ENDED_S / flights._LOOK_S)
    for look in range(2 * looks):
        node.last_s["sim"] = look
        flight._end_silent_sim()
    for _ in range(looks - 1):
        flight._end_silent_sim()
        assert sim.signals == []
    sim.log_size += 1
    for _ in range(looks):
        flight._end_silent_sim()
        assert sim.signals == []
    flight._end_silent_sim()
    assert sim.signals == [signal.SIGKILL]
    assert uav.signals == []


class Bridge(Child):
    """The process of a bridge that does not end, unless a test ends it."""

    def __init__(self, name, module=child_process.BRIDGE):
        super().__init__(name)
        ends = module == child_process.BRIDGE
        self.command = ProcessCommand(name, module, (), (int(name[-1]),), ends=ends)

    def new_lines(self):
        return []

    def exit_summary(self):
        return f"{self.name} has ended with {self.exit_code}"


class Fleet:
    """The launcher of a MAVLink fleet without processes, on a clock that moves with its looks."""

    def __init__(self, monkeypatch, folder, *bridges, stopped=False, only=(), leads=True):
        self.now_s, self.said, self.calls, self.looks = 0.0, [], [], []
        self.folder, self.answer, self.over, self.gone, self.lost = folder, None, False, set(), []
        self.stop = SimpleNamespace(came=stopped, count=int(stopped))
        self.bridges = [Bridge(name) for name in bridges]
        self.uavs = [Bridge(f"uav{name[-1]}", child_process.UAV) for name in bridges]
        only = frozenset({*only, "recorder"} if leads and only else only)
        options = FleetOptions(
            load_scenario("experiment_4"), backend="mavlink", allow_arming=True, only=only
        )
        monkeypatch.setattr(flights.time, "monotonic", lambda: self.now_s)
        self.supervisor = supervisor_of(
            options, self, [*self.bridges, *self.uavs], self.stop, self.said.append
        )

    def call(self, leg, _patience_s):
        self.calls.append(leg)
        return self.answer

    def lose(self, name):
        self.lost.append(name)

    def spin(self, seconds):
        self.now_s += seconds
        for look in self.looks:
            look()

    def record(self, name, **changes):
        values = {"heard": True, "armed": True, "mode": "OFFBOARD", "place": "(1.0, 2.0, 3.0) m"}
        record = VehicleRecord(name, os.getpid(), 1, "px4", "", **values)
        write_record(self.folder, replace(record, **changes))

    def end_at(self, seconds, bridge, code=0):
        def look():
            if self.now_s >= seconds:
                bridge.exit_code = code

        self.looks.append(look)


WORD = "its vehicle was armed at (1.0, 2.0, 3.0) m in OFFBOARD"


@pytest.mark.ros
@pytest.mark.parametrize(("stopped", "leg"), [(False, "land"), (True, "stop")])
def test_at_the_end_it_waits_until_all_have_landed(monkeypatch, tmp_path, stopped, leg):
    fleet = Fleet(monkeypatch, tmp_path, "bridge1", "bridge2", stopped=stopped)
    for seconds, bridge in zip((5.0, 30.0), fleet.bridges, strict=True):
        fleet.end_at(seconds, bridge)
    fleet.supervisor._land()
    assert fleet.calls == [leg]
    assert 30.0 <= fleet.now_s < 31.0
    assert fleet.said == []


@pytest.mark.ros
def test_a_bridge_that_takes_over_in_the_landing_is_waited_for(monkeypatch, tmp_path, dead):
    fleet = Fleet(monkeypatch, tmp_path, "bridge1")
    another, children = Bridge("bridge1"), fleet.supervisor._crew.children

    def start_again(child):
        children[children.index(child)] = another

    fleet.supervisor._crew.start_again = start_again
    fleet.record("bridge1", pid=dead, frame="1.0 2.0 3.0")
    fleet.end_at(5.0, fleet.bridges[0], -9)
    fleet.end_at(30.0, another)
    fleet.supervisor._land()
    assert 30.0 <= fleet.now_s < 31.0


@pytest.mark.ros
def test_bridges_are_waited_for_240_s_at_most(monkeypatch, tmp_path):
    fleet = Fleet(monkeypatch, tmp_path, "bridge1", "bridge2", "bridge3")
    fleet.end_at(20.0, fleet.bridges[0])
    for bridge in fleet.bridges:
        fleet.record(bridge.name)
    fleet.supervisor._land()
    assert 240.0 <= fleet.now_s < 241.0
    assert fleet.said == ["not waited for any longer: bridge2, bridge3"]


@pytest.mark.ros
def test_a_bridge_that_stands_still_is_ended_after_10_s(monkeypatch, tmp_path):
    """Its vehicle hovered for 240 s. A bridge that loads, or waits for its port, has not written a record yet."""
    fleet = Fleet(monkeypatch, tmp_path, "bridge1", "bridge2", "bridge3")
    still, lands, loads = fleet.bridges
    lands.pid, loads.pid, ended_s = 8, 9, []
    for bridge in fleet.bridges:
        fleet.record(bridge.name)
        bridge.reports.running = bridge is not loads

    def look():
        os.utime(record_path(tmp_path, "bridge2"), (fleet.now_s, fleet.now_s))
        if still.signals and still.exit_code is None:
            still.exit_code = -9
            ended_s.append(fleet.now_s)

    fleet.looks.append(look)
    fleet.end_at(30.0, lands)
    fleet.end_at(30.0, loads)
    fleet.supervisor._land()
    assert (still.signals, lands.signals, loads.signals) == ([signal.SIGKILL], [], [])
    assert ended_s == [pytest.approx(ENDED_S, abs=0.2)]
    assert fleet.said[0] == "bridge1 (pid 7) gives no sign of life: it is ended"


@pytest.mark.ros
def test_vehicles_of_pilots_are_waited_for_10_s(monkeypatch, tmp_path):
    """Counted from when pilots fly all that is left; a landing bridge is waited for longer."""
    fleet = Fleet(monkeypatch, tmp_path, "bridge1", "bridge2")
    fleet.end_at(60.0, fleet.bridges[0])
    fleet.record("bridge1")
    fleet.record("bridge2", in_pilots_hands=True)
    fleet.supervisor._land()
    assert 70.0 <= fleet.now_s < 71.0
    assert fleet.said[0] == "not waited for any longer: bridge2"


@pytest.mark.ros
def test_a_second_signal_ends_the_wait_and_the_armed_are_named(monkeypatch, tmp_path):
    fleet = Fleet(monkeypatch, tmp_path, "bridge1", "bridge2", stopped=True)
    fleet.record("bridge1", fate="without setpoints it hovers")
    fleet.record("bridge2", armed=False, landed=True)
    fleet.looks.append(lambda: setattr(fleet.stop, "count", 2 if fleet.now_s > 3.0 else 1))
    fleet.end, fleet.leave, told = lambda _seconds: None, lambda: None, []
    monkeypatch.setattr(flights, "end", lambda *_: None)
    monkeypatch.setattr(
        emergency_stop, "land_left_behind", lambda *of: told.append((of[1], of[2]()))
    )
    for bridge in fleet.bridges:
        bridge.exit_code = None
    fleet.supervisor.end()
    assert fleet.now_s < 4.0
    assert told == [({"bridge1", "bridge2"}, True)]
    assert fleet.said[-1] == (
        "after the flight: bridge1 armed at (1.0, 2.0, 3.0) m in OFFBOARD: without setpoints it hovers; "
        "bridge2 disarmed, on the ground at (1.0, 2.0, 3.0) m in OFFBOARD: "
        "keep away from bridge1: a pilot lands it, or ptnsbc stop"
    )


@pytest.mark.ros
def test_without_a_leader_every_bridge_is_told_by_itself(monkeypatch, tmp_path):
    fleet = Fleet(monkeypatch, tmp_path, "bridge1")
    fleet.answer = "the leader does not answer /formation/land"
    told = []
    monkeypatch.setattr(
        emergency_stop, "order_landing", lambda *of: told.append(of) or ["bridge1: silent"]
    )
    fleet.end_at(1.0, fleet.bridges[0])
    fleet.supervisor._land()
    assert [folder for folder, _ in told] == [tmp_path]
    assert fleet.said == [
        f"every bridge is told to land by itself: {fleet.answer}",
        "bridge1: silent",
    ]


@pytest.mark.ros
def test_a_start_that_is_refused_before_the_uavs_exist_waits_for_no_leader(monkeypatch, tmp_path):
    """It waited for 3 s until the service /formation/land of nobody was there."""
    fleet, told = Fleet(monkeypatch, tmp_path, "bridge1"), []
    monkeypatch.setattr(emergency_stop, "order_landing", lambda *of: told.append(of) or [])
    fleet.supervisor._crew.children.remove(fleet.uavs[0])
    fleet.end_at(0.2, fleet.bridges[0])
    fleet.supervisor._land()
    assert (fleet.calls, len(told), fleet.said) == ([], 1, [])


@pytest.mark.ros
def test_a_leader_that_answers_is_enough(monkeypatch, tmp_path):
    fleet = Fleet(monkeypatch, tmp_path, "bridge1")
    monkeypatch.setattr(emergency_stop, "order_landing", pytest.fail)
    fleet.end_at(1.0, fleet.bridges[0])
    fleet.supervisor._land()
    assert fleet.said == []


@pytest.mark.ros
def test_nothing_is_called_down_when_all_have_ended(monkeypatch, tmp_path):
    fleet = Fleet(monkeypatch, tmp_path, "bridge1")
    fleet.bridges[0].exit_code = 0
    fleet.supervisor._land()
    assert (fleet.calls, fleet.now_s) == ([], 0.0)


@pytest.mark.ros
def test_a_launcher_that_follows_lands_only_its_own_vehicles(monkeypatch, tmp_path):
    fleet = Fleet(monkeypatch, tmp_path, "bridge1", only=["bridge1"], leads=False)
    fleet.end_at(1.0, fleet.bridges[0])
    fleet.supervisor._land()
    assert fleet.bridges[0].signals == [signal.SIGINT]
    assert fleet.calls == []
    over = Fleet(monkeypatch, tmp_path, "bridge1", only=["bridge1"], leads=False)
    over.over = True  # the leader's launcher has called all of them down
    over.end_at(1.0, over.bridges[0])
    over.supervisor._land()
    assert over.bridges[0].signals == []


@pytest.mark.ros
def test_a_launcher_that_follows_ends_with_the_sim_on_another_computer():
    """Seen with a fifth of the packets lost: it knew that the sim had ended, and no word of the flight's end came."""
    following = SimpleNamespace(led=True, over=False, gone=set(), looks=0, lose=lambda name: None)

    def spin(_seconds):
        following.looks += 1
        if following.looks == 3:
            following.gone.add("sim")

    following.spin = spin
    said = []
    options = FleetOptions(load_scenario("paper_5"), only=frozenset({"uav4"}))
    stop = SimpleNamespace(came=False)
    follower = supervisor_of(options, following, [Child("uav4")], stop, said.append)
    follower.watch(10.0)
    assert following.looks == 3
    assert said == ["sim has ended, on another computer"]


@pytest.mark.ros
def test_a_leader_waits_for_the_bridges_of_other_computers(monkeypatch, tmp_path):
    fleet = Fleet(monkeypatch, tmp_path, "bridge1", only=["bridge1", "uav1"])
    fleet.end_at(1.0, fleet.bridges[0])
    elsewhere = {f"bridge{i}" for i in (2, 3, 4)}
    fleet.looks.append(lambda: fleet.gone.update(elsewhere if fleet.now_s > 50.0 else ()))
    fleet.supervisor._land()
    assert 50.0 <= fleet.now_s < 51.0


@pytest.mark.ros
def test_a_bridge_that_dies_in_flight_leaves_its_last_word(monkeypatch, tmp_path):
    fleet = Fleet(monkeypatch, tmp_path, "bridge1", "bridge2")
    fleet.record("bridge1", fate="without setpoints it hovers")
    fleet.record("bridge2", armed=False)
    for bridge in fleet.bridges:
        bridge.exit_code = -9
    fleet.supervisor._report_exits()
    fleet.supervisor._report_exits()
    assert [line for line in fleet.said if WORD in line] == [
        f"bridge1: {WORD}: without setpoints it hovers; ptnsbc stop reaches it past its bridge"
    ]
    assert fleet.lost == ["uav1", "uav2"]


@pytest.fixture
def dead():
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


@pytest.mark.ros
def test_a_bridge_that_dies_in_flight_is_replaced_three_times_at_most(monkeypatch, tmp_path, dead):
    fleet, started = Fleet(monkeypatch, tmp_path, "bridge1", "bridge2"), []

    def start_again(child):
        started.append(Bridge(child.name))
        fleet.supervisor._crew.children[0] = started[-1]

    fleet.supervisor._crew.start_again = start_again
    fleet.record("bridge1", pid=dead, frame="1.0 2.0 3.0")
    for _ in range(4):
        fleet.supervisor._crew.children[0].exit_code = -9
        fleet.supervisor._report_exits()
        fleet.supervisor._report_exits()
    assert len(started) == 3
    assert [child.name for child in fleet.supervisor.died] == ["bridge1"] * 4
    assert fleet.said.count(f"bridge1: {WORD}; another bridge takes it over") == 3
    assert fleet.lost == ["uav1"]  # only in the end


@pytest.mark.ros
@pytest.mark.parametrize(
    "changes",
    [
        {"armed": False},
        {"in_pilots_hands": True},
        {"step": "failed"},  # it has given its vehicle up
        {"frame": ""},  # it has not armed it
        {"order": "latched"},  # the operator's order reaches the vehicle past the bridge
    ],
)
def test_a_bridge_that_has_left_nothing_in_flight_is_not_replaced(
    monkeypatch, tmp_path, dead, changes
):
    fleet = Fleet(monkeypatch, tmp_path, "bridge1")
    fleet.supervisor._crew.start_again = pytest.fail
    fleet.record("bridge1", **{"pid": dead, "frame": "1.0 2.0 3.0", **changes})
    if "order" in changes:
        latch(tmp_path, Order("land"))
    fleet.bridges[0].exit_code = -9
    fleet.supervisor._report_exits()
    assert fleet.lost == ["uav1"]


@pytest.mark.ros
def test_faults_of_one_cause_are_one_line_at_the_end(monkeypatch, tmp_path):
    """Seen on a busy host: twelve lines of the log of each bridge, all of one cause."""
    fleet = Fleet(monkeypatch, tmp_path, "bridge1", "bridge2", "bridge3", "bridge4")
    monkeypatch.setattr(flights, "end", lambda *_: None)
    fleet.end, fleet.leave = (lambda _seconds: None), (lambda: None)
    stood = "no setpoints: this bridge stood still for {} s: give its computer less work"
    faults = [stood.format(0.5), stood.format(0.7), "the battery is low", ""]
    for bridge, bridge.fault in zip(fleet.bridges, faults, strict=True):
        bridge.exit_code = 1
    fleet.supervisor._report_exits()
    assert fleet.said == ["bridge4 has ended with 1"]
    for uav in fleet.uavs:
        uav.exit_code = 0
    fleet.supervisor.end()
    assert fleet.said[1:] == [
        f"not as planned: bridge1, bridge2 (2): {faults[0]}; logs in logs",
        "not as planned: bridge3 (1): the battery is low; logs in logs",
    ]
    assert [child.name for child in fleet.supervisor.died] == [f"bridge{n}" for n in (1, 2, 3, 4)]


@pytest.mark.ros
def test_the_records_of_a_fleet_are_those_of_its_namespace(domain, monkeypatch, tmp_path):
    """`bridge1` of another fleet in the domain is another vehicle."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    for fleet, place in (("", "(9.0, 9.0, 9.0) m"), ("/blue", "(1.0, 2.0, 3.0) m")):
        record = VehicleRecord(
            "bridge1", os.getpid(), 1, "px4", "", heard=True, armed=True, mode="OFFBOARD"
        )
        write_record(runtime_folder(domain, fleet), replace(record, place=place))
    with LauncherNode(domain, "fleet", "/blue") as node:
        word = summary(node.folder, ["bridge1"])
    assert word.startswith("after the flight: bridge1 armed at (1.0, 2.0, 3.0) m in OFFBOARD: keep")
