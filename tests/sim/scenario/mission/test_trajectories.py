"""Curves through points and rows: where they pass, how they begin and end, and what is refused."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from ptnsbc_core.curves.trajectory import curve_state, reference
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import Scenario, load_scenario, scenario_from_text
from ptnsbc_sim.scenario.constants import leader_trajectory
from ptnsbc_sim.scenario.mission.trajectories import extremes, trajectory_of

POINTS = [[0, 0, 8], [4, 0, 8], [4, 3, 9], [0, 3, 8]]
TIMES = [0, 4, 9, 14]
CSV = "t,x,y,z,yaw\n0,0,0,8,3\n2,1,0,8,-3\n4,2,1,8,-2.5\n5,2,2,8,-2\n"


def scenario(**path: Any) -> Scenario:
    return load_scenario("paper_5_free", {"leader.trajectory": path})


def curve(**path: Any) -> Any:
    return leader_trajectory(scenario(**path))


@pytest.mark.parametrize("through", ["straight", "cubic", "minimum_snap"])
@pytest.mark.parametrize("closed", [False, True])
def test_passes_each_point_on_time(through: str, closed: bool) -> None:
    times = [*TIMES, 18] if closed else TIMES
    path = curve(kind="waypoints", points_m=POINTS, times_s=times, through=through, closed=closed)
    for t, point in zip(TIMES, POINTS, strict=True):
        np.testing.assert_allclose(reference(path, float(t)).position, point, atol=1e-12)
    if closed:
        np.testing.assert_allclose(reference(path, 18.0 + 4.0).position, POINTS[1], atol=1e-12)
        return
    for t in (0.0, 14.0):
        np.testing.assert_allclose(reference(path, t).velocity, np.zeros(3), atol=1e-12)
    assert reference(path, 99.0).position == pytest.approx(POINTS[-1])
    assert reference(path, 99.0).velocity == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("through", "closed", "order"),
    [
        ("straight", False, 3),
        ("cubic", False, 2),
        ("cubic", True, 2),
        ("minimum_snap", False, 3),
        ("minimum_snap", True, 3),
    ],
)
def test_derivatives_are_continuous_inside(through: str, closed: bool, order: int) -> None:
    times = [*TIMES, 18] if closed else TIMES
    path = curve(kind="waypoints", points_m=POINTS, times_s=times, through=through, closed=closed)
    for t in [4.0, 9.0, *([14.0, 18.0] if closed else [])]:
        before, after = curve_state(path, t - 1e-9), curve_state(path, t)
        for k in range(order + 1):
            np.testing.assert_allclose(before[k], after[k], atol=1e-6)


def test_minimum_snap_has_less_snap_than_rests_and_than_its_neighbours() -> None:
    """The integral of the squared fourth derivative, of a curve along x that rests at both ends."""
    given = {"kind": "waypoints", "points_m": POINTS, "times_s": TIMES}

    def snap(path: Any, t: float) -> float:
        step = 1e-4
        return (curve_state(path, t + step).jerk[0] - curve_state(path, t - step).jerk[0]) / (
            2 * step
        )

    def cost(path: Any) -> float:
        spans = pairwise(TIMES)
        return sum(quad(lambda t: snap(path, t) ** 2, a + 1e-3, b - 1e-3)[0] for a, b in spans)

    best = curve(**given)
    assert cost(best) < 0.7 * cost(curve(**given, through="straight"))
    # Zero at every waypoint, with three derivatives at the ends: it may be added to any curve that fits.
    bump = np.poly1d([1.0])
    for t, power in zip(TIMES, (4, 1, 1, 4), strict=True):
        bump *= np.poly1d([1.0, -t]) ** power
    bump /= max(abs(bump(np.linspace(0, 14, 200))))
    fourth = bump.deriv(4)
    mixed = sum(
        quad(lambda t: snap(best, t) * fourth(t), a + 1e-3, b - 1e-3)[0] for a, b in pairwise(TIMES)
    )
    own = quad(lambda t: fourth(t) ** 2, 0, 14)[0]
    assert abs(mixed) < 1e-2 * np.sqrt(own * cost(best))  # the first variation vanishes


def test_a_speed_gives_the_times() -> None:
    mean = curve(kind="waypoints", points_m=[[0, 0, 8], [3, 4, 8]], speed_m_s=0.5)
    assert mean.table[:, 0].tolist() == [0.0, 10.0]
    straight = scenario(
        kind="waypoints", points_m=[[0, 0, 8], [3, 4, 8]], speed_m_s=0.5, through="straight"
    )
    most = extremes(straight.leader.trajectory, 60.0)
    assert most.speed_m_s == pytest.approx(0.5, rel=1e-3)


def test_yaws_turn_the_shorter_way() -> None:
    given = {"kind": "waypoints", "points_m": POINTS, "times_s": TIMES}
    path = curve(**given, yaws_rad=[3.0, -3.0, -2.0, 0.0])
    assert curve_state(path, 4.0).heading.angle == pytest.approx(2 * np.pi - 3.0)
    assert curve_state(path, 2.0).heading.rate > 0.0


def test_circle_and_lissajous_along_their_path_are_the_circle() -> None:
    given = {"kind": "circle", "centre_m": [1, 2, 8], "radius_m": 5, "rate_rad_s": -0.2}
    still, turning = curve(**given, phase_rad=0.3), curve(**given, phase_rad=0.3, heading="path")
    for t in (0.0, 3.0, 11.0):
        one, other = curve_state(still, t), curve_state(turning, t)
        for k in range(4):
            np.testing.assert_allclose(one[k], other[k], atol=1e-12)
        assert other.heading.rate == pytest.approx(0.2)  # a negative rate goes counter-clockwise
        assert other.heading.acceleration == pytest.approx(0.0, abs=1e-12)


def test_another_kind_replaces_the_trajectory_that_is_extended(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    lines = "extends: paper_5_free\nname: mine\nleader: {trajectory: {kind: hover, position_m: [0, 0, 3]}}\n"
    path.write_text(lines)
    assert load_scenario(path).leader.trajectory.kind == "hover"
    path.write_text("extends: paper_5_free\nname: mine\nleader: {trajectory: {radius_m: 6}}\n")
    assert load_scenario(path).leader.trajectory.kind == "circle"


def test_hover_is_a_line_that_stays() -> None:
    assert curve(kind="hover", position_m=[1, 2, 3], yaw_rad=0.5) == curve(
        kind="line", position_m=[1, 2, 3], yaw_rad=0.5
    )


def test_csv_is_carried_by_the_scenario(tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text(CSV, encoding="utf-8-sig")  # as Excel does
    path = tmp_path / "mine.yaml"
    path.write_text(
        "extends: paper_5_free\nname: mine\nleader: {trajectory: {kind: csv, file: path.csv}}\n"
    )
    found = load_scenario(path)
    at = reference(leader_trajectory(found), 4.0)
    np.testing.assert_allclose(at.position, [2, 1, 8])
    assert at.yaw == pytest.approx(2 * np.pi - 2.5)
    again = scenario_from_text(found.text, complete=True)
    assert again == found
    (tmp_path / "whole.yaml").write_text(found.text.replace("samples", "file"))
    with pytest.raises(PtnsbcError, match=r"trajectory\.file: not here"):
        scenario_from_text((tmp_path / "whole.yaml").read_text(), complete=True)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"times_s": None}, "times_s: expected either times_s or speed_m_s"),
        ({"speed_m_s": 1.0}, "times_s: expected either times_s or speed_m_s"),
        ({"times_s": [0, 4, 9]}, "times_s: 3 numbers: expected 4"),
        ({"closed": True}, "times_s: 4 numbers: expected 5, one for each of 4 points and the end"),
        ({"times_s": [0, 4, 4, 9]}, r"times_s\[2\]: 4: expected times"),
        ({"times_s": [1, 4, 5, 9]}, r"times_s\[0\]: 1: expected times that begin with 0"),
        ({"yaws_rad": [0, 1]}, "yaws_rad: 2 numbers: expected one for each of 4"),
        ({"points_m": [[0, 0, 1]]}, "points_m"),
        ({"points_m": [[0, 0, 2e6], *POINTS[1:]]}, "points_m: expected no number beyond 1e"),
        ({"times_s": [0, 4, 9, 2e6]}, "times_s: expected no number beyond 1e"),
        ({"yaws_rad": [0, 1, 2, -2e6]}, "yaws_rad: expected no number beyond 1e"),
        ({"times_s": None, "speed_m_s": 1e-300}, "speed_m_s: 1e-300: expected >= 0.001"),
        (
            {"times_s": None, "speed_m_s": 1.0, "points_m": [[0, 0, 1], [0, 0, 1]]},
            r"points_m\[0\]: the same as the next one",
        ),
    ],
)
def test_waypoints_that_are_none(change: dict[str, Any], words: str) -> None:
    given = {"kind": "waypoints", "points_m": POINTS, "times_s": TIMES, **change}
    given = {key: value for key, value in given.items() if value is not None}
    with pytest.raises(PtnsbcError, match=r"leader\.trajectory\." + words):
        scenario(**given)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0,0,0,1\n", "1 rows: expected 2"),
        ("0,0,0,1\n1,2\n", "row 2: 2 numbers"),
        ("0,0,0,1\n1,0,0,1,3\n", "row 2: 5 numbers"),
        ("0,0,0,1\n1,0,x,1\n", "row 2: expected numbers"),
        ("0,0,0,1\n1,0,nan,1\n", "row 2: expected finite numbers"),
        ("0,0,0,1\n1,0,1e300,1\n", "expected no number beyond 1e"),
        ("0,0,0,1\n0,0,0,1\n", "row 2 of numbers, t = 0: expected times"),
        ("1,0,0,1\n2,0,0,1\n", "row 1 of numbers, t = 1: expected times"),
        ("t,x,y,alt\n0,0,0,1\n1,0,0,1\n", "row 1: column t, x, y, alt: expected one named z"),
    ],
)
def test_rows_that_are_none(text: str, words: str) -> None:
    with pytest.raises(PtnsbcError, match=r"leader\.trajectory\.samples: " + words):
        scenario(kind="file", samples=text)


def test_a_table_that_does_not_fit_is_named_with_its_file_and_the_rule(tmp_path: Path) -> None:
    for text, words in (
        ("t,x,y,z_ned\n0,0,0,1\n1,0,0,1\n", "row 1: column z_ned: expected one named z, in m"),
        (
            "".join(f"{k / 1000},0,0,{k}\n" for k in range(100)),
            r"row 2 of numbers, t = 0\.001: .* by 0\.01 s or more",
        ),
        (
            "".join(f"{k},0,0,1\n" for k in range(2001)),
            r"2001 rows: expected 2 to 2000, 0\.01 s apart",
        ),
    ):
        (tmp_path / "path.csv").write_text(text)
        with pytest.raises(PtnsbcError, match=r"trajectory\.file: .*path\.csv: " + words):
            scenario(kind="file", file=str(tmp_path / "path.csv"))


def test_a_table_of_100_hz_is_flown_whatever_its_times_round_to() -> None:
    text = "".join(f"{k / 100},{k / 100},0,6\n" for k in range(200))
    assert curve_state(curve(kind="file", samples=text), 1.5).position[0] == pytest.approx(1.5)


def test_a_file_that_is_not_there() -> None:
    with pytest.raises(PtnsbcError, match=r"trajectory\.file: .*nowhere\.csv: No such file"):
        scenario(kind="file", file="nowhere.csv")
    with pytest.raises(PtnsbcError, match=r"trajectory\.file: 3: expected the name"):
        scenario(kind="file", file=3)
    with pytest.raises(PtnsbcError, match=r"trajectory\.samples: missing"):
        scenario(kind="file")


def test_extremes_of_a_figure_of_eight() -> None:
    path = scenario(
        kind="lissajous",
        centre_m=[0, 0, 8],
        amplitude_m=[6, 3, 0],
        rate_rad_s=[0.1, 0.2, 0],
        heading="path",
    ).leader.trajectory
    most = extremes(path, 600.0)
    assert most.speed_m_s == pytest.approx(0.6 * np.sqrt(2.0), rel=1e-3)
    assert most.jump_m_s == 0.0
    assert 0.2 < most.slowest_m_s < 0.6
    rates = [curve_state(trajectory_of(path), t).heading.rate for t in np.linspace(0.0, 63.0, 200)]
    assert most.turn_rad_s == pytest.approx(max(np.abs(rates)), rel=1e-2)


def test_a_file_that_ends_in_motion_jumps_to_rest() -> None:
    path = scenario(kind="file", samples=CSV).leader.trajectory
    assert extremes(path, 60.0).jump_m_s > 0.5
    assert extremes(path, 4.5).jump_m_s < 1e-6


def test_times_that_no_curve_can_keep_are_refused_or_give_one() -> None:
    """A hundredth of a second beside a million: whatever SciPy makes of it, no traceback and no NaN."""
    given = {"kind": "waypoints", "points_m": POINTS, "times_s": [0, 0.01, 0.02, 1e6]}
    try:
        assert np.isfinite(curve(**given).table).all()
    except PtnsbcError as error:
        assert "no smooth curve" in str(error)
