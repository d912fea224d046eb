"""The messages of a bridge besides odometry: the vehicle's limits and battery, and the origin of the world.

These messages are rare, so message objects are fast enough to write them. What comes from outside never reaches
rclpy's deserialiser.
"""

from __future__ import annotations

import math

from sensor_msgs.msg import BatteryState, NavSatFix
from std_msgs.msg import Float64MultiArray

from ptnsbc_io.cdr import Reader, WireError, encode, split_stamp
from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_sim.scenario.constants import PlannerLimits

_HIGHEST_M = 1e5


def encode_limits(limits: PlannerLimits) -> bytes:
    """Float64MultiArray: speed [m/s], acceleration [m/s^2]."""
    return encode(Float64MultiArray(data=[float(value) for value in limits]))


def decode_limits(data: bytes) -> PlannerLimits:
    """The limits in a Float64MultiArray; WireError unless both are finite and above zero."""
    reader = Reader(data, "std_msgs/Float64MultiArray")
    for _ in range(*reader.numbers("I")):  # dimensions: label, size, stride
        reader.text()
        reader.numbers("II")
    _, count = reader.numbers("II")  # offset of the data, length
    limits = PlannerLimits(*reader.numbers("dd", 8)) if count >= 2 else PlannerLimits(0.0, 0.0)
    if not all(0.0 < number < math.inf for number in limits):
        shown = ", ".join(f"{number:g}" for number in limits[:count]) or "nothing"
        raise WireError(f"limits {shown}: expected a speed and an acceleration above 0")
    return limits


def encode_battery(
    stamp_ns: int, voltage_v: float | None, current_a: float | None, percent: float | None
) -> bytes:
    """BatteryState of a battery in flight; None becomes NaN, as the message has it for what is not measured."""

    def known(value: float | None) -> float:
        return math.nan if value is None else value

    message = BatteryState(
        voltage=known(voltage_v),
        current=-known(current_a),  # negative while it discharges
        percentage=known(percent) / 100.0,
        temperature=math.nan,
        charge=math.nan,
        capacity=math.nan,
        design_capacity=math.nan,
        power_supply_status=BatteryState.POWER_SUPPLY_STATUS_DISCHARGING,
        present=True,
    )
    message.header.stamp.sec, message.header.stamp.nanosec = split_stamp(stamp_ns)
    return encode(message)


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
    """The position in a NavSatFix; WireError for one that is not on the Earth."""
    reader = Reader(data, "sensor_msgs/NavSatFix")
    reader.stamp()
    reader.text()  # frame_id
    reader.take(1)  # status
    reader.take(2, 2)  # service
    latitude, longitude, altitude = reader.numbers("ddd", 8)
    on_earth = abs(latitude) <= 90.0 and abs(longitude) <= 180.0
    if not (on_earth and abs(altitude) <= _HIGHEST_M):
        place = f"{latitude:g}, {longitude:g}, {altitude:g} m"
        raise WireError(f"origin {place}: expected degrees on the Earth, {_HIGHEST_M:g} m at most")
    return GeoPoint(latitude, longitude, altitude)
