"""The sample bag and the layout, by the libraries with which Foxglove and Lichtblick read bags."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from ptnsbc_io.bag import read_bag

ROOT = Path(__file__).parents[1]
HERE = ROOT / "tests" / "foxglove"
SAMPLE = ROOT / "bags" / "sample"
LAYOUT = ROOT / "ros2_ws" / "src" / "ptnsbc_bringup" / "foxglove" / "formation.json"
NODE = shutil.which("node")

pytestmark = [
    pytest.mark.skipif(NODE is None, reason="needs node"),
    pytest.mark.skipif(
        not (HERE / "node_modules").is_dir(), reason="needs npm install --prefix tests/foxglove"
    ),
]


def checked(layout: Path) -> dict[str, Any]:
    words = [str(NODE), str(HERE / "check.mjs"), str(read_bag(SAMPLE).path), str(layout)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_every_message_is_decoded_and_every_plotted_path_is_there() -> None:
    found = checked(LAYOUT)
    assert found["wrong"] == []
    assert found["paths"] == 20
    assert found["counts"] == {name: t.messages for name, t in read_bag(SAMPLE).topics.items()}


def test_a_path_that_is_not_there_is_named(tmp_path: Path) -> None:
    text = LAYOUT.read_text().replace("twist.linear.x", "twist.linear.w")
    (tmp_path / "layout.json").write_text(text.replace('"/formation/markers"', '"/markers"'))
    wrong = checked(tmp_path / "layout.json")["wrong"]
    assert "/uav3/setpoint/velocity.twist.linear.w: not in the bag" in wrong
    assert "/markers: not in the bag" in wrong
    assert len(wrong) == 6
