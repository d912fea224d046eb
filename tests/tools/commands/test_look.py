"""`ptnsbc report` and `ptnsbc plot` as a user meets them, on the sample bag."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from ptnsbc_io.wire import OdometryTemplate
from ptnsbc_tools.cli import app
from ptnsbc_tools.plotting.charts import view_of
from ptnsbc_tools.reading.bag_reader import StatusSeries
from ptnsbc_tools.report.page import page

ODOMETRY = "nav_msgs/msg/Odometry"
SAMPLE = Path(__file__).parents[3] / "bags" / "sample"


def run(*words: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(word) for word in words])
    lines = result.stderr.splitlines(keepends=True)
    # How far it is depends on how busy the machine is.
    return result.exit_code, result.stdout, "".join(one for one in lines if "error" in one)


def test_a_page_and_nothing_else(tmp_path: Path) -> None:
    code, out, _ = run("report", SAMPLE, "-o", tmp_path / "out", "--json")
    told = json.loads(out)
    assert (code, told["verdict"], told["problem"]) == (0, "met", None)
    assert Path(told["report"]) == tmp_path / "out" / "index.html"
    assert [one.name for one in (tmp_path / "out").iterdir()] == ["index.html"]


@pytest.mark.slow
def test_another_flight_beside_it_and_a_pdf_of_all_figures(tmp_path: Path) -> None:
    code, out, _ = run("report", SAMPLE, "--with", SAMPLE, "-o", tmp_path / "two")
    assert code == 0 and Path(out.strip()).is_file()
    for name in ("a.pdf", "b.pdf"):
        code, out, _ = run("plot", SAMPLE, "-o", tmp_path / name)
        assert (code, out) == (0, f"{tmp_path / name}\n")
    first, second = ((tmp_path / name).read_bytes() for name in ("a.pdf", "b.pdf"))
    assert first == second and first.count(b"/Type /Page ") >= 5
    assert run("report", SAMPLE, "--with", tmp_path / "none", "-o", tmp_path / "three")[0] == 2
    assert not (tmp_path / "three").exists()


def test_the_same_bag_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        code, out, _ = run("report", SAMPLE, "-o", tmp_path / name)
        assert (code, out) == (0, f"{tmp_path / name / 'index.html'}\n")
    first, second = ((tmp_path / name / "index.html").read_bytes() for name in ("a", "b"))
    assert first == second


def test_a_minute_of_five_uavs_stays_below_five_megabytes(fly) -> None:
    """With noise on everything, which no compression takes away."""
    noise = np.random.default_rng(1)
    recording = fly(seconds=60.0)
    for tracks in (recording.odometry, recording.wrench):
        for series in tracks.values():
            series.values[:] += 0.01 * noise.standard_normal(series.values.shape)
    recording.estimate.update(recording.odometry)
    assert len(page(view_of(recording, StatusSeries()), {}).encode()) < 5_000_000


def test_a_bag_that_cannot_be_read_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "flight").mkdir()
    (tmp_path / "flight" / "flight_0.mcap").write_bytes(b"")
    code, out, err = run("report", tmp_path / "flight")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert "is empty" in err
    assert [one.name for one in tmp_path.iterdir()] == ["flight"]


def test_a_flight_that_cannot_be_judged_has_a_page_that_says_why(tmp_path: Path) -> None:
    words = ("report", SAMPLE, "-o", tmp_path, "--epoch", "1000", "--json")
    code, out, _ = run(*words)
    told = json.loads(out)
    assert (code, told["verdict"]) == (1, None)
    assert "holds no formation flight" in told["problem"]
    assert told["problem"] in (tmp_path / "index.html").read_text()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("report", "nowhere"), "nowhere: no such bag"),
        (("plot", "nowhere"), "nowhere: no such bag"),
        (("plot", SAMPLE, "--what", "dance"), "--what dance: expected one or more of all"),
        (
            ("plot", SAMPLE, "-o", "x.gif"),
            "x.gif: expected a folder, or FILE with .png, .svg or .pdf",
        ),
        (("plot", SAMPLE, "-o", "x.png"), "x.png: one file for 11 figures"),
        (("plot", SAMPLE, "-o", "x.png", "--what", "latency"), "nothing to draw for latency"),
        (("report", SAMPLE, "-o", "/dev/null/x"), "cannot be written: Not a directory"),
    ],
)
def test_errors_are_one_line_and_two(words: tuple[str, ...], expected: str) -> None:
    code, out, err = run(*words)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert expected in err


def test_a_bag_of_others(fly, tmp_path: Path) -> None:
    """Sqlite3, only odometry, under another name and without an epoch."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    recording = fly(seconds=6.0)
    (tmp_path / "flight.yaml").write_text(recording.scenario.text)
    plugin = rosbag2.StoragePlugin.SQLITE3
    with rosbag2.Writer(tmp_path / "bag", version=9, storage_plugin=plugin) as writer:
        for uav, series in recording.odometry.items():
            topic = writer.add_connection(f"/drone{uav}/odom", ODOMETRY, typestore=store)
            template = OdometryTemplate("map", f"drone{uav}")
            for t_ns, values in zip(series.t_ns.tolist(), series.values, strict=True):
                writer.write(topic, t_ns, template.encode(t_ns, values))
    words = ("--scenario", tmp_path / "flight.yaml", "--odom", "/drone{n}/odom", "--json")
    code, out, err = run("report", tmp_path / "bag", "-o", tmp_path / "out", *words)
    assert (code, json.loads(out)["verdict"], err) == (0, "met", "")


def test_plot_of_some_and_of_one(tmp_path: Path) -> None:
    code, out, _ = run(
        "plot", SAMPLE, "-o", tmp_path, "--what", "errors,separations", "--format", "svg"
    )
    assert code == 0
    assert out.split() == [str(tmp_path / "errors.svg"), str(tmp_path / "between.svg")]
    one = tmp_path / "one" / "inputs.png"
    code, out, _ = run("plot", SAMPLE, "-o", one, "--what", "torque", "--json")
    assert (code, json.loads(out)) == (0, {"figures": [str(one)]})
    assert one.read_bytes().startswith(b"\x89PNG")
