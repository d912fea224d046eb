"""Whole fleets of real processes: equal bytes, deaths in flight, and nobody left behind."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

from std_srvs.srv import Trigger

from ptnsbc_io import wire
from ptnsbc_io.bag import BagError, read_bag
from ptnsbc_nodes.fleet.child_process import ProcessCommand
from ptnsbc_nodes.fleet.fleet import FleetError, FleetOptions, _killed_by, run_fleet
from ptnsbc_nodes.view.observer import Observer
from ptnsbc_sim.scenario import load_scenario, scenario_from_text
from ptnsbc_sim.swarm import fly
from ptnsbc_tools.library.flight import flight_in
from ptnsbc_tools.replay.rerun import rerun

pytestmark = pytest.mark.ros

SCENARIOS = Path(__file__).parents[3] / "scenarios"
EXAMPLES = Path(__file__).parents[3] / "examples"
THREE = EXAMPLES / "three.yaml"


def counts(bag):
    return {name: topic.messages for name, topic in bag.topics.items()}


@pytest.mark.slow
def test_a_lockstep_flight_has_the_bytes_of_the_headless_one(launch, tmp_path):
    """All UAVs in one process: those that have their own send the same, as a slow test shows."""
    flight = launch("--duration", "0.5", "--processes", "1", "--bag", str(tmp_path / "bag"))
    assert flight.finish() == 0, flight.lines
    assert not flight.running()
    bag = read_bag(tmp_path / "bag")
    scenario = load_scenario("paper_5", {"timing.duration_s": 0.5})
    told = counts(bag)
    assert told["/clock"] == told["/uav5/setpoint/wrench"] == scenario.timing.ticks
    assert told["/diagnostics"] == 3 * (1 + len(scenario.uav_ids))
    assert_as_headless(bag, scenario)


MISSION = """
extends: mission_6
timing: {duration_s: 6}
mission:
  legs:
    - {kind: take_off, height_m: 2, over_s: 2}
    - {kind: form, over_s: 2}
    - {kind: follow, over_s: 1, trajectory: {kind: circle, centre_m: [0, 0, 4], radius_m: 1, rate_rad_s: 0.2}}
    - {kind: split, at_s: 5, over_s: 0.2, head: 3, trajectory: {kind: hover, position_m: [-1, -1, 4]}}
    - {kind: change, over_s: 0.1, scale: [1.1, 1, 1]}
    - {kind: join, over_s: 0.1}
    - {kind: land, at_s: 5.41, over_s: 10}
"""


@pytest.mark.slow
def test_a_mission_flown_by_processes_in_lockstep_has_the_bytes_of_the_headless_one(
    launch, tmp_path
):
    """The landing begins between two ticks."""
    (tmp_path / "short.yaml").write_text(MISSION)
    scenario = load_scenario(tmp_path / "short.yaml")
    words = ("--scenario", str(tmp_path / "short.yaml"), "--processes", "2")
    flight = launch(*words, "--bag", str(tmp_path / "bag"))
    assert flight.finish() == 0, flight.lines
    bag = read_bag(tmp_path / "bag")
    assert counts(bag)["/clock"] == scenario.timing.ticks
    assert_as_headless(bag, scenario)


@pytest.mark.slow
def test_processes_with_several_parents_have_the_bytes_of_the_headless_flight(tmp_path):
    """With messages that get lost; the bag runs again."""
    changes = {
        "communication.parents": {4: {2: 0.3, 3: 0.7}, 5: {3: 0.5, 4: 0.5}},
        "communication.loss": 0.3,
        "formation.task": "relative_position",
        "timing.duration_s": 1.0,
    }
    scenario = load_scenario("paper_5", changes)
    options = FleetOptions(scenario, lockstep=True, bag=tmp_path / "bag", processes=2)
    assert run_fleet(options).exit_code == 0
    bag = read_bag(tmp_path / "bag")
    assert_as_headless(bag, scenario)
    carried = scenario_from_text(bag.attachment("scenario.yaml").decode())
    assert rerun(bag, carried).verdict == "equal"


AMONG_OBSTACLES = f"""
extends: yard
timing: {{duration_s: 3}}
leader: {{trajectory: {{position_m: [2.5, 0, 3]}}}}
world:
  obstacles:
    - {{name: yard, kind: map, file: {SCENARIOS / "yard.pcd"}, resolution_m: 0.5, keep_out_m: 0.5}}
    - {{name: box, kind: box, position_m: [3.6, 0.6, 3.4], size_m: [0.4, 0.4, 0.4], keep_out_m: 0.5}}
    - {{name: ball, keep_out_m: 0.8, trajectory: {{kind: line, position_m: [1, 3, 2], velocity_m_s: [0, -1, 0]}}}}
uavs:
  - {{id: 1, position_m: [2.5, 0, 1]}}
  - {{id: 2, position_m: [1, 1, 1]}}
  - {{id: 3, position_m: [1, -1, 1]}}
  - {{id: 4, position_m: [-0.5, 2, 1]}}
  - {{id: 5, position_m: [-0.5, -2, 1]}}
"""


@pytest.mark.slow
def test_processes_among_obstacles_have_the_bytes_of_the_headless_flight(tmp_path):
    """A point cloud, a box and a ball that comes, each of which turns somebody."""
    (tmp_path / "among.yaml").write_text(AMONG_OBSTACLES)
    scenario = load_scenario(tmp_path / "among.yaml")
    options = FleetOptions(scenario, lockstep=True, bag=tmp_path / "bag", processes=1)
    assert run_fleet(options).exit_code == 0
    assert_as_headless(read_bag(tmp_path / "bag"), scenario)
    flown = fly(scenario).track.odometry[:, :, :3]
    obstacles = yaml.safe_load(AMONG_OBSTACLES)["world"]["obstacles"]
    for row in range(len(obstacles)):
        others = {"world.obstacles": obstacles[:row] + obstacles[row + 1 :]}
        without = fly(load_scenario(tmp_path / "among.yaml", others)).track.odometry
        assert np.abs(flown - without[:, :, :3]).max() > 0.3, obstacles[row]["name"]


BETWEEN_WALLS = """
extends: corridor
timing: {duration_s: 6}
communication: {tree: {2: 1, 3: 1}, leader_links: [2, 3], estimator_edges: [[2, 3]]}
leader: {trajectory: {position_m: [0, 0, 2.9]}}
formation: {changes: [], shape: {spacing_m: 2.2}}
world:
  obstacles:
    - {name: box, kind: box, position_m: [3, 4.5, 2.5], size_m: [12, 6, 5], keep_out_m: 0.5}
    - {name: half_space, kind: half_space, position_m: [0, -1.5, 0], normal: [0, 1, 0], keep_out_m: 0.5}
    - {name: plane, kind: plane, position_m: [0, 0, 3.2], normal: [0, 0, 1], keep_out_m: 0.5}
    - {name: ground, kind: ground, height_m: 0, keep_out_m: 0.3}
uavs:
  - {id: 1, position_m: [0, 0, 1]}
  - {id: 2, position_m: [-1.5, 0.8, 1]}
  - {id: 3, position_m: [-1.5, -0.8, 1]}
"""


@pytest.mark.slow
def test_processes_between_walls_have_the_bytes_of_the_headless_flight(tmp_path):
    """A box on the left, a half-space on the right and a plane above, each nearer to a place than its keep-out."""
    (tmp_path / "walls.yaml").write_text(BETWEEN_WALLS)
    scenario = load_scenario(tmp_path / "walls.yaml")
    options = FleetOptions(scenario, lockstep=True, bag=tmp_path / "bag", processes=1)
    assert run_fleet(options).exit_code == 0
    bag = read_bag(tmp_path / "bag")
    assert_as_headless(bag, scenario)
    flown = [wire.decode_odometry(one.data) for one in bag.messages(["/uav2/odom", "/uav3/odom"])]
    times = np.array([one.stamp_ns for one in flown]) * 1e-9
    places = np.array([one.values[:3] for one in flown])
    near_m = {
        one.name: (one.distances(places, times) - one.keep_out_m).min()
        for one in scenario.world.bodies
    }
    assert min(near_m.values()) > 0.0
    assert max(near_m[name] for name in ("box", "half_space", "plane")) < 0.1


def assert_as_headless(bag, scenario):
    """What the processes sent is what the same flight has without processes, to the last bit."""
    track = fly(scenario).track
    expected = {
        "odom": (wire.decode_odometry, track.odometry),
        "formation_state": (wire.decode_odometry, track.reported),
        "leader_estimate": (wire.decode_odometry, track.estimate),
        "setpoint/wrench": (wire.decode_wrench, track.wrench),
    }
    for row, uav in enumerate(scenario.uav_ids):
        for topic, (decode, values) in expected.items():
            for message in bag.messages([f"/uav{uav}/{topic}"]):
                stamp_ns, found = decode(message.data)
                assert message.stamp_ns == stamp_ns
                tick = stamp_ns // scenario.timing.dt_ns
                assert found.tobytes() == np.ascontiguousarray(values[tick, row]).tobytes()


@pytest.mark.slow
def test_lockstep_flights_by_the_same_processes_have_equal_files(tmp_path):
    """In a namespace. By other processes the messages are equal: every flight here has those of the headless one."""
    scenario = load_scenario("paper_5", {"timing.duration_s": 0.5})
    for name in ("first", "second"):
        bag, logs = tmp_path / name / "bag", tmp_path / name / "logs"
        options = FleetOptions(
            scenario, lockstep=True, bag=bag, log_dir=logs, processes=2, namespace="/blue"
        )
        flown = run_fleet(options)
        assert flown.exit_code == 0
        assert [p.name for p in flown.processes] == ["recorder", "uav1-2", "uav3-5", "sim"]
    assert counts(read_bag(bag))["/uav5/setpoint/wrench"] == scenario.timing.ticks
    files = sorted(path.name for path in bag.iterdir())
    assert files == ["bag_0.mcap", "metadata.yaml"]
    for file in files:
        first, second = (tmp_path / name / "bag" / file for name in ("first", "second"))
        assert first.read_bytes() == second.read_bytes(), file


@pytest.mark.slow
@pytest.mark.alone
def test_functions_of_the_user_fly_in_real_time_to_their_deadline_and_run_again(tmp_path):
    """Task, controller, plant, disturbance and sensor at once, by the wall clock."""
    scenario = load_scenario(EXAMPLES / "plugins" / "all.yaml")
    bag = tmp_path / "bag"
    flown = run_fleet(FleetOptions(scenario, bag=bag, log_dir=tmp_path / "logs", processes=2))
    assert (flown.died, flown.exit_code) == ((), 0)
    found = flight_in(bag).verdict
    assert found.verdict == "met", found
    assert rerun(read_bag(bag), scenario).verdict == "equal"


@pytest.mark.slow
@pytest.mark.alone
def test_terminals_that_join_in_flight_and_leave_delay_no_setpoint(tmp_path, domain, monkeypatch):
    """Once all UAVs were silent for 1.2 to 1.7 s while a `stop --ready` was discovered."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    words = [sys.executable, "-m", "ptnsbc_tools", "stop", "--ready"]
    said = []

    def come_and_go():
        for _ in range(5):  # without a terminal it leaves once it has joined
            done = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True)
            said.append(done.stderr)

    def progress(line):
        if line.endswith("started"):
            visitors.start()

    visitors = threading.Thread(target=come_and_go)
    scenario = load_scenario("paper_5", {"timing.duration_s": 20.0})
    bag = tmp_path / "bag"
    flown = run_fleet(FleetOptions(scenario, bag=bag, log_dir=tmp_path / "logs"), progress)
    visitors.join()
    assert flown.exit_code == 0
    assert len(said) == sum("the input has ended" in words for words in said) == 5, said
    stamps = {uav: [] for uav in scenario.uav_ids}
    for message in read_bag(bag).messages([f"/uav{uav}/setpoint/wrench" for uav in stamps]):
        stamps[int(message.topic[4])].append(message.stamp_ns)
    gaps_s = {uav: np.diff(times).max() * 1e-9 for uav, times in stamps.items()}
    assert max(gaps_s.values()) < 0.3, gaps_s


@pytest.mark.slow
def test_the_end_of_a_process_is_the_end_of_its_uavs(launch, tmp_path):
    """The others fly to the end."""
    flight = launch("--duration", "30", "--processes", "2", "--bag", str(tmp_path / "bag"))
    flight.wait_for("steps/s")
    os.kill(flight.pid_of("--uav 3 4 5"), signal.SIGKILL)
    flight.wait_for("uav3-5 (pid ", "signal SIGKILL")
    assert flight.finish() == 1
    assert "with a fault: uav3-5" in flight.lines[-1]
    assert not flight.running()
    told = counts(read_bag(tmp_path / "bag"))
    assert told["/uav1/setpoint/wrench"] == told["/clock"] == 3000
    assert all(0 < told[f"/uav{i}/setpoint/wrench"] < 3000 for i in (3, 4, 5))


@pytest.mark.slow
def test_who_dies_in_flight_is_named_and_the_others_fly_on(launch, tmp_path):
    """One UAV is killed, one hangs; without the sim there is nothing left to fly, and the bag is complete."""
    words = ("--scenario", str(THREE), "--duration", "400", "--bag", str(tmp_path / "bag"))
    flight = launch(*words)
    flight.wait_for("started")
    os.kill(flight.pid_of("--uav 3"), signal.SIGKILL)
    flight.wait_for("uav3 (pid ", "signal SIGKILL")
    flight.wait_for("steps/s")
    os.kill(flight.pid_of("--uav 2"), signal.SIGSTOP)
    flight.wait_for("sim: no answer from", "uav2 for 3 s")
    flight.wait_for("uav2 (pid ", "is stuck: it is ended")
    flight.wait_for("uav2 (pid ", "signal SIGKILL")
    flight.wait_for("steps/s")
    os.kill(flight.pid_of("sim.sim_main"), signal.SIGKILL)
    flight.wait_for("sim (pid ", "signal SIGKILL")
    assert flight.finish() == 1
    assert "with a fault: uav3, uav2, sim" in flight.lines[-1]
    assert not flight.running()
    bag = read_bag(tmp_path / "bag")
    told = counts(bag)
    killed, hung, flew = (told[f"/uav{i}/setpoint/wrench"] for i in (3, 2, 1))
    assert killed < hung < min(flew, told["/uav3/odom"])
    # Its vehicle hovers where it was lost.
    last = [wire.decode_odometry(m.data).values for m in bag.messages(["/uav3/odom"])][-2:]
    assert last[0].tolist() == last[1].tolist()
    assert scenario_from_text(bag.attachment("scenario.yaml").decode()).name == "three"


FAILING_LAW = """
def law(inputs):
    if inputs.t > 0.5 and inputs.offset[1] > 0.0:
        raise ValueError("no way out")
    return (0.0, 0.0, 0.0)
"""


@pytest.mark.slow
def test_a_law_that_raises_in_flight_is_named_by_file_and_line_and_its_vehicle_hovers(
    launch, tmp_path
):
    (tmp_path / "mine.py").write_text(FAILING_LAW)
    (tmp_path / "flown.yaml").write_text(f"extends: {THREE}\nlaw: mine.py:law\n")
    bag = tmp_path / "bag"
    words = ("--scenario", str(tmp_path / "flown.yaml"), "--duration", "1.5", "--bag", str(bag))
    flight = launch(*words)
    assert flight.finish() == 1
    assert f"{tmp_path}/mine.py:4: law: ValueError: no way out" in "\n".join(flight.lines)
    assert "with a fault: uav3" in flight.lines[-1]  # the only UAV whose place is on the left
    assert not flight.running()
    flown = read_bag(bag)
    told = counts(flown)
    assert told["/uav3/setpoint/wrench"] < told["/uav2/setpoint/wrench"]
    hovers = [wire.decode_odometry(m.data).values for m in flown.messages(["/uav3/odom"])][-2:]
    assert hovers[0].tolist() == hovers[1].tolist()


@pytest.mark.slow
def test_without_its_recorder_the_flight_goes_on_and_the_bag_can_be_mended(launch, tmp_path):
    """To its end, without one of the UAVs as well."""
    flight = launch("--duration", "20", "--bag", str(tmp_path / "bag"))
    flight.wait_until_flown(5.5)  # the sim is 4 s ahead of the recorder at most
    os.kill(flight.pid_of("ptnsbc_nodes.recording.recorder_main"), signal.SIGKILL)
    flight.wait_for("recorder (pid ", "signal SIGKILL")
    os.kill(flight.pid_of("--uav 3"), signal.SIGKILL)
    assert flight.finish() == 1
    assert any("sim: 20.00 of 20 s" in line for line in flight.lines)
    assert "with a fault: recorder, uav3" in flight.lines[-1]
    assert not flight.running()
    with pytest.raises(BagError, match="ptnsbc bag repair"):
        read_bag(tmp_path / "bag")
    assert counts(read_bag(tmp_path / "bag.part", salvage=True))["/uav1/odom"] > 100


@pytest.mark.slow
def test_ctrl_c_ends_the_flight_in_order(launch, tmp_path):
    flight = launch("--duration", "200", "--processes", "2", "--bag", str(tmp_path / "bag"))
    flight.wait_until_flown(1.5)
    flight.process.send_signal(signal.SIGINT)
    assert flight.finish() == 130
    assert "interrupted" in flight.lines[-1]
    assert not flight.running()
    told = counts(read_bag(tmp_path / "bag"))
    assert told["/uav1/odom"] > 100


@pytest.mark.slow
def test_no_process_outlives_a_killed_launcher(launch):
    flight = launch("--duration", "600", "--processes", "2")
    flight.wait_for("started")
    assert len(flight.running()) == 3
    flight.process.kill()
    assert flight.all_end(within_s=60)


@pytest.mark.slow
def test_a_process_that_dies_before_the_flight_is_shown_with_its_log(launch, tmp_path):
    too_long = "b" * 252  # with the `.part` of the recorder, and of nobody before
    flight = launch("--processes", "1", "--bag", str(tmp_path / too_long))
    assert flight.finish() == 2
    text = "\n".join(flight.lines)
    assert "before the flight: recorder (pid " in text
    assert "cannot be created" in text
    assert not flight.running()


def test_who_is_late_is_named(tmp_path):
    scenario = load_scenario("paper_5")
    options = FleetOptions(scenario, lockstep=True, log_dir=tmp_path, ready_timeout_s=0.0)
    with pytest.raises(FleetError, match=r"not ready in time: uav1"):
        run_fleet(options)


@pytest.mark.slow
def test_a_fleet_that_waits_flies_its_mission_when_any_client_of_ros_starts_it(ros, tmp_path):
    (tmp_path / "short.yaml").write_text(MISSION)
    scenario = load_scenario(tmp_path / "short.yaml")
    said, told = [], []

    def order():
        domain = int(next(line for line in said if line.startswith("domain "))[7:].split(",")[0])
        try:
            with Observer(domain, "", "health") as observer:
                told.append(observer.ailments(["uav1", "uav6", "sim"], 60.0))
            other = type(ros)(domain)
            client = other.node("client").create_client(Trigger, "/formation/start")
            other.spin_until(client.service_is_ready)
            call = client.call_async(Trigger.Request())
            other.spin_until(call.done)
            told.append(call.result().success)
            other.close()
        except TimeoutError:  # the flight has not begun, and would wait for ever
            os.kill(os.getpid(), signal.SIGINT)

    client = threading.Thread(target=order)

    def progress(line):
        said.append(line)
        if line.startswith("all are ready"):
            client.start()

    options = FleetOptions(scenario, lockstep=True, log_dir=tmp_path, wait=True, processes=2)
    flown = run_fleet(options, progress)
    client.join()
    assert told == [{}, True]
    assert flown.exit_code == 0
    assert any(line.endswith("processes are ready: started") for line in said)


def test_an_existing_bag_is_refused_before_anything_starts(tmp_path):
    (tmp_path / "bag").mkdir()
    said = []
    options = FleetOptions(load_scenario("paper_5"), bag=tmp_path / "bag")
    with pytest.raises(BagError, match="choose another name, or overwrite it"):
        run_fleet(options, said.append)
    assert said == []


def test_a_uav_that_the_scenario_kills_has_not_died():
    """Only of a signal, only a UAV, and only one that the scenario names: `relay` kills 1 and restarts 5.

    The bridge of such a UAV lands its vehicle after a while, and ends with 1.
    """

    def ended(name, exit_code, *uavs):
        module = "ptnsbc_nodes.bridge.bridge_main" if name.startswith("bridge") else "other"
        return SimpleNamespace(
            name=name, exit_code=exit_code, command=ProcessCommand(name, module, (), uavs)
        )

    gone = [ended("uav1", -9, 1), ended("uav5", -9, 5), ended("uav2", -9, 2), ended("sim", -9)]
    assert _killed_by(load_scenario("relay"), gone) == ("uav1", "uav5")
    assert _killed_by(load_scenario("relay"), [ended("uav1", 1, 1), ended("uav5", -15, 5)]) == ()
    assert _killed_by(load_scenario("paper_5"), gone) == ()
    bridges = [ended("bridge1", 1, 1), ended("bridge2", 1, 2), ended("bridge5", -9, 5)]
    assert _killed_by(load_scenario("relay"), bridges) == ("bridge1",)
