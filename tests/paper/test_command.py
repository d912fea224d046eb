"""`ptnsbc reproduce` as a user meets it."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from paper.catalogue import EXPERIMENTS
from paper.output import ExperimentFolder
from paper.runner import run_one
from ptnsbc_tools.cli import app

SMALL = "estimator"


def run(*words: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["reproduce", *(str(word) for word in words)])
    return result.exit_code, result.stdout, result.stderr


def test_an_unknown_part_is_refused_in_one_line(tmp_path: Path) -> None:
    code, out, err = run("--only", "fig_5", "-o", tmp_path / "new")
    assert (code, out) == (2, "")
    assert err.startswith("error: --only fig_5: expected one of promise, ")
    assert err.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_a_key_that_no_scenario_has_is_refused_in_one_line(tmp_path: Path) -> None:
    code, out, err = run("--set", "gains.formation.kapa_1_s=3", "-o", tmp_path / "new")
    assert (code, out) == (2, "")
    assert "kapa_1_s" in err and err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_other_things_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    code, out, err = run("--only", SMALL, "-o", tmp_path)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_every_part_names_what_it_needs() -> None:
    assert len({one.name for one in EXPERIMENTS}) == len(EXPERIMENTS)
    for one in EXPERIMENTS:
        assert one.scenarios and one.seconds > 0
        assert callable(one.load())


@pytest.mark.slow
def test_a_part_is_the_same_bytes_in_a_process_of_its_own(tmp_path: Path) -> None:
    docs = tmp_path / "docs"
    words = ("--only", SMALL, "-o", tmp_path / "run", "--docs", docs, "--json")
    code, out, _ = run(*words, "--set", "world.wind_m_s=[0, 0, 0]")  # as it is: changes nothing
    assert code == 0
    told = json.loads(out)
    assert [claim["key"] for claim in told["claims"]] == ["estimator"]
    experiment = next(one for one in EXPERIMENTS if one.name == SMALL)
    here = tmp_path / "here"
    made = run_one(experiment, ExperimentFolder(here, lambda line: None))
    files = [path.relative_to(here) for path in here.rglob("*.*")]
    assert len(files) == 3
    for path in files:
        assert (here / path).read_bytes() == (tmp_path / "run" / path).read_bytes()
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert results["parts"] == [json.loads(json.dumps(made.part.as_json()))]
    assert results["origin"]["command"] == (
        f"ptnsbc reproduce --only {SMALL} --set 'world.wind_m_s=[0, 0, 0]' --docs {docs}"
    )
    assert (docs / "results.md").read_text().startswith("# Results")
    assert run("-o", tmp_path / "run", "--only", "cost")[0] == 2  # would lose what is there


@pytest.mark.slow
def test_ctrl_c_leaves_nothing(tmp_path: Path) -> None:
    goal = tmp_path / "goal"
    child = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "ptnsbc_tools.cli",
            "reproduce",
            "--only",
            "simulation_1",
            "-o",
            str(goal),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        limit = time.monotonic() + 300.0
        while not list(tmp_path.glob(".goal-*/figures/*.png")):
            assert child.poll() is None, child.stderr.read() if child.stderr else ""
            assert time.monotonic() < limit, "nothing was drawn"
            time.sleep(0.05)  # a process of its own: there is nothing else to wait on
        os.killpg(child.pid, signal.SIGINT)
        _, err = child.communicate(timeout=30)
    finally:
        child.kill()
    assert child.returncode == 130
    assert err.decode().splitlines()[-1] == "interrupted"
    assert b"Traceback" not in err
    assert list(tmp_path.iterdir()) == []
