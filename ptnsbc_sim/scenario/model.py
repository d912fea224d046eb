"""The blocks of a scenario file, as types; what they must satisfy together is in semantics.py."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

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

STILL = (Wave(amount=0.0, shape="constant"),) * 3
HalfTurn = Annotated[Number, Field(gt=0, lt=1.5707963)]


class Timing(Block):
    """Rates of the control loop and of the plant, and how long to fly."""

    control_hz: Annotated[Count, Field(le=2000)]
    """Control rate: a multiple of 5, with a period of whole nanoseconds."""
    physics_hz: Annotated[Count, Field(le=20000)]
    """Rate of the plant's steps, a multiple of `control_hz`."""
    duration_s: Positive
    """Length of the flight, at least one control period."""


class ObstacleBlock(Block):
    """A sphere to keep out of."""

    name: Name
    """Each once."""
    position_m: Vec3
    """Centre."""
    keep_out_m: Positive
    """Radius of the sphere to stay out of."""


class Surroundings(Block):
    """What surrounds the UAVs."""

    gravity_m_s2: NotNegative = 9.81
    """Downwards."""
    wind_m_s: Vec3 = (0.0, 0.0, 0.0)
    """Pushes the quadrotor by its drag."""
    gust_m_s: NotNegativeVec3 = (0.0, 0.0, 0.0)
    """Standard deviation of the gusts around the wind."""
    gust_time_s: Positive = 2.0
    """Correlation time of the gusts."""
    obstacles: tuple[ObstacleBlock, ...] = ()
    """Spheres to keep out of:"""


class Positioning(Block):
    """Position fixes that an estimator on board fuses with inertial measurements."""

    noise_m: Positive
    """Standard deviation of a fix, per axis."""
    rate_hz: Count
    """Of the fixes; divides `control_hz`."""
    latency_s: Annotated[NotNegative, Field(le=1)] = 0.0
    """A fix comes so late; a multiple of the control period."""
    unknown_latency_s: NotNegative = 0.0
    """What the estimator on board does not reckon with of that; all of it where fixes carry no time stamp."""
    acceleration_noise_m_s2: Positive = 0.05
    """Standard deviation of the accelerometer's error between fixes; it sets the filter's gains."""


class Sensor(Block):
    """What a UAV sees of obstacles and other UAVs, and how well it knows where it is: exactly by default."""

    range_m: Positive
    """Of the near-object sensor; `check` wants more than the largest keep-out."""
    rate_hz: Count
    """Of the near-object sensor; divides `control_hz`."""
    noise_m: NotNegative = 0.0
    """Standard deviation of where the near-object sensor sees something, per axis."""
    velocity_noise_m_s: NotNegative = 0.0
    """Standard deviation of how it sees it move, per axis."""
    positioning: Positioning | None = None
    """How well a UAV knows where it is; exactly without it."""


class Quadrotor(Block):
    """The limits of a quadrotor."""

    max_thrust_n: Positive
    """More than the weight."""
    max_tilt_rad: HalfTurn
    """Of the thrust from the vertical."""
    max_torque_nm: PositiveVec3
    """Per body axis."""
    motor_lag_s: Positive
    """First-order lag of thrust and torques."""
    drag_1_s: NotNegative = 0.0
    """Per unit of mass, against the air."""


class RigidBody(Block):
    """The limits of the paper's plant, which has none: far above any force it asks for."""

    max_force_n: Positive = 1e6
    """Limits the controller."""
    max_torque_nm: PositiveVec3 = (1e6, 1e6, 1e6)
    """Limits the controller, per body axis."""


class Plant(Block):
    """The vehicle, the same for all UAVs."""

    kind: Literal["quadrotor", "rigid_body_6dof"]
    """Vehicle model."""
    mass_kg: Positive
    """Of each UAV."""
    inertia_kg_m2: PositiveVec3
    """Principal moments."""
    quadrotor: Quadrotor | None = None
    """Its limits; required for `kind: quadrotor`."""
    rigid_body: RigidBody = RigidBody()
    """Limits of the paper's plant, which has none: far above any force it asks for."""


class Communication(Block):
    """The communication graph of the formation."""

    tree: dict[UavId, UavId]
    """`child: parent`, a tree rooted at the leader."""
    leader_links: tuple[UavId, ...]
    """Followers that hear the leader itself."""
    estimator_edges: tuple[tuple[UavId, UavId], ...]
    """Pairs of followers that exchange estimates, both ways."""
    stale_s: Positive = 0.5
    """Silence after which a UAV holds."""
    loss: Share = 0.0
    """Share of the messages between UAVs that get lost."""


class Circle(Block):
    """Centre + radius (sin, cos)(rate t + phase): clockwise from north, as in the paper."""

    kind: Literal["circle"]
    """Position centre + radius (sin, cos)(rate t + phase): clockwise from north."""
    centre_m: Vec3
    """Also gives the height."""
    radius_m: NotNegative
    """Of the circle."""
    rate_rad_s: Number
    """Angular rate."""
    phase_rad: Number = 0.0
    """Where it begins."""
    yaw_rad: Number = 0.0
    """Heading to hold."""


class Line(Block):
    """position + velocity t."""

    kind: Literal["line"]
    """Position + velocity t."""
    position_m: Vec3
    """At the epoch."""
    velocity_m_s: Vec3 = (0.0, 0.0, 0.0)
    """Constant."""
    yaw_rad: Number = 0.0
    """Heading to hold."""


class Leader(Block):
    """The UAV that the others form around."""

    id: UavId
    """One of `uavs`."""
    trajectory: Annotated[Circle | Line, Field(discriminator="kind")]
    """One of these kinds:"""


class Formation(Block):
    """The shape to hold and the task that holds it."""

    task: Literal["distance_angles", "parent_angle", "relative_position"]
    """What the followers control, see [method.md](method.md)."""
    avoidance: Literal["off", "set_based", "switched"] = "set_based"
    """How obstacles and other UAVs are kept clear of."""
    offsets_m: dict[UavId, Vec3]
    """Every follower's place relative to the leader."""
    heading_anchor_m: Vec3 = (2.0, 0.0, 0.0)
    """Reference point of the leader's children, relative to the leader."""
    uav_keep_out_m: Positive
    """Distance that UAVs keep from each other."""
    sight_m: NotNegative = 0.0
    """A near object so close to where parent or leader say they are counts as them; at most half the keep-out."""
    tolerance_m: Positive = 0.05
    """The verdict's limit at the deadline."""


class UavBlock(Block):
    """One UAV's start and the disturbance it flies in (accelerations)."""

    id: UavId
    """Each once."""
    position_m: Vec3
    """Start."""
    attitude_rad: Vec3 = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw at the start."""
    disturbance_m_s2: Disturbance = STILL
    """Acceleration; `sin` and `cos` are of 1 rad/s."""
    disturbance_rad_s2: Disturbance = STILL
    """Angular acceleration, likewise."""


class ScenarioFile(Block):
    """A whole file, after `extends`, overrides and default gains."""

    name: Name
    """Of the scenario, in bags and verdicts."""
    description: str = ""
    """For people."""
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**32)] = 0
    """Of all that happens by chance: see [below](#chance)."""
    timing: Timing
    """Rates and length."""
    world: Surroundings = Surroundings()
    """What surrounds the UAVs."""
    sensor: Sensor
    """What a UAV sees."""
    plant: Plant
    """The vehicle, the same for all."""
    communication: Communication
    """The communication graph of the formation."""
    leader: Leader
    """The UAV that the others form around."""
    formation: Formation
    """The shape, and the task that holds it."""
    gains: Gains
    """Every gain of the laws."""
    mavlink: Mavlink = Mavlink()
    """Flight controllers instead of the simulator."""
    uavs: Annotated[tuple[UavBlock, ...], Field(min_length=1)]
    """Starts and disturbances, at least one."""
