"""Places on the Earth in a scenario: metres about the origin of the world, or an error with the way out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ptnsbc_io.mavlink.frames import EARTH_RADIUS_M, GeoPoint, point_at
from ptnsbc_sim.scenario import Scenario, ScenarioError, load_scenario, scenario_from_text

ORIGIN = GeoPoint(47.3977, 8.5456, 488.0)


def earth(*metres: float, autopilot: str = "px4") -> dict[str, float]:
    """The place that is so far east, north and above the origin."""
    found = point_at(np.array(metres), ORIGIN, EARTH_RADIUS_M[autopilot])
    return dict(zip(("lat", "lon", "alt"), found, strict=True))


def scenario(changes: dict[str, Any]) -> Scenario:
    origin = dict(zip(("latitude_deg", "longitude_deg", "altitude_m"), ORIGIN, strict=True))
    return load_scenario("paper_5", {"mavlink.world_origin": origin, **changes})


@pytest.mark.parametrize("autopilot", EARTH_RADIUS_M)
def test_a_start_is_where_a_vehicle_believes_to_be_there(autopilot: str) -> None:
    place = earth(-30.0, 12.5, 1.0, autopilot=autopilot)
    made = scenario({"mavlink.autopilot": autopilot, "uavs[1].position_m": place})
    assert made.uav(2).position_m == pytest.approx((-30.0, 12.5, 1.0), abs=1e-3)


def test_a_thousandth_of_a_degree_is_111_metres() -> None:
    place = {"lat": 47.3987, "lon": 8.5456, "alt": 490}
    assert scenario({"uavs[0].position_m": place}).uav(1).position_m == pytest.approx(
        (0.0, 111.195, 2.0), abs=1e-3
    )


def test_obstacles_paths_and_legs_may_be_there() -> None:
    places = [[5.0, -4.5, 9.0], [-3.0, 20.0, 7.0], [1.0, 2.0, 3.0]]
    path = {"kind": "waypoints", "points_m": [earth(*one) for one in places], "speed_m_s": 1}
    obstacle = earth(5.5, -4.5, 9.0)
    made = scenario({"leader.trajectory": path, "world.obstacles[0].position_m": obstacle})
    assert made.world.bodies[0].position == pytest.approx([5.5, -4.5, 9.0], abs=1e-3)
    assert np.ravel(made.leader.trajectory.points_m) == pytest.approx(np.ravel(places), abs=1e-3)
    legs = [{"kind": "form"}, {"kind": "go_to", "over_s": 30, "position_m": earth(5, 5, 8)}]
    made = scenario({"mission.legs": legs})
    assert made.mission.legs[1].position_m == pytest.approx([5.0, 5.0, 8.0], abs=1e-3)
    assert "lat:" not in made.text  # it has metres
    assert scenario_from_text(made.text, complete=True) == made  # as from a bag


CENTRE = "leader.trajectory.centre_m"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {CENTRE: earth(1, 2, 3), "mavlink.world_origin": {}},
            "world_origin: latitude_deg: missing",
        ),
        ({CENTRE: {"lat": 95, "lon": 8, "alt": 1}}, f"{CENTRE}: lat: 95: expected <= 90"),
        ({CENTRE: {"lat": 4, "long": 8, "alt": 1}}, 'long: unknown key: did you mean "lon"?'),
        ({CENTRE: {"lat": 47, "lon": 8}}, f"{CENTRE}: alt: missing"),
        ({"formation.offsets_m": {2: earth(1, 2, 3)}}, "expected a list of three numbers"),
        ({CENTRE: earth(0, 1.5e6, 3)}, "expected a place less than 1e.06 m from the origin"),
    ],
)
def test_what_is_no_place_is_refused_by_its_key(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ScenarioError, match=words.replace("?", r"\?")):
        scenario(changes)


def test_without_an_origin_the_way_out_is_said() -> None:
    with pytest.raises(
        ScenarioError, match=r"uavs\[0\].position_m: .*expected mavlink.world_origin"
    ):
        load_scenario("paper_5", {"uavs[0].position_m": earth(1, 2, 3)})
