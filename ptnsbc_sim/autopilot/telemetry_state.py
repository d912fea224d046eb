"""The messages a stand-in sends of its state: mode, battery, health, clock."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ptnsbc_io.mavlink.dialect import mavlink

if TYPE_CHECKING:
    from ptnsbc_sim.autopilot.vehicle import StandInVehicle

_UNKNOWN_16 = 65535


def heartbeat(vehicle: StandInVehicle, _t: float) -> Any:
    """HEARTBEAT."""
    status = vehicle.status()
    return mavlink.MAVLink_heartbeat_message(
        vehicle.mav_type,
        vehicle.autopilot,
        status.base_mode,
        status.custom_mode,
        status.system_status,
        3,
    )


def _sensors(vehicle: StandInVehicle, t: float) -> tuple[int, int]:
    """Bits of the sensors present, and of the healthy ones."""
    base = (
        mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
        | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
        | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
        | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    )
    gps, ready = mavlink.MAV_SYS_STATUS_SENSOR_GPS, mavlink.MAV_SYS_STATUS_PREARM_CHECK
    healthy = base
    if vehicle.flight.navigation.fix_type > 1:
        healthy |= gps
    if vehicle.arming_problem(t) is None:
        healthy |= ready
    return base | gps | ready, healthy


def sys_status(vehicle: StandInVehicle, t: float) -> Any:
    """SYS_STATUS."""
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
        0,
        0,
        0,
        0,
        0,
        0,
    )


def battery(vehicle: StandInVehicle, _t: float) -> Any:
    """BATTERY_STATUS."""
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
        vehicle.charge_state(),
    )


def extended_state(vehicle: StandInVehicle, _t: float) -> Any:
    """EXTENDED_SYS_STATE."""
    return mavlink.MAVLink_extended_sys_state_message(
        mavlink.MAV_VTOL_STATE_UNDEFINED, vehicle.landed_state()
    )


def estimator(vehicle: StandInVehicle, t: float) -> Any:
    """ESTIMATOR_STATUS."""
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


def version(vehicle: StandInVehicle, _t: float) -> Any:
    """AUTOPILOT_VERSION."""
    capabilities = (
        mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
        | vehicle.capabilities
    )
    nothing = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        capabilities,
        vehicle.version_word,
        0,
        0,
        0,
        nothing,
        nothing,
        nothing,
        0,
        0,
        vehicle.system,
    )


def system_time(vehicle: StandInVehicle, t: float) -> Any:
    """SYSTEM_TIME, which knows no date."""
    return mavlink.MAVLink_system_time_message(0, vehicle.clock.ms(t))


def timesync(vehicle: StandInVehicle, t: float) -> Any:
    """TIMESYNC, a question."""
    return mavlink.MAVLink_timesync_message(0, vehicle.clock.ns(t))
