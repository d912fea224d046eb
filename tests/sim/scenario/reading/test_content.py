"""Trajectories and shapes of the user: called once, then data; nothing from outside is executed."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from ptnsbc_core.curves.trajectory import reference
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import load_scenario, scenario_from_text
from ptnsbc_sim.scenario.constants import leader_trajectory

PATHS = """
from math import cos, sin


def ring(t, radius_m=3.0):
    return radius_m * sin(t / 5), radius_m * cos(t / 5), 4.0


def turning(t):
    return 0.1 * t, 0.0, 4.0, 0.05 * t


def wrong(t):
    return 1.0 / (t - 2.0), 0.0, 0.0


def short(t):
    return 1.0, 2.0


def row(count, gap_m=1.5):
    return [(10.0 - gap_m * k, 5.0, 0.2 * k) for k in range(count)]


def few(count):
    return [(0.0, 0.0, 0.0)]


def broken(count):
    values = []
    return values[count]


number = 3
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "paths.py").write_text(PATHS)
    return tmp_path


def scenario(folder: Path, more: str, name: str = "own.yaml"):
    (folder / name).write_text(f"extends: paper_5_free\nname: own\n{more}")
    return load_scenario(folder / name)


def trajectory(function: str, more: str = "") -> str:
    return f"leader: {{trajectory: {{kind: 'paths.py:{function}'{more}}}}}\n"


def shape(function: str, more: str = "") -> str:
    block = f"shape: {{kind: 'paths.py:{function}'{more}}}"
    return f"formation: {{offsets_m: null, {block}}}\ncommunication: {{tree: auto}}\n"


def test_the_leader_follows_the_function(folder: Path) -> None:
    own = scenario(folder, trajectory("ring", ", arguments: {radius_m: 2.0}, duration_s: 40"))
    curve = leader_trajectory(own)
    for t in (0.0, 0.37, 5.0, 31.234, 39.95):
        place = reference(curve, t).position
        wanted = (2.0 * np.sin(t / 5), 2.0 * np.cos(t / 5), 4.0)
        np.testing.assert_allclose(place, wanted, atol=2e-7)  # of a cubic spline, 0.1 s apart
    assert own.leader.trajectory.kind == "file"


def test_a_fourth_number_is_the_heading(folder: Path) -> None:
    curve = leader_trajectory(scenario(folder, trajectory("turning", ", duration_s: 20")))
    assert reference(curve, 8.0).yaw == pytest.approx(0.4)


def test_a_shape_gives_offsets_from_the_leader(folder: Path) -> None:
    own = scenario(folder, shape("row", ", gap_m: 2.0"))
    places = np.array([own.offset(uav) for uav in own.uav_ids])
    np.testing.assert_allclose(places, [[-2.0 * k, 0.0, 0.2 * k] for k in range(5)], atol=1e-12)
    assert own.formation.shape is None


def test_the_text_is_data_that_needs_no_file(folder: Path) -> None:
    own = scenario(folder, trajectory("ring") + shape("row"))
    assert "paths.py" not in own.text
    (folder / "paths.py").unlink()
    again = scenario_from_text(own.text, complete=True)
    assert again.text == own.text
    assert leader_trajectory(again).table.tobytes() == leader_trajectory(own).table.tobytes()
    assert own.with_({"timing.duration_s": 7.0}).timing.duration_s == 7.0


def test_the_file_beside_an_extended_scenario_counts(folder: Path) -> None:
    scenario(folder, shape("row"), "base.yaml")
    below = folder / "below"
    below.mkdir()
    (below / "own.yaml").write_text("extends: ../base.yaml\nname: below\n")
    own = load_scenario(below / "own.yaml")
    assert own.offset(2).tolist() == pytest.approx([-1.5, 0.0, 0.2])


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (trajectory("wrong"), r"paths\.py:14: wrong: ZeroDivisionError"),
        (
            trajectory("short"),
            r"paths\.py:17: short: gave \[1\.0, 2\.0\] at t = 0: expected 3 or 4",
        ),
        (trajectory("gone"), r"paths\.py: gone: no such name: expected a function"),
        (trajectory("number"), r"paths\.py: number: int: expected a function"),
        (
            trajectory("ring", ", step_s: 0.001"),
            r"step_s: 0.001: expected a number from 0.01 to 1e\+06 s",
        ),
        (trajectory("ring", ", step_s: 5 m"), r'step_s: "5 m": expected a number from 0.01'),
        (trajectory("ring", ", duration_s: 900 s"), r"9001 rows in 900 s: expected 2 to 2000"),
        (trajectory("ring", ", arguments: {size: 1}"), r"paths\.py:5: ring: TypeError"),
        (trajectory("ring", ", arguments: 3"), r"arguments: expected a mapping"),
        (trajectory("ring", ", speed: 3"), r"speed: unknown key"),
        (shape("few"), r"paths\.py:25: few: 1 places: expected one for each of 5 UAVs"),
        (shape("broken"), r"paths\.py:31: broken: IndexError"),
        (trajectory("ring", ", arguments: {function: 1}"), r"paths\.py:5: ring: TypeError"),
        (shape("row", ", 3: 4"), r"paths\.py:\d+: row: TypeError"),
        (shape("row") + "leader: {id: 9}\n", "leader.id: 9: no such UAV"),
    ],
)
def test_errors_name_file_and_line(folder: Path, more: str, words: str) -> None:
    with pytest.raises(PtnsbcError, match=words):
        scenario(folder, more)


def test_a_file_that_is_not_there_or_no_python(folder: Path) -> None:
    (folder / "bad.py").write_text("def path(t:\n")
    for name, words in (("none.py", "No such file"), ("bad.py", r"bad\.py:1: ")):
        with pytest.raises(PtnsbcError, match=words):
            scenario(folder, f"leader: {{trajectory: {{kind: '{name}:path'}}}}\n")


def test_nothing_from_outside_is_executed(folder: Path) -> None:
    """Neither what a bag holds, nor a text without a folder, nor an override, which a ROS parameter may be."""
    mark = folder / "executed"
    (folder / "evil.py").write_text(f"open({str(mark)!r}, 'w')\ndef path(t):\n    return 0, 0, 5\n")
    kind = f"{folder / 'evil.py'}:path"
    text = load_scenario("paper_5_free").text
    named = text.replace("kind: circle", f"kind: {kind}", 1)
    assert kind in named
    for complete in (True, False):
        with pytest.raises(PtnsbcError, match="not here"):
            scenario_from_text(named, complete=complete)
    for given in (
        {"leader.trajectory": {"kind": kind}},
        {"leader.trajectory.kind": kind},
        {"formation.shape": {"kind": kind}},
    ):
        with pytest.raises(PtnsbcError, match="not as an override"):
            load_scenario("paper_5_free", given)
    assert not mark.exists()


def test_an_installed_package_may_bring_one(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "own_paths.py").write_text(PATHS)
    info = folder / "own_paths-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own-paths\nVersion: 1\n")
    entries = (
        "trajectory.ring = own_paths:ring\nshape.row = own_paths:row\ntrajectory.bad = none:x\n"
    )
    (info / "entry_points.txt").write_text(f"[ptnsbc.plugins]\n{entries}")
    monkeypatch.syspath_prepend(str(folder))
    own = scenario(
        folder, "leader: {trajectory: {kind: ring}}\n" + shape("x").replace("paths.py:x", "row")
    )
    assert own.leader.trajectory.kind == "file"
    assert own.offset(3).tolist() == pytest.approx([-3.0, 0.0, 0.4])
    with pytest.raises(PtnsbcError, match=r"bad: ModuleNotFoundError: .*entry point that loads"):
        scenario(folder, "leader: {trajectory: {kind: bad}}\n")
    sys.modules.pop("own_paths", None)
