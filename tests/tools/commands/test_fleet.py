"""The fleet from the command line: the same flight as in one process, bit for bit."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.bag import read_bag
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.check import dry_run
from ptnsbc_tools.cli import app
from ptnsbc_tools.commands import fleet
from ptnsbc_tools.live.dashboard import Viewer
from ptnsbc_tools.options import Showing

needs_rclpy = pytest.mark.skipif(find_spec("rclpy") is None, reason="needs rclpy")
RECORDED = {"messages": 900, "late": 0, "lost": 0, "refused": ""}


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


@pytest.mark.slow
@pytest.mark.ros
@needs_rclpy
def test_a_fleet_in_lockstep_flies_what_one_process_flies(tmp_path: Path) -> None:
    """Noise, losses and delays included, and with the same verdict."""
    links = "communication.links=[{sender: 1, receiver: 3, delay_s: 0.2, loss: 0.4}]"
    late = ("--set", "communication.delay_s=0.055", "--set", links)
    words = ("experiment_4", "--duration", "3", *late, "--json")
    together, flown, err = run("fleet", *words, "--lockstep", "--bag", tmp_path / "fleet")
    alone, simulated, _ = run("simulate", *words, "--bag", tmp_path / "alone")
    assert together == alone == 1, err  # three seconds are too short for the deadline
    assert "/uav1/truth" in assert_same_flight(tmp_path / "fleet", tmp_path / "alone")
    told, expected = json.loads(flown), json.loads(simulated)
    assert told["uavs"] == expected["uavs"]
    assert told["fleet"]["died"] == []


@pytest.mark.slow
@pytest.mark.ros
@needs_rclpy
def test_a_fleet_with_open_slots_flies_what_one_process_flies(tmp_path: Path) -> None:
    """The leader of the file follows, and links and noise are those of UAVs, not of slots."""
    base = load_scenario("experiment_4")
    starts = [
        {"id": uav, "position_m": base.uav(at).position.tolist()}
        for uav, at in {1: 3, 2: 1, 3: 4, 4: 2}.items()
    ]
    settings = {"formation.assignment": "optimal", "uavs": json.dumps(starts)}
    given = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    words = ("experiment_4", "--duration", "1.5", *given, "--json")
    fleet = ("--lockstep", "--processes", "2", "--bag", tmp_path / "fleet")
    together, flown, err = run("fleet", *words, *fleet)
    alone, simulated, _ = run("simulate", *words, "--bag", tmp_path / "alone")
    assert together == alone == 1, err  # too short for the deadline
    assert "/formation/slots" in assert_same_flight(tmp_path / "fleet", tmp_path / "alone")
    told, expected = json.loads(flown), json.loads(simulated)
    assert told["uavs"] == expected["uavs"]
    assert [one["slot"] for one in told["uavs"]] == [3, 1, 4, 2]


@pytest.mark.slow
@pytest.mark.ros
@needs_rclpy
def test_demo_leaves_a_bag_a_verdict_and_a_picture(tmp_path: Path) -> None:
    """It says so in the last lines, as the tutorial shows them."""
    code, out, err = run("demo", "--duration", "1", "--output", tmp_path)
    assert code == 1, err
    assert out.startswith("Verdict: void")
    places = dict(line.split(": ", 1) for line in out.splitlines()[-3:])
    assert list(places) == ["bag", "picture", "report"]
    assert places["report"] == f"ptnsbc report {places['bag']}"
    assert Path(places["picture"]).read_bytes().startswith(b"\x89PNG")
    topics = read_bag(places["bag"]).topics
    assert topics["/uav5/odom"].messages == 100
    assert "/uav1/truth" not in topics


def flown(**changes: Any) -> Any:
    facts = {
        "processes": (),
        "died": (),
        "killed": (),
        "interrupted": False,
        "recorded": RECORDED,
        "startup_s": 1.0,
        "flight_s": 7.0,
        "exit_code": 0,
    }
    result = SimpleNamespace(**{**facts, **changes})
    of_fleets = pytest.importorskip("ptnsbc_nodes.fleet.fleet")  # needs rclpy
    result.losses = of_fleets.FleetResult.losses.fget(result)
    return result


@pytest.mark.parametrize(
    ("changes", "lines"),
    [
        ({}, []),
        ({"died": ("uav3",)}, ["uav3: ended early, or with a fault"]),
        (
            {"died": ("bridge4",), "processes": (SimpleNamespace(name="bridge4", life=2),)},
            ["bridge4 (replaced): ended early, or with a fault"],
        ),
        ({"killed": ("uav1",)}, ["uav1 was killed, as the scenario has it"]),
        (
            {"recorded": {**RECORDED, "late": 2}},
            ["2 messages came too late to be sorted: bytes differ between runs"],
        ),
        (
            {"recorded": {**RECORDED, "lost": 3}},
            ["3 messages did not reach the recorder: 900 are in the bag"],
        ),
        (
            {"recorded": {**RECORDED, "refused": "2 messages refused: /diagnostics: cut"}},
            ["recorder: 2 messages refused: /diagnostics: cut"],
        ),
        (
            {"died": ("recorder",), "recorded": {}},
            [
                "recorder: ended early, or with a fault",
                "the recorder left no count of its messages: the bag may be cut",
            ],
        ),
    ],
)
def test_losses_are_told(changes: dict[str, Any], lines: list[str]) -> None:
    assert list(fleet._losses(flown(**changes), leads=True)) == lines


@pytest.mark.parametrize(("ended", "code"), [(0, 1), (1, 1), (130, 130)])
def test_an_unreadable_bag_does_not_hide_the_flight(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], ended: int, code: int
) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    result = flown(exit_code=ended, died=("recorder",), interrupted=ended == 130)
    viewer = Viewer(None, load_scenario("paper_5"), None)
    assert fleet._judge(bag, result, Showing(json=True), viewer, kept=bag, picture=None) == code
    out, err = capsys.readouterr()
    assert err.count("\n") == 1
    how = "was interrupted" if ended == 130 else "is over"
    assert err.startswith(f"error: the flight {how} after 7.0 s, but has no verdict: ")
    data = json.loads(out)
    assert (data["verdict"], data["fleet"]["died"]) == (None, ["recorder"])
    assert data["fleet"]["recorded"] == RECORDED


def test_the_links_follow_a_port(monkeypatch: pytest.MonkeyPatch) -> None:
    """As those of `ptnsbc autopilot --port-base`: the first vehicle on the port, the others on the next ones."""
    flown = []
    monkeypatch.setattr(fleet, "fly_and_judge", lambda scenario, *_, **more: flown.append(scenario))
    words = ["fleet", "take_off_4", "--backend", "mavlink", "--port-base", "24540"]
    assert CliRunner().invoke(app, words).exit_code == 0
    links = [flown[0].vehicle_link(uav).connect for uav in flown[0].uav_ids]
    assert links == [f"udpin:127.0.0.1:{port}" for port in range(24540, 24544)]


def test_every_override_is_told_beside_what_the_file_says() -> None:
    overrides = {"gains.formation.deadline_s": 9, "formation.tolerance_m": 0.3}
    scenario = load_scenario("paper_5", {"mavlink.overrides": overrides})
    told = list(fleet._flight_overrides(scenario))
    assert told == [
        f"in flight: gains.formation.deadline_s: 9 instead of {scenario.gains.formation.deadline_s} "
        "(mavlink.overrides)",
        f"in flight: formation.tolerance_m: 0.3 instead of {scenario.formation.tolerance_m} "
        "(mavlink.overrides)",
    ]
    assert scenario.bridged().gains.formation.deadline_s == 9


def test_without_overrides_there_is_nothing_to_tell() -> None:
    assert list(fleet._flight_overrides(load_scenario("paper_5"))) == []


@needs_rclpy
@pytest.mark.ros
@pytest.mark.parametrize(
    ("backend", "check", "first"),
    [
        ("mavlink", None, "judged where they stand"),
        ("mavlink", False, "flown"),
        ("sim", None, "flown"),
        ("sim", True, "dry runs"),
    ],
)
def test_dry_runs_are_flown_once_of_real_vehicles_from_where_they_stand(
    monkeypatch: pytest.MonkeyPatch, backend: Any, check: bool | None, first: str
) -> None:
    class EndedError(Exception):
        """What came first."""

    def ends(word: str) -> Any:
        def call(*_: object) -> None:
            raise EndedError(word)

        return call

    monkeypatch.setattr(dry_run, "flown", ends("dry runs"))
    judged = "judged where they stand"
    fly = lambda request, _: ends("flown" if request.objection is None else judged)()  # noqa: E731
    monkeypatch.setattr(fleet, "_fly", fly)
    monkeypatch.setattr("ptnsbc_nodes.fleet.fleet.load_fleet", lambda _: None)
    monkeypatch.setattr("ptnsbc_nodes.fleet.fleet.load_world", lambda _: None)
    scenario, parts = load_scenario("experiment_4"), fleet.Parts(backend=backend, allow_arming=True)
    with pytest.raises(EndedError, match=first):
        fleet.fly_and_judge(scenario, parts, Showing(json=True), check=check)
    if backend == "mavlink":  # refused before anything is flown
        with pytest.raises(PtnsbcError, match="expected --allow-arming"):
            fleet.fly_and_judge(scenario, fleet.Parts(backend=backend), Showing(json=True))
