"""The judgement of a flight on processes that end, that are stuck, or that it has to kill."""

import os
import signal
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from ptnsbc_nodes.fleet import supervisor as flights
from ptnsbc_nodes.fleet.child_process import ChildProcess, ProcessCommand
from ptnsbc_nodes.fleet.process_list import FleetOptions
from ptnsbc_nodes.fleet.supervisor import Supervisor
from ptnsbc_nodes.runtime.watchdog import SIM_ENDED_S
from ptnsbc_sim.scenario import load_scenario

ROOT = Path(__file__).resolve().parents[3]

_STAYS = """
import signal, sys
from ptnsbc_nodes.runtime.process import report_finished
if sys.argv[1] == "finished":
    report_finished("5 messages")
print("here", flush=True)
signal.pause()
"""


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

    def end(name: str, state: str, **more: bool) -> tuple[list[str], list[str]]:
        said: list[str] = []
        coordinator = SimpleNamespace(end=lambda _seconds: None)
        flight = Supervisor(FleetOptions(load_scenario("paper_5")), coordinator, None, said.append)
        folders = os.pathsep.join([str(ROOT), str(tmp_path)])
        environment = {**os.environ, "PYTHONPATH": folders}
        child = ChildProcess(
            ProcessCommand(name, "stays", (state,), **more), environment, Path(tmp_path)
        )
        flight.children.append(child)
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
@pytest.mark.parametrize("name", ["uav2", "recorder"])
def test_a_process_that_is_killed_at_work_has_died(ended, name):
    died, (line,) = ended(name, "working")
    assert died == [name]
    assert "signal SIGKILL" in line


@pytest.mark.ros
def test_what_runs_beside_the_flight_is_reported_and_changes_nothing(ended):
    died, (line,) = ended("operator", "working", beside=True)
    assert died == []
    assert "signal SIGKILL" in line


class Child:
    def __init__(self, name, *uavs):
        self.name, self.pid, self.exit_code, self.signals = name, 7, None, []
        self.command = ProcessCommand(name, "module", (), uavs)

    def send(self, number):
        self.signals.append(number)


@pytest.mark.ros
@pytest.mark.parametrize("lockstep", [True, False])
def test_a_process_that_is_stuck_is_ended(lockstep):
    """A UAV after 10 s, a recorder after 60 s; in real time none, because no process waits for another."""
    waited = {"uav1": 10.1, "uav2": 9.9, "recorder": 59.0, "sim": 100.0}
    coordinator = SimpleNamespace(stuck=lambda: waited)
    options = FleetOptions(load_scenario("paper_5"), lockstep=lockstep)
    said: list[str] = []
    flight = Supervisor(options, coordinator, None, said.append)
    children = [
        Child("uav1", 1),
        Child("uav2", 2),
        Child("uav3", 3),
        Child("recorder"),
        Child("sim"),
    ]
    flight.children.extend(children)
    flight._end_stuck()
    assert [c.name for c in children if c.signals] == (["uav1"] if lockstep else [])
    waited["recorder"] = 60.1
    flight._end_stuck()
    assert children[3].signals == ([signal.SIGKILL] if lockstep else [])
    assert children[4].signals == []


@pytest.mark.ros
def test_a_sim_without_a_sign_of_life_is_ended():
    """Each line of its log and each status counts; so long as they come it may take as long as it likes."""
    statuses = iter(range(10_000))
    alive = True
    newest: list[int | None] = [None]

    def last_status_s(_name: str) -> int | None:
        if alive:
            newest[0] = next(statuses)
        return newest[0]

    coordinator = SimpleNamespace(last_status_s=last_status_s)
    flight = Supervisor(FleetOptions(load_scenario("paper_5")), coordinator, None, print)
    flight.children.extend([Child("uav1", 1), sim := Child("sim")])
    looks = round(SIM_ENDED_S / flights._LOOK_S)
    for _ in range(2 * looks):
        flight._end_silent_sim()
    alive = False
    for _ in range(looks - 1):
        flight._end_silent_sim()
        assert sim.signals == []
    flight._sim_lines += 1  # a line of its log
    for _ in range(looks):
        flight._end_silent_sim()
        assert sim.signals == []
    flight._end_silent_sim()
    assert sim.signals == [signal.SIGKILL]
    assert flight.children[0].signals == []
