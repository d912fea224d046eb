"""The layouts for Foxglove and RViz show what is in every bag, in the frame that is in every bag."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import yaml

from ptnsbc_io.bag import read_bag
from ptnsbc_io.wire import decode_diagnostics, decode_header
from ptnsbc_nodes.comm import topics

ROOT = Path(__file__).parents[1]
BRINGUP = ROOT / "ros2_ws" / "src" / "ptnsbc_bringup"
FOXGLOVE = json.loads((BRINGUP / "foxglove" / "formation.json").read_text())
RVIZ = yaml.safe_load((BRINGUP / "rviz" / "formation.rviz").read_text())["Visualization Manager"]
PLOTS = [path for panel in FOXGLOVE["configById"].values() for path in panel.get("paths", ())]
IN_BAG = {topic.name for topic in topics.in_bag(range(1, 6))}


def panels(layout) -> set[str]:
    """Names of all panels of a layout tree."""
    return (
        {layout} if isinstance(layout, str) else panels(layout["first"]) | panels(layout["second"])
    )


def test_every_panel_has_its_settings():
    assert panels(FOXGLOVE["layout"]) == FOXGLOVE["configById"].keys()


def test_what_is_plotted_is_in_the_bag():
    names = {re.split(r"\.", path["value"])[0] for path in PLOTS}
    assert names <= IN_BAG
    space = FOXGLOVE["configById"]["3D!formation"]
    assert {topics.MARKERS.name} == space["topics"].keys() <= IN_BAG
    shown = {d["Topic"]["Value"] for d in RVIZ["Displays"] if "Topic" in d}
    assert shown == {topics.MARKERS.name}


@pytest.fixture(scope="module")
def sample():
    return read_bag(ROOT / "bags" / "sample")


def test_the_fixed_frame_is_that_of_markers_and_transforms(sample):
    frame = FOXGLOVE["configById"]["3D!formation"]["fixedFrame"]
    assert RVIZ["Global Options"]["Fixed Frame"] == frame
    for topic in (topics.MARKERS.name, topics.TF.name):
        message = next(iter(sample.messages([topic])))
        # A list: the header of its first element comes after the count.
        assert decode_header(message.data[:4] + message.data[8:]).frame_id == frame


def test_diagnostics_have_the_keys_that_are_plotted(sample):
    (sought,) = {
        re.search(r'key=="(\w+)"', path["value"])[1]
        for path in PLOTS
        if path["value"].startswith(topics.DIAGNOSTICS.name)
    }
    messages = sample.messages([topics.DIAGNOSTICS.name])
    told = {
        status.name: status.values
        for message in messages
        for status in decode_diagnostics(message.data).statuses
    }
    assert all(float(told[f"uav{uav}: planner"][sought]) >= 0 for uav in range(1, 6))
