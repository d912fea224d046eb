"""An order to all vehicles: repeated until every bridge has answered; who does not is named."""

import os
import select
import subprocess
import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("pymavlink")

from mavlink_wires import Far, heartbeat

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.emergency import (
    Order,
    OrderPort,
    VehicleRecord,
    latched,
    list_fleet,
    records,
    write_record,
)
from ptnsbc_nodes.fleet import emergency_stop
from ptnsbc_nodes.fleet.emergency_stop import EmergencyStop, land_left_behind, order_return

ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
LAND, KILL = Order("land"), Order("kill")
PATIENCE_S = 30.0


class OneBridge:
    """The port of a bridge whose vehicle obeys, unless a test changes that."""

    def __init__(self, folder, name, **changes):
        base = VehicleRecord(
            name=name,
            pid=os.getpid(),
            sysid=1,
            autopilot="px4",
            connect="udpin:127.0.0.1:1",
            heard=True,
            armed=True,
            mode="OFFBOARD",
            place="(1.0, 2.0, 3.0) m",
            fate="without setpoints it hovers",
        )
        self.record = replace(base, **changes)
        self.folder, self.ignores, self.orders, self.port = folder, 0, [], None
        write_record(folder, self.record)

    def open(self):
        self.port = OrderPort(self.folder, self.record.name, self.take, self.answer)
        return self

    def take(self, order):
        self.orders.append(order)
        if len(self.orders) <= self.ignores:
            return
        if self.record.in_pilots_hands and not order.pilots_too:
            self.record = replace(self.record, order=order.text)
            return
        fault = "motors stopped by the operator" if order.what == "kill" else ""
        mode = {"return": "RTL"}.get(order.what, "LAND")
        self.record = replace(
            self.record, order=order.text, armed=order.what != "kill", fault=fault, mode=mode
        )
        write_record(self.folder, self.record)

    def answer(self):
        return self.record.encode()


@pytest.fixture
def bridge(tmp_path):
    made = []

    def make(name, **changes):
        made.append(OneBridge(tmp_path, name, **changes))
        return made[-1]

    yield make
    for one in made:
        if one.port is not None:
            one.port.close()


@pytest.fixture
def give(tmp_path):
    given = []

    def run(order, patience_s=PATIENCE_S, remote=None):
        given.append(EmergencyStop(tmp_path, order, remote))
        given[-1].begin()
        done = given[-1].run(patience_s)
        return done, {one.name: one for one in given[-1].outcomes()}

    yield run
    for one in given:
        one.close()


@pytest.fixture
def dead():
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_all_motors_stop_and_the_order_is_latched(bridge, give, tmp_path):
    bridges = [bridge(f"bridge{n}").open() for n in (1, 2, 3)]
    bridges[1].ignores = 3
    done, found = give(KILL)
    assert done
    assert [one.obeyed for one in found.values()] == [True] * 3
    assert found["bridge1"].text.startswith("motors stopped after 0.")
    assert len(bridges[1].orders) > 3  # repeated until it counted
    assert latched(tmp_path) == KILL


def test_a_landing_is_reported_as_what_it_is(bridge, give):
    bridge("bridge1").open()
    done, found = give(LAND)
    assert done
    assert "landing, armed at (1.0, 2.0, 3.0) m in LAND" in found["bridge1"].text


def test_bridges_of_a_fleet_that_have_given_up_on_the_ground_are_not_waited_for(
    bridge, give, tmp_path
):
    """Four lines said 'silent: the bridge does not answer', 3 s after a start that was refused."""
    list_fleet(tmp_path, ["bridge1"])
    bridge("bridge1", ended=True, armed=False, landed=True, step="failed")
    done, found = give(LAND, patience_s=1.0)
    assert done
    assert found["bridge1"].obeyed
    assert found["bridge1"].text.startswith("not flying (disarmed, on the ground at")


def test_what_is_seen_past_a_silent_bridge_stands_beside_no_old_place(bridge, tmp_path):
    far = Far()
    bridge("bridge1", peer=f"127.0.0.1:{far.port}")  # no port: it does not answer
    operation = EmergencyStop(tmp_path, KILL)
    operation.begin()
    while not select.select([far.socket], [], [], 0.0)[0]:
        operation.look()
    far.receive()
    far.send(heartbeat())  # disarmed
    while "disarmed" not in (text := operation.outcomes()[0].text):
        operation.look()
    assert "disarmed at a place unknown since" in text and "(1.0, 2.0, 3.0) m" not in text
    operation.close()
    far.close()


def test_a_vehicle_in_a_pilots_hands_is_left_alone_and_named(bridge, give):
    bridge("bridge1", in_pilots_hands=True, mode="OTHER").open()
    done, found = give(KILL)
    assert done
    assert found["bridge1"].obeyed
    assert "in a pilot's hands, left alone (armed at" in found["bridge1"].text
    assert "--all" in found["bridge1"].text


def test_with_all_a_pilots_vehicle_is_ordered_too(bridge, give):
    bridge("bridge1", in_pilots_hands=True, mode="OTHER").open()
    done, found = give(Order("kill", pilots_too=True))
    assert done
    assert found["bridge1"].text.startswith("motors stopped after")


def test_a_bridge_of_the_fleet_that_is_never_heard_of_is_missing(bridge, give, tmp_path):
    list_fleet(tmp_path, ["bridge1", "bridge2"])
    bridge("bridge1").open()
    done, found = give(KILL, 0.5)
    assert not done
    assert found["bridge1"].obeyed
    assert not found["bridge2"].obeyed
    assert found["bridge2"].text == "silent: it was never heard of"


def test_a_vehicle_that_does_not_obey_is_no_success(bridge, give):
    one = bridge("bridge1").open()
    one.ignores = 10**9
    done, found = give(KILL, 0.5)
    assert not done
    assert "does not obey: armed at" in found["bridge1"].text
    assert "without setpoints it hovers" in found["bridge1"].text


def test_a_silent_vehicle_is_not_said_to_have_landed(bridge, give):
    bridge("bridge1", heard=False).open()
    done, found = give(LAND, 0.5)
    assert not done
    assert "does not obey: silent, last armed" in found["bridge1"].text


@pytest.mark.parametrize("order", [LAND, KILL])
def test_the_vehicle_of_a_dead_bridge_is_told_past_it(bridge, give, tmp_path, dead, order):
    far = Far()
    port = Far()  # only to find a free one
    free = port.port
    port.close()
    far.to = ("127.0.0.1", free)
    bridge("bridge1", pid=dead, connect=f"udpin:127.0.0.1:{free}", autopilot="px4")
    operation = EmergencyStop(tmp_path, order)
    operation.begin()
    operation.look()  # opens the port that the dead bridge has left
    far.send(heartbeat(base_mode=ARMED))
    told = None
    while told is None or told.get_type() != "COMMAND_LONG":
        operation.look()
        if select.select([far.socket], [], [], 0.0)[0]:
            told = far.receive()
    expected = {
        "land": (mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_NAV_LAND),  # in turn
        "kill": (mavlink.MAV_CMD_COMPONENT_ARM_DISARM,),
    }
    assert told.command in expected[order.what]
    assert not operation.run(0.05)
    far.send(heartbeat())  # disarmed
    assert operation.run(PATIENCE_S)
    (found,) = operation.outcomes()
    assert found.obeyed
    assert "its bridge has ended, the vehicle is disarmed after" in found.text
    operation.close()
    far.close()


def test_a_port_that_a_dying_bridge_still_has_is_opened_when_it_is_free(bridge, tmp_path, dead):
    far, still = Far(), Far()
    bridge("bridge1", pid=dead, connect=f"udpin:127.0.0.1:{still.port}")
    operation = EmergencyStop(tmp_path, KILL)
    operation.begin()
    assert not operation.run(0.05)
    (found,) = operation.outcomes()
    assert "not reached past it: udpin" in found.text
    far.to = ("127.0.0.1", still.port)
    still.close()
    deadline = time.monotonic() + PATIENCE_S
    while not operation.look() and time.monotonic() < deadline:
        far.send(heartbeat())  # disarmed
    (found,) = operation.outcomes()
    assert found.obeyed
    operation.close()
    far.close()


def test_a_bridge_that_hangs_is_passed_by_and_counts_as_missing(bridge, give):
    far = Far()
    bridge("bridge1", peer=f"127.0.0.1:{far.port}")  # no port: it does not answer
    done, found = give(KILL, 1.0)
    told = far.receive()
    assert told.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM
    assert told.param2 == 21196.0
    assert not done
    assert not found["bridge1"].obeyed
    assert "told past it by MAVLink, without an answer" in found["bridge1"].text
    far.close()


def test_a_pilots_vehicle_is_not_told_past_its_bridge(bridge, give, dead):
    far = Far()
    bridge("bridge1", peer=f"127.0.0.1:{far.port}", in_pilots_hands=True)
    done, _ = give(KILL, 0.7)
    assert not done
    assert far.receive(timeout=0.05) is None
    far.close()


class Elsewhere:
    """Bridges of another host, through the middleware."""

    def __init__(self, *records):
        self.status = SimpleNamespace(vehicles={record.name: record for record in records})
        self.orders = []

    def send(self, order):
        self.orders.append(order)
        if len(self.orders) == 3:  # the first two get lost
            for name, record in self.status.vehicles.items():
                self.status.vehicles[name] = replace(
                    record, order=order.text, armed=False, written_s=time.time()
                )

    def spin(self, seconds):
        pass


class LastHeard:
    """What was heard of bridges before the order: they have died or hang since."""

    def __init__(self, *records):
        self.status = SimpleNamespace(vehicles={record.name: record for record in records})

    def send(self, order):
        pass

    def spin(self, seconds):
        pass


@pytest.mark.parametrize("order", [LAND, KILL])
@pytest.mark.parametrize("last_order", ["", "land"])
def test_the_last_state_of_a_dead_bridge_is_no_answer(bridge, tmp_path, dead, order, last_order):
    """`stop --ready` had heard it on /diagnostics: it counted as an answer, and the vehicle was not told."""
    far = Far()
    port = Far()  # only to find a free one
    free = port.port
    port.close()
    far.to = ("127.0.0.1", free)
    bridge("bridge1", pid=dead, connect=f"udpin:127.0.0.1:{free}")
    heard = VehicleRecord("bridge1", 0, 0, "", "", heard=True, armed=True, order=last_order)
    operation = EmergencyStop(tmp_path, order, LastHeard(heard))
    operation.begin()
    deadline = time.monotonic() + PATIENCE_S
    told = None
    while (told is None or told.get_type() != "COMMAND_LONG") and time.monotonic() < deadline:
        assert not operation.look()
        far.send(heartbeat(base_mode=ARMED))
        if select.select([far.socket], [], [], 0.0)[0]:
            told = far.receive()
    assert told is not None
    far.send(heartbeat())  # disarmed
    assert operation.run(PATIENCE_S)
    (found,) = operation.outcomes()
    assert "its bridge has ended, the vehicle is disarmed after" in found.text
    operation.close()
    far.close()


@pytest.mark.parametrize("order", [LAND, KILL])
def test_after_a_second_without_an_answer_a_bridge_is_passed_by_whatever_is_known(
    bridge, give, order
):
    """By its record and its last status the vehicle is disarmed, which says nothing of now."""
    far = Far()
    bridge("bridge1", peer=f"127.0.0.1:{far.port}", armed=False)
    heard = VehicleRecord("bridge1", 0, 0, "", "", heard=True)
    done, found = give(order, 1.5, remote=LastHeard(heard))
    assert not done
    assert far.receive() is not None
    assert "told past it by MAVLink, without an answer" in found["bridge1"].text
    far.close()


def test_a_state_with_the_order_of_before_is_no_answer_of_a_bridge_that_hangs(bridge, give):
    """A second `stop`: the bridge had taken the first one, and hangs since."""
    far = Far()
    bridge("bridge1", peer=f"127.0.0.1:{far.port}")
    before = VehicleRecord("bridge1", 0, 0, "", "", heard=True, armed=True, order="land")
    done, _ = give(LAND, 1.5, remote=LastHeard(replace(before, written_s=time.time())))
    assert not done
    assert far.receive() is not None
    far.close()


def test_a_bridge_that_hangs_after_its_answer_is_passed_by(bridge, give):
    far = Far()
    one = bridge("bridge1", peer=f"127.0.0.1:{far.port}").open()
    one.ignores = 10**9
    answer, answers = one.answer, []

    def hang():
        answers.append(time.monotonic())
        return b"" if len(answers) > 3 else answer()

    one.port.close()
    one.answer = hang
    one.open()
    done, found = give(KILL, 1.5)
    assert not done
    assert far.receive() is not None
    assert "does not answer" in found["bridge1"].text
    far.close()


def test_the_way_to_each_vehicle_is_rehearsed(bridge, tmp_path, dead):
    list_fleet(tmp_path, ["bridge1", "bridge2", "bridge3", "bridge4", "bridge5", "bridge6"])
    taken, port = Far(), Far()  # the second one only to find a free one
    free = port.port
    port.close()
    one = bridge("bridge1").open()
    bridge("bridge2", pid=dead, connect=f"udpin:127.0.0.1:{free}")
    bridge("bridge3", pid=dead, connect=f"udpin:127.0.0.1:{taken.port}")
    bridge("bridge4", peer="127.0.0.1:9")  # hangs
    heard = VehicleRecord("bridge5", 0, 0, "", "", heard=True, written_s=time.time() + 60.0)
    operation = EmergencyStop(tmp_path, LAND, LastHeard(heard))
    ways, deadline = None, time.monotonic() + PATIENCE_S
    while ways is None and time.monotonic() < deadline:
        ways = operation.rehearse()
    assert ways.pop("bridge3").startswith(f"NOT REACHED: udpin:127.0.0.1:{taken.port}")
    assert ways == {
        "bridge1": "by its socket",
        "bridge2": "past its bridge",
        "bridge4": "past its bridge",
        "bridge5": "by the network",
        "bridge6": "NOT REACHED: it is not heard",
    }
    assert one.orders == []
    operation.close()
    taken.close()


class Flown:
    """A vehicle whose bridge has died, at its port."""

    def __init__(self, bridge, dead, **changes):
        port = Far()  # only to find a free one
        self.far, free = Far(), port.port
        port.close()
        self.far.to = ("127.0.0.1", free)
        bridge("bridge1", pid=dead, connect=f"udpin:127.0.0.1:{free}", **changes)

    def land_left_behind(self, folder, states, seconds=PATIENCE_S):
        """The printed lines, and the commands sent before each of the `states` of the vehicle's HEARTBEAT was over."""
        said, commands, end = [], [], time.monotonic() + seconds

        def look():
            state = states[min(len(commands), len(states) - 1)]
            self.far.send(heartbeat(**state))
            if select.select([self.far.socket], [], [], 0.0)[0]:
                message = self.far.receive()
                if message.get_type() == "COMMAND_LONG":
                    commands.append(message.command)
            return time.monotonic() > end

        land_left_behind(folder, {"bridge1"}, look, said.append)
        self.far.close()
        return said, commands


FLIES = {
    "base_mode": ARMED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
    "custom_mode": 4 << 16 | 3 << 24,
}
BY_HAND = {**FLIES, "custom_mode": 3 << 16}


@pytest.mark.parametrize("changes", [{}, {"armed": False, "step": "arming"}, {"landed": True}])
def test_a_vehicle_that_a_dead_bridge_left_armed_is_landed_and_waited_for(
    bridge, dead, tmp_path, changes
):
    said, commands = Flown(bridge, dead, **changes).land_left_behind(tmp_path, [FLIES] * 3 + [{}])
    disarm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
    assert commands[0] == mavlink.MAV_CMD_DO_SET_MODE
    assert (disarm in commands) == changes.get("landed", False)
    assert said[-1] == "bridge1: its vehicle is disarmed"
    (record,) = records(tmp_path)
    # The bridge's last word was of a place in the air, and of what it would do there.
    assert (record.armed, record.landed, record.place, record.fate) == (False, True, "", "")


def test_until_then_it_is_named_and_the_operator_may_end_the_wait(bridge, dead, tmp_path):
    said, _ = Flown(bridge, dead).land_left_behind(tmp_path, [FLIES], 0.5)
    assert said == ["armed without a bridge, told to land: bridge1; interrupt to end"]


@pytest.mark.parametrize("changes", [{}, {"in_pilots_hands": True}])
def test_a_pilots_vehicle_is_not_landed_by_a_launcher(bridge, dead, tmp_path, monkeypatch, changes):
    monkeypatch.setattr(emergency_stop, "_PILOT_S", 0.3)
    said, commands = Flown(bridge, dead, **changes).land_left_behind(tmp_path, [BY_HAND])
    assert commands == []
    if not changes:
        assert said[-1] == "bridge1: its vehicle is left to its pilot"


def test_a_vehicle_that_is_silent_is_given_up(bridge, dead, tmp_path, monkeypatch):
    monkeypatch.setattr(emergency_stop, "SILENT_S", 0.3)
    bridge("bridge1", pid=dead, connect="udpout:127.0.0.1:9")
    said = []
    land_left_behind(tmp_path, {"bridge1"}, lambda: False, said.append)
    assert said[-1].startswith("bridge1: not reached, silent; its vehicle was armed at (1.0")


def test_bridges_of_other_hosts_are_ordered_until_they_report_it(bridge, give):
    bridge("bridge1").open()
    record = VehicleRecord("bridge2", 0, 0, "", "", heard=True, armed=True, mode="OFFBOARD")
    remote = Elsewhere(record)
    done, found = give(KILL, remote=remote)
    assert done
    assert found["bridge2"].obeyed
    assert len(remote.orders) >= 3


def test_a_bridge_that_ended_meanwhile_has_obeyed(bridge, give, tmp_path):
    one = bridge("bridge1").open()
    one.ignores = 2

    def answer():
        if one.record.order:  # it ends before it can answer
            write_record(tmp_path, replace(one.record, ended=True))
            return b""
        return one.record.encode()

    one.answer = answer
    one.port.close()
    one.open()
    done, found = give(KILL)
    assert done
    assert found["bridge1"].obeyed


def test_the_dead_bridges_of_an_earlier_flight_are_not_asked(bridge, give, dead):
    bridge("bridge1", pid=dead, armed=False, heard=False)
    done, found = give(LAND, 0.2)
    assert not done
    assert found == {}


def test_one_vehicle_alone_is_sent_home_and_nothing_is_latched(bridge, tmp_path):
    one, other = bridge("bridge1", label="red").open(), bridge("bridge2").open()
    one.ignores = 2  # repeated until it shows
    assert order_return(tmp_path, 1, PATIENCE_S).startswith("bridge1 (red): returns, armed")
    assert {order.text for order in one.orders} == {"return"}
    with pytest.raises(PtnsbcError, match=r"another one returns, bridge1 \(red\)"):
        order_return(tmp_path, 2, PATIENCE_S)
    assert other.orders == [] and latched(tmp_path) == Order()


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"autopilot": "generic"}, "generic has no mode that returns"),
        ({"autopilot": "ros"}, "ros has no mode that returns"),
        ({"in_pilots_hands": True}, "its pilot flies it"),
        ({"armed": False}, "it is not in the air"),
        ({"landed": True}, "it is not in the air"),
        ({"step": Step.TAKEOFF.value}, "it is taking off"),
        ({"step": Step.LAND.value}, "it is landing"),
        ({"ended": True}, "no bridge of this host"),
    ],
)
def test_who_cannot_return_is_told_nothing(bridge, tmp_path, changes, why):
    one = bridge("bridge1", **changes).open()
    with pytest.raises(PtnsbcError, match=why):
        order_return(tmp_path, 1, PATIENCE_S)
    assert one.orders == []


def test_ways_home_cross(bridge, tmp_path):
    bridge("bridge2", mode="RTL", in_pilots_hands=True)
    one = bridge("bridge1").open()
    with pytest.raises(PtnsbcError, match="another one returns, bridge2, and ways home cross"):
        order_return(tmp_path, 1, PATIENCE_S)
    assert one.orders == []


def test_a_vehicle_that_does_not_return_is_named(bridge, tmp_path):
    bridge("bridge1").open().ignores = 10**6
    with pytest.raises(PtnsbcError, match=r"bridge1: not obeyed .* asked on: armed .* in OFFBOARD"):
        order_return(tmp_path, 1, 0.1)
