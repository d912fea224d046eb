"""What a bridge sends besides odometry: the vehicle's limits, and the origin of the world.

These messages are rare, so message objects are fast enough.
"""

from __future__ import annotations

from typing import NamedTuple

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Float64MultiArray

from ptnsbc_core.types import AgentConfig
from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_nodes.comm.serialize import encode


class PlannerLimits(NamedTuple):
    """The largest speed and acceleration that a planner may command."""

    speed_m_s: float
    acceleration_m_s2: float


def encode_limits(limits: PlannerLimits) -> bytes:
    """Float64MultiArray: speed [m/s], acceleration [m/s^2]."""
    return encode(Float64MultiArray(data=[float(value) for value in limits]))


def decode_limits(data: bytes) -> PlannerLimits:
    """The limits in a Float64MultiArray."""
    speed, acceleration = deserialize_message(data, Float64MultiArray).data[:2]
    return PlannerLimits(float(speed), float(acceleration))


def limited(config: AgentConfig, speed_m_s: float, acceleration_m_s2: float) -> AgentConfig:
    """The constants of one UAV, with its planner's limits lowered to the vehicle's."""
    limits = config.filter
    return config._replace(
        filter=limits._replace(
            max_speed=min(limits.max_speed, speed_m_s),
            max_acceleration=min(limits.max_acceleration, acceleration_m_s2),
        )
    )


def encode_origin(place: GeoPoint) -> bytes:
    """NavSatFix."""
    return encode(
        NavSatFix(
            latitude=float(place.latitude_deg),
            longitude=float(place.longitude_deg),
            altitude=float(place.altitude_m),
        )
    )


def decode_origin(data: bytes) -> GeoPoint:
    """The position in a NavSatFix."""
    fix = deserialize_message(data, NavSatFix)
    return GeoPoint(fix.latitude, fix.longitude, fix.altitude)
