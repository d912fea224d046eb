"""`ptnsbc stop`: what it says and how it exits, without the middleware."""

import os
import pty
from dataclasses import replace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("pymavlink")

import typer

from ptnsbc_nodes.emergency import (
    Order,
    OrderPort,
    VehicleRecord,
    latch,
    latched,
    list_fleet,
    runtime_folder,
    write_record,
)
from ptnsbc_nodes.runtime import environment
from ptnsbc_tools.commands import stop as command

DOMAIN = 7


class NoMiddleware:
    """A fleet of this host alone; its leader obeys, unless a test changes that."""

    refusal = None

    def __init__(self):
        self.vehicles, self.called = {}, []
        self.leader = self

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def call(self, name, _patience_s):
        self.called.append(name)
        return self.refusal

    def send(self, order):
        pass

    def spin(self, _seconds):
        pass


@pytest.fixture
def middleware(monkeypatch):
    one = NoMiddleware()
    monkeypatch.setattr(command, "_middleware", lambda _domain, _fleet: one)
    monkeypatch.setattr(command, "_DISCOVERY_S", 0.1)
    return one


@pytest.fixture(autouse=True)
def hurries(monkeypatch):
    calls = []
    monkeypatch.setattr(environment, "prefer_punctuality", lambda: calls.append(True))
    return calls


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return runtime_folder(DOMAIN)


@pytest.fixture
def bridge(folder):
    ports = []

    def make(name="bridge1", **changes):
        base = VehicleRecord(name, os.getpid(), 1, "px4", "", heard=True, armed=True, mode="X")
        state = [replace(base, **changes)]
        write_record(folder, state[0])

        def take(order):
            fault = "motors stopped by the operator" if order.what == "kill" else ""
            armed = order.what != "kill"
            state[0] = replace(state[0], order=order.text, armed=armed, fault=fault)

        ports.append(OrderPort(folder, name, take, lambda: state[0].encode()))

    yield make
    for port in ports:
        port.close()


def give(**options):
    given = {
        "kill": False, "pilots_too": False, "ready": False, "clear": False, "patience": 30.0,
        "domain": DOMAIN, **options,
    }  # fmt: skip
    with pytest.raises(typer.Exit) as ended:
        command.stop(**given)
    return ended.value.exit_code


def test_all_obey(bridge, middleware, folder, hurries, capsys):
    list_fleet(folder, ["bridge1"])
    bridge()
    assert give(kill=True) == 0
    assert "bridge1: motors stopped after 0." in capsys.readouterr().err
    assert middleware.called == []
    assert latched(folder) == Order("kill")
    assert hurries == [True]  # it does not wait behind the processes that fly


def test_a_landing_is_told_to_the_leader_as_well(bridge, middleware, folder, capsys):
    list_fleet(folder, ["bridge1"])
    bridge()
    assert give() == 0
    assert "bridge1: landing, armed in X" in capsys.readouterr().err
    assert middleware.called == ["stop"]


def test_who_is_missing_is_named(bridge, middleware, folder, capsys):
    list_fleet(folder, ["bridge1", "bridge2"])
    bridge()
    assert give(kill=True, patience=0.5) == 1
    assert "error: not obeyed: bridge2" in capsys.readouterr().err


def test_a_simulated_fleet_has_no_bridge_but_a_leader(middleware, folder, capsys):
    assert give(kill=True) == 0
    assert "has no motors to stop" in capsys.readouterr().err
    middleware.refusal = "the leader's service is not there"
    with pytest.raises(command.StopError, match="no bridge listens"):
        command.stop(domain=DOMAIN, patience=0.5)


def test_the_order_is_released(folder, capsys):
    latch(folder, Order("kill"))
    command.stop(clear=True, domain=DOMAIN)
    command.stop(clear=True, domain=DOMAIN)
    assert capsys.readouterr().err.splitlines() == ["released: kill", "no order holds"]


def test_ready_waits_for_a_key(bridge, middleware, monkeypatch, capsys):
    bridge()
    master, terminal = pty.openpty()
    with os.fdopen(terminal) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        middleware.spin = lambda _seconds: os.write(master, b"x")
        assert give(kill=True, ready=True) == 0
    os.close(master)
    printed = capsys.readouterr().err
    assert "bridge1: motors stopped after 0." in printed


def test_ready_without_a_terminal_gives_no_order(bridge, middleware, folder, monkeypatch):
    bridge()
    with open(os.devnull) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        with pytest.raises(command.StopError, match="the input has ended"):
            command.stop(kill=True, ready=True, domain=DOMAIN, patience=1.0)
    assert latched(folder) == Order()
