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
    physics_hz: Annotated[Count, Field(le=20000)]
    duration_s: Positive


class ObstacleBlock(Block):
    """A sphere to keep out of."""

    name: Name
    position_m: Vec3
    keep_out_m: Positive


class World(Block):
    """What surrounds the UAVs."""

    gravity_m_s2: NotNegative = 9.81
    wind_m_s: Vec3 = (0.0, 0.0, 0.0)
    gust_m_s: NotNegativeVec3 = (0.0, 0.0, 0.0)
    gust_time_s: Positive = 2.0
    obstacles: tuple[ObstacleBlock, ...] = ()


class Positioning(Block):
    """Position fixes that an estimator on board fuses with inertial measurements."""

    noise_m: Positive
    rate_hz: Count
    latency_s: Annotated[NotNegative, Field(le=1)] = 0.0
    acceleration_noise_m_s2: Positive = 0.05


class Sensor(Block):
    """What a UAV sees of obstacles and other UAVs, and how well it knows where it is: exactly by default."""

    range_m: Positive
    rate_hz: Count
    positioning: Positioning | None = None


class Quadrotor(Block):
    """The limits of a quadrotor."""

    max_thrust_n: Positive
    max_tilt_rad: HalfTurn
    max_torque_nm: PositiveVec3
    motor_lag_s: Positive
    drag_1_s: NotNegative = 0.0


class RigidBody(Block):
    """The limits of the paper's plant, which has none: far above any force it asks for."""

    max_force_n: Positive = 1e6
    max_torque_nm: PositiveVec3 = (1e6, 1e6, 1e6)


class Plant(Block):
    """The vehicle, the same for all UAVs."""

    kind: Literal["quadrotor", "rigid_body_6dof"]
    mass_kg: Positive
    inertia_kg_m2: PositiveVec3
    quadrotor: Quadrotor | None = None
    rigid_body: RigidBody = RigidBody()


class Communication(Block):
    """Who hears whom."""

    tree: dict[UavId, UavId]
    leader_links: tuple[UavId, ...]
    estimator_edges: tuple[tuple[UavId, UavId], ...]
    stale_s: Positive = 0.5
    loss: Share = 0.0


class Circle(Block):
    """Centre + radius (sin, cos)(rate t + phase): clockwise from north, as in the paper."""

    kind: Literal["circle"]
    centre_m: Vec3
    radius_m: NotNegative
    rate_rad_s: Number
    phase_rad: Number = 0.0
    yaw_rad: Number = 0.0


class Line(Block):
    """position + velocity t."""

    kind: Literal["line"]
    position_m: Vec3
    velocity_m_s: Vec3 = (0.0, 0.0, 0.0)
    yaw_rad: Number = 0.0


class Leader(Block):
    """The UAV that the others form around."""

    id: UavId
    trajectory: Annotated[Circle | Line, Field(discriminator="kind")]


class Formation(Block):
    """The shape to hold and the task that holds it."""

    task: Literal["distance_angles", "parent_angle", "relative_position"]
    avoidance: Literal["off", "set_based", "switched"] = "set_based"
    offsets_m: dict[UavId, Vec3]
    heading_anchor_m: Vec3 = (2.0, 0.0, 0.0)
    uav_keep_out_m: Positive
    tolerance_m: Positive = 0.05


class UavBlock(Block):
    """One UAV's start and the disturbance it flies in (accelerations)."""

    id: UavId
    position_m: Vec3
    attitude_rad: Vec3 = (0.0, 0.0, 0.0)
    disturbance_m_s2: Disturbance = STILL
    disturbance_rad_s2: Disturbance = STILL


class ScenarioFile(Block):
    """A whole file, after `extends`, overrides and default gains."""

    name: Name
    description: str = ""
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**32)] = 0
    timing: Timing
    world: World = World()
    sensor: Sensor
    plant: Plant
    communication: Communication
    leader: Leader
    formation: Formation
    gains: Gains
    mavlink: Mavlink = Mavlink()
    uavs: Annotated[tuple[UavBlock, ...], Field(min_length=1)]
