"""A bag is played as it was recorded; the autopilots' logs beside it."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

import rclpy
from rclpy.node import Node
from typer.testing import CliRunner

from ptnsbc_autopilot.flight_logs import log_bytes
from ptnsbc_autopilot.launch import Fleet, Network, Options, stations
from ptnsbc_autopilot.server import serve
from ptnsbc_io.bag import BagTopic, BagWriter, read_bag
from ptnsbc_io.bag.metadata import declare
from ptnsbc_io.wire import HeaderTemplate, peek_stamp
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.recording.player import profile
from ptnsbc_nodes.runtime.environment import free_domain
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.cli import app

pytestmark = pytest.mark.ros


@pytest.fixture
def domain() -> Iterator[int]:
    """A domain that nobody else uses."""
    with free_domain() as number:
        yield number


@pytest.fixture
def start(domain: int) -> Iterator[Callable[..., subprocess.Popen]]:
    """Start `ptnsbc …` on a domain of our own; whatever still runs at the end is ended."""
    running: list[subprocess.Popen] = []
    settings = {**os.environ, "ROS_DOMAIN_ID": str(domain)}

    def start(*words: object) -> subprocess.Popen:
        command = [sys.executable, "-m", "ptnsbc_tools.cli", *map(str, words)]
        pipe = subprocess.PIPE
        running.append(subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=settings))
        return running[-1]

    yield start
    for process in running:
        process.kill()
        process.communicate()


def await_line(process: subprocess.Popen, wanted: str) -> None:
    while (line := process.stderr.readline()) != f"{wanted}\n":
        assert line, f"it ended before it said {wanted!r}"


@contextmanager
def observer(domain: int) -> Iterator[Node]:
    """A node that sees who is there."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("observer", context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def contents(path: Path, *left_out: str) -> dict[str, list[bytes]]:
    found = defaultdict(list)
    for message in read_bag(path).messages():
        if message.topic not in left_out:
            found[message.topic].append(message.data)
    return dict(found)


@pytest.mark.slow
def test_played_and_recorded_again(start, headless, tmp_path):
    old, again = read_bag(headless), tmp_path / "again"
    scenario = tmp_path / "scenario.yaml"
    scenario.write_bytes(old.attachment("scenario.yaml"))
    recorder = start("network", "node", "recorder", "--bag", again, "--uavs", *range(1, 6), "--attach",
                     f"scenario.yaml={scenario}")  # fmt: skip
    await_line(recorder, "ready")
    played = start("bag", "replay", headless, "--publish", "--wait", 60, "--rate", 0.5, "--json")
    out, err = played.communicate(timeout=120)
    assert played.returncode == 0, err
    recorder.send_signal(signal.SIGINT)
    told, err = recorder.communicate(timeout=60)
    assert recorder.returncode == 0, err
    assert contents(again, "/tf") == contents(headless, "/tf")
    counts = json.loads(told)["topics"]
    made = 0 if topics.tf_is_available() else counts["/tf"]  # of odometry, by the recorder
    assert json.loads(out)["messages"] == sum(counts.values()) - made
    new = read_bag(again)
    # Twice as slow, and paced: the middle message came in the middle.
    assert (new.end_ns - new.start_ns) * 1e-9 >= 2 * 1.4
    # And what was heard can be run again: it is the same flight.
    rerun = start("bag", "replay", again, "--rerun", "--scenario", scenario)
    assert rerun.wait(120) == 0, rerun.stdout.read()


@pytest.mark.slow
def test_some_topics_are_played_with_a_clock(start, headless, tmp_path):
    part = tmp_path / "part"
    recorder = start("network", "node", "recorder", "--bag", part, "--uavs", 1)
    await_line(recorder, "ready")
    played = start("bag", "replay", headless, "--publish", "--wait", 60, "--topics", "/uav1/setpoint/*",
                   "--clock", 100, "--start", 0.5)  # fmt: skip
    assert played.wait(120) == 0, played.stderr.read()
    recorder.send_signal(signal.SIGTERM)
    out, err = recorder.communicate(timeout=60)
    assert recorder.returncode == 0, err
    counts = {name: count for name, count in json.loads(out)["topics"].items() if count}
    assert set(counts) == {"/clock", "/uav1/setpoint/velocity", "/uav1/setpoint/wrench"}
    heard = contents(part)
    assert len(heard["/uav1/setpoint/wrench"]) == 100
    clock = [peek_stamp(data) for data in heard["/clock"]]
    assert clock == sorted(clock)
    assert clock[0] >= 500_000_000


@pytest.mark.slow
def test_ctrl_c_ends_a_loop_in_order(start, domain, headless):
    played = start("bag", "replay", headless, "--publish", "--loop", "--wait", 0, "--json")
    end = time.monotonic() + 60.0
    with observer(domain) as node:
        while not node.count_publishers("/uav1/odom"):
            assert played.poll() is None and time.monotonic() < end
            time.sleep(
                0.05
            )  # between two looks at the graph: the observer has no executor to wait in
    played.send_signal(signal.SIGINT)
    _, err = played.communicate(timeout=60)
    assert played.returncode == 130, err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("info", "reliable", "latched"),
    [
        (declare("/a", "std_msgs/msg/Header"), True, False),
        (declare("/a", "std_msgs/msg/Header", reliable=False, depth=1), False, False),
        (declare("/a", "std_msgs/msg/Header", latched=True, depth=1), True, True),
    ],
)
def test_quality_of_service_as_recorded(info, reliable, latched):
    topic = BagTopic(info.name, info.type, 1, info.channel_metadata["offered_qos_profiles"])
    found = profile(topic)
    assert (found.reliability.name == "RELIABLE") == reliable
    assert (found.durability.name == "TRANSIENT_LOCAL") == latched
    assert found.depth >= info.qos[0]["depth"]


@pytest.mark.parametrize(
    "text",
    [
        *("", "[", "- reliability: 2\n  durability: 2\n", "7", 99 * "[" + 99 * "]"),
        *("- depth: many\n", "- depth: [1]\n", f"- depth: {10**30}\n", "- depth: -1\n"),
    ],
)
def test_quality_of_service_of_others(text):
    expected = "BEST_EFFORT" if "2" in text else "RELIABLE"
    found = profile(BagTopic("/a", "std_msgs/msg/Header", 1, text))
    assert found.reliability.name == expected
    assert 1 <= found.depth <= 100_000


@contextmanager
def flown_vehicles(scenario: Path, count: int) -> Iterator[None]:
    """Stand-ins of the first vehicles of a scenario, which have flown once."""
    stop, ready = threading.Event(), threading.Event()
    options = Options(fleet=Fleet(count, scenario), network=Network(gcs=None), boot_time=0.0)
    fleet = stations(options, time.monotonic(), lambda _line: None)
    for station in fleet:
        station.vehicle.flown = 1
    thread = threading.Thread(target=serve, args=(fleet, stop.is_set), kwargs={"ready": ready.set})
    thread.start()
    try:
        assert ready.wait(20.0)
        yield
    finally:
        stop.set()
        thread.join()


def test_the_autopilots_logs_are_laid_into_the_folder_of_the_bag(tmp_path):
    keys = {"mavlink.vehicles.1.label": "red, Ada", "mavlink.vehicles.2.autopilot": "ardupilot"}
    for uav in (1, 2):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            keys[f"mavlink.vehicles.{uav}.connect"] = f"udpout:127.0.0.1:{free.getsockname()[1]}"
    text = load_scenario("examples/three.yaml", keys).text
    flight, scenario = tmp_path / "flight", tmp_path / "three.yaml"
    scenario.write_text(text)
    attached = {"scenario.yaml": text.encode()}
    with BagWriter(flight, [declare("/a", "std_msgs/msg/Header")], attachments=attached) as bag:
        bag.write("/a", 0, HeaderTemplate("map").encode(0))
    (flight / "uav3.ulg").touch()
    with flown_vehicles(scenario, 2):
        done = CliRunner().invoke(app, ["bag", "logs", str(flight)])
    assert done.exit_code == 1, done.output
    assert (flight / "uav1.ulg").read_bytes() == log_bytes(1, 1)
    assert (flight / "uav2.bin").read_bytes() == log_bytes(2, 1)
    assert done.stdout.splitlines() == [
        f"uav1 (red, Ada): 9123 bytes: {flight}/uav1.ulg",
        f"uav2: 9123 bytes: {flight}/uav2.bin",
    ]
    assert f"uav3: {flight}/uav3.ulg exists: move it away, or give --overwrite" in done.stderr
    assert (flight / "uav3.ulg").read_bytes() == b""
    assert CliRunner().invoke(app, ["bag", "info", str(flight), "--check"]).exit_code == 0
