"""docs/library.md and docs/tutorial.md: the Python of a page runs as one script, from top to bottom."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ptnsbc_tools.library import new_scenario

DOCS = Path(__file__).parents[2] / "docs"


def run_code_of(page: str, count: int) -> None:
    text = (DOCS / page).read_text("utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert len(blocks) == count
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, f"docs/{page}", "exec"), names)


def test_the_code_of_the_page_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0})  # one worker: no processes
    run_code_of("library.md", 3)
    assert capsys.readouterr().out.startswith("True\nmet\n")
    assert (tmp_path / "errors.png").stat().st_size > 10_000


def test_the_code_of_the_tutorial_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    new_scenario.new("out/flock", "v", 7)  # as its first commands do
    run_code_of("tutorial.md", 1)
    assert capsys.readouterr().out.startswith("met ")
    assert (tmp_path / "out" / "errors.png").stat().st_size > 10_000
