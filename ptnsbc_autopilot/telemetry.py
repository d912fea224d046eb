"""The messages that a stand-in streams or sends on request, by message id."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ptnsbc_autopilot.physics.frames import attitude_swap, body_swap, euler_of, geodetic, world_swap
from ptnsbc_autopilot.vehicle import StandInVehicle
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.dialect import mavlink

Builder = Callable[[StandInVehicle, float], Any]

_UNKNOWN_16 = 65535
_UNIT_QUATERNION = [1.0, 0.0, 0.0, 0.0]


def _lat_lon_alt(vehicle: StandInVehicle, local_enu: Array) -> tuple[int, int, int]:
    """Estimated latitude, longitude [1e-7 deg] and altitude [mm] of a point (3,) of the local frame."""
    world_enu = local_enu + vehicle.flight.navigation.origin_enu
    point = geodetic(vehicle.body.datum, world_enu, vehicle.earth_radius_m)
    return (
        round(point.latitude_deg * 1e7),
        round(point.longitude_deg * 1e7),
        round(point.altitude_m * 1e3),
    )


def _attitude(vehicle: StandInVehicle, t: float) -> Any:
    flight = vehicle.flight
    euler = euler_of(attitude_swap(flight.estimate.attitude_enu))
    return mavlink.MAVLink_attitude_message(
        vehicle.clock.ms(t), *euler, *body_swap(flight.estimate.rates_flu).tolist()
    )


def _attitude_quaternion(vehicle: StandInVehicle, t: float) -> Any:
    flight = vehicle.flight
    return mavlink.MAVLink_attitude_quaternion_message(
        vehicle.clock.ms(t),
        *attitude_swap(flight.estimate.attitude_enu),
        *body_swap(flight.estimate.rates_flu).tolist(),
        [0.0] * 4,
    )


def _local_position(vehicle: StandInVehicle, t: float) -> Any:
    flight = vehicle.flight
    return mavlink.MAVLink_local_position_ned_message(
        vehicle.clock.ms(t),
        *world_swap(flight.estimate.position_enu).tolist(),
        *world_swap(flight.estimate.velocity_enu).tolist(),
    )


def _body_velocity(vehicle: StandInVehicle) -> Array:
    """Estimated velocity (3,) in FRD."""
    w, x, y, z = vehicle.flight.estimate.attitude_enu
    u, v, s = (float(value) for value in vehicle.flight.estimate.velocity_enu)
    ahead = (1 - 2 * (y * y + z * z)) * u + 2 * (x * y + w * z) * v + 2 * (x * z - w * y) * s
    left = 2 * (x * y - w * z) * u + (1 - 2 * (x * x + z * z)) * v + 2 * (y * z + w * x) * s
    up = 2 * (x * z + w * y) * u + 2 * (y * z - w * x) * v + (1 - 2 * (x * x + y * y)) * s
    return body_swap((ahead, left, up))  # type: ignore[arg-type]


def _covariance(quality_variance: float) -> list[float]:
    """Upper triangle (21) of a 6 x 6 covariance with one variance in the first three diagonal entries."""
    out = [0.0] * 21
    out[0] = out[6] = out[11] = quality_variance
    return out


def _odometry(vehicle: StandInVehicle, t: float) -> Any:
    flight = vehicle.flight
    quality = flight.body.quality
    return mavlink.MAVLink_odometry_message(
        vehicle.clock.us(t),
        mavlink.MAV_FRAME_LOCAL_NED,
        mavlink.MAV_FRAME_BODY_FRD,
        *world_swap(flight.estimate.position_enu).tolist(),
        list(attitude_swap(flight.estimate.attitude_enu)),
        *_body_velocity(vehicle).tolist(),
        *body_swap(flight.estimate.rates_flu).tolist(),
        _covariance(quality.position_m**2),
        _covariance(quality.velocity_m_s**2),
        vehicle.boots % 256,
        mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT,
        100,
    )


def _global_position(vehicle: StandInVehicle, t: float) -> Any:
    flight = vehicle.flight
    velocity = world_swap(flight.estimate.velocity_enu) * 100.0
    above = flight.estimate.position_enu[2] - vehicle.home_local_enu[2]
    return mavlink.MAVLink_global_position_int_message(
        vehicle.clock.ms(t),
        *_lat_lon_alt(vehicle, flight.estimate.position_enu),
        round(float(above) * 1e3),
        *(round(v) for v in velocity.tolist()),
        round(flight.estimate.heading_ned * 18000.0 / 3.141592653589793) % 36000,
    )


def _gps_raw(vehicle: StandInVehicle, t: float) -> Any:
    fix = vehicle.flight.navigation.fix_type
    error_m = max(vehicle.flight.body.quality.position_m, 0.01)
    has = fix > 1
    return mavlink.MAVLink_gps_raw_int_message(
        vehicle.clock.us(t),
        fix,
        *(_lat_lon_alt(vehicle, vehicle.flight.estimate.position_enu) if has else (0, 0, 0)),
        round(error_m * 100.0) if has else _UNKNOWN_16,
        round(error_m * 150.0) if has else _UNKNOWN_16,
        _UNKNOWN_16,
        _UNKNOWN_16,
        14 if has else 0,
        h_acc=round(vehicle.flight.body.quality.position_m * 1e3) if has else 0,
    )


def _home(vehicle: StandInVehicle, t: float) -> Any:
    return mavlink.MAVLink_home_position_message(
        *_lat_lon_alt(vehicle, vehicle.home_local_enu),
        *world_swap(vehicle.home_local_enu).tolist(),
        _UNIT_QUATERNION,
        *[0.0] * 3,
        vehicle.clock.us(t),
    )


def _origin(vehicle: StandInVehicle, t: float) -> Any:
    return mavlink.MAVLink_gps_global_origin_message(
        *_lat_lon_alt(vehicle, np.zeros(3)), vehicle.clock.us(t)
    )


def _true_place(vehicle: StandInVehicle) -> tuple[int, int, float]:
    """True latitude, longitude [1e-7 deg] and altitude [m]."""
    flight = vehicle.flight
    point = geodetic(vehicle.body.datum, flight.truth.position_enu, vehicle.earth_radius_m)
    return round(point.latitude_deg * 1e7), round(point.longitude_deg * 1e7), point.altitude_m


def _hil_state(vehicle: StandInVehicle, t: float) -> Any:
    """The truth, as PX4's simulations tell it."""
    flight = vehicle.flight
    latitude, longitude, altitude_m = _true_place(vehicle)
    return mavlink.MAVLink_hil_state_quaternion_message(
        vehicle.clock.us(t),
        list(attitude_swap(flight.truth.attitude_enu)),
        *body_swap(flight.estimate.rates_flu).tolist(),
        latitude,
        longitude,
        round(altitude_m * 1e3),
        *(round(100.0 * v) for v in world_swap(flight.truth.velocity_enu).tolist()),
        *[0] * 5,
    )


def _sim_state(vehicle: StandInVehicle, _t: float) -> Any:
    """The truth, as ArduPilot's simulations tell it."""
    flight = vehicle.flight
    latitude, longitude, altitude_m = _true_place(vehicle)
    attitude = attitude_swap(flight.truth.attitude_enu)
    return mavlink.MAVLink_sim_state_message(
        *attitude,
        *euler_of(attitude),
        *[0.0] * 3,
        *body_swap(flight.estimate.rates_flu).tolist(),
        latitude * 1e-7,
        longitude * 1e-7,
        altitude_m,
        0.0,
        0.0,
        *world_swap(flight.truth.velocity_enu).tolist(),
        latitude,
        longitude,
    )


def _heartbeat(vehicle: StandInVehicle, t: float) -> Any:
    return mavlink.MAVLink_heartbeat_message(
        vehicle.mav_type, vehicle.autopilot, *vehicle.heartbeat_fields(t), 3
    )


def _sensors(vehicle: StandInVehicle, t: float) -> tuple[int, int]:
    """Bits of the sensors present, and of the healthy ones."""
    base = (
        mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
        | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
        | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
        | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
        | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    )
    gps, ready = mavlink.MAV_SYS_STATUS_SENSOR_GPS, mavlink.MAV_SYS_STATUS_PREARM_CHECK
    healthy = base
    if vehicle.flight.navigation.fix_type > 1:
        healthy |= gps
    if vehicle.arming_problem(t) is None:
        healthy |= ready
    return base | gps | ready, healthy & ~vehicle.faults.unhealthy


def _sys_status(vehicle: StandInVehicle, t: float) -> Any:
    present, healthy = _sensors(vehicle, t)
    flight = vehicle.flight
    return mavlink.MAVLink_sys_status_message(
        present,
        present,
        healthy,
        300,
        round(flight.battery_v * 1000.0),
        -1,
        round(flight.battery * 100.0),
        *[0] * 6,
    )


def _charge_state(charge: float) -> int:
    if charge <= 0.07:
        return int(mavlink.MAV_BATTERY_CHARGE_STATE_CRITICAL)
    if charge <= 0.15:
        return int(mavlink.MAV_BATTERY_CHARGE_STATE_LOW)
    return int(mavlink.MAV_BATTERY_CHARGE_STATE_OK)


def _battery_status(vehicle: StandInVehicle, _t: float) -> Any:
    flight = vehicle.flight
    cells = [round(flight.battery_v * 1000.0 / 4)] * 4 + [_UNKNOWN_16] * 6
    return mavlink.MAVLink_battery_status_message(
        0,
        mavlink.MAV_BATTERY_FUNCTION_ALL,
        mavlink.MAV_BATTERY_TYPE_LIPO,
        32767,
        cells,
        -1,
        -1,
        -1,
        round(flight.battery * 100.0),
        0,
        _charge_state(flight.battery),
    )


def _extended_state(vehicle: StandInVehicle, _t: float) -> Any:
    return mavlink.MAVLink_extended_sys_state_message(
        mavlink.MAV_VTOL_STATE_UNDEFINED, vehicle.landed_state()
    )


def _estimator(vehicle: StandInVehicle, t: float) -> Any:
    flags = mavlink.ESTIMATOR_ATTITUDE | mavlink.ESTIMATOR_POS_VERT_ABS
    if vehicle.position_valid(t):
        flags |= (
            mavlink.ESTIMATOR_VELOCITY_HORIZ
            | mavlink.ESTIMATOR_VELOCITY_VERT
            | mavlink.ESTIMATOR_POS_HORIZ_REL
            | mavlink.ESTIMATOR_POS_HORIZ_ABS
        )
    quality = vehicle.flight.body.quality
    return mavlink.MAVLink_estimator_status_message(
        vehicle.clock.us(t), flags, 0, 0, 0, 0, 0, 0, quality.position_m, quality.height_m
    )


def _version(vehicle: StandInVehicle, _t: float) -> Any:
    capabilities = (
        mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
        | vehicle.capabilities
    )
    zeros = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        capabilities, vehicle.version_word, 0, 0, 0, zeros, zeros, zeros, 0, 0, vehicle.system
    )


def _system_time(vehicle: StandInVehicle, t: float) -> Any:
    """Without a date: the stand-in has none."""
    return mavlink.MAVLink_system_time_message(0, vehicle.clock.ms(t))


def _timesync(vehicle: StandInVehicle, t: float) -> Any:
    """A request to the companion."""
    return mavlink.MAVLink_timesync_message(0, vehicle.clock.ns(t))


BUILDERS: dict[int, Builder] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position,
    mavlink.MAVLINK_MSG_ID_ODOMETRY: _odometry,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: _gps_raw,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: _battery_status,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_state,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: _home,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _origin,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: _estimator,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _version,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: _system_time,
    mavlink.MAVLINK_MSG_ID_TIMESYNC: _timesync,
    mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION: _hil_state,
    mavlink.MAVLINK_MSG_ID_SIM_STATE: _sim_state,
}
"""By message id: what can be streamed or requested."""

_NEED_POSITION = (_local_position, _odometry, _global_position, _home, _origin)


def send_message(vehicle: StandInVehicle, message_id: int, link: int, t: float) -> bool:
    """Send a message by its id; False when there is none, or nothing valid to send."""
    build = BUILDERS.get(message_id)
    if build is None or (build in _NEED_POSITION and not vehicle.position_valid(t)):
        return False
    if message_id != mavlink.MAVLINK_MSG_ID_HEARTBEAT or not vehicle.faults.no_heartbeat:
        vehicle.send(link, build(vehicle, t))
    return True
