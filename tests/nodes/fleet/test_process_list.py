"""Which processes a computer runs: all of a fleet, or those that are named."""

from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from ptnsbc_nodes.fleet.child_process import FleetOptions, ProcessListError, chosen, commands, names
from ptnsbc_nodes.fleet.fleet import FleetError, check_options, run_fleet
from ptnsbc_sim.scenario import load_scenario, scenario_from_text


@pytest.fixture(scope="module")
def paper_5():
    return load_scenario("paper_5")


def started(options: FleetOptions) -> dict[str, tuple[str, ...]]:
    return {line.name: line.arguments for line in commands(options, Path("s.yaml"))}


def test_a_number_is_a_uav_with_its_bridge(paper_5):
    assert chosen("recorder, sim 1,2", paper_5, "sim") == {"recorder", "sim", "uav1", "uav2"}
    assert chosen("3", paper_5, "mavlink") == {"bridge3", "uav3"}


@pytest.mark.parametrize(
    ("text", "backend", "words"),
    [
        ("6", "sim", r"'6' is no process of paper_5: .* numbers of UAVs \(1, 2, 3, 4, 5\)"),
        ("1,uav", "sim", "'uav' is no process"),
        ("sim", "mavlink", "'sim' is no process .* recorder, bridge1"),
        (" , ", "sim", "nothing named"),
    ],
)
def test_others_are_refused(paper_5, text, backend, words):
    with pytest.raises(ProcessListError, match=words):
        chosen(text, paper_5, backend)


def test_two_computers_run_the_fleet_of_one(paper_5):
    everything = names(paper_5, "sim")
    parts = [chosen(text, paper_5, "sim") for text in ("recorder,sim,1,2,3", "4,5")]
    first = started(FleetOptions(paper_5, only=parts[0], bag=Path("bag")))
    second = started(FleetOptions(paper_5, only=parts[1]))
    assert sorted([*first, *second]) == sorted(everything)
    whole = started(FleetOptions(paper_5, bag=Path("bag")))
    assert {**first, **second} == whole


def test_the_recorder_is_there_first_and_the_world_last(paper_5):
    first, *others, last = started(FleetOptions(paper_5, bag=Path("bag")))
    assert (first, last) == ("recorder", "sim")
    assert others == ["uav1", "uav2", "uav3", "uav4", "uav5"]


def test_uavs_share_processes_evenly(paper_5):
    found = started(FleetOptions(paper_5, processes=2, namespace="/blue"))
    assert list(found) == ["uav1-2", "uav3-5", "sim"]
    assert found["uav3-5"][-6:] == ("--uav", "3", "4", "5", "--fleet", "/blue")
    assert started(FleetOptions(paper_5, processes=5)) == started(FleetOptions(paper_5))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"processes": 6}, "paper_5 has 5 UAVs: expected 1 to 5"),
        ({"backend": "mavlink", "allow_arming": True}, "of its own with --backend mavlink"),
        ({"only": frozenset({"uav1"})}, "of its own with --only"),
    ],
)
def test_some_uavs_share_no_process(paper_5, monkeypatch, given, words):
    monkeypatch.setenv("ROS_DOMAIN_ID", "5")
    with pytest.raises(FleetError, match=words):
        check_options(FleetOptions(paper_5, **{"processes": 2, **given}))


def test_the_fault_of_one_uav_must_not_strike_those_beside_it(paper_5):
    text = paper_5.text + "\nfaults: [{kind: kill, uav: 3, at_s: 1}]\n"
    struck = scenario_from_text(text)
    with pytest.raises(FleetError, match=r"kill of uav3 at 1 s: it would strike the other UAVs"):
        check_options(FleetOptions(struck, processes=2))
    check_options(FleetOptions(struck))


def test_the_computer_with_the_recorder_leads(paper_5):
    assert FleetOptions(paper_5).leads
    assert FleetOptions(paper_5, only=frozenset({"recorder"})).leads
    assert not FleetOptions(paper_5, only=frozenset({"sim", "uav1"})).leads


def test_a_bag_needs_its_recorder(paper_5, monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_DOMAIN_ID", "5")
    options = FleetOptions(paper_5, only=frozenset({"uav1"}), bag=tmp_path / "bag")
    with pytest.raises(FleetError, match="the recorder is not among --only uav1"):
        run_fleet(options)


def test_several_computers_need_a_domain(paper_5, monkeypatch):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    with pytest.raises(FleetError, match="expected --domain N"):
        run_fleet(FleetOptions(paper_5, only=frozenset({"uav1"})))
