"""The messages a stand-in sends of itself, by message id; those of its state are in `telemetry_state`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_sim.autopilot import telemetry_state
from ptnsbc_sim.autopilot.physics.frames import attitude_swap, body_swap, euler_of, world_swap
from ptnsbc_sim.autopilot.physics.geodesy import Geodetic, geodetic

if TYPE_CHECKING:
    from ptnsbc_sim.autopilot.vehicle import StandInVehicle

Builder = Callable[["StandInVehicle", float], Any]

_UNKNOWN_16 = 65535
_UNIT_QUATERNION = [1.0, 0.0, 0.0, 0.0]


def _on_earth(vehicle: StandInVehicle, local_enu: Array) -> Geodetic:
    """Where a place (3,) of the vehicle's local frame is, as the vehicle believes."""
    world_enu = local_enu + vehicle.flight.navigation.origin_enu
    return geodetic(vehicle.body.datum, world_enu, vehicle.earth_radius_m)


def _e7(degrees: float) -> int:
    return round(degrees * 1e7)


def _attitude(vehicle: StandInVehicle, t: float) -> Any:
    flight = vehicle.flight
    euler = euler_of(attitude_swap(flight.attitude_enu))
    return mavlink.MAVLink_attitude_message(
        vehicle.clock.ms(t), *euler, *body_swap(flight.rates_flu).tolist()
    )


def _attitude_quaternion(vehicle: StandInVehicle, t: float) -> Any:
    flight = vehicle.flight
    return mavlink.MAVLink_attitude_quaternion_message(
        vehicle.clock.ms(t),
        *attitude_swap(flight.attitude_enu),
        *body_swap(flight.rates_flu).tolist(),
        [0.0] * 4,
    )


def _local_position(vehicle: StandInVehicle, t: float) -> Any:
    if not vehicle.position_valid(t):
        return None
    flight = vehicle.flight
    return mavlink.MAVLink_local_position_ned_message(
        vehicle.clock.ms(t),
        *world_swap(flight.position_enu).tolist(),
        *world_swap(flight.velocity_enu).tolist(),
    )


def _in_body(vehicle: StandInVehicle) -> Array:
    """Estimated velocity (3,) in FRD."""
    w, x, y, z = vehicle.flight.attitude_enu
    u, v, s = (float(value) for value in vehicle.flight.velocity_enu)
    ahead = (1 - 2 * (y * y + z * z)) * u + 2 * (x * y + w * z) * v + 2 * (x * z - w * y) * s
    left = 2 * (x * y - w * z) * u + (1 - 2 * (x * x + z * z)) * v + 2 * (y * z + w * x) * s
    up = 2 * (x * z + w * y) * u + 2 * (y * z - w * x) * v + (1 - 2 * (x * x + y * y)) * s
    return body_swap((ahead, left, up))  # type: ignore[arg-type]


def _covariance(quality_variance: float) -> list[float]:
    """Upper triangle (21) of a 6 x 6 covariance with one variance on the first three diagonal places."""
    out = [0.0] * 21
    out[0] = out[6] = out[11] = quality_variance
    return out


def _odometry(vehicle: StandInVehicle, t: float) -> Any:
    if not vehicle.position_valid(t):
        return None
    flight = vehicle.flight
    quality = flight.body.quality
    return mavlink.MAVLink_odometry_message(
        vehicle.clock.us(t),
        mavlink.MAV_FRAME_LOCAL_NED,
        mavlink.MAV_FRAME_BODY_FRD,
        *world_swap(flight.position_enu).tolist(),
        list(attitude_swap(flight.attitude_enu)),
        *_in_body(vehicle).tolist(),
        *body_swap(flight.rates_flu).tolist(),
        _covariance(quality.position_m**2),
        _covariance(quality.velocity_m_s**2),
        vehicle.boots % 256,
        mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT,
        100,
    )


def _global_position(vehicle: StandInVehicle, t: float) -> Any:
    if not vehicle.position_valid(t):
        return None
    place = _on_earth(vehicle, vehicle.flight.position_enu)
    flight = vehicle.flight
    velocity = world_swap(flight.velocity_enu) * 100.0
    heading = euler_of(attitude_swap(flight.attitude_enu)).yaw
    above = flight.position_enu[2] - vehicle.home_local_enu[2]
    return mavlink.MAVLink_global_position_int_message(
        vehicle.clock.ms(t),
        _e7(place.latitude_deg),
        _e7(place.longitude_deg),
        round(place.altitude_m * 1e3),
        round(float(above) * 1e3),
        *(round(v) for v in velocity.tolist()),
        round(heading * 18000.0 / 3.141592653589793) % 36000,
    )


def _gps_raw(vehicle: StandInVehicle, t: float) -> Any:
    fix = vehicle.flight.navigation.fix_type
    place = _on_earth(vehicle, vehicle.flight.position_enu)
    error_m = max(vehicle.flight.body.quality.position_m, 0.01)
    has = fix > 1
    return mavlink.MAVLink_gps_raw_int_message(
        vehicle.clock.us(t),
        fix,
        _e7(place.latitude_deg) if has else 0,
        _e7(place.longitude_deg) if has else 0,
        round(place.altitude_m * 1e3) if has else 0,
        round(error_m * 100.0) if has else _UNKNOWN_16,
        round(error_m * 150.0) if has else _UNKNOWN_16,
        _UNKNOWN_16,
        _UNKNOWN_16,
        14 if has else 0,
    )


def _home(vehicle: StandInVehicle, t: float) -> Any:
    if not vehicle.position_valid(t):
        return None
    place = _on_earth(vehicle, vehicle.home_local_enu)
    return mavlink.MAVLink_home_position_message(
        _e7(place.latitude_deg),
        _e7(place.longitude_deg),
        round(place.altitude_m * 1e3),
        *world_swap(vehicle.home_local_enu).tolist(),
        _UNIT_QUATERNION,
        0.0,
        0.0,
        0.0,
        vehicle.clock.us(t),
    )


def _origin(vehicle: StandInVehicle, t: float) -> Any:
    if not vehicle.position_valid(t):
        return None
    place = _on_earth(vehicle, np.zeros(3))
    return mavlink.MAVLink_gps_global_origin_message(
        _e7(place.latitude_deg),
        _e7(place.longitude_deg),
        round(place.altitude_m * 1e3),
        vehicle.clock.us(t),
    )


BUILDERS: dict[int, Builder] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: telemetry_state.heartbeat,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position,
    mavlink.MAVLINK_MSG_ID_ODOMETRY: _odometry,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: _gps_raw,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: telemetry_state.sys_status,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: telemetry_state.battery,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: telemetry_state.extended_state,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: _home,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _origin,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: telemetry_state.estimator,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: telemetry_state.version,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: telemetry_state.system_time,
    mavlink.MAVLINK_MSG_ID_TIMESYNC: telemetry_state.timesync,
}
"""What can be streamed or requested; a builder says None while there is nothing valid to send."""
