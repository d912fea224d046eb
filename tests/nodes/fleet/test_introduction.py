"""Processes that have loaded and that nobody hears are started again."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from ptnsbc_nodes.fleet import introduction
from ptnsbc_nodes.fleet import supervisor as flights
from ptnsbc_nodes.fleet.child_process import ProcessCommand
from ptnsbc_nodes.fleet.process_list import FleetOptions
from ptnsbc_nodes.fleet.supervisor import Supervisor
from ptnsbc_sim.scenario import load_scenario


class Loaded:
    """A process that has loaded."""

    def __init__(self, command):
        self.command, self.name, self.pid, self.exit_code = command, command.name, 7, None
        self.reports = SimpleNamespace(running=True)


class Network:
    """A coordinator that hears some processes; the others wait to be introduced."""

    def __init__(self, heard=(), sees=(), asked=()):
        self.waiting = dict.fromkeys(heard, "")
        self.seen, self.was_asked = sees, asked
        self.done = []

    def sees(self, node):
        return node in self.seen

    def asked(self, name):
        return name in self.was_asked

    def rejoin(self):
        self.done.append("joined again")

    def manage(self, name, _node):
        self.done.append(f"managed {name}")


@pytest.fixture
def renewed(monkeypatch):
    monkeypatch.setattr(introduction, "_UNHEARD_S", 0.0)

    def renewed(network: Network, *names: str, looks: int = 1) -> tuple[list[str], list[str]]:
        """The steps taken about processes that have loaded, and the arguments of those started again."""
        flight = Supervisor(FleetOptions(load_scenario("paper_5")), network, None, lambda _: None)
        started: list[str] = []
        monkeypatch.setattr(flights, "end", lambda ended: network.done.append(ended[0].name))

        def launch(command):
            started.extend(command.arguments)
            return Loaded(command)

        flight._launch = launch
        for name in names:
            command = ProcessCommand(
                name, "none", (), managed=f"/{name}", ends=name.startswith("bridge")
            )
            flight.children.append(Loaded(command))
        for _ in range(looks):
            flight._introduction.look(flight.children)
        return network.done, started

    return renewed


def test_a_process_that_nobody_hears_is_started_again(renewed):
    done, _ = renewed(Network(heard=["uav1"]), "uav1", "uav2")
    assert done == ["uav2", "managed uav2"]


def test_who_is_heard_is_left_alone(renewed):
    done, _ = renewed(Network(heard=["uav1"], sees=["recorder"]), "recorder", "uav1", looks=3)
    assert done == []


def test_a_recorder_that_is_left_out_replaces_its_own_empty_bag(renewed):
    done, arguments = renewed(Network(heard=["uav1"]), "recorder", "uav1")
    assert done[0] == "recorder"
    assert arguments == ["--overwrite"]


def test_a_launcher_that_hears_nobody_joins_again_before_it_ends_a_process(renewed):
    done, _ = renewed(Network(), "uav1", "uav2", looks=2)
    assert done == ["joined again", "uav1", "managed uav1"]


def test_a_bridge_that_was_asked_to_act_may_be_flying(renewed):
    assert renewed(Network(heard=["uav1"], asked=["bridge1"]), "uav1", "bridge1")[0] == []
    done, _ = renewed(Network(heard=["uav1"]), "uav1", "bridge1")
    assert done == ["bridge1", "managed bridge1"]
