"""`ptnsbc inject`: what it refuses, and what reaches a fleet; `ptnsbc mission`: what it says when nobody answers."""

import re

import pytest

pytest.importorskip("rclpy")

from typer.testing import CliRunner

from ptnsbc_io.wire import HeaderTemplate, WireError
from ptnsbc_nodes.comm.announcements import encode_fault, fault_decoder
from ptnsbc_nodes.fleet.fault_injector import announce_fault, hear_faults
from ptnsbc_nodes.fleet.fleet_node import FleetNode
from ptnsbc_nodes.runtime.environment import free_domain
from ptnsbc_sim.scenario.mission.fault_rules import FAULTS, FaultBlock
from ptnsbc_tools.cli import app
from ptnsbc_tools.commands import flying_fleet as command

UAVS = (1, 2, 3)


@pytest.fixture
def domain():
    with free_domain() as number:
        yield number


def run(*words):
    return CliRunner().invoke(app, ["inject", *words])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["ghosts"], "fault ghosts: expected one of silence, loss"),
        (["silence"], "--uav: missing"),
        (["loss", "--uav", "2"], "--share: missing: loss needs it"),
        (["jump", "--uav", "2"], "--offset: missing: jump needs it"),
        (["clock_offset", "--uav", "2"], "--clock: missing: clock_offset needs it"),
        (["kill"], "--uav: kill needs --uav or --process: expected one of them"),
        (["loss", "--uav", "2", "--share", "2"], "--share: 2.0: expected < 1"),
        (["kill", "--process", "sh"], '--process: "sh": expected uavN, bridgeN, sim or recorder'),
        (["freeze", "--uav", "2"], "--duration: missing"),
        (["jump", "--uav", "2", "--offset", "1", "0", "0"], "under faults in the scenario"),
        (["battery", "--uav", "2", "--charge", "0.1"], "expected --control PORT"),
        (["gps_off", "--uav", "2", "--duration", "3", "--control", "9"], "a stand-in takes none"),
    ],
)
def test_what_is_refused(words, said):
    done = run(*words)
    assert done.exit_code == 2
    assert said in done.output


def test_without_a_fleet_that_takes_faults_it_says_so(domain, monkeypatch):
    monkeypatch.setattr(command, "_LISTENERS_S", 0.5)
    with pytest.raises(command.OrderError, match="whose scenario has the key faults"):
        command.inject(command.Fault("silence", uav=2), domain=domain)


def test_a_fault_of_a_stand_in_goes_to_its_port(monkeypatch):
    sent = []
    monkeypatch.setattr(
        "ptnsbc_autopilot.fault_lines.send_fault", lambda *given: sent.append(given)
    )
    assert run("battery", "--uav", "2", "--charge", "0.1", "--control", "9").exit_code == 0
    assert run("gps_off", "--uav", "3", "--control", "9").exit_code == 0
    assert sent == [(9, "2 battery 0.1"), (9, "3 gps off")]


def test_a_fault_reaches_the_fleet(domain):
    heard = []
    with FleetNode(domain) as fleet:
        hear_faults(fleet, UAVS, heard.append)
        with FleetNode(domain, "inject") as operator:
            fault = FaultBlock.model_validate({"kind": "loss", "uav": 2, "at_s": 0, "share": 0.5})
            assert announce_fault(operator, fault, 30.0) == 1
        while not heard:
            fleet.spin(0.05)
    assert heard == [fault]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "null",
        "{",
        '{"kind": "silence"}',
        '{"kind": "silence", "uav": 9}',
        '{"kind": "kill", "process": "x"}',
        '{"kind": "silence", "uav": 1e400}',
        "[" * 5000,
        '{"kind": "jump", "uav": 2, "offset_m": [1, 0, 0]}',
        '{"kind": "silence", "uav": ' + "9" * 5000 + "}",
    ],
)
def test_no_message_is_a_fault_by_accident(text):
    with pytest.raises(WireError):
        fault_decoder(UAVS)(HeaderTemplate(text).encode(0))


def test_a_fault_has_all_its_keys_after_the_wire():
    for keys in (
        {"kind": "loss", "uav": 2, "share": 0.25, "duration_s": 3},
        {"kind": "clock_offset", "uav": 2, "offset_s": -0.5},
        {"kind": "freeze", "process": "recorder", "duration_s": 1},
    ):
        fault = FaultBlock.model_validate({**keys, "at_s": 0})
        assert fault_decoder(UAVS)(encode_fault(5, fault)) == (5, fault)


def test_the_help_names_every_fault() -> None:
    assert set(command.KINDS) == set(FAULTS)


def test_an_empty_domain_says_what_is_expected_there(monkeypatch):
    monkeypatch.setattr(command, "_ANSWER_S", 0.3)
    with free_domain() as number:
        words = re.escape(
            f"domain {number}: no fleet answered: expected one there that flies a scenario with the key "
            "mission; choose another by --domain N or --namespace NAME"
        )
        with pytest.raises(command.OrderError, match=words):
            command.list_legs(domain=number)
        with pytest.raises(command.OrderError, match="expected one there that waits for"):
            command.arm(domain=number)
