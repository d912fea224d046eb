"""`ptnsbc simulate`, `sweep` and `compare` as a user meets them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from ptnsbc_sim.sweep import runner
from ptnsbc_sim.sweep.draws import SweepError
from ptnsbc_tools.cli import app
from ptnsbc_tools.sweeps.summary import read_sweep

QUICK = ("--stop-after", 1.2, "--set", "gains.formation.deadline_s=0.8", "--workers", 1)
SMALL = ("paper_5", "--runs", 4, "--starts", "near:0.2", *QUICK)
# Avoidance to the end of so short a flight would excuse every error in it.
ALONE = ("--set", "formation.avoidance=off")


def run(*words: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(word) for word in words])
    return result.exit_code, result.stdout, re.sub(r"compiling.*\n", "", result.stderr)


def run_json(*words: object) -> dict[str, Any]:
    code, out, err = run(*words, "--json")
    assert code == 0, err
    return json.loads(out)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sweep") / "small"
    assert run("sweep", *SMALL, "--output", folder, "--no-report")[0] == 0
    return folder


def test_a_sweep_says_its_share_and_how_to_fly_the_worst_again(tmp_path: Path) -> None:
    folder = tmp_path / "sweep"
    code, out, _ = run("sweep", *SMALL, *ALONE, "--output", folder, "--no-report")
    assert code == 0
    first, second, *_ = out.splitlines()
    assert first == "paper_5: 4 flights, the first 1.2 s, seed 0; starts near:0.2"
    assert second.startswith("Flights met: ")
    assert "largest after tf" not in out
    assert re.search(
        rf"^worst: draw \d \(.*\): ptnsbc simulate --sweep {folder} --draw \d$", out, re.M
    )
    assert re.search(
        r"^closest UAVs: draw \d \([\d.]+ m\): ptnsbc simulate .* --draw \d$", out, re.M
    )
    assert f"table: {folder / 'table.parquet'}" in out
    code, out, _ = run("sweep", *SMALL, *ALONE, "--output", folder, "--verbose")
    assert code == 0
    assert "largest after tf, with excused spans" in out
    assert "largest after tf, without excused spans" in out
    assert out.count(f"ptnsbc simulate --sweep {folder} --draw ") == 5
    assert (folder / "report" / "index.html").is_file()


def test_a_sweep_that_is_done_is_not_flown_again(
    small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner, "fly_chunk", None)
    data = run_json("sweep", *SMALL, "--output", small, "--no-report")
    assert data["flights"]["of"] == 4
    assert (data["missing"], data["failed"], data["report"]) == (0, [], None)


def test_a_draw_flown_again_is_the_same_flight(small: Path) -> None:
    table = read_sweep(small).table
    for k in (0, 3):
        code, out, err = run("simulate", "--sweep", small, "--draw", k, "--json")
        assert code in (0, 1), err
        uavs = json.loads(out)["uavs"]
        rows = table["draw"] == k
        assert [one["error_at_deadline_m"] for one in uavs] == table["error_at_deadline_m"][
            rows
        ].tolist()
        assert [one["verdict"] for one in uavs] == table["verdict"][rows].tolist()


def test_a_draw_leaves_a_bag(small: Path, tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    bags = [tmp_path / "a", tmp_path / "b"]
    for k, bag in enumerate(bags):
        assert run("simulate", "--sweep", small, "--draw", k, "--bag", bag)[0] in (0, 1)
    data = json.loads(run("compare", *bags, "--json")[1])
    assert data["others"][0]["draws"] == 1
    code, _, err = run("compare", bags[0], small)
    assert (code, "expected sweeps, or flights" in err) == (2, True)


def test_a_family_and_a_grid(tmp_path: Path) -> None:
    short = tmp_path / "few.yaml"
    short.write_text("{name: few, size: 2, deadline: {seconds: 0.8, after_s: 0.3}}")
    vary = ("--vary", "plant.mass_kg=1.0,1.2")
    words = ("-n", 2, *vary, "-j", 1, "-o", tmp_path / "o", "--no-report")
    data = run_json("sweep", "--family", short, *words)
    assert (data["name"], data["draws"]) == ("few", 4)
    assert [cell["values"] for cell in data["cells"]] == [
        {"plant.mass_kg": 1.0},
        {"plant.mass_kg": 1.2},
    ]


def test_the_families_are_listed() -> None:
    code, out, _ = run("sweep", "--list-families")
    assert code == 0
    assert {"near", "clutter", "swap"} <= {line.split()[0] for line in out.splitlines()}


def test_compare_finds_what_is_worse(small: Path, tmp_path: Path) -> None:
    code, out, _ = run("compare", small, small)
    assert (code, out.splitlines()[-1]) == (0, f"{small} is not worse at 5 %")
    worse = ("--set", "plant.mass_kg=1.3")
    other = tmp_path / "other"
    assert run("sweep", *SMALL, *worse, "--output", other, "--no-report")[0] == 0
    code, out, _ = run("compare", small, other, small)
    assert code in (0, 1) and out.splitlines()[-1] == f"{small} is not worse at 5 %"
    code, out, _ = run("compare", small, other, small, "--json")
    assert [one["name"] for one in json.loads(out)["others"]] == [str(other), str(small)]
    assert run("compare", small, tmp_path / "nowhere")[0] == 2


def test_compare_takes_the_names_of_sweeps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("before", "after"):
        assert run("sweep", "paper_5", "--runs", 1, *QUICK, "--name", name, "--no-report")[0] == 0
    assert run("compare", "before", "after")[0] == 0
    code, _, err = run("compare", "before", "later")
    assert code == 2 and "later: no such sweep or bag, and no sweep of that name" in err


def test_ctrl_c_keeps_what_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> bytes:
        raise KeyboardInterrupt

    monkeypatch.setattr(runner, "fly_chunk", interrupted)
    folder = tmp_path / "sweep"
    code, out, err = run("sweep", *SMALL, "--output", folder)
    assert (code, out) == (130, "")
    assert (
        err
        == f"interrupted: 0 of 4 flights are kept in {folder}; the same command goes on from there\n"
    )
    monkeypatch.undo()
    assert run("sweep", *SMALL, "--output", folder, "--no-report")[0] == 0


def test_draws_that_cannot_be_flown_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fly = runner.fly_chunk

    def broken(text: str, index: int) -> bytes:
        if index == 1:
            raise SweepError("draw 26: no such flight")
        return fly(text, index)

    monkeypatch.setattr(runner, "fly_chunk", broken)
    short = ("--stop-after", 0.1, "-j", 1, "-o", tmp_path / "o", "--no-report")
    code, out, err = run("sweep", "paper_5", "-n", 28, *short)
    assert code == 1
    assert "draws 25 to 27 were not flown: draw 26: no such flight" in err
    assert "3 of 28 draws were not flown" in out
    code, out, _ = run("sweep", "paper_5", "-n", 28, *short, "--json")
    assert (code, json.loads(out)["failed"][0]["first"]) == (1, 25)


def test_a_draw_that_cannot_be_flown_leaves_the_others(tmp_path: Path) -> None:
    vary = ("--vary", "plant.mass_kg=1.0,9.0")
    words = ("paper_5", "-n", 1, *vary, *QUICK, "-o", tmp_path / "o", "--no-report")
    code, out, err = run("sweep", *words)
    assert code == 1
    assert "draw 1 was not flown: " in err
    assert "1 of 2 draws were not flown" in out
    assert run("compare", tmp_path / "o", tmp_path / "o")[0] == 0


def test_a_sweep_of_another_plan_stays_unless_it_may_go(tmp_path: Path) -> None:
    folder = tmp_path / "sweep"
    assert run("sweep", *SMALL, "--output", folder, "--no-report")[0] == 0
    (folder / "report").mkdir()
    other = ("paper_5", "--runs", 1, *QUICK, "--output", folder, "--no-report")
    code, _, err = run("sweep", *other)
    assert (code, "--overwrite" in err) == (2, True)
    assert run("sweep", *other, "--overwrite")[0] == 0
    assert not (folder / "report").exists()


@pytest.mark.parametrize(
    "words",
    [
        ("sweep",),
        ("sweep", "paper_55"),
        ("sweep", "paper_5", "--vary", "a"),
        ("sweep", "paper_5", "--starts", "there"),
        ("sweep", "--family", "nobody"),
        ("sweep", "paper_5", "--search", "worst"),
        ("sweep", "paper_5", "--promise", "keep_out"),
        ("simulate",),
        ("simulate", "paper_5", "--draw", 1),
        ("simulate", "--sweep", "nowhere", "--draw", 1),
        ("compare", "nowhere", "nowhere"),
    ],
)
def test_errors_are_one_line_and_two(words: tuple[object, ...]) -> None:
    code, out, err = run(*words)
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1


def test_the_picture_is_drawn_and_named(tmp_path: Path) -> None:
    picture = tmp_path / "flight.png"
    words = ["simulate", "paper_5_free", "--duration", "6", "--json", "--picture", str(picture)]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0
    assert json.loads(result.stdout)["picture"] == str(picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size > 10_000


def test_a_picture_of_another_kind_is_refused(tmp_path: Path) -> None:
    words = ["simulate", "paper_5_free", "--duration", "1", "--picture", str(tmp_path / "a.xyz")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert "a.xyz" in result.stderr and ".png" in result.stderr
    assert not list(tmp_path.iterdir())
