"""The command line as a user meets it: exit codes, one line per error, JSON alone on stdout."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ptnsbc_io.bag import BagWriter, declare
from ptnsbc_io.wire import HeaderTemplate, OdometryTemplate, WrenchTemplate
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.runtime.environment import ONE_THREAD
from ptnsbc_sim.verdict import Recording, Track
from ptnsbc_tools.cli import app, functions
from ptnsbc_tools.reading.bag_reader import SCENARIO_ATTACHMENT

Fly = Callable[..., Recording]


def run(*words: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(word) for word in words])
    # The tests before decide whether the laws are compiled, and the machine whether the dry runs show progress.
    err = re.sub(r"(compiling|dry runs: ).*\n", "", result.stderr)
    return result.exit_code, result.stdout, err


def write(recording: Recording, directory: Path) -> Path:
    """A recording as a bag, without diagnostics."""
    scenario = recording.scenario
    infos = [declare(topics.EPOCH.name, topics.EPOCH.type, depth=1)]
    for uav in scenario.uav_ids:
        for topic in (topics.odom(uav), topics.wrench_setpoint(uav)):
            infos.append(declare(topic.name, topic.type, depth=1))
    attached = {SCENARIO_ATTACHMENT: scenario.text.encode()}
    state, wrench = OdometryTemplate("map", "b"), WrenchTemplate("b")
    with BagWriter(directory, infos, attachments=attached) as writer:
        for stamp, leg in recording.epochs:
            writer.write(topics.EPOCH.name, stamp, HeaderTemplate(leg).encode(stamp))
        for uav in scenario.uav_ids:
            series = recording.odometry[uav]
            for row, stamp in enumerate(series.t_ns.tolist()):
                writer.write(topics.odom(uav).name, stamp, state.encode(stamp, series.values[row]))
            name, series = topics.wrench_setpoint(uav).name, recording.wrench[uav]
            for row, stamp in enumerate(series.t_ns.tolist()):
                writer.write(name, stamp, wrench.encode(stamp, series.values[row]))
    return directory


def test_help_is_one_screen_of_the_commands_of_a_day() -> None:
    code, out, _ = run("--help")
    assert code == 0 and run("help")[1] == out
    assert len(out.splitlines()) <= 24 and max(map(len, out.splitlines())) <= 80
    rows = re.findall(r"(?m)^  ([a-z]+)  +[A-Z]", out.partition("a day:")[2])
    assert rows == ["new", "check", "simulate", "sweep", "fleet", "view", "report", "stop"]
    assert "ptnsbc help all" in out
    assert run("--version")[1].startswith("ptnsbc ")


def test_help_all_has_every_command_in_its_panel() -> None:
    out = run("help", "all")[1]
    rows = re.findall(r"(?m)^  ([a-z]+(?: [a-z]+)?)  +[A-Z]", out.partition("Begin:")[2])
    assert sorted(rows) == sorted(name for name, _ in functions())
    places = [out.index(word) for word in ("Begin", "Fly", "Look at flights", "Vehicles and")]
    assert places == sorted(places)


def test_help_of_a_command() -> None:
    assert run("help", "bag", "repair") == run("bag", "repair", "--help")
    assert run("help", "dance")[0] == 2


@pytest.mark.parametrize("name", [name for name, _ in functions() if name != "reproduce"])
def test_every_command_has_help_by_both_names(name: str) -> None:
    short, long = (run(*name.split(), word) for word in ("-h", "--help"))
    assert short == long and short[0] == 0
    assert f" {name} [" in short[1]


def test_help_after_other_words_and_not_after_the_end_of_options() -> None:
    assert run("check", "paper_5", "--seed", "x", "-h")[0] == 0
    assert run("check", "--", "-h")[0] == 2


def test_paragraphs_are_wrapped_by_the_terminal() -> None:
    command = [sys.executable, "-m", "ptnsbc_tools", "compare", "-h"]
    environment = {**os.environ, "COLUMNS": "200"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    assert "when the largest error after the deadline has grown in the median" in done.stdout


@pytest.mark.parametrize("words", [["check", "--help"], ["--help"], ["help", "all"]])
def test_help_loads_neither_the_laws_nor_what_parses_options(words: list[str]) -> None:
    code = (
        "import sys\nfrom ptnsbc_tools.cli import app\n"
        f"try:\n    app({words}, prog_name='ptnsbc')\nexcept SystemExit:\n    pass\n"
        "heavy = {'numba', 'numpy', 'pydantic', 'rich', 'scipy', 'matplotlib', 'rclpy'} & set(sys.modules)\n"
        "print(sorted(heavy), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == "[]\n"


def test_check_says_first_whether_then_the_plan_then_what_to_type() -> None:
    code, out, err = run("check", "paper_5", "--runs", 2)
    lines = out.splitlines()
    assert (code, err, lines[0]) == (0, "", "paper_5: accepted: 3 of 3 dry runs met")
    assert [line.split()[0] for line in lines[1:4]] == ["deadline", "flown", "avoids"]
    assert lines[-1] == "next: ptnsbc simulate paper_5" and len(lines) <= 24
    assert "info" not in out and "other findings are as they should be: -v" in out
    assert "sigma_min" in run("check", "paper_5", "--no-fly", "-v")[1]


def test_check_that_refuses_says_why_and_what_to_change() -> None:
    words = ("paper_5", "--set", "gains.formation.deadline_s=1")
    code, out, err = run("check", *words)
    assert code == 2 and err.count("\n") == 1
    first, *lines = out.splitlines()
    assert first.startswith("paper_5: refused: gains.formation.deadline_s: 1 s, too short")
    assert any("change: set gains.formation.deadline_s to at least" in line for line in lines)
    assert len(lines) < 24 and "next:" not in out


def test_check_as_json() -> None:
    code, out, err = run("check", "paper_5", "--json")
    data = json.loads(out)
    assert (code, err, data["ok"]) == (0, "", True)
    assert {"severity", "key", "value", "limit", "advice"} == set(data["findings"][0])
    assert "info" in {one["severity"] for one in data["findings"]}
    assert data["plan"]["flown"].startswith("5 of 5 in place by 5 s")


def test_check_of_what_real_vehicles_fly() -> None:
    """`mavlink.overrides` of experiment_4 fly relative positions."""
    words = ("check", "experiment_4", "--no-fly", "--json")
    tasks = [
        next(one["value"] for one in json.loads(run(*words, *more)[1])["findings"]
             if one["key"] == "formation.offsets_m.2")
        for more in ((), ("--backend", "mavlink"))
    ]  # fmt: skip
    assert ["distance_angles" in tasks[0], "relative_position" in tasks[1]] == [True, True]


@pytest.mark.parametrize("command", ["check", "simulate", "fleet"])
def test_what_cannot_fly_is_refused(command: str) -> None:
    code, _, err = run(command, "paper_5", "--set", "gains.formation.deadline_s=2 s", "--json")
    assert code == 2
    assert err.count("\n") == 1
    assert err.startswith("error: ")
    assert "gains.formation.deadline_s: 2 s" in err


@pytest.mark.parametrize(
    "words",
    [
        ("check", "paper_55"),
        ("check", "paper_5", "--set", "gains.formaton.scale=1"),
        ("check", "paper_5", "--set", "seed: [1"),
        ("check", "paper_5", "--duration", "-1"),
        ("verify", "nowhere"),
    ],
)
def test_errors_are_one_line_and_two(words: tuple[str, ...]) -> None:
    code, out, err = run(*words)
    assert (code, out) == (2, "")
    assert "Traceback" not in err
    if not err.startswith("Usage"):
        assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "instead"),
    [
        (("demo", "--out", "x"), "--output"),
        (("reproduce", "--jobs", "2"), "--workers"),
        (("autopilot", "--key", "x"), "--signing-key"),
        (("simulate", "paper_5", "--deadline", "6"), "--set gains.formation.deadline_s=S"),
        (("simulate", "paper_5", "--duration", "5m"), 'as in "5 s"'),
        (("export", "bags/sample", "-o", "a.rrd"), "Rerun opens the .mcap file"),
    ],
)
def test_what_is_gone_names_what_to_use_instead(words: tuple[str, ...], instead: str) -> None:
    code, out, err = run(*words)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("error: ") and instead in err


@pytest.mark.parametrize(
    "words", [("check",), ("check", "paper_5", "--task", "dance"), ("dance",), ("check", "a", "b")]
)
def test_usage_errors_are_two(words: tuple[str, ...]) -> None:
    assert run(*words)[0] == 2


def test_interrupt_is_130(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("ptnsbc_tools.options.scenario_with", interrupt)
    code, _, err = run("check", "paper_5")
    assert (code, err) == (130, "interrupted\n")


def test_verify_a_flight_that_keeps_its_deadline(fly: Fly, tmp_path: Path) -> None:
    bag = write(fly(seconds=7.0), tmp_path / "bag")
    code, out, err = run("verify", bag)
    assert (code, err) == (0, "")
    assert "Verdict: met" in out
    picture = tmp_path / "flight.png"
    code, out, err = run("verify", bag, "--json", "--picture", picture)
    data = json.loads(out)
    assert (code, err, data["verdict"]) == (0, "", "met")
    assert len(data["uavs"]) == 5
    assert data["picture"] == str(picture)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_verify_a_flight_that_does_not(fly: Fly, tmp_path: Path) -> None:
    bag = write(fly({4: lambda t: 0.2 + 0 * t}, seconds=7.0), tmp_path / "bag")
    code, out, _ = run("verify", bag)
    assert code == 1
    assert "Verdict: missed" in out
    assert run("verify", bag, "--tolerance", "0.3")[0] == 0


def test_verify_with_another_scenario(fly: Fly, tmp_path: Path) -> None:
    bag = write(fly(seconds=7.0), tmp_path / "bag")
    other = tmp_path / "other.yaml"
    other.write_text(
        "extends: paper_5_free\ntiming: {duration_s: 7}\nformation: {offsets_m: {4: [0.6, -1.5, 0]}}\n"
    )
    assert run("verify", bag, "--scenario", other)[0] == 1


def test_a_bag_of_nan_is_missed(fly: Fly, tmp_path: Path) -> None:
    recording = fly(seconds=7.0)
    recording.odometry[3].values[550:] = float("nan")
    code, out, err = run("verify", write(recording, tmp_path / "bag"))
    assert (code, err) == (1, "")
    assert "UAV 3 missed: state not finite from t = 5.50 s" in out


def test_a_bag_with_holes_says_so(fly: Fly, without: Callable[..., Track], tmp_path: Path) -> None:
    recording = fly(seconds=7.0)
    whole = recording.odometry[3]
    cut = replace(recording, odometry={**recording.odometry, 3: without(whole, 10, 600)})
    code, out, _ = run("verify", write(cut, tmp_path / "few"))
    assert code == 0
    assert "2 messages missing" in out
    cut = replace(recording, odometry={**recording.odometry, 3: without(whole, 10)})
    assert "1 message missing" in run("verify", write(cut, tmp_path / "one"))[1]
    hole = without(whole, *range(100, 400))
    cut = replace(recording, odometry={**recording.odometry, 3: hole})
    code, out, _ = run("verify", write(cut, tmp_path / "many"), "--json")
    data = json.loads(out)
    assert (code, data["verdict"]) == (1, "void")
    assert data["uavs"][2]["reason"].startswith("recording incomplete: nothing on /uav3/odom")
    assert [one["missing"] for one in data["uavs"]] == [0, 0, 300, 0, 0]
    assert [one["missing"] for one in data["efforts"]] == [0, 0, 0, 0, 0]


def test_seed_says_what_it_is_for() -> None:
    assert "disturbances: noise" in run("simulate", "--help")[1]


def test_a_cut_bag_is_one_line(fly: Fly, tmp_path: Path) -> None:
    bag = write(fly(seconds=7.0), tmp_path / "bag")
    file = next(bag.glob("*.mcap"))
    file.write_bytes(file.read_bytes()[:20_000])
    code, out, err = run("verify", bag)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert err.startswith("error: ")
    assert "cut" in err


def test_a_bag_without_a_scenario_says_what_to_do(fly: Fly, tmp_path: Path) -> None:
    recording = fly(seconds=1.0)
    infos = [declare("/uav1/odom", topics.odom(1).type, depth=1)]
    with BagWriter(tmp_path / "bag", infos) as writer:
        row = recording.odometry[1].values[0]
        writer.write("/uav1/odom", 0, OdometryTemplate("map", "b").encode(0, row))
    code, _, err = run("verify", tmp_path / "bag")
    assert code == 2
    assert "give the scenario file with which it was flown, as verify" in err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "judged_by"), [("paper_5_free", "odometry"), ("experiment_4", "truth")]
)
def test_simulate_and_verify_agree(scenario: str, judged_by: str, tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    bag = tmp_path / "bag"
    words = (scenario, "--duration", "6", "--task", "relative_position", "--json")
    code, out, _ = run("simulate", *words, "--bag", bag)
    flown = json.loads(out)
    again, read, _ = run("verify", bag, "--json")
    assert code == again
    told = json.loads(read)
    # /diagnostics carries six digits of it
    exact, rounded = (one.pop("priority_violation_m_s") for one in (flown, told))
    assert exact == pytest.approx(rounded, rel=1e-5)
    assert {**flown, "bag": None} == {**told, "bag": None}
    assert (told["verdict"], told["judged_by"]) == ("met", judged_by)
    assert run("simulate", *words, "--bag", bag)[0] == 2  # it exists


@pytest.mark.slow
def test_the_same_flight_gives_the_same_bytes(tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    for name in ("a", "b"):
        run("simulate", "paper_5", "--duration", "1", "--bag", tmp_path / name / "bag", "--json")
    first, second = (next((tmp_path / name / "bag").glob("*.mcap")) for name in ("a", "b"))
    assert first.read_bytes() == second.read_bytes()


WITHOUT_ROS = "import sys; sys.modules['rclpy'] = None\n"


def test_a_flight_in_one_process_needs_no_ros() -> None:
    modules = "ptnsbc, ptnsbc_tools.reading.headless, ptnsbc_tools.commands.simulate"
    subprocess.run([sys.executable, "-c", f"{WITHOUT_ROS}import {modules}"], check=True)


def test_linear_algebra_has_one_thread_unless_the_user_says_otherwise() -> None:
    code = (
        "import os\nfrom ptnsbc_tools.cli import main\n"
        "try:\n    main()\nfinally:\n    print(os.environ['OMP_NUM_THREADS'], os.environ['OPENBLAS_NUM_THREADS'])"
    )
    unset = {name: value for name, value in os.environ.items() if name not in ONE_THREAD}
    done = subprocess.run(
        [sys.executable, "-c", code, "--version"],
        env={**unset, "OMP_NUM_THREADS": "3"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines()[-1] == "3 1"


def test_a_simulated_fleet_needs_no_mavlink() -> None:
    """pymavlink is an extra of the package."""
    flown = ("fleet.fleet", "uav.uav_node", "sim.sim_node", "recording.fleet_recorder")
    modules = ", ".join(f"ptnsbc_nodes.{name}" for name in (*flown, "view.observer"))
    code = f"import sys; sys.modules['pymavlink'] = None\nimport ptnsbc, {modules}"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_order_without_ros_is_refused_in_words_where_no_bridge_of_this_host_hears_it() -> None:
    code = f"{WITHOUT_ROS}from ptnsbc_tools.cli import main\nmain()"
    words = ("stop", "--namespace", "nobody", "--domain", "7")
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True)
    assert done.returncode == 2
    assert "domain 7: no bridge listens, and rclpy is not installed: " in done.stderr
    assert done.stderr.count("\n") == 1


def test_what_a_bag_names_is_no_command_for_the_terminal(tmp_path: Path) -> None:
    """A topic `[/b]` was a traceback, and metadata could clear the screen."""
    infos = [declare(name, "std_msgs/msg/Header") for name in ("[/b]", ":smile:\x1b[2J")]
    metadata = {"pilot\x1b]0;owned\x07": "\x1b[31mred\u202e"}
    with BagWriter(tmp_path / "flight", infos, metadata=metadata) as writer:
        writer.write("[/b]", 0, HeaderTemplate("x").encode(0))
    code, out, err = run("bag", "info", tmp_path / "flight", "--check")
    assert (code, err) == (0, "")
    assert "[/b]" in out and ":smile:\\x1b[2J" in out and "\\x1b[31mred\\u202e" in out
    assert not {"\x1b", "\x07", "\u202e"}.intersection(out)
    assert all(text.isprintable() for text in run("check", "no\x1b[2Jsuch")[2].splitlines())


def test_overwrite_refuses_a_folder_that_is_no_bag(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    words = ("paper_5", "--duration", "1", "--bag", tmp_path / "mine", "--overwrite")
    code, _, err = run("simulate", *words)
    assert code == 2
    assert "holds letter.txt" in err and "a bag replaces bags only" in err
    assert (tmp_path / "mine" / "letter.txt").read_text() == "dear"


def test_a_place_where_no_bag_can_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("dear")
    code, _, err = run("simulate", "paper_5", "--bag", tmp_path / "letter.txt" / "flight")
    assert code == 2
    assert f"{tmp_path / 'letter.txt'} is no folder to write into" in err


def test_a_flight_of_ages_is_refused(tmp_path: Path) -> None:
    code, _, err = run("check", "paper_5", "--set", "timing.duration_s=1e300")
    assert code == 2
    assert err.count("\n") == 1 and "expected <= 1e+06" in err
