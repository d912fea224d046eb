"""Huge numbers: refused in words, on the command line and in the library, never a traceback."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

import ptnsbc
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim import track
from ptnsbc_sim.scenario import ScenarioError
from ptnsbc_tools.cli import app

SAMPLE = "bags/sample"
READERS = (
    ("verify", SAMPLE),
    ("report", SAMPLE, "-o", "OUT.html"),
    ("plot", SAMPLE, "-o", "OUT"),
    ("export", SAMPLE, "-o", "OUT.csv"),
)
TIMED = (
    *((*words, option) for words in READERS for option in ("--window", "--epoch")),
    ("bag", "replay", SAMPLE, "--publish", "--start"),
    ("bag", "replay", SAMPLE, "--publish", "--wait"),
    ("bag", "replay", SAMPLE, "--publish", "--clock"),
    ("sweep", "paper_5", "-o", "OUT", "--stop-after"),
    ("sweep", "paper_5", "-o", "OUT", "--runs"),
    ("sweep", "paper_5", "-o", "OUT", "--check"),
    ("check", "paper_5", "--runs"),
    *((*words, "--tolerance") for words in READERS),
    ("compare", SAMPLE, SAMPLE, "--margin"),
    ("stop", "--patience"),
    ("autopilot", "--origin-spread"),
    ("autopilot", "--yaw"),
)


def run(*words: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, list(words), catch_exceptions=False)
    return result.exit_code, result.stderr.replace("│\n│", "")  # a box wraps its line


@pytest.mark.parametrize("words", TIMED, ids=" ".join)
def test_a_huge_number_is_refused(words: tuple[str, ...], tmp_path: Path) -> None:
    given = [word.replace("OUT", str(tmp_path / "out")) for word in words]
    whole = words[-1] in ("--runs", "--check")
    for value in [str(10**24)] if whole else ["1e300", "nan"]:
        code, err = run(*given, value)
        assert code == 2
        words_in = " ".join(err.split())
        assert re.search(rf"'{words[-1]}'.*: .* (less|greater) than or equal to [\d.]+", words_in)
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("value", [1e300, float("inf"), float("nan"), -1.0])
@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda value: ptnsbc.read_bag(SAMPLE, window_s=value), "window_s"),
        (lambda value: ptnsbc.read_bag(SAMPLE, epoch_s=value), "epoch_s"),
    ],
)
def test_the_library_refuses_it_too(
    call: Callable[[float], object], name: str, value: float
) -> None:
    with pytest.raises(PtnsbcError, match=rf"^{name}: .*: expected [\d.]+ to 1e\+06$"):
        call(value)


def test_the_library_refuses_numbers_that_mean_nothing() -> None:
    flight = ptnsbc.read_bag(SAMPLE)
    for call, words in (
        (lambda: ptnsbc.verdict(flight, -1.0), r"tolerance_m: -1: expected 1e-06 to 1e\+06"),
        (
            lambda: ptnsbc.check("paper_5", dry_runs=-1),
            r"dry_runs: -1: expected a whole number, 0 to 1e\+06",
        ),
        (lambda: ptnsbc.sweep("paper_5", 10**12), r"runs: 1e\+12: expected a whole number, 1 to "),
        (lambda: ptnsbc.sweep("paper_5", 3.5), r"runs: 3\.5: expected a whole number, 1 to 1e\+06"),
        (lambda: ptnsbc.verdict(flight, "5 cm"), r"tolerance_m: '5 cm': expected 1e-06 to 1e\+06"),
    ):
        with pytest.raises(PtnsbcError, match=words):
            call()


WITHOUT_MEMORY = (
    r"timing\.duration_s: 1e\+06 s of 5 UAVs at 100 Hz take 240 GB of memory: expected at most "
    r"16(\.0)? GB, which are free: shorten timing\.duration_s to at most 66666 s, "
    r"or lower timing\.control_hz"
)


def test_a_flight_that_does_not_fit_into_memory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before anything is allocated, compiled or checked."""
    monkeypatch.setattr(track, "_free_bytes", lambda: 16e9)
    for work in ("ptnsbc_sim.swarm.track_of", "ptnsbc_tools.library.flying.findings_of"):
        monkeypatch.setattr(work, lambda *_: pytest.fail("begun"))
    code, err = run("simulate", "paper_5", "--duration", "1e6")
    assert (code, err.count("\n")) == (2, 1)
    assert re.search(WITHOUT_MEMORY, err)
    long = ptnsbc.load("paper_5", **{"timing.duration_s": 1e6})
    for checked in (True, False):
        with pytest.raises(ScenarioError, match=WITHOUT_MEMORY):
            ptnsbc.fly(long, checked=checked)
    with pytest.raises(ScenarioError, match=WITHOUT_MEMORY):
        ptnsbc.sweep(long, runs=1)
    track.refuse_without_memory(ptnsbc.load("paper_5", **{"timing.duration_s": 66666}))
