"""The fleet from the command line: the same flight as in one process, bit for bit."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from ptnsbc_io.bag import read_bag

pytestmark = [
    pytest.mark.slow,
    pytest.mark.ros,
    pytest.mark.skipif(find_spec("rclpy") is None, reason="needs rclpy"),
]


def run(*words: object) -> tuple[int, str, str]:
    """In a process of its own: rclpy wants real streams."""
    command = [sys.executable, "-m", "ptnsbc_tools.cli", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    return done.returncode, done.stdout, done.stderr


def assert_same_flight(fleet: Path, alone: Path) -> set[str]:
    """Every message of both bags is equal, topic by topic; returns the topics."""
    first, second = (list(read_bag(bag).messages()) for bag in (fleet, alone))
    assert [message[:2] for message in first] == [message[:2] for message in second]
    assert [a.topic for a, b in zip(first, second, strict=True) if a.data != b.data] == []
    return {message.topic for message in first}


def test_a_fleet_in_lockstep_flies_what_one_process_flies(tmp_path: Path) -> None:
    """Noise and losses included, and with the same verdict."""
    words = ("experiment_4", "--duration", "3", "--json")
    together, flown, err = run("fleet", *words, "--lockstep", "--bag", tmp_path / "fleet")
    alone, simulated, _ = run("simulate", *words, "--bag", tmp_path / "alone")
    assert together == alone == 1, err  # three seconds are too short for the deadline
    assert "/uav1/truth" in assert_same_flight(tmp_path / "fleet", tmp_path / "alone")
    told, expected = json.loads(flown), json.loads(simulated)
    assert told["uavs"] == expected["uavs"]
    assert told["fleet"]["died"] == []


def test_demo_leaves_a_bag_a_verdict_and_a_picture(tmp_path: Path) -> None:
    """Of the flight of `paper_5` as one process flies it."""
    code, out, err = run("demo", "--duration", "2", "--out", tmp_path, "--json")
    assert code == 1, err
    data = json.loads(out)
    assert Path(data["picture"]).read_bytes().startswith(b"\x89PNG")
    assert read_bag(data["bag"]).topics["/uav5/odom"].messages == 200
    words = ("paper_5", "--duration", "2", "--json", "--bag", tmp_path / "alone")
    code, simulated, _ = run("simulate", *words)
    assert (code, json.loads(simulated)["uavs"]) == (1, data["uavs"])
    assert "/uav1/truth" not in assert_same_flight(data["bag"], tmp_path / "alone")
