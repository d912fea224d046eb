"""Orders: how they add up, and the latch in the folder of a domain."""

import json
import os
import select
import stat
import subprocess
import sys
from dataclasses import asdict, replace

import pytest

from ptnsbc_nodes.emergency import (
    Order,
    OrderClient,
    OrderPort,
    RuntimeFolderError,
    VehicleRecord,
    decode_record,
    fleet_bridges,
    forget_dead,
    in_pilots_hands,
    latch,
    latched,
    list_fleet,
    parse_order,
    record_path,
    records,
    release,
    runtime_folder,
    socket_path,
    summary,
    write_record,
)

LAND, KILL = Order("land"), Order("kill")


@pytest.mark.parametrize("text", ["land", "kill", "land all", "kill all", "apart", "return"])
def test_an_order_reads_what_it_writes(text):
    assert parse_order(text).text == text


@pytest.mark.parametrize(
    "text", ["", "all", "kill  all", "Kill", "return all", "start", "x" * 5000]
)
def test_anything_else_is_no_order(text):
    assert parse_order(text) is None


def test_a_kill_is_never_taken_down_to_a_landing():
    assert Order().then(LAND) == LAND
    assert LAND.then(KILL) == KILL
    assert KILL.then(LAND) == KILL
    assert KILL.then(Order("land", pilots_too=True)) == KILL
    assert KILL.then(Order()) == KILL


def test_whoever_returns_still_lands_with_the_others_and_gives_way():
    home = Order("return")
    assert [home.then(Order(what)).what for what in ("apart", "land", "kill")] == [
        "apart", "land", "kill"
    ]  # fmt: skip
    assert LAND.then(home) == LAND


def test_a_landing_of_a_pilots_vehicle_is_no_order_to_kill_it():
    assert Order("land", pilots_too=True).then(KILL) == KILL
    assert LAND.then(Order("land", pilots_too=True)).pilots_too
    assert Order("land", pilots_too=True).then(LAND).pilots_too


def test_the_latch_holds_until_it_is_released(tmp_path):
    assert latched(tmp_path) == Order()
    latch(tmp_path, LAND)
    latch(tmp_path, KILL)
    assert latch(tmp_path, LAND) == KILL
    assert latched(tmp_path) == KILL
    assert release(tmp_path) == KILL
    assert latched(tmp_path) == Order()
    assert release(tmp_path) == Order()


@pytest.mark.parametrize("content", ["", "[]", "{", '{"order": 5}', '{"order": "up"}', "[" * 9999])
def test_a_broken_latch_holds_nothing(tmp_path, content):
    (tmp_path / "order.json").write_text(content)
    assert latched(tmp_path) == Order()


def test_the_bridges_of_a_fleet(tmp_path):
    list_fleet(tmp_path, ["bridge1", "bridge2"])
    assert fleet_bridges(tmp_path) == ["bridge1", "bridge2"]
    list_fleet(tmp_path, [])
    assert fleet_bridges(tmp_path) == []
    (tmp_path / "fleet.json").write_text(json.dumps({"bridges": "bridge1"}))
    assert fleet_bridges(tmp_path) == []


def test_the_folder_belongs_to_one_user(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    folder = runtime_folder(42)
    assert folder == tmp_path / "ptnsbc" / "42"
    assert stat.S_IMODE(folder.stat().st_mode) & 0o077 == 0
    monkeypatch.setattr("os.getuid", lambda: 12345)
    with pytest.raises(RuntimeFolderError, match="not a folder of this user"):
        runtime_folder(42)


def test_each_fleet_of_a_domain_has_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    fleets = ["", "/blue", "/red", "/blue/one", "/blue_one"]
    assert len({runtime_folder(42, fleet) for fleet in fleets}) == len(fleets)


def test_a_folder_that_cannot_be_made(tmp_path, monkeypatch):
    (tmp_path / "ptnsbc").write_text("a file")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with pytest.raises(RuntimeFolderError, match="expected a folder"):
        runtime_folder(1)


PATIENCE_S = 30.0


@pytest.fixture
def port(tmp_path):
    taken = []
    port = OrderPort(tmp_path, "bridge3", taken.append, lambda: b"state")
    port.taken = taken
    yield port
    port.close()


@pytest.fixture
def client(tmp_path):
    client = OrderClient(tmp_path)
    yield client
    client.close()


def answer(client):
    assert select.select([client], [], [], PATIENCE_S)[0]
    return client.answers()


def test_an_order_is_taken_and_answered(port, client):
    assert client.send("bridge3", Order("kill", pilots_too=True))
    assert answer(client) == [b"state"]
    assert port.taken == [Order("kill", pilots_too=True)]


def test_a_question_is_answered_and_orders_nothing(port, client):
    assert client.send("bridge3", Order())
    assert answer(client) == [b"state"]
    assert port.taken == []


def test_bytes_that_are_no_order_change_nothing(port, client, tmp_path):
    for data in (b"\xff\x00", b"kill everything", b"x" * 9000):
        client._socket.sendto(data, str(socket_path(tmp_path, "bridge3")))
    assert client.send("bridge3", Order("land"))
    assert answer(client) == [b"state"]
    assert port.taken == [Order("land")]


def test_nobody_listens(client):
    assert not client.send("bridge9", Order("kill"))


def test_a_socket_of_a_killed_bridge_is_replaced(port, client, tmp_path):
    taken = []
    second = OrderPort(tmp_path, "bridge3", taken.append, lambda: b"second")
    port.close()  # the first one does not remove what is no longer its own
    assert client.send("bridge3", Order("kill"))
    assert answer(client) == [b"second"]
    assert taken == [Order("kill")]
    second.close()
    assert not socket_path(tmp_path, "bridge3").exists()


def test_no_place_for_a_socket(tmp_path):
    with pytest.raises(RuntimeFolderError, match="expected a place for a socket"):
        OrderPort(tmp_path / "missing", "bridge3", print, lambda: b"")


RECORD = VehicleRecord(
    name="bridge3",
    pid=os.getpid(),
    sysid=3,
    autopilot="px4",
    connect="udpin:127.0.0.1:14542",
    armed=True,
    heard=True,
    mode="OFFBOARD",
    place="(1.0, 2.0, 3.0) m",
)


@pytest.fixture
def dead():
    """The process id of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_a_record_reads_what_it_writes(tmp_path):
    assert decode_record(RECORD.encode()) == RECORD
    write_record(tmp_path, RECORD)
    (found,) = records(tmp_path)
    assert replace(found, written_s=0.0) == RECORD


@pytest.mark.parametrize(
    "data",
    [b"", b"\xff", b"[]", b"{}", b"[" * 9999, json.dumps({**asdict(RECORD), "pid": "x"}).encode()],
)
def test_anything_else_is_no_record(tmp_path, data):
    assert decode_record(data) is None
    record_path(tmp_path, "bridge3").write_bytes(data)
    assert list(records(tmp_path)) == []


def test_the_record_of_a_dead_bridge_stays_until_it_is_forgotten(tmp_path, dead):
    write_record(tmp_path, RECORD)
    write_record(tmp_path, replace(RECORD, name="bridge4", pid=dead))
    assert [record.alive for record in records(tmp_path)] == [True, False]
    forget_dead(tmp_path)
    assert [record.name for record in records(tmp_path)] == ["bridge3"]


def test_whether_pilots_fly_all_of_them(tmp_path):
    write_record(tmp_path, replace(RECORD, in_pilots_hands=True))
    write_record(tmp_path, replace(RECORD, name="bridge4"))
    assert in_pilots_hands(tmp_path, ["bridge3"])
    assert not in_pilots_hands(tmp_path, ["bridge3", "bridge4"])
    assert not in_pilots_hands(tmp_path, ["bridge3", "bridge9"])


def test_the_summary_after_a_flight(tmp_path):
    write_record(tmp_path, replace(RECORD, armed=False, landed=True, place=""))
    down = "bridge3 disarmed, on the ground in OFFBOARD"
    assert summary(tmp_path, ["bridge3"]) == f"after the flight: {down}: all disarmed"
    armed = replace(RECORD, name="bridge4", fate="it hovers", label="red, Ada")
    write_record(tmp_path, armed)
    assert summary(tmp_path, ["bridge3", "bridge4"]) == (
        f"after the flight: {down}; bridge4 (red, Ada) armed at (1.0, 2.0, 3.0) m in OFFBOARD: it hovers: "
        "keep away from bridge4 (red, Ada): a pilot lands it, or ptnsbc stop"
    )


def test_the_state_in_words():
    assert RECORD.state == "armed at (1.0, 2.0, 3.0) m in OFFBOARD"
    silent = replace(RECORD, heard=False)
    assert silent.state == "silent, last armed at (1.0, 2.0, 3.0) m in OFFBOARD"
    never = VehicleRecord("bridge3", 1, 3, "px4", "udpin:127.0.0.1:14542")
    assert never.state == "never heard"
    down = replace(RECORD, armed=False, landed=True, place="")
    assert down.state == "disarmed, on the ground in OFFBOARD"
    stands = replace(RECORD, landed=True, place="")
    assert stands.state == "armed, on the ground, rotors turning in OFFBOARD"
