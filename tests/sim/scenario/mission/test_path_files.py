"""Paths in the forms of other programs: each is known by its content, and what is none is refused with words."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BPoly

from ptnsbc_core.curves.trajectory import curve_samples, reference
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import load_scenario, scenario_from_text
from ptnsbc_sim.scenario.constants import leader_trajectory
from ptnsbc_sim.scenario.mission.path_files import path_rows, text_of, waypoints_of

SQUARE = [[0, 0, 8], [4, 0, 8], [4, 3, 9], [0, 3, 8]]
NAMES = ",".join(f"{axis}^{k}" for axis in ("x", "y", "z", "yaw") for k in range(8))
HOME = [47.3977, 8.5456, 488.0]


def scenario(folder: Path, content: str | bytes, **keys: Any) -> Any:
    data = content.encode() if isinstance(content, str) else content
    (folder / "path.any").write_bytes(data)
    block = {"kind": "file", "file": str(folder / "path.any"), **keys}
    return load_scenario("paper_5_free", {"leader.trajectory": block})


def curve(folder: Path, content: str | bytes, **keys: Any) -> Any:
    return leader_trajectory(scenario(folder, content, **keys))


def polynomials(*pieces: tuple[float, dict[int, list[float]]], axes: int = 4) -> str:
    """Rows of pieces: a duration, and of some axes the coefficients, the lowest power first."""
    rows = []
    for span, of_axis in pieces:
        row = np.zeros((axes, 8))
        for axis, coefficients in of_axis.items():
            row[axis, : len(coefficients)] = coefficients
        rows.append(",".join(map(str, [span, *row.ravel().tolist()])))
    return "\n".join(rows) + "\n"


def item(north_deg: float, east_deg: float, height: float, **changes: Any) -> dict[str, Any]:
    place = [HOME[0] + north_deg, HOME[1] + east_deg, height]
    return {
        "type": "SimpleItem",
        "command": 16,
        "frame": 3,
        "params": [0, 0, 0, None, *place],
        **changes,
    }


def plan(*items: dict[str, Any], **changes: Any) -> str:
    mission = {"hoverSpeed": 2.5, "cruiseSpeed": 15, "plannedHomePosition": HOME, "items": items}
    return json.dumps({"fileType": "Plan", "version": 1, "mission": {**mission, **changes}})


def skyc(*drones: Any, **files: Any) -> bytes:
    made = BytesIO()
    with ZipFile(made, "w") as folder:
        swarm = {"drones": [{"type": "generic", "settings": {"trajectory": one}} for one in drones]}
        folder.writestr("show.json", json.dumps({"version": 1, "swarm": swarm}))
        for name, content in files.items():
            folder.writestr(f"drones/{name}/trajectory.json", json.dumps(content))
    return made.getvalue()


def drone(*points: Any) -> dict[str, Any]:
    return {"version": 1, "takeoffTime": 3.0, "points": list(points)}


HEADS = ["", f"duration,{NAMES}\n", f"Duration,{NAMES},\n", f"# fitted\n\nduration,{NAMES}\n"]


def test_names_of_polynomials_decide() -> None:
    turned = ",".join(reversed(f"duration,{NAMES}".split(",")))
    rows = path_rows(f"{turned}\r{','.join(map(str, range(33)))}\r")
    np.testing.assert_array_equal(rows, [range(32, -1, -1)])
    with pytest.raises(ValueError, match=r"expected one named x\^1"):
        path_rows(f"duration,{NAMES}\n1\n".replace("x^1", "x^9"))


@pytest.mark.parametrize("head", HEADS)
def test_polynomials_are_flown_as_they_are(tmp_path: Path, head: str) -> None:
    first = {0: [0, 0, 0, 0, 1], 1: [1.0], 2: [8.0], 3: [0.5, 0.1]}
    last = {0: [1, 4], 1: [1, 0, 0.5], 2: [8.0], 3: [0.6]}
    path = curve(tmp_path, head + polynomials((1.0, first), (2.0, last)))
    at = reference(path, 0.5)
    np.testing.assert_allclose(at.position, [0.0625, 1, 8])
    assert at.yaw == pytest.approx(0.55)
    np.testing.assert_allclose(reference(path, 2.0).position, [5, 1.5, 8])
    np.testing.assert_allclose(reference(path, 9.0).position, [9, 3, 8])
    assert reference(path, 9.0).velocity == (0.0, 0.0, 0.0)


def test_polynomials_without_a_heading_leave_it_to_the_scenario(tmp_path: Path) -> None:
    text = polynomials((10.0, {0: [0, 1], 2: [8]}), axes=3)
    assert reference(curve(tmp_path, text, yaw_rad=0.7), 1.0).yaw == pytest.approx(0.7)
    assert reference(curve(tmp_path, text, heading="path"), 1.0).yaw == pytest.approx(0.0)


@pytest.mark.parametrize("form", ["{0},{1},{2}", "{0} {1} {2}", "{0};{1};{2}"])
def test_waypoints_are_flown_at_the_speed_of_the_scenario(tmp_path: Path, form: str) -> None:
    text = "\n".join(form.format(*point) for point in SQUARE)
    known = load_scenario(
        "paper_5_free",
        {"leader.trajectory": {"kind": "waypoints", "points_m": SQUARE, "speed_m_s": 0.5}},
    )
    for named in (text, form.format("x", "y_m", "z") + "\n" + text):
        found = curve(tmp_path, named, speed_m_s="0.5 m/s")
        np.testing.assert_array_equal(found.table, leader_trajectory(known).table)


def test_waypoints_may_have_headings(tmp_path: Path) -> None:
    path = curve(tmp_path, "x,y,z,yaw_deg\n0,0,8,0\n1,0,8,90\n", speed_m_s=1.0)
    assert reference(path, 1.0).yaw == pytest.approx(np.pi / 2)


@pytest.mark.parametrize("head", ["", "x,y,z,heading\n", "heading,x,y,z\n"])
def test_samples_at_a_constant_rate_have_the_rate_of_the_scenario(
    tmp_path: Path, head: str
) -> None:
    rows = [[0.1 * k, 0, 8, 0.02 * k] for k in range(20)]
    order = [3, 0, 1, 2] if head.startswith("heading") else range(4)
    text = head + "\n".join(",".join(str(row[k]) for k in order) for row in rows)
    at = reference(curve(tmp_path, text, rate_hz=5), 1.0)
    np.testing.assert_allclose(at.position, [0.5, 0, 8])
    assert at.yaw == pytest.approx(0.1)


@pytest.mark.parametrize("head", ["", "# timestamp tx ty tz qx qy qz qw\n", "# by a tracker\n"])
def test_poses_of_tum_begin_at_zero_and_turn(tmp_path: Path, head: str) -> None:
    half = np.sqrt(0.5)
    rows = [(1305031102.25 + k, k, 2 * k, 8, 0, 0, half, half) for k in range(5)]
    at = reference(curve(tmp_path, head + "\n".join(" ".join(map(str, row)) for row in rows)), 2.0)
    np.testing.assert_allclose(at.position, [2, 4, 8], atol=1e-6)
    assert at.yaw == pytest.approx(np.pi / 2)


def test_a_show_of_skybrush_gives_a_drone(tmp_path: Path) -> None:
    curved = [[1.0, [0, 0, 8], []], [3.0, [2, 2, 8], [[1, 0, 8], [2, 0, 8]]], [4.0, [3, 2, 8], []]]
    show = skyc(
        drone(*curved),
        {"$ref": "./drones/b/trajectory.json#"},
        b=drone([0, [9, 0, 5], []], [1, [9, 1, 5], []]),
    )
    path = curve(tmp_path, show)
    bezier = BPoly(np.array([[0, 0, 8], [1, 0, 8], [2, 0, 8], [2, 2, 8]], float)[:, None], [0, 2])
    for t in (0.0, 0.3, 1.7, 2.0):
        np.testing.assert_allclose(reference(path, t).position, bezier(t), atol=1e-8)
    np.testing.assert_allclose(reference(path, 2.5).position, [2.5, 2, 8])
    np.testing.assert_allclose(reference(curve(tmp_path, show, drone=2), 0.5).position, [9, 0.5, 5])


def test_a_plan_of_qgroundcontrol_is_flown_about_its_home(tmp_path: Path) -> None:
    takeoff = item(-HOME[0], -HOME[1], 10, command=22)
    text = plan(takeoff, item(1e-4, 0, 10), item(1e-4, 1e-4, 500, frame=0))
    own = scenario(tmp_path, text)
    path = leader_trajectory(own)
    times, places = path.table[:, 0], curve_samples(path, path.table[:, 0])[:, :3]
    north, east = (
        np.radians(1e-4) * 6371000,
        np.radians(1e-4) * 6371000 * np.cos(np.radians(HOME[0])),
    )
    np.testing.assert_allclose(places, [[0, 0, 10], [0, north, 10], [east, north, 12]], atol=1e-3)
    assert times[1] == pytest.approx(north / 2.5, rel=1e-4)
    slower = curve(tmp_path, text, speed_m_s=1.0)
    assert slower.table[1, 0] == pytest.approx(north, rel=1e-4)
    assert own.mavlink.world_origin.place == tuple(HOME)
    again = scenario_from_text(own.text, complete=True)
    assert leader_trajectory(again).table.tobytes() == path.table.tobytes()


def test_a_plan_stays_where_it_is_on_the_earth(tmp_path: Path) -> None:
    (tmp_path / "a.plan").write_text(plan(item(0, 0, 10), item(1e-4, 0, 10)))
    origin = {"latitude_deg": HOME[0] + 1e-4, "longitude_deg": HOME[1], "altitude_m": HOME[2] - 5}
    block = {"kind": "file", "file": str(tmp_path / "a.plan")}
    given = {"leader.trajectory": block, "mavlink.world_origin": origin}
    own = load_scenario("paper_5_free", given)
    places = curve_samples(leader_trajectory(own), np.array([0.0, 99.0]))[:, :3]
    south = np.radians(-1e-4) * 6371000
    np.testing.assert_allclose(places, [[0, south, 15], [0, 0, 15]], atol=1e-3)
    assert own.mavlink.world_origin.place[0] == origin["latitude_deg"]


@pytest.mark.parametrize(
    ("content", "keys", "words"),
    [
        ("x,y,z\n0,0,8\n1,0,8\n", {}, "no times: expected speed_m_s, or rate_hz"),
        ("0,0,8\n1,0,8\n", {}, "no times: expected speed_m_s, or rate_hz"),
        ("t,x,y,z\n0,0,0,8\n1,0,0,8\n", {"speed_m_s": 1}, "have times: expected neither speed_m_s"),
        ("0,0,8\n0,0,8\n", {"speed_m_s": 1}, "row 2 of numbers: expected another point"),
        ("0,0,8\n1,0,8\n", {"speed_m_s": 1, "rate_hz": 5}, "either speed_m_s or rate_hz"),
        ("0,0,8,1\n0,1,8,1\n0,2,8,2\n", {}, "speed_m_s or rate_hz of rows without times"),
        ("0,0,8\n1,0,8\n", {"rate_hz": 1e4}, r"rate_hz: 10000\.0: expected <= 1000"),
        ("1,2,3,4,5,6\n", {}, "6 columns without names: expected rows t, x, y, z, yaw; .* a .skyc"),
        ("0 0 0 8 0 0 0 2\n1 0 0 8 0 0 0 2\n", {}, "quaternions qx, qy, qz, qw of length 1"),
        ("0 0 0 8 0 0 0 1e300\n1 0 0 8 0 0 0 1\n", {}, "quaternions qx, qy, qz, qw of length 1"),
        (polynomials((1.0, {0: [0, 1]}), (1.0, {0: [3]})), {}, "row 2 .* begins 2 m from the end"),
        (polynomials((0.0, {0: [0, 1]})), {}, r"pieces of 0\.01 s or more"),
        (polynomials((9.0, {0: [0] * 7 + [1e7]})), {}, "no number beyond 1e"),
        (f"duration,{NAMES}\n", {}, "0 rows: expected"),
        (polynomials((1.0, {})) + "1,2\n", {}, "row 2: 2 numbers: expected duration, x"),
        (b"\xff\x00", {}, "byte 0 is no text: expected rows t, x, y, z, yaw; .* a .plan"),
        ("{}", {}, "fileType: Field required: expected rows .* a .plan of QGroundControl"),
        ('{"fileType": "GeoFence"}', {}, "fileType: Input should be 'Plan'"),
        (plan(item(0, 0, 9), item(0, 0, 9, command=20)), {}, r"items\[1\]: return 20 in frame 3: exp"),
        (plan(item(0, 0, 9, complexItemType="survey"), {}), {}, r"items\[0\]: survey 16 in .* expected a take-off"),
        (plan(item(0, 0, 9, params=[5, 0, 0, 0, *HOME]), {}), {}, r"items\[0\]: .* without a hold"),
        (plan(item(0, 0, 9, frame=10), {}), {}, "frame 10: expected .* a height above home"),
        (plan(item(0, 0, 9)), {}, r"mission\.items: List should have at least 2"),
        (plan(item(0, 0, 9), {}, hoverSpeed="fast"), {}, r"mission\.hoverSpeed: Input should be a valid"),
        (b"PK\3\4 no zip", {}, "BadZipFile.*expected rows"),
        (skyc(drone([0, [0, 0, 8], []], [0, [1, 0, 8], []])), {}, r"points\[1\]: 0 s: expected times"),
        (skyc(drone([0, [0, 0, 8]], [1, [1, 0, 8]])), {}, r"trajectory\.points\.0\.2: Field required"),
        (skyc({"$ref": "gone.json"}), {}, "There is no item named 'gone.json'"),
        (skyc(drone()), {"drone": 2}, "drone: 2: expected 1 to 1"),
        (skyc(drone()), {"drone": "b"}, "drone: 'b': expected 1 to 1"),
        ("0,0,0,8\n1,0,0,8\n", {"drone": 1}, "drone: expected no number, only a .skyc"),
    ],
)  # fmt: skip
def test_what_is_no_path_is_refused_with_words(
    tmp_path: Path, content: str | bytes, keys: dict[str, Any], words: str
) -> None:
    with pytest.raises(PtnsbcError, match="leader.trajectory.*" + words):
        scenario(tmp_path, content, **keys)


@given(st.binary(max_size=200), st.sampled_from([b"", b"PK", b"{", b"0,0,8\n", b"# t x y z\n"]))
def test_bytes_are_a_path_or_an_error_in_words(data: bytes, head: bytes) -> None:
    try:
        text = text_of(head + data)
        waypoints_of(text) if text.startswith("{") else path_rows(text)
    except ValueError as error:
        assert str(error)
