"""Recordings for Rerun: verified by its own program where that is installed, and refused with a word where not."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

from ptnsbc_sim.verdict import Recording
from ptnsbc_tools.library.flight import Flight
from ptnsbc_tools.library.flying import fly, load
from ptnsbc_tools.library.optional import LibraryMissingError
from ptnsbc_tools.library.rerun_file import write_rerun


def test_without_the_library_the_way_out_is_named(
    fly: Callable[..., Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(LibraryMissingError, match=r'rerun is not installed: .*"ptnsbc\[rerun\]"'):
        write_rerun(Flight(fly(seconds=1.0)), tmp_path / "flight.rrd")
    assert not list(tmp_path.iterdir())


def test_its_own_program_finds_no_error(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    flown = fly(load("moving_obstacles").with_({"timing.duration_s": 0.5}), checked=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_rerun(flown, tmp_path / "flight.rrd")
    program = [sys.executable, "-m", "rerun", "rrd"]
    said = subprocess.run(
        [*program, "stats", tmp_path / "flight.rrd"], capture_output=True, text=True, check=True
    ).stdout
    for entity in ("/world/uav5/body", "/world/uav5/path", "/error_m/uav5", "/world/obstacles/"):
        assert entity in said
    subprocess.run([*program, "verify", tmp_path / "flight.rrd"], check=True, capture_output=True)
