"""The blocks of a scenario file as types. `semantics.py` checks them against each other."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, WrapValidator

from ptnsbc_core.nanoseconds import SECOND_NS, nanoseconds
from ptnsbc_core.tasks.table import TaskName
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario.fields import (
    AUTO,
    Block,
    Count,
    Name,
    NotNegative,
    NotNegativeVec3,
    Number,
    Positive,
    PositiveVec3,
    Share,
    UavId,
    Vec3,
    Wave,
    Waves,
)
from ptnsbc_sim.scenario.gains import Gains
from ptnsbc_sim.scenario.mavlink import FIRST_PORT, Mavlink, MavlinkVehicle, VehicleLink
from ptnsbc_sim.scenario.mission.fault_rules import MESSAGES, NEVER_NS, FaultBlock, modelled
from ptnsbc_sim.scenario.mission.legs import Mission
from ptnsbc_sim.scenario.mission.shapes import Change, ShapeBlock
from ptnsbc_sim.scenario.mission.trajectories import LeaderTrajectoryBlock
from ptnsbc_sim.scenario.obstacles import Obstacle, ObstacleBlock, bodies
from ptnsbc_sim.scenario.problems import ScenarioError
from ptnsbc_sim.scenario.ros import Ros

STILL = (Wave(amount=0.0, shape="constant"),) * 3
Delay = Annotated[NotNegative, Field(le=1)]
HalfTurn = Annotated[Number, Field(gt=0, lt=1.5707963)]


class Timing(Block):
    """Rates of the control loop and of the plant, and the length of the flight."""

    control_hz: Annotated[Count, Field(le=2000)]
    """Control rate: a multiple of 5 with a period of whole nanoseconds."""
    physics_hz: Annotated[Count, Field(le=20000)]
    """Integration rate of the plant, a multiple of `control_hz`."""
    duration_s: Annotated[Positive, Field(le=1e6)]
    """Length of the flight, at least one control period."""

    @property
    def dt_ns(self) -> int:
        """Control period [ns], exact."""
        return SECOND_NS // self.control_hz

    @property
    def ticks(self) -> int:
        """Length of the flight in control periods."""
        return round(self.duration_s * self.control_hz)


class Surroundings(Block):
    """The surroundings of the UAVs."""

    gravity_m_s2: NotNegative = 9.81
    """Acceleration, downwards."""
    wind_m_s: Vec3 = (0.0, 0.0, 0.0)
    """Mean wind; it acts on the vehicles through their drag."""
    gust_m_s: NotNegativeVec3 = (0.0, 0.0, 0.0)
    """Standard deviation of the gusts around the wind."""
    gust_time_s: Positive = 2.0
    """Correlation time of the gusts."""
    obstacles: tuple[ObstacleBlock, ...] = ()
    """Obstacles to keep out of:"""

    @cached_property
    def bodies(self) -> tuple[Obstacle, ...]:
        """All bodies to keep out of: the obstacles, and the boxes of maps."""
        return tuple(Obstacle(body) for obstacle in self.obstacles for body in bodies(obstacle))

    def body_positions(self, t_s: float) -> Array:
        """Positions (O, 3) [m] of all `bodies`, so many seconds after the first epoch."""
        at = np.array([t_s], dtype=np.float64)
        return np.array([body.motion(at).positions[0] for body in self.bodies]).reshape(-1, 3)


class Positioning(Block):
    """Position fixes that an estimator on board fuses with inertial measurements."""

    noise_m: Positive
    """Standard deviation of a fix, per axis."""
    rate_hz: Count
    """Rate of the fixes, a divisor of `control_hz`."""
    latency_s: Delay = 0.0
    """Latency of a fix, a multiple of the control period."""
    unknown_latency_s: NotNegative = 0.0
    """Part of the latency that the estimator on board does not compensate; all of it without time stamps."""
    acceleration_noise_m_s2: Positive = 0.05
    """Standard deviation of the accelerometer's error between fixes; it sets the filter's gains."""


class Sensor(Block):
    """The near-object sensor of a UAV, and its positioning."""

    range_m: Positive
    """Range of the near-object sensor; `ptnsbc check` expects more than the largest keep-out."""
    rate_hz: Count
    """Rate of the near-object sensor, a divisor of `control_hz`."""
    noise_m: NotNegative = 0.0
    """Standard deviation of a position from the near-object sensor, per axis."""
    velocity_noise_m_s: NotNegative = 0.0
    """Standard deviation of a velocity from the near-object sensor, per axis."""
    positioning: Positioning | None = None
    """Errors of the UAV's own position. Default: none, the position is exact."""


class Quadrotor(Block):
    """The limits of a quadrotor."""

    max_thrust_n: Positive
    """Largest thrust, above the weight."""
    max_tilt_rad: HalfTurn
    """Largest angle of the thrust from the vertical."""
    max_torque_nm: PositiveVec3
    """Largest torque, per body axis."""
    motor_lag_s: Positive
    """First-order lag of thrust and torques."""
    drag_1_s: NotNegative = 0.0
    """Linear drag relative to the air, per unit of mass."""


class RigidBody(Block):
    """Limits of the paper's plant. The paper has none; the defaults are far above any command."""

    max_force_n: Positive = 1e6
    """Largest force of the controller."""
    max_torque_nm: PositiveVec3 = (1e6, 1e6, 1e6)
    """Largest torque of the controller, per body axis."""
    drag_1_s: NotNegative = 0.0
    """Linear drag relative to the air, per unit of mass. The paper has none."""


class Plant(Block):
    """The vehicle, the same for all UAVs."""

    kind: Literal["quadrotor", "rigid_body_6dof"]
    """Vehicle model."""
    mass_kg: Positive
    """Mass of each UAV."""
    inertia_kg_m2: PositiveVec3
    """Principal moments of inertia."""
    quadrotor: Quadrotor | None = None
    """Limits of the quadrotor; required for `kind: quadrotor`."""
    rigid_body: RigidBody = RigidBody()

    @property
    def rotor_limits(self) -> Quadrotor:
        """The limits of a quadrotor; an error for a vehicle without them."""
        if self.quadrotor is None:
            raise ScenarioError("plant.quadrotor: missing: expected its limits")
        return self.quadrotor


class LinkBlock(Block):
    """The link from one UAV to another, where it differs from the others."""

    sender: UavId
    """Id of the UAV that sends."""
    receiver: UavId
    """Id of the UAV that receives; `tree`, `parents`, `leader_links` or `estimator_edges` must have the edge."""
    loss: Share | None = None
    """Fraction of the messages that is lost. Default: that of all links."""
    delay_s: Delay | None = None
    """Time from sending to arrival. Default: that of all links."""


class LinkQuality(NamedTuple):
    """The loss and delay of the messages from one UAV to another."""

    loss: float  # fraction that is lost
    delay_s: float  # from sending to arrival


class AutoTree(dict[int, int]):
    """A tree that is left to us, empty until it is known."""


Parents = Annotated[
    dict[UavId, UavId],
    WrapValidator(lambda value, check: AutoTree() if value == AUTO else check(value)),
]


class Communication(Block):
    """The communication graph of the formation."""

    tree: Parents
    """`child: parent`, a tree rooted at the leader. `auto` proposes one for the shape: short edges over which the
    task is well conditioned, at most three hops deep."""
    parents: dict[UavId, dict[UavId, Positive]] | None = None
    """Several parents of a follower, each with its weight: `child: {parent: weight}`. The parent in `tree` is one of
    them, and the weights sum to 1, see [method.md](method.md#several-parents)."""
    leader_links: tuple[UavId, ...]
    """Followers that receive the leader's state."""
    estimator_edges: tuple[tuple[UavId, UavId], ...]
    """Pairs of followers that exchange estimates, both ways."""
    stale_s: Positive = 0.5
    """A UAV holds after its parent or leader has been silent for this long."""
    loss: Share = 0.0
    """Fraction of the messages between UAVs that is lost."""
    delay_s: Delay = 0.0
    """Time from sending to arrival of a message between UAVs; less than `stale_s`."""
    links: tuple[LinkBlock, ...] = ()
    """Single links with a loss or a delay of their own, each in one direction:"""

    def link(self, sender: int, receiver: int) -> LinkQuality:
        """Loss and delay of the messages from one UAV to another."""
        for link in self.links:
            if (link.sender, link.receiver) == (sender, receiver):
                return LinkQuality(
                    self.loss if link.loss is None else link.loss,
                    self.delay_s if link.delay_s is None else link.delay_s,
                )
        return LinkQuality(self.loss, self.delay_s)

    def parent(self, uav_id: int) -> int | None:
        """The UAV relative to which this one keeps its position; None for the leader."""
        return self.tree.get(uav_id)

    def weights_of(self, uav_id: int) -> Mapping[int, float]:
        """Weights of the parents of a UAV with several, ascending by id; empty where it has one."""
        return dict(sorted(self.parents.get(uav_id, {}).items())) if self.parents else {}

    def parents_of(self, uav_id: int) -> tuple[int, ...]:
        """The parent or the several parents of a UAV, ascending; empty for the leader."""
        parent = self.parent(uav_id)
        return tuple(self.weights_of(uav_id)) or (() if parent is None else (parent,))

    @property
    def lossy(self) -> bool:
        """True if links lose or delay messages."""
        late = any(link.loss or link.delay_s for link in self.links)
        return late or self.loss > 0.0 or self.delay_s > 0.0


class Leader(Block):
    """The UAV around which the others form."""

    id: UavId
    """Id of one of `uavs`."""
    successors: tuple[UavId, ...] = ()
    """UAVs that take over the lead, in this order, when the leader is lost or leaves, see
    [missions.md](missions.md#coming-and-going)."""
    trajectory: LeaderTrajectoryBlock
    """Trajectory of the leader, one of these kinds:"""


class Formation(Block):
    """The shape to hold and the task that holds it."""

    task: TaskName
    """Task of the followers, see [method.md](method.md)."""
    approach: Literal["planned", "task"] = "planned"
    """The way to the formation: `planned` forms by positions, on straight lines with one time profile, and holds
    by the task; `task` lets the task itself close every error, as the paper does."""
    assignment: Literal["fixed", "optimal"] = "fixed"
    """Assignment of the slots: `fixed` gives every UAV its own; `optimal` decides at each epoch by the measured
    positions, see [method.md](method.md#slots)."""
    turn_rad: Annotated[Number, Field(ge=-3.2, le=3.2)] | None = None
    """Angle about the vertical by which all planned paths turn on their way, 0 for straight lines, see
    [method.md](method.md#turned-approach). Default: 0 where straight lines keep all pairs of UAVs apart, else
    by starts, places and deadline of the scenario."""
    vacancy: Literal["wait", "keep", "close_up"] = "wait"
    """Use of the slot of a UAV that is lost or leaves, see [missions.md](missions.md#coming-and-going): with
    `wait` its children hold until they hear it again; `keep` leaves the slot empty, and they get another parent;
    `close_up` moves those behind it up."""
    avoidance: Literal["off", "set_based", "switched"] = "set_based"
    """Rule of the clearance from obstacles and other UAVs."""
    offsets_m: dict[UavId, Vec3] = Field(default_factory=dict)
    """Desired position of every follower, or of every slot but the leader's, relative to the leader. Give this or
    `shape`."""
    shape: ShapeBlock | None = None
    """Offsets by the name of a shape, in the order of `uavs`."""
    frame: Literal["world", "heading"] = "world"
    """Axes of the offsets: those of the world, or turned by the heading of the leader's trajectory."""
    changes: Annotated[tuple[Change, ...], Field(max_length=200)] = ()
    """Changes of the shape at mission times, each from the one before it by the time profile of the method:"""
    heading_anchor_m: Vec3 = (2.0, 0.0, 0.0)
    """Reference point of the leader's children, relative to the leader."""
    uav_keep_out_m: Positive
    """Least distance between two UAVs."""
    uav_keep_out_above_m: Positive | None = None
    """Least distance of two UAVs one above the other, for the downwash: the keep-out is an ellipsoid, so high and
    `uav_keep_out_m` wide. Default: `uav_keep_out_m`, a sphere."""
    sight_m: NotNegative = 0.0
    """Distance within which a detected object is taken to be the parent or the leader; at most half of the keep-out."""
    tolerance_m: Positive = 0.05
    """Largest error at the deadline that the verdict accepts."""
    recovery_s: Positive = 1.0
    """Shortest time base of the way back after an encounter; it is longer where the limits of speed and acceleration
    need more, see [method.md](method.md#way-back)."""

    @property
    def keep_out_height(self) -> float:
        """Height of the keep-out of every UAV over its width [1]; 1 for a sphere."""
        above_m = self.uav_keep_out_above_m
        return 1.0 if above_m is None else above_m / self.uav_keep_out_m

    @property
    def keep_out_scale(self) -> Array:
        """Factors (3,) of x, y and z: the lengths of differences between UAVs times these count against keep-outs."""
        return np.array([1.0, 1.0, 1.0 / self.keep_out_height])

    @property
    def has_open_slots(self) -> bool:
        """True if it is open who takes which slot, until an epoch decides it."""
        return self.assignment == "optimal"

    @property
    def moves(self) -> bool:
        """True if the shape moves in itself."""
        return self.frame == "heading" or bool(self.changes)

    @property
    def reconfigures(self) -> bool:
        """True if UAVs may come and go: the others take another parent or leader then."""
        return self.vacancy != "wait"


class UavBlock(Block):
    """Start of one UAV, what acts on it, and how it differs from the others."""

    id: UavId
    """Id, unique."""
    position_m: Vec3
    """Start position."""
    attitude_rad: Vec3 = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw at the start."""
    disturbance_m_s2: Waves = STILL
    """Acceleration that acts on the UAV; `sin` and `cos` have 1 rad/s."""
    disturbance_rad_s2: Waves = STILL
    """Angular acceleration that acts on the UAV, in the same form."""
    mass_scale: Positive = 1.0
    """True mass over the one that the laws know."""
    inertia_scale: PositiveVec3 = (1.0, 1.0, 1.0)
    """True moments of inertia over those that the laws know."""
    mass_kg: Positive | None = None
    """Mass that the laws know. Default: `plant.mass_kg`."""
    inertia_kg_m2: PositiveVec3 | None = None
    """Moments of inertia that the laws know. Default: `plant.inertia_kg_m2`."""
    max_force_n: Positive | None = None
    """Largest thrust of a quadrotor, largest force of a rigid body. Default: that of `plant`."""
    max_torque_nm: PositiveVec3 | None = None
    """Largest torque, per body axis. Default: that of `plant`."""
    max_tilt_rad: HalfTurn | None = None
    """Largest tilt of a quadrotor. Default: that of `plant`."""
    drag_1_s: NotNegative | None = None
    """Linear drag, per unit of mass. Default: that of `plant`."""
    max_speed_m_s: Positive | None = None
    """Limit of its commanded speed. Default: `gains.filter.max_speed_m_s`."""
    keep_out_m: Positive | None = None
    """Its keep-out: two UAVs stay the mean of both apart. Default: `formation.uav_keep_out_m`."""
    joins_s: Positive | None = None
    """Mission time at which it joins the formation; until then it holds at its start. Default: from the begin on."""
    leaves_s: Positive | None = None
    """Mission time at which it leaves the formation and lands. Default: never."""

    @property
    def position(self) -> Array:
        """Start position (3,) [m], ENU."""
        return np.array(self.position_m, dtype=np.float64)

    @property
    def joins_ns(self) -> int:
        """The time at which it joins, after the first epoch [ns]; 0: it is there from the begin on."""
        return 0 if self.joins_s is None else nanoseconds(self.joins_s)

    @property
    def leaves_ns(self) -> int:
        """The time at which it leaves, after the first epoch [ns]."""
        return NEVER_NS if self.leaves_s is None else nanoseconds(self.leaves_s)


def plant_of(plant: Plant, uav: UavBlock) -> Plant:
    """The vehicle of one UAV, as the laws know it."""
    own = {"mass_kg": uav.mass_kg, "inertia_kg_m2": uav.inertia_kg_m2}
    limits = {"max_torque_nm": uav.max_torque_nm, "drag_1_s": uav.drag_1_s}
    tilts = {"max_thrust_n": uav.max_force_n, "max_tilt_rad": uav.max_tilt_rad}
    changes = _given(own)
    if quadrotor := _given(limits | tilts):
        changes["quadrotor"] = plant.quadrotor and plant.quadrotor.model_copy(update=quadrotor)
    if rigid_body := _given(limits | {"max_force_n": uav.max_force_n}):
        changes["rigid_body"] = plant.rigid_body.model_copy(update=rigid_body)
    return plant.model_copy(update=changes) if changes else plant


def _given(keys: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in keys.items() if value is not None}


FunctionName = Annotated[str, Field(pattern=r"^(.+\.py:)?[A-Za-z_]\w*$")]
"""`FILE.py:NAME` of a function, or the name of an entry point."""


class Plugins(Block):
    """Functions of the user in the place of parts of the flight, see [laws.md](laws.md#more-of-your-own)."""

    task: FunctionName | None = None
    """Task of the followers in place of `formation.task`."""
    controller: FunctionName | None = None
    """Controller of every UAV: force and torque from the command."""
    plant: FunctionName | None = None
    """Equations of motion of every UAV, for `plant.kind: quadrotor`."""
    disturbance: FunctionName | None = None
    """Acceleration that acts on every UAV, besides the other disturbances."""
    sensor: FunctionName | None = None
    """Near-object sensor of every UAV."""
    vehicle: FunctionName | None = None
    """Class of the vehicles of `--backend ros`, see [vehicles.md](vehicles.md#a-driver-of-your-own)."""


class ScenarioFile(Block):
    """A whole file, after `extends`, overrides and default gains."""

    name: Name
    """Name of the scenario, in bags and verdicts."""
    description: str = ""
    """Text for the reader."""
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**32)] = 0
    """Seed of all random numbers, see [below](#chance)."""
    security: Literal["none", "signed"] = "none"
    """`signed`: processes take only messages that carry the seal of the fleet, see [security.md](security.md)."""
    faults: Annotated[tuple[FaultBlock, ...], Field(max_length=200)] = ()
    """Faults that are injected, see [faults.md](faults.md#injection)."""
    timing: Timing
    world: Surroundings = Surroundings()
    sensor: Sensor
    plant: Plant
    communication: Communication
    leader: Leader
    formation: Formation
    gains: Gains
    mission: Mission | None = None
    """Task of the formation, leg by leg, see [missions.md](missions.md). Default: it forms and follows the trajectory
    of the leader."""
    law: FunctionName | None = None
    """Law of the followers in place of ours: `FILE.py:NAME` of a function, looked for beside this file, or the name
    of an entry point, see [laws.md](laws.md)."""
    plugins: Plugins = Plugins()
    """More functions of the user, each as `FILE.py:NAME` or as the name of an entry point:"""
    mavlink: Mavlink = Mavlink()
    ros: Ros | None = None
    """Vehicles behind topics and services of ROS 2, see [vehicles.md](vehicles.md). Default: none."""
    uavs: Annotated[tuple[UavBlock, ...], Field(min_length=1)]
    """Starts and disturbances of the UAVs, at least one."""

    @property
    def uav_ids(self) -> tuple[int, ...]:
        """Ids of all UAVs, in the order of the file."""
        return tuple([uav.id for uav in self.uavs])  # a list is faster

    @property
    def followers(self) -> tuple[int, ...]:
        """Ids of all UAVs but the leader."""
        return tuple(uav for uav in self.uav_ids if uav != self.leader.id)

    @property
    def near_every(self) -> int:
        """Control periods between two readings of the near-object sensor."""
        return self.timing.control_hz // self.sensor.rate_hz

    @property
    def task_name(self) -> str:
        """The task of the followers: ours by its name, or FILE.py:NAME of the user's."""
        task = self.plugins.task
        return self.formation.task if task is None else Path(task).name

    def uav(self, uav_id: int) -> UavBlock:
        """The block of one UAV.

        Raises:
            ScenarioError: there is no such UAV.
        """
        for uav in self.uavs:
            if uav.id == uav_id:
                return uav
        known = ", ".join(map(str, self.uav_ids))
        raise ScenarioError(f"{self.name}: UAV {uav_id}: expected one of {known}")

    def vehicle(self, uav_id: int) -> Plant:
        """The vehicle of one UAV, as the laws know it; `plant` itself where it has nothing of its own."""
        return plant_of(self.plant, self.uav(uav_id))

    def vehicle_link(self, uav_id: int) -> VehicleLink:
        """Connection to the flight controller of one UAV. Default: the PX4 simulation with the same number."""
        number = self.uav_ids.index(self.uav(uav_id).id)
        vehicle = self.mavlink.vehicles.get(uav_id, MavlinkVehicle())
        connect = vehicle.connect or f"udpin:127.0.0.1:{FIRST_PORT + number}"
        autopilot = vehicle.autopilot or self.mavlink.autopilot
        setpoint = vehicle.setpoint or self.mavlink.setpoint
        rest = (getattr(vehicle, name) for name in VehicleLink._fields[4:-1])
        link = VehicleLink(connect, vehicle.sysid or number + 1, autopilot, setpoint, *rest)
        if autopilot != "ros" or self.ros is None:
            return link
        ros = self.ros.vehicle(uav_id)
        whole = self.plugins.vehicle is not None or "position" in ros.fields
        return link._replace(
            connect=f"ros:{ros.name}",
            autopilot="ros_take_off" if ros.services.get("take_off") else autopilot,
            setpoint="position_velocity" if whole else "velocity",
            origin_m=link.origin_m or (0.0, 0.0, 0.0),
            ros=ros,
        )

    def max_speed_m_s(self, uav_id: int) -> float:
        """Limit of the commanded speed of one UAV."""
        limit = self.uav(uav_id).max_speed_m_s
        return self.gains.filter.max_speed_m_s if limit is None else limit

    def offset(self, uav_id: int) -> Array:
        """Desired position relative to the reference point (3,) [m], ENU: zeros for the leader of the file."""
        place = self.formation.offsets_m.get(self.uav(uav_id).id, (0.0, 0.0, 0.0))
        return np.array(place, dtype=np.float64)

    def keep_out_m(self, uav_id: int) -> float:
        """The keep-out of one UAV."""
        keep_out = self.uav(uav_id).keep_out_m
        return self.formation.uav_keep_out_m if keep_out is None else keep_out

    def keep_out_between(self, uav_id: int, other: int) -> float:
        """Least distance [m] of two UAVs."""
        return 0.5 * (self.keep_out_m(uav_id) + self.keep_out_m(other))

    @property
    def widest_keep_out_m(self) -> float:
        """The largest least distance of any two UAVs."""
        default = self.formation.uav_keep_out_m
        keep_outs = (default if uav.keep_out_m is None else uav.keep_out_m for uav in self.uavs)
        widest = sorted(keep_outs)[-2:]
        return 0.5 * (widest[0] + widest[-1])

    @property
    def highest_keep_out_m(self) -> float:
        """The largest least distance of any two UAVs, in the direction where it is largest."""
        return self.formation.keep_out_height * self.widest_keep_out_m

    @property
    def lossy(self) -> bool:
        """True if messages between UAVs get lost or come late."""
        struck = any(fault.rule.strikes == MESSAGES for fault in self.faults)
        return struck or self.communication.lossy

    @property
    def imperfect(self) -> bool:
        """True if the flight has disturbances: position or sensor noise, gusts, lost or late messages, faults."""
        return (
            self.sensor.positioning is not None
            or self.sensor.noise_m > 0.0
            or self.sensor.velocity_noise_m_s > 0.0
            or any(self.world.gust_m_s)
            or self.lossy
            or bool(modelled(self.faults))
        )
