"""`ptnsbc new`, `scenarios` and `check`: files that are written whole, a list that stands a broken file, a plan."""

from __future__ import annotations

import json
from pathlib import Path
from shutil import copy

import pytest
from typer.testing import CliRunner

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.cli import app

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


def run(*words: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(word) for word in words])
    return result.exit_code, result.stdout, result.stderr


def test_a_file_is_written_once(tmp_path: Path) -> None:
    code, out, err = run("new", tmp_path / "flock", "--shape", "circle", "--n", 6)
    file = tmp_path / "flock.yaml"
    assert (code, out, err) == (0, f"{file}\n", f"next: ptnsbc check {file}\n")
    assert len(load_scenario(file).uav_ids) == 6
    code, _, err = run("new", file)
    assert code == 2 and "exists: choose another name, or overwrite it" in err
    assert run("new", file, "--overwrite", "-n", 3)[0] == 0
    assert len(load_scenario(file).uav_ids) == 3


def test_a_shape_that_does_not_exist_is_one_line(tmp_path: Path) -> None:
    code, out, err = run("new", tmp_path / "a", "--shape", "gridd")
    assert (code, out) == (2, "")
    assert err == 'error: shape gridd: did you mean "grid"?\n'
    assert list(tmp_path.iterdir()) == []


def test_the_list_stands_a_broken_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "broken.yaml").write_text("name: [")
    run("new", tmp_path / "scenarios" / "mine", "-n", 3)
    code, out, err = run("scenarios", "--json")
    rows = {row["name"]: row for row in json.loads(out)["scenarios"]}
    assert (code, err) == (0, "")
    assert {"paper_5", "mine", "broken"} <= set(rows)
    assert rows["mine"]["uavs"] == 3 and "error" in rows["broken"]
    assert "paper_20" in run("scenarios")[1]


def test_the_plan_is_drawn_before_the_flight(tmp_path: Path) -> None:
    picture, words = tmp_path / "plan.png", ("check", "paper_5_free", "--duration", 6, "-n", 0)
    code, _, err = run(*words, "--picture", picture)
    assert (code, err) == (0, f"picture: {picture}\n")
    assert picture.read_bytes().startswith(b"\x89PNG")
    code, _, err = run(*words, "--picture", tmp_path / "plan.xyz")
    assert code == 2 and "expected .png, .svg or .pdf" in err


def test_the_file_of_a_stranger_is_named_before_it_runs_or_does_not_run(tmp_path: Path) -> None:
    for name in ("spiral.yaml", "spiral.py"):
        copy(EXAMPLES / "functions" / name, tmp_path)
    ran, file = tmp_path / "ran", tmp_path / "spiral.py"
    file.write_text(f"open({str(ran)!r}, 'a').write('x')\n{file.read_text()}")
    for words in (("check", "--no-fly"), ("check", "--no-code"), ("doctor",)):
        code, _, err = run(*words, tmp_path / "spiral.yaml")
        assert code == 2
        assert f"{file}: the code of a trajectory, which this command does not run" in err
    assert not ran.exists()
    assert f"runs the code of {file}" in run("check", tmp_path / "spiral.yaml", "--runs", 0)[2]
    assert ran.exists()
