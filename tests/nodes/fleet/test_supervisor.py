"""How a flight judges the processes that it has ended."""

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

    def end(name: str, state: str) -> tuple[list[str], list[str]]:
        said: list[str] = []
        coordinator = SimpleNamespace(end=lambda _seconds: None)
        flight = Supervisor(FleetOptions(load_scenario("paper_5")), coordinator, None, said.append)
        folders = os.pathsep.join([str(ROOT), str(tmp_path)])
        environment = {**os.environ, "PYTHONPATH": folders}
        child = ChildProcess(ProcessCommand(name, "stays", (state,)), environment, Path(tmp_path))
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
