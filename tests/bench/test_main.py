"""The command of `make bench`: its JSON, by a section that needs no ROS."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

ROW_KEYS = {
    "section",
    "figure",
    "value",
    "unit",
    "runs",
    "reference",
    "reference_value",
    "reference_unit",
    "ratio",
    "target",
    "met",
}
MACHINE_KEYS = {
    "cores",
    "load_before",
    "load_after",
    "elapsed_s",
    "python",
    "versions",
}


@pytest.mark.slow
def test_a_quick_section_as_json():
    command = [sys.executable, "-m", "bench", "--only", "headless", "--quick", "--json"]
    done = subprocess.run(
        command,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found.keys() == {"quick", "machine", "rows", "failed"}
    assert found["quick"] is True
    assert found["failed"] == {}
    assert found["machine"].keys() == MACHINE_KEYS
    assert all(row.keys() == ROW_KEYS for row in found["rows"])
    row = found["rows"][0]
    assert row["figure"] == "headless flight, N = 5"
    assert (row["unit"], row["reference_unit"]) == ("ticks/s", "µs")
    assert row["value"] > 0.0
    assert len(row["runs"]) == 2
    assert row["target"] == "≥ 100,000 ticks/s"


def test_an_unknown_section_is_refused():
    command = [sys.executable, "-m", "bench", "--only", "nothing"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "invalid choice" in done.stderr
