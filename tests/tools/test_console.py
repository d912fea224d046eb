"""Tables that keep their numbers in a narrow terminal, and the words about a compilation."""

from __future__ import annotations

import io
import threading
import time
from contextlib import nullcontext

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


def test_a_compilation_names_its_functions(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    numba = pytest.importorskip("numba")
    monkeypatch.setattr(console, "_PATIENCE_S", 0.0)
    monkeypatch.setattr(console, "_COMPILING_SAY_S", 0.001)
    console.say_once.cache_clear()

    with console.compiling():
        said = ""
        deadline = time.monotonic() + 60.0
        while "now law_of_this_test" not in said and time.monotonic() < deadline:

            @numba.njit
            def law_of_this_test(x: float) -> float:
                return x + 1.0

            law_of_this_test(1.0)
            said += capsys.readouterr().err
    assert said.startswith(console.COMPILING)
    assert "now law_of_this_test" in said


class Compiled(list[str]):
    """The names of compiled functions, and whether somebody has looked."""

    def __init__(self, *names: str) -> None:
        super().__init__(names)
        self.looked = threading.Event()

    def __len__(self) -> int:
        self.looked.set()
        return super().__len__()


@pytest.mark.parametrize(("names", "said"), [((), ""), (("law",), f"{console.COMPILING}\n")])
def test_only_a_compilation_is_said_and_once(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    names: tuple[str, ...],
    said: str,
) -> None:
    """A long look at the disk, or laws that are interpreted, are none."""
    console.say_once.cache_clear()
    monkeypatch.setattr(console, "_PATIENCE_S", 0.0)
    for _ in range(2):
        compiled = Compiled(*names)
        monkeypatch.setattr(
            console, "_counted_compilations", lambda found=compiled: nullcontext(found)
        )
        with console.compiling():
            assert compiled.looked.wait(60.0)
    assert capsys.readouterr().err == said
