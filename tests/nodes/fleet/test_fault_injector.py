"""Faults of processes: on children that do nothing, and on a whole fleet in lock-step."""

import os
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from ptnsbc_core.types import Array
from ptnsbc_io import wire
from ptnsbc_io.bag import Bag, read_bag
from ptnsbc_nodes.fleet.child_process import ChildProcess, ProcessCommand, end
from ptnsbc_nodes.fleet.fault_injector import FaultInjector
from ptnsbc_nodes.fleet.fleet import FleetOptions, run_fleet
from ptnsbc_nodes.runtime import environment
from ptnsbc_sim.disturbances.faults import gone
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.swarm import fly

THREE = Path(__file__).parents[3] / "examples" / "three.yaml"
WAITS = "import signal\nprint('running', flush=True)\nsignal.pause()\n"
WRITES = """
import sys, time
file = open(sys.argv[1], "wb", buffering=0)
try:
    for _ in range(10_000):
        file.write(bytes(4096))
        time.sleep(0.001)
except OSError as error:
    sys.exit(f"full: {error.strerror}")
"""


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


class Bench:
    """One child that does nothing, and an injector that may strike it."""

    def __init__(self, tmp_path: Path, faults, **options):
        self.clock, self.lines, self.restarted = Clock(), [], []
        scenario = load_scenario("paper_5", {"faults": faults})
        self.injector = FaultInjector(
            FleetOptions(scenario, **options), self.lines.append, self.restarted.append, self.clock
        )
        self._folder = tmp_path
        self.children = []

    def start(self, name: str, text: str, *arguments: str) -> ChildProcess:
        (self._folder / f"{name}_program.py").write_text(text)
        root = str(Path(environment.__file__).parents[2])
        settings = {**os.environ, "PYTHONPATH": os.pathsep.join([root, str(self._folder)])}
        command = ProcessCommand(name, f"{name}_program", arguments)
        self.children.append(ChildProcess(command, settings, self._folder))
        return self.children[-1]

    def look_at(self, now_s: float) -> None:
        self.clock.now_s = now_s
        self.injector.look(self.children)


@pytest.fixture
def bench(tmp_path):
    made = []

    def make(*faults, **options) -> Bench:
        made.append(Bench(tmp_path, list(faults), **options))
        return made[-1]

    yield make
    for one in made:
        one.injector.end()
        end(one.children, 0.0)


def state_of(child: ChildProcess) -> str:
    """T: stopped."""
    stat = Path(f"/proc/{child.pid}/stat").read_text()
    return stat.rpartition(") ")[2][0]


def until_stopped(child: ChildProcess) -> None:
    assert os.waitid(os.P_PID, child.pid, os.WSTOPPED | os.WNOWAIT) is not None


def test_a_process_is_frozen_for_its_time_and_goes_on(bench):
    one = bench({"kind": "freeze", "uav": 2, "at_s": 3, "duration_s": 1})
    child, other = one.start("uav2", WAITS), one.start("uav3", WAITS)
    one.look_at(200.0)
    one.injector.begin(200.0)
    one.look_at(202.9)
    assert one.lines == []
    one.look_at(203.0)
    until_stopped(child)
    assert one.lines == [f"fault: freeze of uav2 at 3 s for 1 s (pid {child.pid})"]
    assert state_of(other) != "T"
    one.look_at(203.9)
    assert state_of(child) == "T"
    one.look_at(204.0)
    os.waitid(os.P_PID, child.pid, os.WCONTINUED | os.WNOWAIT)
    assert state_of(child) != "T"


def test_at_the_end_a_frozen_process_goes_on_so_that_it_can_end(bench):
    one = bench({"kind": "freeze", "process": "sim", "at_s": 0, "duration_s": 50})
    child = one.start("sim", WAITS)
    one.injector.begin(100.0)
    one.look_at(100.0)
    until_stopped(child)
    one.injector.end()
    os.waitid(os.P_PID, child.pid, os.WCONTINUED | os.WNOWAIT)
    assert state_of(child) != "T"


@pytest.mark.parametrize("kind", ["kill", "restart"])
def test_a_process_is_killed_and_started_again_where_that_is_asked_for(bench, kind):
    one = bench({"kind": kind, "uav": 2, "at_s": 0})
    child = one.start("uav2", WAITS)
    one.injector.begin(100.0)
    one.look_at(100.0)
    assert child.wait(30.0) == -9
    assert one.restarted == ([child] if kind == "restart" else [])


def test_a_full_disk_is_an_error_of_the_process_that_writes(bench, tmp_path):
    part = tmp_path / "bag.part"
    part.mkdir()
    one = bench({"kind": "disk_full", "at_s": 0}, bag=tmp_path / "bag")
    child = one.start("recorder", WRITES, str(part / "bag_0.mcap"))
    while not (part / "bag_0.mcap").exists():
        assert child.exit_code is None, child.tail()
    one.injector.begin(100.0)
    one.look_at(100.0)
    assert child.wait(60.0) == 1
    assert "full: File too large" in child.tail()


def test_in_lockstep_the_scenarios_faults_are_not_the_launchers(bench):
    one = bench({"kind": "kill", "uav": 2, "at_s": 0}, lockstep=True)
    child = one.start("uav2", WAITS)
    one.injector.begin(100.0)
    one.look_at(200.0)
    assert child.exit_code is None
    assert one.lines == []


def test_faults_of_messages_are_not_the_launchers(bench):
    one = bench({"kind": "silence", "uav": 2, "at_s": 0})
    one.start("uav2", WAITS)
    one.injector.begin(100.0)
    one.look_at(100.0)
    assert one.lines == []


def assert_recorded(bag: Bag, uav: int, topic: str, expected: Array) -> None:
    """A bag holds the messages of a UAV on a topic, to the bit."""
    decode = wire.decode_wrench if topic == "setpoint/wrench" else wire.decode_odometry
    found = [decode(one.data).values for one in bag.messages([f"/uav{uav}/{topic}"])]
    assert len(found) == len(expected), topic
    assert np.stack(found).tobytes() == np.ascontiguousarray(expected).tobytes(), topic


@pytest.mark.ros
@pytest.mark.slow
def test_a_fleet_in_lockstep_flies_its_faults_as_the_headless_flight_does(tmp_path):
    """Messages that are lost, late or no numbers, a position that jumps, a process that is killed: the same bits."""
    faults = [
        {"kind": "silence", "uav": 2, "at_s": 0.2, "duration_s": 0.7},
        {"kind": "loss", "uav": 3, "at_s": 0.1, "share": 0.5},
        {"kind": "delay", "uav": 1, "at_s": 0.2, "delay_s": 0.1, "duration_s": 0.5},
        {"kind": "nan", "uav": 2, "at_s": 1, "duration_s": 0.2},
        {"kind": "jump", "uav": 3, "at_s": 0.5, "duration_s": 0.5, "offset_m": [0.3, 0, 0]},
        {"kind": "kill", "uav": 3, "at_s": 1},
    ]
    scenario = load_scenario(THREE, {"faults": faults, "timing.duration_s": 1.5})
    done = run_fleet(FleetOptions(scenario, lockstep=True, bag=tmp_path / "bag"))
    assert (done.exit_code, done.died, done.killed) == (0, (), ("uav3",))
    track, bag = fly(scenario).track, read_bag(tmp_path / "bag")
    for row, uav in enumerate(scenario.uav_ids):
        ends = 100 if uav == 3 else scenario.timing.ticks
        assert_recorded(bag, uav, "odom", track.odometry[:, row])
        assert_recorded(bag, uav, "truth", track.truth[:, row])
        assert_recorded(bag, uav, "setpoint/wrench", track.wrench[:ends, row])


COMING_AND_GOING = {
    "communication.stale_s": 0.2,
    "timing.duration_s": 3.0,
    "faults": [
        {"kind": "restart", "uav": 5, "at_s": 0.8, "duration_s": 0.5},
        {"kind": "kill", "uav": 1, "at_s": 2.0},
    ],
}


@pytest.mark.ros
@pytest.mark.slow
def test_a_fleet_in_lockstep_comes_and_goes_as_the_headless_flight_does(tmp_path):
    """A joiner, a leaver, a restart and the loss of the leader, after which UAV 2 leads: the same bits."""
    uavs = [uav.model_dump(mode="json", exclude_unset=True) for uav in load_scenario("relay").uavs]
    uavs[5]["leaves_s"], uavs[6]["joins_s"] = 1.7, 0.6
    scenario = load_scenario("relay", {**COMING_AND_GOING, "uavs": uavs})
    done = run_fleet(FleetOptions(scenario, lockstep=True, bag=tmp_path / "bag"))
    assert (done.exit_code, done.died, done.killed) == (0, (), ("uav1",))
    track, bag, silent = fly(scenario).track, read_bag(tmp_path / "bag"), gone(scenario)
    for row, uav in enumerate(scenario.uav_ids):
        sent = ~silent[:, row]
        assert_recorded(bag, uav, "truth", track.truth[:, row])
        assert_recorded(bag, uav, "setpoint/wrench", track.wrench[sent, row])
        assert_recorded(bag, uav, "leader_estimate", track.estimate[sent, row])
