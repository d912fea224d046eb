"""What the check says of a trajectory along the whole of it."""

from typing import Any

import pytest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.check.finding import Finding
from ptnsbc_tools.check.trajectory import trajectory

POINTS = [[0, 0, 8], [6, 0, 8], [6, 6, 8]]


def found(**changes: Any) -> list[Finding]:
    overrides = {key.replace("__", "."): value for key, value in changes.items()}
    return list(trajectory(load_scenario("paper_5_free", overrides)))


def odd(**changes: Any) -> list[tuple[str, str]]:
    return [(one.severity, one.key) for one in found(**changes) if one.severity != "info"]


def path(**keys: Any) -> dict[str, Any]:
    return {"kind": "waypoints", "points_m": POINTS, "times_s": [0, 20, 40], **keys}


def test_shipped_trajectories_pass() -> None:
    assert odd() == []
    shipped = load_scenario("waypoints_5")
    assert [one for one in trajectory(shipped) if one.severity != "info"] == []


def test_says_how_fast_it_is() -> None:
    """A circle of 5 m at 0.1 rad/s: 0.5 m/s, 0.05 m/s^2, 0.005 m/s^3."""
    assert found()[0].value == "at most 0.5 m/s, 0.05 m/s^2, 0.005 m/s^3"


def test_a_path_below_the_ground_is_refused() -> None:
    low = [[0, 0, 8], [6, 0, -1], [6, 6, 8]]
    (error,) = [
        one for one in found(leader__trajectory=path(points_m=low)) if one.severity == "error"
    ]
    assert error.key == "leader.trajectory"
    assert " comes down to -1." in error.value


def test_a_place_below_the_ground_is_refused_too() -> None:
    assert odd(**{"formation__offsets_m__4": [0.6, -1.2, -9]}) == [("error", "leader.trajectory")]


@pytest.mark.parametrize(
    ("fence", "outside"),
    [
        ({"radius_m": 9.0}, False),
        ({"radius_m": 5.5}, True),
        ({"box_min_m": [-9, -9, 0], "box_max_m": [9, 9, 9]}, False),
        ({"box_min_m": [-9, -9, 0], "box_max_m": [9, 9, 7]}, True),
    ],
)
def test_the_fence_holds_every_place(fence: dict[str, Any], outside: bool) -> None:
    assert odd(mavlink__geofence=fence) == ([("error", "mavlink.geofence")] if outside else [])


def test_a_jerk_that_no_tilt_can_follow_is_named() -> None:
    rough = path(times_s=[0, 1.2, 2.4])
    assert ("warning", "leader.trajectory") in odd(leader__trajectory=rough)


def test_a_path_that_rests_has_no_heading() -> None:
    assert odd(leader__trajectory=path(heading="path")) == [("error", "leader.trajectory.heading")]


def test_a_file_that_ends_in_motion() -> None:
    rows = "0,0,5,8\n10,5,5,8\n20,10,5,8\n"
    csv = {"kind": "csv", "samples": rows}
    assert odd(leader__trajectory=csv) == [("warning", "leader.trajectory")]
    assert odd(leader__trajectory=csv, timing__duration_s=19) == []
