"""Fleets of real processes over real UDP: the command of the manual, and a fleet in which processes are killed.

They fly in real time with as many processes as two cores can carry, so no other test runs beside them.
"""

import json
import os
import signal

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("pymavlink")

from domain_ports import first_port
from mavlink_processes import (
    COMMAND,
    Program,
    flying,
    mode_of,
    nearest_pair,
    pid_of,
    stand_ins,
    write_scenario,
)

from ptnsbc_autopilot.fault_lines import send_fault
from ptnsbc_io.bag import read_bag

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.alone]

THREE = {1: ("px4", "velocity"), 3: ("px4", "velocity"), 4: ("px4", "velocity")}
PAIR = {1: ("ardupilot", "velocity"), 3: ("px4", "attitude")}


def test_the_command_flies_stand_ins_of_both_kinds_into_formation(tmp_path, domain):
    """`ptnsbc fleet SCENARIO --backend mavlink`, 13 s of 50, both kinds in one fleet, and setpoints of both kinds.

    Fleets of one kind fly in test_fleet_mavlink.py, on a clock of the tests.
    """
    path = write_scenario(tmp_path / "two.yaml", domain, duration_s=13, fleet=PAIR)
    command = (COMMAND, "fleet", path, "--backend", "mavlink", "--allow-arming", "--json")
    parameters = ("--param", "COM_OBL_RC_ACT=5", "--param", "GUID_OPTIONS=8")
    with (
        stand_ins(path, domain, *parameters, count=2, kinds=("px4", "ardupilot")) as vehicles,
        flying(*command, "--bag", tmp_path / "bag", domain=domain) as fleet,
    ):
        code = fleet.finish()
        output = fleet.json_output()
        assert code == 0, [uav["reason"] for uav in output["uavs"]]
    assert fleet.printed("in flight: gains.formation.deadline_s: 10 instead of 5.0", "they may arm")
    steps = ("taking off", "airborne", "in formation", "landing", "done")
    assert fleet.printed(*(f"bridge{number}: {step}" for number in PAIR for step in steps))
    programs = {"px4": "px4", "ardupilot": "arducopter"}
    assert vehicles.printed(
        *(f"{programs[kind]} {n}: disarmed: landed" for n, (kind, _) in enumerate(PAIR.values(), 1))
    )
    assert output["verdict"] == "met"
    assert [uav["verdict"] for uav in output["uavs"]] == ["met", "met"]
    assert min(separation["distance_m"] for separation in output["separations"]) > 0.5


def test_nothing_is_armed_for_a_flight_that_is_refused_from_where_the_vehicles_stand(
    tmp_path, domain
):
    """The file is accepted; UAV 4 stands 300 m from where the file says."""
    pair = {1: ("px4", "velocity"), 4: ("px4", "velocity")}
    path = write_scenario(tmp_path / "two.yaml", domain, duration_s=13, fleet=pair)
    starts = {1: (0.1, 1.1), 4: (300, 0)}
    uavs = "".join(f"  - {{id: {i}, position_m: [{x}, {y}, 1]}}\n" for i, (x, y) in starts.items())
    (tmp_path / "stand.yaml").write_text(f"extends: {path}\nuavs:\n{uavs}")
    command = (COMMAND, "fleet", path, "--backend", "mavlink", "--allow-arming")
    with (
        stand_ins(tmp_path / "stand.yaml", domain, count=2) as vehicles,
        flying(*command, "--bag", tmp_path / "bag", domain=domain) as fleet,
    ):
        assert fleet.finish() == 2, fleet.lines
    assert fleet.printed("error: from where the vehicles stand nothing is armed: "), fleet.lines
    assert not any("armed" in line for line in vehicles.lines), vehicles.lines


def test_a_bridge_killed_during_the_take_off_ends_the_flight_with_all_on_the_ground(
    tmp_path, domain
):
    """Nothing is to be saved yet: no other bridge takes over, and the launcher lands the vehicle past it."""
    pair = {1: ("px4", "velocity"), 4: ("px4", "velocity")}
    path = write_scenario(tmp_path / "two.yaml", domain, duration_s=13, fleet=pair)
    logs, control = tmp_path / "logs", first_port(domain) + 20
    command = (
        "tests.support.fleet_main", "--scenario", path, "--backend", "mavlink", "--allow-arming",
        "--log-dir", logs,
    )  # fmt: skip
    with (
        stand_ins(
            path, domain, "--param", "COM_OBL_RC_ACT=5", "--control", control, count=2
        ) as vehicles,
        flying(*command, domain=domain) as fleet,
    ):
        fleet.wait_for("bridge1: taking off", "bridge4: taking off")
        os.kill(pid_of("ptnsbc_nodes.bridge.bridge_main", 4, logs), signal.SIGKILL)
        assert fleet.finish() == 2, fleet.lines
        states = json.loads(send_fault(control, "all state"))
        assert [(each["armed"], each["contact"]) for each in states] == [(False, True)] * 2
    assert fleet.printed("before the flight: bridge4 (pid ", "bridge4: its vehicle is disarmed")
    assert not fleet.printed("another bridge takes it over")
    assert vehicles.printed("mode LAND")
    assert "after the flight: " in (logs / "fleet.log").read_text()


def test_a_uav_process_and_a_bridge_killed_and_the_operators_stop(tmp_path, domain):
    """The fleet waits for its operator: before the word nothing is armed.

    The vehicle of the dead bridge hovers by its failsafe, and comes back with the next bridge.
    """
    path = write_scenario(tmp_path / "three.yaml", domain, duration_s=60, fleet=THREE)
    logs, control = tmp_path / "logs", first_port(domain) + 20
    command = (
        "tests.support.fleet_main", "--scenario", path, "--backend", "mavlink", "--allow-arming",
        "--bag", tmp_path / "bag", "--log-dir", logs, "--wait",
    )  # fmt: skip

    def mission(*words):
        said = Program(COMMAND, "mission", *words, "--domain", domain, domain=domain)
        assert said.finish() == 0, said.lines

    with (
        stand_ins(
            path, domain, "--param", "COM_OBL_RC_ACT=5", "--control", control, count=3
        ) as vehicles,
        flying(*command, domain=domain) as fleet,
        nearest_pair(control) as distances_m,
    ):
        fleet.wait_for("the vehicles arm when an operator calls /formation/arm")
        assert not any("armed" in line for line in vehicles.lines), vehicles.lines
        mission("arm")
        fleet.wait_for("all are ready: the flight begins when an operator calls /formation/start")
        mission("start", 1)
        fleet.wait_for(*(f"bridge{i}: in formation" for i in THREE))
        os.kill(pid_of("ptnsbc_nodes.bridge.bridge_main", 4, logs), signal.SIGKILL)
        fleet.wait_for("bridge4: its vehicle was armed at ", "; another bridge takes it over")
        assert mode_of(control, 3, other_than="OFFBOARD") == "HOLD"  # UAV 4, by its own failsafe
        fleet.wait_for(
            "bridge4: its bridge died, and another one took over",
            "bridge4: setpoints are back, the formation goes on",
        )
        assert mode_of(control, 3, other_than="HOLD") == "OFFBOARD"
        os.kill(pid_of("ptnsbc_nodes.uav.uav_main", 3, logs), signal.SIGKILL)
        fleet.wait_for("uav3 (pid ", "bridge3: no setpoints: ")
        stop = Program(COMMAND, "stop", "--domain", domain, domain=domain)
        assert stop.finish() == 0, stop.lines
        assert stop.printed("bridge1: landing, armed at", "bridge4: landing, armed at"), stop.lines
        fleet.wait_for(*(f"bridge{i}: done" for i in THREE))
        assert fleet.finish() == 1  # two processes died
        assert fleet.lines[-2].startswith("fleet: after the flight: bridge1 disarmed")
        assert fleet.lines[-2].endswith(": all disarmed")
        assert "with a fault: bridge4 (replaced), uav3, bridge3" in fleet.lines[-1]
        states = json.loads(send_fault(control, "all state"))
        assert [(each["armed"], each["contact"]) for each in states] == [(False, True)] * 3
    assert min(distances_m) > 0.5
    bag = read_bag(tmp_path / "bag")
    assert bag.topics["/uav1/odom"].messages > 100
    assert len(list(bag.messages(["/formation/epoch"]))) == 2  # form, and the operator's landing
