"""`ptnsbc mission` and `stop`: what they refuse, whom they reach; `stop` without the middleware."""

import os
import pty
import re
from dataclasses import replace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("pymavlink")

import typer

from ptnsbc_core.errors import PtnsbcError
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
from ptnsbc_nodes.fleet import fleet_node
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.environment import free_domain
from ptnsbc_tools.commands import flying_fleet as command


def test_an_empty_domain_says_what_is_expected_there(monkeypatch):
    monkeypatch.setattr(command, "_ANSWER_S", 0.3)
    with free_domain() as number:
        words = re.escape(
            f"domain {number}: no fleet answered: expected one there that flies a scenario with the key "
            "mission; choose another by --domain N or --namespace NAME"
        )
        with pytest.raises(PtnsbcError, match=words):
            command.list_legs(domain=number)
        with pytest.raises(PtnsbcError, match="expected one there that waits for"):
            command.arm(domain=number)


DOMAIN = 7


class NoMiddleware:
    """A fleet of this host alone; its leader obeys, unless a test changes that."""

    refusal = None

    def __init__(self):
        self.vehicles, self.called = {}, []
        self.leader = self.status = self

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
    monkeypatch.setattr(fleet_node, "LauncherNode", lambda *_, **__: one)
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


@pytest.mark.parametrize("more", [{"home": [1, 2]}, {"home": [1], "kill": True}])
def test_ways_home_cross_so_one_vehicle_alone_returns(bridge, folder, more):
    bridge()
    given = {"kill": False, "pilots_too": False, "ready": False, "clear": False, "domain": DOMAIN}
    with pytest.raises(typer.BadParameter, match="expected one UAV and no other order"):
        command.stop(**{**given, **more})
    assert latched(folder) == Order()


def test_who_is_missing_is_named(bridge, middleware, folder, capsys):
    list_fleet(folder, ["bridge1", "bridge2"])
    bridge()
    assert give(kill=True, patience=0.5) == 1
    assert "error: not obeyed: bridge2" in capsys.readouterr().err


def test_a_simulated_fleet_has_no_bridge_but_a_leader(middleware, folder, capsys):
    assert give(kill=True) == 0
    assert "has no motors to stop" in capsys.readouterr().err
    middleware.refusal = "the leader's service is not there"
    with pytest.raises(PtnsbcError, match="no bridge listens"):
        command.stop(domain=DOMAIN, patience=0.5)


@pytest.mark.parametrize("kill", [False, True])
def test_an_order_to_this_host_needs_no_middleware(bridge, folder, monkeypatch, capsys, kill):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    list_fleet(folder, ["bridge1"])
    bridge()
    assert give(kill=kill) == 0
    assert (
        "bridge1: motors stopped" in (said := capsys.readouterr().err) or "bridge1: landing" in said
    )
    assert ("only bridges of this host are reached" in said) is not kill
    bridge("bridge2")
    with open(os.devnull) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        with pytest.raises(PtnsbcError, match="the input has ended"):
            command.stop(kill=kill, ready=True, domain=DOMAIN, patience=1.0)


def test_an_order_to_nobody_says_that_it_holds(folder, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    with pytest.raises(PtnsbcError, match=r"DISCOVERY_RANGE=OFF.*The order holds.*stop --clear"):
        command.stop(domain=DOMAIN, patience=0.5)
    assert latched(folder) == Order("land")


def test_the_order_is_released(folder, capsys):
    latch(folder, Order("kill"))
    command.stop(clear=True, domain=DOMAIN)
    command.stop(clear=True, domain=DOMAIN)
    assert capsys.readouterr().err.splitlines() == ["released: kill", "no order holds in domain 7"]


def test_ready_waits_for_a_key(bridge, middleware, monkeypatch, capsys):
    bridge()
    master, terminal = pty.openpty()
    with os.fdopen(terminal) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        printed = ""

        def press_when_ready(_seconds):
            nonlocal printed
            printed += capsys.readouterr().err
            if "ready:" in printed:
                os.write(master, b"x")

        middleware.spin = press_when_ready
        assert give(kill=True, ready=True) == 0
    os.close(master)
    printed += capsys.readouterr().err
    assert "ready: any key: STOP ALL MOTORS: bridge1 by its socket (Ctrl-C: no order)" in printed
    assert "bridge1: motors stopped after 0." in printed


def test_ready_joins_no_domain_where_all_bridges_are_of_this_host(
    bridge, folder, monkeypatch, capsys
):
    """Without a middleware it says nothing of one."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    list_fleet(folder, ["bridge1"])
    bridge()
    keys, hand = os.pipe()
    os.write(hand, b"x")
    os.close(hand)
    with os.fdopen(keys) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        assert give(kill=True, ready=True) == 0
    assert "bridge1: motors stopped after 0." in (said := capsys.readouterr().err)
    assert "only bridges of this host" not in said


def test_ready_without_a_terminal_gives_no_order(bridge, middleware, folder, monkeypatch):
    bridge()
    with open(os.devnull) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        with pytest.raises(PtnsbcError, match="the input has ended"):
            command.stop(kill=True, ready=True, domain=DOMAIN, patience=1.0)
    assert latched(folder) == Order()


@pytest.mark.parametrize(("flying", "number"), [([], 0), ([3], 3)])
def test_an_order_goes_to_the_only_fleet_of_this_host(folder, monkeypatch, capsys, flying, number):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    monkeypatch.setattr(environment, "flying_domains", lambda: flying)
    command.stop(clear=True)
    assert capsys.readouterr().err.splitlines()[-1] == f"no order holds in domain {number}"


def test_an_order_asks_which_of_several_fleets_is_meant(folder, monkeypatch):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    monkeypatch.setattr(environment, "flying_domains", lambda: [3, 5])
    with pytest.raises(PtnsbcError, match="in the domains 3, 5: expected --domain N"):
        command.stop()
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    command.stop(clear=True)
