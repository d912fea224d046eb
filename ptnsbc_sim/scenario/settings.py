"""The settings of a flight in a scenario file: UAVs, vehicles, distances, links, rates and gains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from ptnsbc_core.topology import Topology
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario.gains import Gains
from ptnsbc_sim.scenario.mavlink import Mavlink, VehicleLink, vehicle_link
from ptnsbc_sim.scenario.mission.faults import MESSAGES, FaultBlock, modelled
from ptnsbc_sim.scenario.model import (
    LinkQuality,
    Plant,
    Plugins,
    Quadrotor,
    ScenarioFile,
    Sensor,
    plant_of,
)
from ptnsbc_sim.scenario.obstacles import Obstacle, bodies
from ptnsbc_sim.scenario.problems import ScenarioError
from ptnsbc_sim.scenario.semantics import NANOSECONDS
from ptnsbc_sim.scenario.start import UavStart, uav_start


@dataclass(frozen=True)
class ScenarioSettings:
    """The settings of one flight. Immutable and validated."""

    file: ScenarioFile = field(repr=False)
    topology: Topology = field(repr=False)
    text: str = field(repr=False)
    """YAML after `extends` and overrides: loads again to the same scenario; attached to bags."""
    source: str
    """The file or text that it was read from, for messages."""

    @property
    def name(self) -> str:
        """The scenario's own name."""
        return self.file.name

    @property
    def seed(self) -> int:
        """Seed of all random numbers of a flight."""
        return self.file.seed

    @property
    def uav_ids(self) -> tuple[int, ...]:
        """Ids of all UAVs, in the order of the file."""
        return tuple(uav.id for uav in self.file.uavs)

    @property
    def leader_id(self) -> int:
        """Id of the leader."""
        return self.file.leader.id

    @property
    def followers(self) -> tuple[int, ...]:
        """Ids of all UAVs but the leader."""
        return tuple(uav for uav in self.uav_ids if uav != self.leader_id)

    @property
    def control_hz(self) -> int:
        """Rate of the control loop."""
        return self.file.timing.control_hz

    @property
    def physics_hz(self) -> int:
        """Rate of the plant's integration."""
        return self.file.timing.physics_hz

    @property
    def dt_ns(self) -> int:
        """Control period [ns], exact."""
        return NANOSECONDS // self.control_hz

    @property
    def duration_s(self) -> float:
        """Length of the flight."""
        return self.file.timing.duration_s

    @property
    def ticks(self) -> int:
        """Length of the flight in control periods."""
        return round(self.duration_s * self.control_hz)

    @property
    def sensor(self) -> Sensor:
        """Range and rate of the near-object sensor."""
        return self.file.sensor

    @property
    def near_every(self) -> int:
        """Control periods between two readings of the near-object sensor."""
        return self.control_hz // self.file.sensor.rate_hz

    @property
    def gains(self) -> Gains:
        """Every gain, defaults filled in."""
        return self.file.gains

    @property
    def plant(self) -> Plant:
        """The vehicle."""
        return self.file.plant

    @property
    def plant_kind(self) -> str:
        """Name of the plant, a key of ptnsbc_core.types.PLANTS."""
        return self.file.plant.kind

    @cached_property
    def vehicles(self) -> dict[int, Plant]:
        """The vehicle of every UAV, as the laws know it; `file.plant` itself where it has nothing of its own."""
        return {uav.id: plant_of(self.file.plant, uav) for uav in self.file.uavs}

    def vehicle(self, uav_id: int) -> Plant:
        """The vehicle of one UAV, as the laws know it."""
        if uav_id not in self.vehicles:
            self.uav(uav_id)  # names the ids there are
        return self.vehicles[uav_id]

    def max_speed_m_s(self, uav_id: int) -> float:
        """Limit of the commanded speed of one UAV."""
        own = next(uav.max_speed_m_s for uav in self.file.uavs if uav.id == uav_id)
        return self.gains.filter.max_speed_m_s if own is None else own

    @cached_property
    def keep_outs_m(self) -> dict[int, float]:
        """The keep-out of every UAV."""
        default = self.uav_keep_out_m
        return {
            uav.id: default if uav.keep_out_m is None else uav.keep_out_m for uav in self.file.uavs
        }

    def keep_out_between(self, one: int, other: int) -> float:
        """Least distance [m] of two UAVs."""
        return 0.5 * (self.keep_outs_m[one] + self.keep_outs_m[other])

    @property
    def widest_keep_out_m(self) -> float:
        """The largest least distance of any two UAVs."""
        widest = sorted(self.keep_outs_m.values())[-2:]
        return 0.5 * (widest[0] + widest[-1])

    @property
    def reach_m(self) -> float:
        """The largest keep-out of anything that a UAV may meet."""
        return max([self.widest_keep_out_m, *(one.keep_out_m for one in self.obstacles)])

    @property
    def mass_kg(self) -> float:
        """Nominal mass of a UAV without one of its own: what the laws know."""
        return self.file.plant.mass_kg

    @property
    def inertia_kg_m2(self) -> tuple[float, float, float]:
        """Nominal moments of inertia of a UAV without its own: what the laws know."""
        return self.file.plant.inertia_kg_m2

    @property
    def quadrotor(self) -> Quadrotor:
        """Limits of the quadrotor; an error for a scenario without them."""
        if self.file.plant.quadrotor is None:
            raise ScenarioError(f"{self.source}: plant.quadrotor: missing: expected its limits")
        return self.file.plant.quadrotor

    @property
    def gravity_m_s2(self) -> float:
        """Gravity, downwards."""
        return self.file.world.gravity_m_s2

    @property
    def wind_m_s(self) -> Array:
        """Constant wind (3,), ENU."""
        return np.array(self.file.world.wind_m_s, dtype=np.float64)

    def link(self, sender: int, receiver: int) -> LinkQuality:
        """Loss and delay of the messages from one UAV to another."""
        return self.file.communication.link(sender, receiver)

    @property
    def lossy(self) -> bool:
        """True if messages between UAVs get lost or come late."""
        block = self.file.communication
        own = any(link.loss or link.delay_s for link in block.links)
        late = own or block.loss > 0.0 or block.delay_s > 0.0
        return late or any(fault.rule.strikes == MESSAGES for fault in self.faults)

    @property
    def reconfigures(self) -> bool:
        """True if UAVs may come and go: the others take another parent or leader then."""
        return self.file.formation.vacancy != "wait"

    @property
    def faults(self) -> tuple[FaultBlock, ...]:
        """Faults that are injected."""
        return self.file.faults or ()

    @property
    def modelled_faults(self) -> tuple[FaultBlock, ...]:
        """Those of `faults` that a headless flight injects."""
        return modelled(self.faults)

    @property
    def imperfect(self) -> bool:
        """True if the flight has disturbances: position or sensor noise, gusts, lost or late messages, faults."""
        return (
            self.sensor.positioning is not None
            or self.sensor.noise_m > 0.0
            or self.sensor.velocity_noise_m_s > 0.0
            or any(self.file.world.gust_m_s)
            or self.lossy
            or bool(self.modelled_faults)
        )

    @cached_property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """All obstacles."""
        return tuple(Obstacle(body) for one in self.file.world.obstacles for body in bodies(one))

    def obstacle_positions(self, t_s: float) -> Array:
        """Positions (O, 3) [m] of all obstacles, so many seconds after the first epoch."""
        at = np.array([t_s], dtype=np.float64)
        return np.array([one.motion(at).positions[0] for one in self.obstacles]).reshape(-1, 3)

    @property
    def uav_keep_out_m(self) -> float:
        """Least distance between two UAVs without keep-outs of their own."""
        return self.file.formation.uav_keep_out_m

    @property
    def plugins(self) -> Plugins:
        """The functions of the user besides a law."""
        return self.file.plugins

    @property
    def task_name(self) -> str:
        """The task of the followers: ours by its name, or FILE.py:NAME of the user's."""
        own = self.plugins.task
        return self.file.formation.task if own is None else Path(own).name

    @property
    def law(self) -> str | None:
        """FILE.py:NAME of the law of the followers; None: ours."""
        return self.file.law

    @property
    def mavlink(self) -> Mavlink:
        """Settings for real flight controllers."""
        return self.file.mavlink

    def vehicle_link(self, uav_id: int) -> VehicleLink:
        """Connection to the flight controller of one UAV."""
        self.uav(uav_id)  # names the ids there are when this is not one
        return vehicle_link(self.mavlink, self.uav_ids, uav_id)

    def uav(self, uav_id: int) -> UavStart:
        """Start and disturbance of one UAV."""
        for block in self.file.uavs:
            if block.id == uav_id:
                return uav_start(block)
        known = ", ".join(map(str, self.uav_ids))
        raise ScenarioError(f"{self.source}: UAV {uav_id}: expected one of {known}")

    def offset(self, uav_id: int) -> Array:
        """Desired position relative to the reference point (3,) [m], ENU: zeros for the leader of the file."""
        offsets = self.file.formation.offsets_m
        if uav_id not in offsets:
            self.uav(uav_id)  # names the ids there are when this is not one
            return np.zeros(3)
        return np.array(offsets[uav_id], dtype=np.float64)

    def parent(self, uav_id: int) -> int | None:
        """The UAV relative to which this one keeps its position; None for the leader."""
        return self.file.communication.tree.get(uav_id)

    def parent_weights(self, uav_id: int) -> Mapping[int, float]:
        """Weights of the parents of a UAV with several, ascending by id; empty where it has one."""
        given = (self.file.communication.parents or {}).get(uav_id, {})
        return dict(sorted(given.items()))

    def parents(self, uav_id: int) -> tuple[int, ...]:
        """The parent or the several parents of a UAV, ascending; empty for the leader."""
        one = self.parent(uav_id)
        return tuple(self.parent_weights(uav_id)) or (() if one is None else (one,))

    @property
    def most_parents(self) -> int:
        """The largest number of parents of a UAV with several; 0 where each has one."""
        return max(map(len, (self.file.communication.parents or {}).values()), default=0)

    def pinned(self, uav_id: int) -> bool:
        """True if this follower receives the leader's state."""
        return uav_id in self.topology.pinned

    def estimator_neighbours(self, uav_id: int) -> tuple[int, ...]:
        """Followers whose leader estimate this one receives, ascending."""
        return tuple(sorted(self.topology.neighbours.get(uav_id, ())))
