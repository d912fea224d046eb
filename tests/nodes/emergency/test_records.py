"""The record of a vehicle: as bytes, as a file, and what it says of a dead bridge."""

import json
import os
import subprocess
import sys
from dataclasses import asdict, replace

import pytest

from ptnsbc_nodes.emergency.records import (
    VehicleRecord,
    decode_record,
    forget_dead,
    in_pilots_hands,
    last_word,
    record_path,
    records,
    write_record,
)

RECORD = VehicleRecord(
    name="bridge3",
    pid=os.getpid(),
    sysid=3,
    autopilot="px4",
    connect="udpin:127.0.0.1:14542",
    armed=True,
    heard=True,
    mode="OFFBOARD",
    place="(1.0, 2.0, 3.0) m",
)


@pytest.fixture
def dead():
    """The process id of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_a_record_reads_what_it_writes(tmp_path):
    assert decode_record(RECORD.encode()) == RECORD
    write_record(tmp_path, RECORD)
    (found,) = records(tmp_path)
    assert replace(found, written_s=0.0) == RECORD


@pytest.mark.parametrize(
    "data",
    [b"", b"\xff", b"[]", b"{}", b"[" * 9999, json.dumps({**asdict(RECORD), "pid": "x"}).encode()],
)
def test_anything_else_is_no_record(tmp_path, data):
    assert decode_record(data) is None
    record_path(tmp_path, "bridge3").write_bytes(data)
    assert list(records(tmp_path)) == []


def test_the_record_of_a_dead_bridge_stays_until_it_is_forgotten(tmp_path, dead):
    write_record(tmp_path, RECORD)
    write_record(tmp_path, replace(RECORD, name="bridge4", pid=dead))
    assert [record.alive for record in records(tmp_path)] == [True, False]
    forget_dead(tmp_path)
    assert [record.name for record in records(tmp_path)] == ["bridge3"]


def test_the_last_word_about_a_vehicle_whose_bridge_has_ended(tmp_path):
    write_record(tmp_path, replace(RECORD, fate="without setpoints it hovers"))
    assert last_word(tmp_path, "bridge3") == (
        "its vehicle was armed at (1.0, 2.0, 3.0) m in OFFBOARD: without setpoints it hovers; "
        "ptnsbc stop reaches it past its bridge"
    )
    write_record(tmp_path, replace(RECORD, armed=False))
    assert last_word(tmp_path, "bridge3") == ""
    assert last_word(tmp_path, "bridge9") == ""


def test_whether_pilots_fly_all_of_them(tmp_path):
    write_record(tmp_path, replace(RECORD, in_pilots_hands=True))
    write_record(tmp_path, replace(RECORD, name="bridge4"))
    assert in_pilots_hands(tmp_path, ["bridge3"])
    assert not in_pilots_hands(tmp_path, ["bridge3", "bridge4"])
    assert not in_pilots_hands(tmp_path, ["bridge3", "bridge9"])


def test_the_state_in_words():
    assert RECORD.state == "armed at (1.0, 2.0, 3.0) m in OFFBOARD"
    silent = replace(RECORD, heard=False)
    assert silent.state == "the vehicle is silent, last armed at (1.0, 2.0, 3.0) m in OFFBOARD"
    down = replace(RECORD, armed=False, landed=True, place="")
    assert down.state == "disarmed, on the ground in OFFBOARD"
