"""Each executable as a process: it comes up under its name, and a signal ends it cleanly."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import textwrap
from itertools import cycle
from pathlib import Path
from types import SimpleNamespace

import pytest
from domain_ports import first_port
from own_services import PARAMETERS

pytest.importorskip("rclpy")

import pytest

from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.runtime import node_process as processes

ROOT = Path(__file__).resolve().parents[3]
PATIENCE_S = 240  # the first flight compiles the laws

pytestmark = [pytest.mark.ros, pytest.mark.slow]


@pytest.fixture
def start(domain, tmp_path):
    """Starts modules of ptnsbc_nodes as processes of their own."""
    running = []

    def begin(module, *arguments):
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        process = subprocess.Popen(
            [sys.executable, "-m", f"ptnsbc_nodes.{module}", *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
            cwd=ROOT,
        )
        running.append(process)
        return process

    yield begin
    for process in running:
        if process.poll() is None:
            process.kill()
            process.communicate()


def commands(tmp_path, domain):
    """Name in the graph of each kind of process: how it is started."""
    found = {
        "/uav1/controller": ("uav.uav_main", "--scenario", "paper_5", "--uav", 1),
        "/uav2/controller": ("uav.uav_main", "--scenario", "paper_5", "--uav", 2, "--lockstep"),
        "/sim": ("sim.sim_main", "--scenario", "paper_5"),
        "/recorder": ("recording.recorder_main", "--bag", tmp_path / "bag", "--uavs", 1, 2),
    }
    try:
        import pymavlink  # noqa: F401
    except ImportError:
        return found
    link = ("--connect", f"udpin:127.0.0.1:{first_port(domain)}")
    bridge = ("bridge.bridge_main", "--scenario", "experiment_4", "--uav", 3, *link)
    return {**found, "/uav3/bridge": bridge}


def test_a_signal_ends_every_process_cleanly(ros, start, tmp_path):
    """SIGINT and SIGTERM in turn, which have one handler."""
    processes = {name: start(*words) for name, words in commands(tmp_path, ros.domain).items()}
    looker = ros.node("looker")

    def up():
        for name, process in processes.items():
            assert process.poll() is None, (name, process.communicate())
        seen = looker.get_node_names_and_namespaces()
        return processes.keys() <= {f"{space.rstrip('/')}/{name}" for name, space in seen}

    ros.spin_until(up, timeout=PATIENCE_S)
    for process, number in zip(processes.values(), cycle((signal.SIGINT, signal.SIGTERM))):
        process.send_signal(number)
    for name, process in processes.items():
        _, err = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, (name, err)
        assert "Traceback" not in err, (name, err)


NODE = textwrap.dedent(
    """
    import time
    from ptnsbc_nodes.runtime.node_process import Arguments, ProcessLifetime, ros_context, ros_node, run

    class Quiet:
        def last_word(self):
            pass

        def flush(self, timeout_s):
            pass

    def body(arguments, argv):
        lifetime = ProcessLifetime()
        with ros_context(argv), ros_node("spinner", "") as node:
            node.create_timer(0.5, lambda: print("tick", flush=True))
            began = time.process_time()
            lifetime.serve([node], lambda: [Quiet()])
            print(time.process_time() - began, flush=True)
        return 0

    raise SystemExit(run(Arguments("spinner", ""), ["--scenario", "paper_5"], body))
    """
)


def test_a_node_waits_without_burning_the_processor(domain):
    """EventsExecutor.spin() of the wheels is a busy loop; ours must not be."""
    process = subprocess.Popen(
        [sys.executable, "-c", NODE],
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
    )
    told = [process.stdout.readline() for _ in range(6)]
    assert told == ["tick\n"] * 6
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    *_, used_s = out.split()
    # A busy loop takes all of the 2.5 s of waiting that it is given.
    assert float(used_s) < 0.5


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--ros-args", "--params-file", "nowhere.yaml"), "nowhere.yaml"),
        (("--ros-args", "-r", "bad"), "bad"),
        (("--ros-args", "-p", "gains.profile:=reference"), "--set gains.profile=VALUE"),
    ],
)
def test_arguments_that_ros_refuses_are_one_line_and_exit_2(start, arguments, says):
    process = start("uav.uav_main", "--scenario", "paper_5", "--uav", 3, *arguments)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, out) == (2, "")
    assert err.startswith("uav: ") and says in err
    assert err.count("\n") == 1


class Deaf:
    """A node of which one reader acknowledges nothing, by a clock that only its waiting moves."""

    now_s = 0.0

    def __init__(self, words):
        self._words = words

    def last_word(self):
        self._words.append(Deaf.now_s)

    def flush(self, timeout_s):
        Deaf.now_s += timeout_s


def test_several_nodes_of_a_process_wait_for_their_readers_together(ros, monkeypatch):
    """Fast DDS asks a reader again after 3 s: one after the other, five nodes outlasted their launcher's patience."""
    node, words = ros.node("first"), []
    monkeypatch.setattr(Deaf, "now_s", 0.0)
    monkeypatch.setattr(processes, "time", SimpleNamespace(monotonic=lambda: Deaf.now_s))
    monkeypatch.setattr(
        processes, "make_executor", lambda _: SimpleNamespace(add_node=id, shutdown=int)
    )
    reports: list[str] = []
    monkeypatch.setattr(processes, "report_finished", reports.append)
    lifetime = processes.ProcessLifetime()
    lifetime.end("landed early")
    lifetime.end()  # of the signal that follows
    lifetime.serve([node], lambda: [Deaf(words) for _ in range(5)])
    assert reports == ["landed early"]
    assert words == [0.0] * 5
    assert Deaf.now_s == processes.FLUSH_S


def test_messages_of_a_node_that_uses_them_at_ticks_wait_for_the_next_one(ros, monkeypatch):
    """Each of 1000 wrenches a second woke the sim of twenty UAVs; it took 0.30 cores, and 0.20 since."""
    node, happened = ros.node("resting"), []
    lifetime = processes.ProcessLifetime()
    ticks = iter([None, 0.015, None, None, -0.001, 90.0])  # after each callback

    def spin_once(timeout_sec):
        happened.append(("served", timeout_sec))
        if len(happened) == 8:
            lifetime.end()

    clock = SimpleNamespace(
        monotonic=lambda: 0.0, sleep=lambda rest_s: happened.append(("rested", rest_s))
    )
    monkeypatch.setattr(processes, "time", clock)
    executor = SimpleNamespace(add_node=id, shutdown=int, spin_once=spin_once)
    monkeypatch.setattr(processes, "make_executor", lambda _: executor)
    lifetime.serve([node], lambda: [Deaf([])], rest_s=lambda: next(ticks))
    served = ("served", processes._SIGNAL_CHECK_S)
    assert happened == [
        *(served, served, ("rested", 0.015)),
        *(served, served, served, ("rested", processes._LEAST_REST_S)),
        *(served, ("rested", processes._SIGNAL_CHECK_S)),
    ]


def test_a_tick_leaves_nothing_behind(ros, monkeypatch):
    """A sim in real time grew by 32 bytes in each tick: half a percent in ten minutes at 50 Hz."""
    node, lifetime, blocks = ros.node("ticking"), processes.ProcessLifetime(), []

    def tick():
        blocks.append(sys.getallocatedblocks())
        if len(blocks) == 1200:
            lifetime.end()

    node.create_timer(0.0005, tick)
    lifetime.serve([node], lambda: [Deaf([])], rest_s=lambda: 0.0)
    # The list of figures itself takes one block for each.
    assert blocks[-1] - blocks[200] < 1000 + 500


HANGS = """
import argparse, ctypes
from ptnsbc_nodes.runtime import node_process as process
process.TEARDOWN_S = 0.2

def body(arguments, argv):
    process.report_finished("all is done")
    ctypes.PyDLL(None).sleep(600)  # with Python's lock, as the middleware does it
    return 0

process.run(argparse.ArgumentParser(), None, body)
"""


def test_a_process_that_the_middleware_keeps_after_its_work_is_ended():
    process = subprocess.run(
        [sys.executable, "-c", HANGS], cwd=ROOT, timeout=PATIENCE_S, check=False
    )
    assert process.returncode == -signal.SIGALRM


COLUMNS = {"publishes": 3, "hears": 4}


def listed(what, node):
    """Topics that docs/architecture.md lists for a kind of node, with N for the number of a UAV."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = text.partition("<!-- made: topics -->")[2].partition("<!-- /made -->")[0].splitlines()
    cells = [[cell.strip(" `") for cell in row.split("|")[1:-1]] for row in rows if "`/" in row]
    return {row[0] for row in cells if node in row[COLUMNS[what]]}


def plain(names):
    return {re.sub(r"^/uav\d+/(?!bridge/)", "/uavN/", name) for name in names}


# Topics that paper_5 has no use for, and those of a bridge that leads, or has an operator or other settings.
UNUSED = {
    "/sim": {"publishes": {"/uavN/truth"}, "hears": {"/formation/recorded"}},
    "/uav3/bridge": {
        "publishes": {"/formation/origin"},
        "hears": {"/uavN/setpoint/wrench", "/formation/setpoint_taken"},
    },
}


@pytest.mark.parametrize("name", ["/sim", "/uav3/bridge"])
def test_the_graph_shows_what_the_architecture_lists(ros, start, tmp_path, name):
    """As `ros2 node info` asks, of a process as it is started."""
    words = commands(tmp_path, ros.domain).get(name)
    if words is None:
        pytest.skip("pymavlink is not installed")
    process, looker = start(*words), ros.node("looker")
    space, _, node = name.rpartition("/")
    kind = "bridge" if name.endswith("bridge") else "sim"
    own = {f"{name}/{service}" for service in PARAMETERS}
    asked = {
        "publishes": looker.get_publisher_names_and_types_by_node,
        "hears": looker.get_subscriber_names_and_types_by_node,
        "serves": looker.get_service_names_and_types_by_node,
        "calls": looker.get_client_names_and_types_by_node,
    }
    besides = {"/parameter_events", "/rosout"}
    if topics.tf_is_available():
        besides.add(topics.TF.name)
    expected = {
        "publishes": (listed("publishes", kind) | besides) - UNUSED[name]["publishes"],
        "hears": listed("hears", kind) - UNUSED[name]["hears"],
        "serves": own | {f"{name}/get_type_description"},
        "calls": set(),
    }

    def shown():
        assert process.poll() is None, process.communicate()
        if (node, space or "/") not in looker.get_node_names_and_namespaces():
            return {}
        return {
            what: plain(topic for topic, _ in ask(node, space or "/"))
            for what, ask in asked.items()
        }

    with contextlib.suppress(TimeoutError):
        ros.spin_until(lambda: shown() == expected, timeout=PATIENCE_S)
    assert shown() == expected


def test_a_message_after_a_slice_does_not_end_what_is_waited_for_next():
    """It ended the wait for the answer of a service: the leader was said to be silent."""
    from ptnsbc_nodes.runtime.node_process import BoundedSpin

    waited = []
    slices = BoundedSpin(
        SimpleNamespace(
            spin_until_future_complete=lambda future, timeout_sec: waited.append(future)
        )
    )
    slices.serve(0.0)
    slices.look()
    assert [future.done() for future in waited] == [False]


@pytest.mark.ros
def test_a_slice_ends_although_more_is_waiting(ros):
    """A recorder that is behind must see the signal that ends it, and take in the rest for so long at most."""
    from rclpy.duration import Duration
    from std_msgs.msg import Empty

    from ptnsbc_nodes.runtime.node_process import BoundedSpin

    node, slices, heard = ros.node("behind"), BoundedSpin(ros.executor), []

    def on_message(message):
        heard.append(message)
        slices.look()

    node.create_subscription(Empty, "many", on_message, 100)
    publisher = node.create_publisher(Empty, "many", 100)
    ros.spin_until(publisher.get_subscription_count)
    ros.spin_for(
        0.01
    )  # what has come before the executor knows the subscription is one event to it
    take_rest = (
        lambda: slices.serve(0.0, longest_s=10.0),
        lambda: slices.drain(lambda: len(heard), quiet_s=0.2, limit_s=10.0),
    )
    for count, take in enumerate(take_rest, start=1):
        for _ in range(100):
            publisher.publish(Empty())
        assert publisher.wait_for_all_acked(Duration(seconds=5))
        assert slices.serve(0.0)
        assert len(heard) < 100 * count
        assert not take()
        assert len(heard) == 100 * count
