"""How answers to faults are read from the reports of UAVs, and from a whole flight of processes."""

import pytest

pytest.importorskip("rclpy")

from bench.answers import Report, absence_s, answers, refused_after_s
from ptnsbc_io.bag import read_bag
from ptnsbc_nodes.fleet.fleet import FleetOptions, run_fleet
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.reading.bag_reader import read_recording


def reports(*stamps_s: float) -> list[Report]:
    return [Report(round(one * 1e9), "") for one in stamps_s]


@pytest.mark.parametrize(
    ("stamps_s", "absent_s"),
    [
        ((9.8, 10.0, 12.5, 12.7), 2.3),  # killed at 10.0, heard again 0.2 s before its report
        ((9.8, 10.0, 10.2, 13.0), 2.8),  # the launcher was a little late
        ((9.8, 10.0), 0.0),  # the flight ended
        ((9.8, 10.0, 10.2, 10.4), 0.0),
    ],
)
def test_a_process_was_absent_until_shortly_before_its_first_report(stamps_s, absent_s):
    assert absence_s(reports(*stamps_s), 10_000_000_000) == pytest.approx(absent_s)


def test_only_a_report_after_the_fault_that_names_refused_messages_answers_it():
    refused = "holding; 40 messages refused: /uav2/odom: position nan"
    told = [Report(1, refused), Report(5, "holding"), Report(9, refused)]
    assert refused_after_s(told, 1) == pytest.approx(8e-9)
    assert refused_after_s(told, 9) is None


def test_the_answers_of_a_fleet_in_lockstep(tmp_path):
    """Both answers of UAV 5, whose parent sends no numbers; those of UAV 3 could be to either fault of its parent."""
    faults = [
        {"kind": "silence", "uav": 2, "at_s": 1.0, "duration_s": 1.2},
        {"kind": "loss", "uav": 2, "at_s": 1.1, "duration_s": 0.2, "share": 0.5},
        {"kind": "nan", "uav": 4, "at_s": 3.0, "duration_s": 1.0},
    ]
    scenario = load_scenario("paper_5", {"faults": faults, "timing.duration_s": 5.0})
    assert run_fleet(FleetOptions(scenario, lockstep=True, bag=tmp_path / "bag")).exit_code == 0
    found = list(answers(read_recording(tmp_path / "bag"), read_bag(tmp_path / "bag")))
    assert [(one.uav, one.action) for one in found] == [(5, "names what it refuses"), (5, "holds")]
    assert [one.after_s for one in found] == pytest.approx([0.2, 0.49])
    assert not any(one.late for one in found)
