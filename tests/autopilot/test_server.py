"""Stand-ins behind real sockets."""

import socket
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from ptnsbc_autopilot.fault_lines import FaultPort, TimedFault, parse_timed_fault, send_fault
from ptnsbc_autopilot.launch import (
    Fleet,
    Network,
    Options,
    parse_address,
    parse_parameter,
    stations,
)
from ptnsbc_autopilot.server import Address, AutopilotError, Codec, serve
from ptnsbc_io.mavlink.dialect import mavlink

LIMIT_S = 20.0


def udp():
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", 0))
    made.settimeout(0.2)
    return made


def free_port():
    with udp() as made:
        return made.getsockname()[1]


@contextmanager
def serving(options, timed=()):
    """Stand-ins in a thread; their stations and the control port."""
    began, stop, port = time.monotonic(), threading.Event(), free_port()
    fleet = stations(options, began, lambda _line: None)
    vehicles = [station.vehicle for station in fleet]

    def body():
        with FaultPort(vehicles, began, port=port, timed=timed, log=lambda _line: None) as control:
            serve(fleet, stop.is_set, control.poll, ready.set)

    ready = threading.Event()
    thread = threading.Thread(target=body)
    thread.start()
    try:
        assert ready.wait(LIMIT_S)
        yield fleet, port
    finally:
        stop.set()
        thread.join()


def receive(channel, codec, want):
    """Messages until `want(messages)` holds."""
    out, end = [], time.monotonic() + LIMIT_S
    while not want(out):
        assert time.monotonic() < end, f"only {sorted({m.get_type() for m in out})}"
        try:
            out += codec.decode(channel.recv(65535))
        except TimeoutError:
            continue
    return out


def names(messages):
    return {m.get_type() for m in messages}


def systems(messages, name):
    return {m.get_srcSystem() for m in messages if m.get_type() == name}


@contextmanager
def udp_in_a_row():
    """Two sockets with ports that follow each other."""
    for _ in range(1000):
        with udp() as first, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second:
            second.settimeout(0.2)
            try:
                second.bind(("127.0.0.1", first.getsockname()[1] + 1))
            except (OSError, OverflowError):  # taken, or beyond the last port
                continue
            yield first, second
            return
    raise AssertionError("no two free ports follow each other")


def test_two_vehicles_reach_their_companions_and_the_ground_station():
    """Each sends to a companion of its own, and the ground station hears both on one port."""
    with udp_in_a_row() as companions, udp() as ground:
        port = companions[0].getsockname()[1]
        network = Network(connect=f"udpout:127.0.0.1:{port}", gcs=Address(*ground.getsockname()))
        options = Options(fleet=Fleet(count=2), network=network, boot_time=0.0)
        with serving(options):
            wanted = {"HEARTBEAT", "ATTITUDE", "LOCAL_POSITION_NED"}
            for system, companion in enumerate(companions, start=1):
                got = receive(companion, Codec(245), lambda got: wanted <= names(got))
                assert {m.get_srcSystem() for m in got} == {system}
            receive(ground, Codec(255), lambda got: systems(got, "HEARTBEAT") == {1, 2})


def test_whoever_calls_a_listening_vehicle_is_answered():
    port = free_port()
    network = Network(connect=f"udpin:127.0.0.1:{port}", gcs=None)
    with udp() as caller, serving(Options(kind="arducopter", network=network)):
        codec = Codec(245, 191)
        caller.sendto(codec.encode(mavlink.MAVLink_timesync_message(0, 77)), ("127.0.0.1", port))
        got = receive(caller, codec, lambda got: "TIMESYNC" in names(got))
        assert [m.ts1 for m in got if m.get_type() == "TIMESYNC"] == [77]


def test_faults_by_the_port_and_by_time():
    network = Network(connect=f"udpin:127.0.0.1:{free_port()}", gcs=None)
    options = Options(fleet=Fleet(count=1), network=network)
    with serving(options, [TimedFault(0.0, "1 battery 0.5")]) as (fleet, port):
        assert '"system": 1' in send_fault(port, "all state")
        assert fleet[0].vehicle.flight.battery == pytest.approx(0.5, abs=0.01)
        assert send_fault(port, "1 arming refuse") == "ok"
        assert fleet[0].vehicle.faults.refuse_arming
        with pytest.raises(AutopilotError, match="expected one of"):
            send_fault(port, "1 nonsense")


def test_a_duplicate_sends_from_another_port():
    with udp() as companion:
        port = companion.getsockname()[1]
        network = Network(connect=f"udpout:127.0.0.1:{port}", gcs=None)
        with serving(Options(fleet=Fleet(count=1), network=network)) as (_, control):
            send_fault(control, "1 duplicate on")
            end, senders = time.monotonic() + LIMIT_S, set()
            while len(senders) < 2 and time.monotonic() < end:
                data, sender = companion.recvfrom(65535)
                if Codec(245).decode(data)[0].get_srcSystem() == 1:
                    senders.add(sender)
            assert len(senders) == 2


def test_a_taken_port_is_refused_in_one_line():
    with udp() as taken:
        port = taken.getsockname()[1]
        network = Network(connect=f"udpin:127.0.0.1:{port}", gcs=None)
        fleet = stations(Options(network=network), 0.0, lambda _line: None)
        with pytest.raises(AutopilotError, match=f"{port}.*free port"):
            serve(fleet, lambda: True)


def test_ports_of_px4():
    made = stations(Options(fleet=Fleet(count=3)), 0.0, lambda _line: None)
    ends = [(s.endpoints[0].partner.port, s.endpoints[0].listen.port) for s in made]
    assert ends == [(14540, 14580), (14541, 14581), (14542, 14582)]
    assert [s.endpoints[1].partner.port for s in made] == [14550] * 3
    assert [s.vehicle.system for s in made] == [1, 2, 3]
    many = stations(Options(fleet=Fleet(count=12)), 0.0, lambda _line: None)
    assert [s.endpoints[0].partner.port for s in many[8:]] == [14548, 14549, 14549, 14549]
    assert many[11].endpoints[0].listen.port == 14591


def test_a_scenario_says_where_and_how(tmp_path: Path):
    file = tmp_path / "two.yaml"
    file.write_text(
        "extends: experiment_4\n"
        "mavlink:\n"
        "  autopilot: ardupilot\n"
        "  world_origin: {latitude_deg: 1, longitude_deg: 2, altitude_m: 3}\n"
        "  vehicles:\n"
        "    1: {connect: 'udpin:0.0.0.0:16500', sysid: 41}\n"
        "    2: {connect: 'udpout:127.0.0.1:16501'}\n"
    )
    made = stations(Options(fleet=Fleet(scenario=str(file))), 0.0, lambda _line: None)
    assert len(made) == 4
    first, second = (s.endpoints[0] for s in made[:2])
    assert (first.partner, first.listen.port) == (Address("127.0.0.1", 16500), 16540)
    assert (second.partner, second.listen.port) == (None, 16501)
    body = made[0].vehicle.body
    assert made[0].vehicle.system == 41
    assert type(made[0].vehicle).__name__ == "ArduCopter"
    assert body.start_enu.tolist() == [0.1, 1.1, 0.0]
    assert body.datum == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (Options(kind="apm"), "expected one of px4"),
        (Options(network=Network(connect="tcp:127.0.0.1:1")), "expected udpin"),
        (Options(network=Network(key="/nowhere/key")), "expected a readable"),
        (Options(fleet=Fleet(gnss="good")), "expected one of plain"),
        (Options(parameters={"NO_SUCH": 1.0}), "param NO_SUCH: expected one of BAT"),
        (Options(fleet=Fleet(scenario="experiment_4", count=9)), "at most 4"),
    ],
)
def test_what_cannot_be_is_refused(options, message):
    from ptnsbc_core.errors import PtnsbcError

    with pytest.raises(PtnsbcError, match=message):
        stations(options, 0.0, lambda _line: None)


def test_parameters_instead_of_the_defaults():
    made = stations(Options(parameters={"COM_OBL_RC_ACT": 5.0}), 0.0, lambda _line: None)
    assert made[0].vehicle.parameters["COM_OBL_RC_ACT"] == 5


def test_a_parameter_goes_to_those_of_a_mixed_fleet_that_have_it(tmp_path: Path):
    file = tmp_path / "mixed.yaml"
    file.write_text("extends: experiment_4\nmavlink: {vehicles: {2: {autopilot: ardupilot}}}\n")
    options = Options(fleet=Fleet(scenario=str(file)), parameters={"GUID_OPTIONS": 8.0})
    first, second = (s.vehicle.parameters for s in stations(options, 0.0, lambda _line: None)[:2])
    assert "GUID_OPTIONS" not in first
    assert second["GUID_OPTIONS"] == 8


def test_addresses_times_and_parameters():
    assert parse_parameter("A=2") == ("A", 2.0)
    for wrong in ("A", "=2", "A=x"):
        with pytest.raises(AutopilotError):
            parse_parameter(wrong)
    assert parse_address("127.0.0.1:14550", "gcs") == ("127.0.0.1", 14550)
    assert parse_timed_fault("20 1 gps off") == (20.0, "1 gps off")
    for wrong in ("127.0.0.1", "h:0", "h:70000", "h:x"):
        with pytest.raises(AutopilotError):
            parse_address(wrong, "gcs")
    for wrong in ("x 1 gps off", "-1 1 gps off", "20"):
        with pytest.raises(AutopilotError):
            parse_timed_fault(wrong)
