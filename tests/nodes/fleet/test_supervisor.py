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

_STAYS = "import signal, sys; print(sys.argv[1], flush=True); signal.pause()"
SENT = 'sent {"since_ns": -1, "before": {}, "sent": {"/uav2/odom": 5}}'


def kill(children, _patience_s=0.0):
    for child in children:
        if child.exit_code is None:
            child.send(signal.SIGKILL)
            child.wait(10.0)


@pytest.fixture
def ended(tmp_path, monkeypatch):
    """Names of those that died, and what was said, when a process must be killed that has `last` in its log."""
    (tmp_path / "stays.py").write_text(_STAYS)
    monkeypatch.setattr(flights, "end", kill)

    def end(name: str, last: str) -> tuple[list[str], list[str]]:
        said: list[str] = []
        tower = SimpleNamespace(end=lambda _seconds: None)
        flight = Supervisor(FleetOptions(load_scenario("paper_5")), tower, None, said.append)
        environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
        child = ChildProcess(ProcessCommand(name, "stays", (last,)), environment, Path(tmp_path))
        flight.children.append(child)
        while not child.last_line():
            assert child.wait(0.02) is None, child.tail()
        flight.end()
        return [child.name for child in flight.died], said

    return end


@pytest.mark.ros
@pytest.mark.parametrize(("name", "last"), [("uav2", SENT), ("recorder", '{"messages": 5}')])
def test_who_had_finished_but_did_not_go_is_named_and_has_not_died(ended, name, last):
    died, (line,) = ended(name, last)
    assert died == []
    assert line.startswith(f"{name} (pid ")
    assert line.endswith("had finished and did not go: killed")


@pytest.mark.ros
@pytest.mark.parametrize(("name", "last"), [("uav2", "flying"), ("recorder", "ready")])
def test_who_had_more_to_do_has_died(ended, name, last):
    died, (line,) = ended(name, last)
    assert died == [name]
    assert "signal SIGKILL" in line
