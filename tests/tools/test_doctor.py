"""The doctor: what it finds where something is wrong, and that each finding says what to change."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ptnsbc_core.compile_cache import source_digest
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools import doctor
from ptnsbc_tools.check import ERROR, INFO, WARNING
from ptnsbc_tools.cli import app


def test_the_command_prints_what_is_found() -> None:
    result = CliRunner().invoke(app, ["doctor", "--json"])
    keys = {one["key"] for one in json.loads(result.stdout)["findings"]}
    assert {"platform", "cores", "timers", "middleware", "clock", "cache", "disk"} <= keys
    assert CliRunner().invoke(app, ["doctor", "nowhere"]).exit_code == 2


def test_what_is_no_information_says_what_to_change() -> None:
    for one in doctor.examine():
        assert one.severity == INFO or one.advice, one


def test_a_port_in_use_is_an_error() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        place = f"127.0.0.1:{taken.getsockname()[1]}"
        keys = {"mavlink.vehicles.2.connect": f"udpin:{place}"}
        found = {one.key: one for one in doctor.ports(load_scenario("paper_5", keys))}
    second = found["port of UAV 2"]
    assert second.severity == ERROR and place in second.value
    assert "mavlink.vehicles.2.connect" in second.advice


def test_the_cache_counts_what_is_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PTNSBC_CACHE_DIR", str(tmp_path / "cache"))
    (found,) = doctor._cache()
    assert found.severity == INFO and "a minute more" in found.advice
    folder = tmp_path / "cache" / source_digest()
    folder.mkdir(parents=True)
    (folder / "law").touch()
    (found,) = doctor._cache()
    assert "1 laws compiled" in found.value and found.advice == ""


def test_a_wide_discovery_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    found = {one.key: one for one in doctor._middleware()}
    assert found["discovery"].severity == WARNING
