"""The report from Python, and tables for other programs, with units."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from typer.testing import CliRunner

import ptnsbc
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.bag import BagError
from ptnsbc_sim.verdict import Recording
from ptnsbc_tools.cli import app
from ptnsbc_tools.library.flight import Flight
from ptnsbc_tools.library.reporting import checked, export

Fly = Callable[..., Recording]
SAMPLE = Path(__file__).parents[3] / "bags" / "sample"


def test_a_parquet_file_has_the_arrays_and_their_units(fly: Fly, tmp_path: Path) -> None:
    flight = Flight(fly(seconds=7.0))
    file = tmp_path / "flight.parquet"
    assert ptnsbc.export(flight, file) == file
    table = pyarrow.parquet.read_table(tmp_path / "flight.parquet")
    assert table.num_rows == 700 * 5
    east = table["position_m.x"].to_numpy().reshape(700, 5)
    np.testing.assert_array_equal(east, flight.position_m[:, :, 0])
    assert table.schema.field("velocity_m_s.x").metadata == {b"unit": b"m/s"}
    assert table.schema.metadata[b"scenario"] == b"paper_5_free"


def test_a_csv_file_gives_the_same_numbers(fly: Fly, tmp_path: Path) -> None:
    flight = Flight(fly(seconds=7.0))
    export(flight, tmp_path / "deep" / "flight.csv")
    table = pyarrow.csv.read_csv(tmp_path / "deep" / "flight.csv")
    np.testing.assert_array_equal(table["error_m"].to_numpy(), flight.error_m.ravel())
    assert table.column_names[:3] == ["time_s", "uav", "position_m.x"]


@pytest.mark.parametrize(
    ("name", "way"),
    [
        ("flight", "$"),
        ("flight.xlsx", "$"),
        ("flight.rrd", "; Rerun opens the .mcap file"),
        ("flight.ulg", "; PlotJuggler opens the .mcap file"),
    ],
)
def test_another_format_is_refused(name: str, way: str) -> None:
    with pytest.raises(PtnsbcError, match=rf"expected \.csv or \.parquet{way}"):
        checked(Path(name))


def test_the_sample_bag_is_exported(tmp_path: Path) -> None:
    file = tmp_path / "sample.parquet"
    done = CliRunner().invoke(app, ["export", "bags/sample", "-o", str(file), "--window", "1"])
    assert (done.exit_code, done.stdout) == (0, f"{file}\n")
    assert pyarrow.parquet.read_metadata(file).num_rows == 101 * 5
    assert CliRunner().invoke(app, ["export", "bags/sample", "-o", "a.txt"]).exit_code == 2


def test_the_export_of_a_flight_imports_no_library_that_it_does_not_need(tmp_path: Path) -> None:
    """A bag of six ticks took 316 MB, two thirds of it for other libraries and the code of sweeps."""
    code = (
        "import sys; from ptnsbc_tools.cli import app;"
        f"app(['export', 'bags/sample', '--window', '1', '-o', {str(tmp_path / 'a.csv')!r}], standalone_mode=False);"
        "spared = 'pandas', 'pyarrow', 'ptnsbc_sim.sweep', 'scipy.stats';"
        "print([name for name in spared if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=200)
    assert done.stdout.splitlines()[-1] == "[]", done.stderr


def test_a_report_names_its_page_and_the_verdict(tmp_path: Path) -> None:
    made = ptnsbc.report(SAMPLE, tmp_path / "page")
    assert made.page == tmp_path / "page" / "index.html"
    assert made.page.stat().st_size > 100_000
    assert (made.verdict, made.problem) == (ptnsbc.read_bag(SAMPLE).verdict.verdict, "")


def test_a_bag_that_is_not_there_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="none: no such bag"):
        ptnsbc.report(tmp_path / "none")
    assert list(tmp_path.iterdir()) == []


def test_a_flight_has_the_page_of_its_bag(tmp_path: Path) -> None:
    flight = ptnsbc.read_bag(SAMPLE)
    made = ptnsbc.report(flight, tmp_path / "flight", other=flight)
    read = ptnsbc.report(SAMPLE, tmp_path / "bag", other=SAMPLE)
    assert made.page.read_bytes() == read.page.read_bytes()


def test_a_flight_without_a_bag_has_its_page_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    flight = replace(ptnsbc.read_bag(SAMPLE), bag=None)
    made = ptnsbc.report(flight)
    assert made.page == Path("paper_5_free-report", "index.html")
    assert "headless" in made.page.read_text("utf-8")
