"""The `mavlink` block: how real flight controllers are reached, limited and flown."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field

from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_sim.scenario.fields import (
    Block,
    Count,
    Flag,
    NotNegative,
    Number,
    Positive,
    UavId,
    Vec3,
)
from ptnsbc_sim.scenario.ros import RosVehicle

Autopilot = Literal["px4", "ardupilot", "generic", "ros"]
SetpointKind = Literal["velocity", "position_velocity", "attitude"]

FIRST_PORT = 14540
"""PX4's simulations send to this UDP port and the following ones, one per vehicle."""


class WorldOrigin(Block):
    """Position of the world frame's origin on the Earth."""

    latitude_deg: Annotated[Number, Field(ge=-90, le=90)]
    """Latitude, north is positive."""
    longitude_deg: Annotated[Number, Field(ge=-180, le=180)]
    """Longitude, east is positive."""
    altitude_m: Number
    """Height above sea level."""

    @property
    def place(self) -> GeoPoint:
        """The same as a point."""
        return GeoPoint(self.latitude_deg, self.longitude_deg, self.altitude_m)


class Geofence(Block):
    """Region in which the vehicles may fly, world frame: setpoints keep them inside and push them back."""

    radius_m: Positive | None = None
    """Largest horizontal distance from the world's origin."""
    box_min_m: Vec3 | None = None
    """One corner of a box; give both corners or none."""
    box_max_m: Vec3 | None = None
    """The opposite corner of the box."""
    slack_m: NotNegative = 1.0
    """A vehicle that is, or soon will be, farther outside than this lands; nearer it is pushed back."""
    ahead_s: Annotated[NotNegative, Field(le=5)] = 0.5
    """Time over which the predicted path counts: the vehicle's lag. It should stop inside within this time."""


class Abort(Block):
    """From which values on the formation is given up in flight: all hold apart by height, then land. 0: off."""

    separation_share: Annotated[NotNegative, Field(le=1)] = 0.6
    """Distance to another vehicle, now or within half a second, as a share of the keep-out of the two, beyond the
    error of their positions."""
    swing_m_s: NotNegative = 1.0
    """Speed to and fro against the motion of the vehicle's place, four reversals that do not die out."""
    away_m_s: NotNegative = 2.0
    """Speed against the motion of the vehicle's place for 3 s, from 5 s after the deadline on."""
    against_m_s: NotNegative = 1.0
    """Speed back to its place that its planner wants, while the vehicle flies away from it for 3 s."""
    jump_m: NotNegative = 1.0
    """Jump of the vehicle's own position: its estimator was reset."""
    unhealthy_s: NotNegative = 2.0
    """Time for which the vehicle says that a sensor has failed since it was armed; a critical text counts at once."""
    late_share: Annotated[NotNegative, Field(le=1)] = 0.5
    """Share of 3 s in which setpoints are late: none for 0.1 s, because bridge or UAV process miss their ticks."""
    layer_m: Positive = 1.5
    """Height from one vehicle to the next while they hold apart."""


class VehicleLimits(Block):
    """Limits of the setpoints. Lower limits in the vehicle's own parameters take precedence."""

    horizontal_m_s: Positive = 5.0
    """Horizontal speed. A lower limit in the vehicle's own parameters takes precedence, here and below."""
    up_m_s: Positive = 3.0
    """Climb speed."""
    down_m_s: Positive = 1.5
    """Descent speed."""
    acceleration_m_s2: Positive = 5.0
    """Acceleration of velocity setpoints."""
    tilt_rad: Annotated[Number, Field(gt=0, lt=1.5707963)] = 0.61
    """Tilt of attitude setpoints."""


class MavlinkVehicle(Block):
    """Settings of one vehicle."""

    label: Annotated[str, Field(max_length=40, pattern=r"^[^\x00-\x1f\x7f]*$")] = ""
    """Its name, colour and pilot for people, such as `red, Ada`: on the health board, in what `ptnsbc stop` and
    the summary say."""
    connect: str | None = None
    """`udpin:ADDRESS:PORT`, `udpout:ADDRESS:PORT`, `tcp:ADDRESS:PORT`, `serial:DEVICE[:BAUD]`; unique.
    Default: `udpin:127.0.0.1:14540`, 14541, …"""
    sysid: UavId | None = None
    """MAVLink system id, unique. Default: 1, 2, … in the order of `uavs`."""
    origin_m: Vec3 | None = None
    """Surveyed position of the vehicle's local origin in the world frame. Default: by GPS."""
    signing_key: str | None = None
    """Path of a key file, unique."""
    autopilot: Autopilot | None = None
    """Autopilot, for mixed fleets. Default: as above."""
    setpoint: SetpointKind | None = None
    """Kind of setpoint, for mixed fleets. Default: as above."""
    velocity_loop_1_s: Annotated[Positive, Field(le=20)] | None = None
    """Gain of its velocity loop. Default: by its parameters."""
    tilt_lag_s: Annotated[Positive, Field(le=2)] | None = None
    """Lag between the acceleration asked for and flown. Default: by its parameters."""


class Mavlink(Block):
    """Flight controllers instead of the simulator."""

    autopilot: Autopilot = "px4"
    """Autopilot of the vehicles; `generic` accepts attitude targets only, `ros` has the topics of the block `ros`."""
    setpoint: SetpointKind = "velocity"
    """Kind of setpoint, see [hardware.md](hardware.md#setpoints)."""
    rate_hz: Annotated[Count, Field(ge=20, le=100)] = 50
    """Rate of the setpoints."""
    acceleration_feed_forward: Flag = True
    """True if velocity setpoints lead the known lag of the vehicle, with an acceleration beside them."""
    takeoff_height_m: Positive = 3.0
    """Takeoff height above the ground under each vehicle."""
    start_tolerance_m: Positive = 1.0
    """Largest distance of a vehicle from its start in the scenario, beyond the error of its position, to be armed."""
    position_error_m: NotNegative = 0.1
    """Error of positions of a vehicle that does not report one (GPS_RAW_INT, h_acc)."""
    climb_spacing_m: NotNegative = 1.0
    """Vehicles that stand nearer than the keep-out, the position error and this climb one after the other."""
    near: Literal["links", "all"] = "links"
    """`links`: a vehicle avoids those with which it has an edge; `all`: it avoids all. Abort and landing see all."""
    world_origin: WorldOrigin | None = None
    """Position of the world's origin on the Earth. Default: the leader's position."""
    height: Literal["origin", "ground"] = "origin"
    """`origin`: heights relative to each vehicle's GPS origin; `ground`: above the start of each, for level ground."""
    hover_thrust: Annotated[Number, Field(gt=0.05, lt=0.95)] = 0.5
    """Thrust at hover. A parameter of the vehicle takes precedence."""
    battery_land_percent: Annotated[NotNegative, Field(le=90)] = 20.0
    """Battery charge below which the vehicle lands."""
    geofence: Geofence = Geofence()
    abort: Abort = Abort()
    limits: VehicleLimits = VehicleLimits()
    vehicles: dict[UavId, MavlinkVehicle] = Field(default_factory=dict)
    """Settings of single vehicles, by UAV id:"""
    overrides: dict[str, Any] = Field(default_factory=dict)
    """Dotted keys below `gains` and `formation` for real vehicles only, because their inner loops are slower."""


class VehicleLink(NamedTuple):
    """Connection to one vehicle, with defaults filled in."""

    connect: str
    sysid: int
    autopilot: str  # name of a profile of ptnsbc_io/mavlink/autopilots.py
    setpoint: SetpointKind
    origin_m: tuple[float, float, float] | None
    signing_key: str | None
    velocity_loop_1_s: float | None
    tilt_lag_s: float | None
    label: str
    ros: RosVehicle | None = None  # without MAVLink
