"""The blocks of a scenario file as types. `semantics.py` checks them against each other."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field

from ptnsbc_core.tasks.table import TaskName
from ptnsbc_sim.scenario.fields import (
    Block,
    Count,
    Disturbance,
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
)
from ptnsbc_sim.scenario.gains import Gains
from ptnsbc_sim.scenario.mavlink import Mavlink
from ptnsbc_sim.scenario.mission.faults import FaultBlock
from ptnsbc_sim.scenario.mission.legs import Mission
from ptnsbc_sim.scenario.mission.shapes import Change, ShapeBlock
from ptnsbc_sim.scenario.mission.trajectories import LeaderTrajectoryBlock
from ptnsbc_sim.scenario.obstacles import ObstacleBlock

STILL = (Wave(amount=0.0, shape="constant"),) * 3
Delay = Annotated[NotNegative, Field(le=1)]
HalfTurn = Annotated[Number, Field(gt=0, lt=1.5707963)]


class Timing(Block):
    """Rates of the control loop and of the plant, and how long to fly."""

    control_hz: Annotated[Count, Field(le=2000)]
    """Control rate: a multiple of 5 with a period of whole nanoseconds."""
    physics_hz: Annotated[Count, Field(le=20000)]
    """Integration rate of the plant, a multiple of `control_hz`."""
    duration_s: Annotated[Positive, Field(le=1e6)]
    """Length of the flight, at least one control period."""


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
    """Limits of the paper's plant."""


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


class Communication(Block):
    """The communication graph of the formation."""

    tree: dict[UavId, UavId]
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
    offsets_m: dict[UavId, Vec3]
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
    sight_m: NotNegative = 0.0
    """Distance within which a detected object is taken to be the parent or the leader; at most half of the keep-out."""
    tolerance_m: Positive = 0.05
    """Largest error at the deadline that the verdict accepts."""
    recovery_s: Positive = 1.0
    """Shortest time base of the way back after an encounter; it is longer where the limits of speed and acceleration
    need more, see [method.md](method.md#way-back)."""


class UavBlock(Block):
    """Start of one UAV, what acts on it, and how it differs from the others."""

    id: UavId
    """Id, unique."""
    position_m: Vec3
    """Start position."""
    attitude_rad: Vec3 = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw at the start."""
    disturbance_m_s2: Disturbance = STILL
    """Acceleration that acts on the UAV; `sin` and `cos` have 1 rad/s."""
    disturbance_rad_s2: Disturbance = STILL
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

    @property
    def of_uav(self) -> bool:
        """True if a function runs in the process of a UAV."""
        return self.task is not None or self.controller is not None

    @property
    def of_world(self) -> bool:
        """True if a function runs where the vehicles are simulated."""
        return any(one is not None for one in (self.plant, self.disturbance, self.sensor))


class ScenarioFile(Block):
    """A whole file, after `extends`, overrides and default gains."""

    name: Name
    """Name of the scenario, in bags and verdicts."""
    description: str = ""
    """Text for the reader."""
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**32)] = 0
    """Seed of all random numbers, see [below](#chance)."""
    security: Literal["none", "signed", "required"] = "none"
    """`signed`: processes take only messages that carry the seal of the fleet. `required`: no process starts without
    DDS Security. See [security.md](security.md)."""
    faults: Annotated[tuple[FaultBlock, ...], Field(max_length=200)] | None = None
    """Faults that are injected, see [faults.md](faults.md#injection). A fleet takes `ptnsbc inject` only with this key;
    an empty list will do. Default: none, and `ptnsbc inject` is refused."""
    timing: Timing
    """Rates and duration."""
    world: Surroundings = Surroundings()
    """The surroundings of the UAVs."""
    sensor: Sensor
    """Sensors of a UAV."""
    plant: Plant
    """The vehicle, the same for all."""
    communication: Communication
    """The communication graph of the formation."""
    leader: Leader
    """The UAV around which the others form."""
    formation: Formation
    """The shape, and the task that holds it."""
    gains: Gains
    """All gains of the laws."""
    mission: Mission | None = None
    """Task of the formation, leg by leg, see [missions.md](missions.md). Default: it forms and follows the trajectory
    of the leader."""
    law: FunctionName | None = None
    """Law of the followers in place of ours: `FILE.py:NAME` of a function, looked for beside this file, or the name
    of an entry point, see [laws.md](laws.md)."""
    plugins: Plugins = Plugins()
    """More functions of the user, each as `FILE.py:NAME` or as the name of an entry point:"""
    mavlink: Mavlink = Mavlink()
    """Flight controllers instead of the simulator."""
    uavs: Annotated[tuple[UavBlock, ...], Field(min_length=1)]
    """Starts and disturbances of the UAVs, at least one."""
