"""Tables that keep their numbers in a narrow terminal, and the words about a compilation."""

from __future__ import annotations

import io
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from rich.table import Table

from ptnsbc_core.compile_cache import CacheFolder
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


@pytest.mark.parametrize(("path", "word"), [("elsewhere", "bin/ptnsbc"), ("bin", "ptnsbc")])
def test_what_to_type_next_is_found_by_this_shell(
    path: str, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """README's `make demo` runs before anybody has activated the environment."""
    script = tmp_path / "bin" / "ptnsbc"
    script.parent.mkdir()
    script.touch(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(script), "demo"])
    monkeypatch.setenv("PATH", str(tmp_path / path))
    assert console.program() == word


def test_a_compilation_shows_its_share_and_time_and_nothing_else_is_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A long look at the disk, or laws that are compiled already, are none."""
    numba = pytest.importorskip("numba")
    monkeypatch.setattr(console, "_PATIENCE_S", 0.0)
    with console.compiling():
        pass
    assert capsys.readouterr().err == ""
    for _ in range(2):
        with console.compiling():
            numba.njit(lambda x: x + 1.0)(1.0)
        *lines, last = capsys.readouterr().err.splitlines()
        assert lines and all(re.match(rf"{re.escape(console.COMPILING)}: \d+ %", x) for x in lines)
        assert re.fullmatch(rf"{re.escape(console.COMPILING)}: done in \d+ s", last)


TELLS_OPTIMISING = """
import sys
from ptnsbc_core.compiler import _Whole
optimise = _Whole._optimize_final_module
def told(library):
    print("optimising", library.name, file=sys.stderr, flush=True)
    optimise(library)
_Whole._optimize_final_module = told
from ptnsbc_tools.cli import main
sys.argv[1:] = ["simulate", "paper_5", "--duration", "1"]
main()
"""


@pytest.mark.slow
def test_a_law_that_is_compiled_does_not_hold_up_an_interrupt(tmp_path: Path) -> None:
    """LLVM does not return for seconds; the process ends at once, and what is in the cache is whole."""
    command = [sys.executable, "-c", TELLS_OPTIMISING]
    environment = {**os.environ, "PTNSBC_CACHE_DIR": str(tmp_path)}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        assert any(line.startswith("optimising _fly") for line in process.stderr)
        begun_s = processor_s(process.pid)
        while (spent_s := processor_s(process.pid)) < begun_s + 0.2:  # in the midst of LLVM
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        assert process.stderr.read().endswith("interrupted\n")
    assert process.returncode == 130
    assert usage.ru_utime + usage.ru_stime - spent_s < 2.0  # of the 6 that LLVM takes
    (folder,) = tmp_path.iterdir()
    assert {path.suffix for path in folder.iterdir()} == {
        ".kernel",
        ".code",
    }  # nothing half-written
    cache = CacheFolder(tmp_path, folder.name)
    assert all(cache.read(path.name) for path in folder.iterdir())


def processor_s(pid: int) -> float:
    """Seconds of a processor that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
