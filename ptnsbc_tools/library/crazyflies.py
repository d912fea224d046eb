"""A scenario for the Crazyflies of a laboratory, by the names and places in the crazyflies.yaml of Crazyswarm2."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ptnsbc_sim.scenario.problems import ScenarioError
from ptnsbc_sim.scenario.reading.reader import dump, parse, read_text

_RADIO = "crazyflie"  # the connection of a type of robot that has none of its own


def _robots(path: Path) -> dict[str, list[float]]:
    """The place (3,) [m] of each Crazyflie that is enabled, by name, in the order of the file."""
    tree = parse(read_text(path), str(path), begins="robots")
    found: dict[str, list[float]] = {}
    try:
        for name, robot in tree["robots"].items():
            kind = tree.get("robot_types", {}).get(robot.get("type"), {})
            if robot["enabled"] and kind.get("connection", _RADIO) == _RADIO:
                x, y, z = map(float, robot["initial_position"])
                found[str(name)] = [x, y, z]
    except (AttributeError, KeyError, TypeError, ValueError):
        expected = (
            "robots, each with enabled and initial_position [x, y, z], as Crazyswarm2 has them"
        )
        raise ScenarioError(f"{path}: expected {expected}") from None
    if len(found) < 2:
        raise ScenarioError(f"{path}: {len(found)} Crazyflies are enabled: expected 2 or more")
    return found


def lab_text(path: Path, name: str) -> str:
    """The file of a scenario: what `crazyflie_4` flies, with the Crazyflies of a crazyflies.yaml; the first one leads.

    Raises:
        ScenarioError: the file cannot be read, or is none of Crazyswarm2's.
    """
    robots = _robots(path)
    ids = range(1, len(robots) + 1)
    x, y, z = next(iter(robots.values()))
    blocks: dict[str, Any] = {
        "extends": "crazyflie_4",
        "name": name,
        "description": f"{len(robots)} Crazyflies of {path.name}",
        "communication": {
            "leader_links": [*ids[1:]],
            "estimator_edges": [[uav, uav + 1] for uav in ids[1:-1]],
        },
        "leader": {"trajectory": {"position_m": [x, y, z + 1.0]}},
        "formation": {"assignment": "optimal"},  # who stands where is the laboratory's
        "ros": {"vehicles": {uav: {"name": robot} for uav, robot in zip(ids, robots, strict=True)}},
        "uavs": [
            {"id": uav, "position_m": place}
            for uav, place in zip(ids, robots.values(), strict=True)
        ],
    }
    return f"# Names and places of {path.name}; all else is that of crazyflie_4.\n{dump(blocks)}"
