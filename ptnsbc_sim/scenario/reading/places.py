"""Places on the Earth in a scenario: they become metres about `mavlink.world_origin` when it is read."""

from __future__ import annotations

import copy
from typing import Annotated, Any

from pydantic import Field, ValidationError

from ptnsbc_io.mavlink.frames import EARTH_RADIUS_M, GeoPoint, offset_enu
from ptnsbc_sim.scenario.fields import Block, Number
from ptnsbc_sim.scenario.mavlink import WorldOrigin
from ptnsbc_sim.scenario.mission.path_files import HOME
from ptnsbc_sim.scenario.problems import ScenarioError, Tree, scenario_error, shown
from ptnsbc_sim.scenario.reading.content import blocks_below
from ptnsbc_sim.scenario.reading.reader import merged, overridden

PLACES = ("position_m", "centre_m", "points_m")
"""The keys of places, in metres or on the Earth."""


class EarthPlace(Block):
    """Latitude [°], longitude [°] and height above sea level [m] of a place."""

    lat: Annotated[Number, Field(ge=-90, le=90)]
    lon: Annotated[Number, Field(ge=-180, le=180)]
    alt: Number


def with_places(tree: Tree, source: str) -> Tree:
    """`tree`, which is whole, with x, y, z [m] in the place of `{lat, lon, alt}`.

    The home of a plan is the origin of a scenario that has none.

    Raises:
        ScenarioError: a place is none, or the scenario has no origin.
    """
    places = {
        key: block
        for key, block in blocks_below(tree)
        if key.rpartition(".")[2].partition("[")[0] in PLACES
        and block.keys() & EarthPlace.model_fields.keys()
    }
    if not places:
        return tree
    tree = copy.deepcopy(tree)
    for home in [block.pop(HOME) for _, block in blocks_below(tree) if HOME in block]:
        tree = merged({"mavlink": {"world_origin": home}}, tree)
    mavlink = tree.get("mavlink") or {}
    return overridden(
        tree, {key: _metres(mavlink, source, key, block) for key, block in places.items()}, source
    )


def _metres(mavlink: Any, source: str, key: str, block: Tree) -> list[float]:
    """By the projection of the bridges: a vehicle that believes to be there is there."""
    given = mavlink.get("world_origin") if isinstance(mavlink, dict) else None
    if given is None:
        expected = "expected mavlink.world_origin in the scenario, or x, y, z in m"
        raise ScenarioError(f"{source}: {key}: {shown(block)}: {expected}")
    try:
        place = EarthPlace.model_validate(block)
        key, block = "mavlink.world_origin", given
        origin = WorldOrigin.model_validate(given)
    except ValidationError as error:
        raise scenario_error(f"{source}: {key}", error, block) from None
    radius_m = EARTH_RADIUS_M.get(str(mavlink.get("autopilot")), EARTH_RADIUS_M["px4"])
    away = offset_enu(GeoPoint(place.lat, place.lon, place.alt), origin.place, radius_m)
    return [float(coordinate) for coordinate in away]
