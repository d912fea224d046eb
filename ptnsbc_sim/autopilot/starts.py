"""Where vehicles start, and what they are: from options or from a scenario."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ptnsbc_sim.autopilot.codec import AutopilotError
from ptnsbc_sim.autopilot.physics.body import VehicleDescription, default_plant
from ptnsbc_sim.autopilot.physics.geodesy import PX4_HOME, Geodetic
from ptnsbc_sim.autopilot.physics.navigation import QUALITIES
from ptnsbc_sim.plants.build import plant_config
from ptnsbc_sim.scenario import Scenario, load_scenario

_SPACING_M = 2.0


@dataclass(frozen=True)
class Fleet:
    """What is asked for."""

    count: int | None = None
    scenario: str | Path | None = None
    gnss: str = "plain"
    origin_spread_m: float = 0.0
    yaw_deg: float | None = None
    seed: int = 1
    battery: float = 1.0


@dataclass(frozen=True)
class Start:
    """One vehicle to be: its MAVLink system id and its body; the rest is the scenario's, None without one."""

    system: int
    body: VehicleDescription
    kind: str | None = None
    connect: str | None = None  # how the bridge reaches it
    key: str | None = None


_KINDS = {"px4": "px4", "ardupilot": "arducopter", "generic": "stm32"}
"""Personalities by the scenario's names."""


def starts(fleet: Fleet) -> list[Start]:
    """System ids from 1 and bodies, all on the ground; in the order of the scenario's UAVs where there is one.

    Raises:
        AutopilotError: more vehicles than the scenario has, or an unknown receiver.
    """
    if fleet.gnss not in QUALITIES:
        raise AutopilotError(f"gnss={fleet.gnss}: expected one of {', '.join(QUALITIES)}")
    if fleet.scenario is None:
        return [Start(n + 1, _body(fleet, n, None)) for n in range(fleet.count or 1)]
    scenario = load_scenario(fleet.scenario, {"plant.kind": "quadrotor"})
    size = len(scenario.uav_ids)
    count = size if fleet.count is None else fleet.count
    if count > size:
        raise AutopilotError(f"count={count}: expected at most {size}, the UAVs of {scenario.name}")
    return [_start(fleet, n, scenario) for n in range(count)]


def _start(fleet: Fleet, n: int, scenario: Scenario) -> Start:
    link = scenario.vehicle_link(scenario.uav_ids[n])
    body = _body(fleet, n, scenario)
    return Start(link.sysid, body, _KINDS[link.autopilot], link.connect, link.signing_key)


def _datum(scenario: Scenario) -> Geodetic:
    origin = scenario.mavlink.world_origin
    if origin is None:
        return PX4_HOME
    return Geodetic(origin.latitude_deg, origin.longitude_deg, origin.altitude_m)


def _body(fleet: Fleet, n: int, scenario: Scenario | None) -> VehicleDescription:
    random = np.random.default_rng((fleet.seed, n))
    yaw = random.uniform(-np.pi, np.pi) if fleet.yaw_deg is None else np.radians(fleet.yaw_deg)
    ground, plant, datum = np.array((_SPACING_M * n, 0.0, 0.0)), default_plant(), PX4_HOME
    if scenario is not None:
        uav_id = scenario.uav_ids[n]
        ground = scenario.uav(uav_id).position * np.array((1.0, 1.0, 0.0))
        plant, datum = plant_config(scenario, uav_id), _datum(scenario)
    return VehicleDescription(
        plant,
        ground,
        float(yaw),
        QUALITIES[fleet.gnss],
        fleet.origin_spread_m,
        datum,
        fleet.battery,
        int(random.integers(1 << 31)),
    )
