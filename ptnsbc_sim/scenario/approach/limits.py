"""The rest of the limits of speed and acceleration that a mission leaves for the approach, of the weakest vehicle.

The motion of the leader, that of a shape and the drag take their part, with the largest speed and the largest
acceleration of the whole flight.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.curves.shape import place_samples
from ptnsbc_core.curves.trajectory import curve_samples
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario.mission.curves import extremes, trajectory_of
from ptnsbc_sim.scenario.mission.shapes import moves, shape_of
from ptnsbc_sim.scenario.mission.trajectories import Circle, Line, Route
from ptnsbc_sim.scenario.model import Plant, ScenarioFile, UavBlock, plant_of

_SAMPLE_S, _MOST_SAMPLES = 0.02, 20_000  # of the motion of a shape


class MotionLimits(NamedTuple):
    """The rest of the limits of speed and acceleration beside the leader's motion; not above 0: nothing."""

    speed_m_s: float
    acceleration_m_s2: float


def leader_motion(file: ScenarioFile) -> tuple[float, float]:
    """Largest speed [m/s] and acceleration [m/s^2] of the leader's path."""
    path = file.leader.trajectory
    if isinstance(path, Circle):
        speed = abs(path.radius_m * path.rate_rad_s)
        return speed, speed * abs(path.rate_rad_s)
    if isinstance(path, Line):
        return math.hypot(*path.velocity_m_s), 0.0
    begins = [leg.begin_s for leg in path.legs] if isinstance(path, Route) else []
    last = min((begin_s for begin_s in begins if begin_s > 0.0), default=math.inf)
    most = extremes(path, min(file.timing.duration_s, last))
    return most.speed_m_s, most.acceleration_m_s2


def _places_motion(file: ScenarioFile, first: float, last: float) -> tuple[float, float]:
    """Largest speed [m/s] and acceleration [m/s^2] of the leader and the places in the world, between two times [s]."""
    curve, span = trajectory_of(file.leader.trajectory), last - first
    times = np.linspace(first, last, min(max(round(span / _SAMPLE_S), 1), _MOST_SAMPLES) + 1)
    lead = curve_samples(curve, times)
    speed, acceleration = _longest(lead[:, 3:6]), _longest(lead[:, 6:9])
    for uav in file.formation.offsets_m if moves(file.formation) else ():
        place = place_samples(shape_of(file, uav), curve, times)
        speed = max(speed, _longest(lead[:, 3:6] + place[:, 3:6]))
        acceleration = max(acceleration, _longest(lead[:, 6:9] + place[:, 6:9]))
    return speed, acceleration


def _longest(vectors: Array) -> float:
    return float(np.linalg.norm(vectors, axis=1).max())


def _motion(file: ScenarioFile) -> tuple[float, float]:
    """Largest speed [m/s] and acceleration [m/s^2] that the mission asks of a UAV beside the approach."""
    leader, changes = leader_motion(file), file.formation.changes
    if not moves(file.formation) or not file.formation.offsets_m:
        return leader
    begins = [one.at_s for one in changes if one.at_s > 0.0]
    begins += [one.begin_s for one in getattr(file.leader.trajectory, "apart", ())]
    first = min(begins, default=file.timing.duration_s)
    places = _places_motion(file, 0.0, first)
    return max(leader[0], places[0]), max(leader[1], places[1])


def _vehicle_acceleration(file: ScenarioFile, plant: Plant, leader_speed: float) -> float:
    """Acceleration [m/s^2] that the actuators allow in the weakest direction, beside gravity and drag."""
    gravity = file.world.gravity_m_s2
    if plant.kind != "quadrotor" or plant.quadrotor is None:
        return plant.rigid_body.max_force_n / plant.mass_kg - gravity
    sideways = gravity * math.tan(plant.quadrotor.max_tilt_rad)
    upwards = plant.quadrotor.max_thrust_n / plant.mass_kg - gravity
    drag = plant.quadrotor.drag_1_s * (leader_speed + math.hypot(*file.world.wind_m_s))
    return min([upwards, *([sideways - drag] if gravity > 0 else [])])


def fastest_m_s(file: ScenarioFile, uav: UavBlock) -> float:
    """Largest speed [m/s] of a UAV."""
    own = uav.max_speed_m_s
    return float(file.gains.filter.max_speed_m_s if own is None else own)


def _left_of(file: ScenarioFile, uav: UavBlock, speed: float, acceleration: float) -> MotionLimits:
    actuators = _vehicle_acceleration(file, plant_of(file.plant, uav), speed)
    most = min(file.gains.filter.max_acceleration_m_s2, actuators)
    return MotionLimits(fastest_m_s(file, uav) - speed, most - acceleration)


def _left(file: ScenarioFile, speed: float, acceleration: float) -> MotionLimits:
    """The rest of the limits of the weakest vehicle: that of the speed and that of the acceleration may be two."""
    every = [_left_of(file, uav, speed, acceleration) for uav in file.uavs]
    return MotionLimits(
        min(one.speed_m_s for one in every), min(one.acceleration_m_s2 for one in every)
    )


def limits_left(file: ScenarioFile) -> MotionLimits:
    """Speed and acceleration that are left for the approach, of the weakest vehicles."""
    return _left(file, *_motion(file))


def limits_left_by_mission(file: ScenarioFile, first: float, last: float) -> MotionLimits:
    """Speed and acceleration that trajectory and shape leave between two times [s]."""
    return _left(file, *_places_motion(file, first, last))
