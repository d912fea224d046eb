"""The sample flight: whole, readable by others, and judged as its manifest says."""

from __future__ import annotations

import hashlib
import json
import sys
from collections import Counter
from pathlib import Path

import pytest

from ptnsbc_io.bag import read_bag
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_tools.reading.bag_reader import read_recording

sys.path.insert(0, str(Path(__file__).parent))
import doctor

SAMPLE = Path(__file__).parents[1] / "bags" / "sample"
MANIFEST = json.loads((SAMPLE / "MANIFEST.json").read_text(encoding="utf-8"))
FILES = {"MANIFEST.json", "metadata.yaml", "sample_0.mcap"}


def test_it_is_the_one_that_was_signed():
    sums = dict(
        reversed(line.split("  ")) for line in (SAMPLE / "SHA256SUMS").read_text().splitlines()
    )
    found = {name: hashlib.sha256((SAMPLE / name).read_bytes()).hexdigest() for name in FILES}
    assert found == sums
    assert sum((SAMPLE / name).stat().st_size for name in FILES) < 1_500_000


def test_another_reader_reads_every_message():
    ours = Counter({topic.name: topic.messages for topic in read_bag(SAMPLE).topics.values()})
    counts = doctor.read_by_another(SAMPLE)
    assert counts == ours
    assert counts["/uav5/odom"] == 750
    assert counts["/tf"] == 5 * 150
    assert counts["/formation/markers"] == 38


def test_the_verdict_is_that_of_its_manifest():
    verdict = verdict_on(read_recording(SAMPLE)).as_json()
    assert verdict["verdict"] == MANIFEST["verdict"] == "met"
    told = {uav["uav"]: uav for uav in verdict["uavs"]}
    for uav in MANIFEST["uavs"]:
        assert {key: told[uav["uav"]][key] for key in uav} == pytest.approx(uav)


def test_the_manifest_says_how_to_make_it():
    assert MANIFEST["command"].startswith("ptnsbc simulate paper_5_free ")
    assert len(MANIFEST["commit"]) == 40
    assert MANIFEST["shows"]
