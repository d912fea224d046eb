"""Tables that keep their numbers in a narrow terminal, and the words about a compilation."""

from __future__ import annotations

import io

import pytest
from rich.table import Table

from ptnsbc_tools import console


def wide() -> Table:
    table = Table(title="numbers", title_justify="left")
    table.add_column("UAV")
    for k in range(12):
        table.add_column(f"col{k} m", justify="right")
    table.add_row("1", *(f"{k}.{1000 + k}" for k in range(12)), style="red")
    return table


@pytest.mark.parametrize("width", [40, 80, 200])
def test_every_number_is_shown_whole(width: int) -> None:
    out = console.recording(io.StringIO(), width)
    for part in console.narrowed(wide(), out):
        out.print(part)
    text = out.export_text()
    assert max(map(len, text.splitlines())) <= width
    assert all(f"{k}.{1000 + k}" in text for k in range(12)) and "…" not in text


def test_a_table_that_fits_is_left_alone() -> None:
    table = wide()
    assert console.narrowed(table, console.recording(io.StringIO(), 200)) == [table]


def test_a_compilation_is_said_once_and_nothing_else_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A long look at the disk, or laws that are compiled already, are none."""
    numba = pytest.importorskip("numba")
    monkeypatch.setattr(console, "_PATIENCE_S", 0.0)
    console.say_once.cache_clear()
    with console.compiling():
        pass
    assert capsys.readouterr().err == ""
    for _ in range(2):
        with console.compiling():
            numba.njit(lambda x: x + 1.0)(1.0)
    assert capsys.readouterr().err == f"{console.COMPILING}\n"
