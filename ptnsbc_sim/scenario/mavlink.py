"""The `mavlink` block: how real flight controllers are reached, limited and flown."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import Field

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

if TYPE_CHECKING:
    from ptnsbc_sim.scenario.model import ScenarioFile

Autopilot = Literal["px4", "ardupilot", "generic"]
SetpointKind = Literal["velocity", "position_velocity", "attitude"]

FIRST_PORT = 14540
"""PX4's simulations send to this UDP port and the following ones, one per vehicle."""

_CONNECT = re.compile(r"udp(in|out):[^:\s]+:\d{1,5}|serial:[^:\s]+(:\d+)?")
_CONNECT_HELP = "expected udpin:ADDRESS:PORT, udpout:ADDRESS:PORT or serial:DEVICE[:BAUD]"


class WorldOrigin(Block):
    """Where the origin of the world frame is on the Earth."""

    latitude_deg: Annotated[Number, Field(ge=-90, le=90)]
    """North is positive."""
    longitude_deg: Annotated[Number, Field(ge=-180, le=180)]
    """East is positive."""
    altitude_m: Number
    """Above sea level."""


class Geofence(Block):
    """Where the vehicles may be, world frame; a vehicle outside lands."""

    radius_m: Positive | None = None
    """Horizontally from the world's origin."""
    box_min_m: Vec3 | None = None
    """A corner; both or none."""
    box_max_m: Vec3 | None = None
    """The corner opposite."""


class VehicleLimits(Block):
    """What a setpoint may ask for, whatever the vehicle's own parameters allow."""

    horizontal_m_s: Positive = 5.0
    """The vehicle's own parameters count where they are lower, here and below."""
    up_m_s: Positive = 3.0
    """Climb."""
    down_m_s: Positive = 1.5
    """Descent."""
    acceleration_m_s2: Positive = 5.0
    """Of velocity setpoints."""
    tilt_rad: Annotated[Number, Field(gt=0, lt=1.5707963)] = 0.61
    """Of attitude setpoints."""


class MavlinkVehicle(Block):
    """What differs between the vehicles."""

    connect: str | None = None
    """`udpin:ADDRESS:PORT`, `udpout:ADDRESS:PORT`, `serial:DEVICE[:BAUD]`; each once.
    Default: `udpin:127.0.0.1:14540`, 14541, …"""
    sysid: UavId | None = None
    """Each once. Default: 1, 2, … in the order of `uavs`."""
    origin_m: Vec3 | None = None
    """Surveyed place of the vehicle's local origin in the world frame. Default: by GPS."""
    signing_key: str | None = None
    """Path of a key file, each once."""
    autopilot: Autopilot | None = None
    """For mixed fleets; default as above."""
    setpoint: SetpointKind | None = None
    """For mixed fleets; default as above."""


class Mavlink(Block):
    """Flight controllers instead of the simulator."""

    autopilot: Autopilot = "px4"
    """`generic` takes attitude targets only."""
    setpoint: SetpointKind = "velocity"
    """What is sent, see [hardware.md](hardware.md#setpoints)."""
    rate_hz: Annotated[Count, Field(ge=20, le=100)] = 50
    """Of the setpoints."""
    acceleration_feed_forward: Flag = False
    """Adds the rate of change of the velocity setpoint."""
    takeoff_height_m: Positive = 3.0
    """Above where each vehicle stands."""
    near: Literal["links", "all"] = "links"
    """`links`: a vehicle keeps clear of those it has an edge with; `all`: of all, and hears them."""
    world_origin: WorldOrigin | None = None
    """Where the world's origin is on the Earth. Default: the leader's place."""
    height: Literal["origin", "ground"] = "origin"
    """`origin`: heights by each vehicle's GPS origin; `ground`: above where each stands, for level ground."""
    hover_thrust: Annotated[Number, Field(gt=0.05, lt=0.95)] = 0.5
    """Where the vehicle has a parameter for it, that counts."""
    battery_land_percent: Annotated[NotNegative, Field(le=90)] = 20.0
    """Below it the vehicle lands."""
    geofence: Geofence = Geofence()
    """Where the vehicles may be, world frame; one outside lands."""
    limits: VehicleLimits = VehicleLimits()
    """What a setpoint may ask for."""
    vehicles: dict[UavId, MavlinkVehicle] = Field(default_factory=dict)
    """What differs between them, by UAV id:"""
    overrides: dict[str, Any] = Field(default_factory=dict)
    """Dotted keys below `gains` and `formation`, for real vehicles only: their inner loops are slower."""


class VehicleLink(NamedTuple):
    """How one vehicle is reached, defaults filled in."""

    connect: str
    sysid: int
    autopilot: Autopilot
    setpoint: SetpointKind
    origin_m: tuple[float, float, float] | None
    signing_key: str | None


def vehicle_link(block: Mavlink, uav_ids: tuple[int, ...], uav_id: int) -> VehicleLink:
    """The link of one UAV; without an entry, that of the PX4 simulation of the same number."""
    number = uav_ids.index(uav_id)
    own = block.vehicles.get(uav_id, MavlinkVehicle())
    return VehicleLink(
        own.connect or f"udpin:127.0.0.1:{FIRST_PORT + number}",
        own.sysid or number + 1,
        own.autopilot or block.autopilot,
        own.setpoint or block.setpoint,
        own.origin_m,
        own.signing_key,
    )


def problems(file: ScenarioFile) -> Iterator[str]:
    """What in the block does not fit together, or to the rest of the file."""
    block = file.mavlink
    ids = tuple(uav.id for uav in file.uavs)
    for uav, vehicle in block.vehicles.items():
        where = f"mavlink.vehicles.{uav}"
        if uav not in ids:
            known = ", ".join(map(str, ids))
            yield f"{where}: no such UAV; expected one of the ids under uavs: {known}"
        if vehicle.connect is not None and not _CONNECT.fullmatch(vehicle.connect):
            yield f'{where}.connect: "{vehicle.connect}": {_CONNECT_HELP}'
    for key in block.overrides:
        if key.split(".")[0] not in ("gains", "formation"):
            yield f"mavlink.overrides.{key}: expected a key below gains or formation"
    yield from _duplicates(block, ids)
    yield from _fence(block.geofence)


def _duplicates(block: Mavlink, ids: tuple[int, ...]) -> Iterator[str]:
    links = {uav: vehicle_link(block, ids, uav) for uav in ids}
    for what in ("sysid", "connect", "signing_key"):
        first: dict[str, int] = {}
        for uav, link in links.items():
            value = getattr(link, what)
            if value is None:
                continue
            # Whichever address it listens at, a port has one listener.
            key = str(value).rpartition(":")[2] if str(value).startswith("udpin:") else str(value)
            if key in first:
                yield (
                    f"mavlink.vehicles.{uav}.{what}: {value}: duplicate of that of UAV "
                    f"{first[key]}, give every vehicle its own"
                )
            first.setdefault(key, uav)


def _fence(fence: Geofence) -> Iterator[str]:
    if (fence.box_min_m is None) != (fence.box_max_m is None):
        yield "mavlink.geofence: one corner of the box: expected box_min_m and box_max_m, or neither"
    elif fence.box_min_m is not None and fence.box_max_m is not None:
        for low, high in zip(fence.box_min_m, fence.box_max_m, strict=True):
            if low >= high:
                yield f"mavlink.geofence.box_max_m: {high:g}: expected more than box_min_m, {low:g}"
