"""The shortest deadline of the formation in closed form, and the one that `deadline_s: auto` takes.

The motion of the leader, that of a shape and the drag take their part of the limits of the weakest vehicle. The planned
approach E_0 (1 - h) asks for the largest speed and acceleration of h (`feasible_deadline`), a turned one for more
(`approach_peaks`). With the rest of the limits (`limits_left`) this is a bound: it takes the leader to move all the
time as fast as ever, against the way of each UAV. A deadline below the bound is possible where the planned path itself
keeps the limits (`ptnsbc_sim.scenario.approach.path`). The turn that a scenario leaves open is the first of those whose
bound fits into its deadline.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.curves.shape import place_samples
from ptnsbc_core.curves.trajectory import curve_samples, reference
from ptnsbc_core.timebase import feasible_deadline
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario.approach.path import (
    EpochPlaces,
    Pairs,
    approach_peaks,
    candidates,
    pairs_of,
    shortest_below,
)
from ptnsbc_sim.scenario.fields import kept
from ptnsbc_sim.scenario.gains import gain_of
from ptnsbc_sim.scenario.mission.legs import LandLeg, ScheduledLeg, moves_shape
from ptnsbc_sim.scenario.mission.route import places_beside_leader, shape_of
from ptnsbc_sim.scenario.mission.shapes import nearest_places
from ptnsbc_sim.scenario.mission.trajectories import (
    Circle,
    Line,
    Route,
    extremes,
    longest,
    trajectory_of,
)
from ptnsbc_sim.scenario.model import Plant, ScenarioFile, plant_of
from ptnsbc_sim.scenario.problems import Problem, ScenarioError

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
    speed, acceleration = longest(lead[:, 3:6]), longest(lead[:, 6:9])
    for uav in file.formation.offsets_m if file.formation.moves else ():
        place = place_samples(shape_of(file, uav), curve, times)
        speed = max(speed, longest(lead[:, 3:6] + place[:, 3:6]))
        acceleration = max(acceleration, longest(lead[:, 6:9] + place[:, 6:9]))
    return speed, acceleration


def _actuators(file: ScenarioFile, plant: Plant, leader_speed: float) -> float:
    """Acceleration [m/s^2] that the actuators allow in the weakest direction, beside gravity and drag."""
    gravity = file.world.gravity_m_s2
    if plant.kind != "quadrotor" or plant.quadrotor is None:
        return plant.rigid_body.max_force_n / plant.mass_kg - gravity
    sideways = gravity * math.tan(plant.quadrotor.max_tilt_rad)
    upwards = plant.quadrotor.max_thrust_n / plant.mass_kg - gravity
    drag = plant.quadrotor.drag_1_s * (leader_speed + math.hypot(*file.world.wind_m_s))
    return min(upwards, sideways - drag)


def _left(file: ScenarioFile, speed: float, acceleration: float) -> MotionLimits:
    """The rest of the limits of the weakest vehicle: that of the speed and that of the acceleration may be two."""
    most = file.gains.filter.max_acceleration_m_s2
    actuators = (_actuators(file, plant_of(file.plant, uav), speed) for uav in file.uavs)
    return MotionLimits(
        min(file.max_speed_m_s(uav) - speed for uav in file.uav_ids),
        min(min(most, actuator) - acceleration for actuator in actuators),
    )


def limits_left(file: ScenarioFile) -> MotionLimits:
    """Speed and acceleration that are left for the approach, of the weakest vehicles."""
    speed, acceleration = leader_motion(file)
    if file.formation.moves and file.formation.offsets_m:
        path, changes = file.leader.trajectory, file.formation.changes
        begins = [change.at_s for change in changes if change.at_s > 0.0]
        begins += [group.begin_s for group in path.apart] if isinstance(path, Route) else []
        first = min(begins, default=file.timing.duration_s)
        of_places = _places_motion(file, 0.0, first)
        speed, acceleration = max(speed, of_places[0]), max(acceleration, of_places[1])
    return _left(file, speed, acceleration)


def limits_left_by_mission(file: ScenarioFile, first: float, last: float) -> MotionLimits:
    """Speed and acceleration that trajectory and shape leave between two times [s]."""
    return _left(file, *_places_motion(file, first, last))


MARGIN = 1.5
"""`auto` is so many times the shortest deadline."""

_RESERVE = 1.2
"""A turn is taken where the deadline is so many times the shortest one with it."""

_STEP_S = 0.1  # `auto` is rounded up to it


class Need(NamedTuple):
    """The shortest deadline of one UAV."""

    uav: int
    deadline_s: float


def leg_room(file: ScenarioFile, one: ScheduledLeg, until_s: float) -> Problem:
    """The room of a leg other than a first one of kind form, until another one begins; no advice: it can be flown."""
    key = f"mission.legs[{one.number - 1}]"
    if isinstance(one.leg, LandLeg):
        curve, places = trajectory_of(file.leader.trajectory), _offsets_at(file, one.begin_s)
        lead = float(curve_samples(curve, np.array([one.begin_s]))[0, 2])
        height = lead + max(float(place[2]) for place in places.values()) - one.leg.ground_m
        speed = file.gains.hold.land_speed_m_s
        need = height / speed if speed > 0.0 else math.inf
        return Problem(
            key,
            f"{one.name}: {one.leg.over_s:g} s from {height:.2f} m above the ground",
            f">= {need:.2f} s at gains.hold.land_speed_m_s, {speed:g} m/s",
            "lengthen over_s, or land from a lower place" if need > one.leg.over_s else "",
        )
    left = limits_left_by_mission(file, one.begin_s, max(until_s, one.due_s))
    return Problem(
        key,
        f"{one.name} leaves {left.speed_m_s:.2f} m/s and {left.acceleration_m_s2:.2f} m/s^2 of the limits",
        "> 0",
        "lengthen over_s, or go less far" if min(left) <= 0.0 else "",
    )


def _offsets_at(file: ScenarioFile, t: float) -> dict[int, Array]:
    """Place (3,) [m] of every slot beside the leader's, so long after the first epoch."""
    return {uav: places_beside_leader(file, uav, np.array([t]))[0] for uav in file.uav_ids}


def starts_of(file: ScenarioFile) -> EpochPlaces:
    """The starts of the file; the slots are its own, or those that these starts are given.

    Without the UAVs that join later, by a deadline of their own.
    """
    ids = slots = file.uav_ids
    if file.formation.has_open_slots:
        places = np.stack(list(_offsets_at(file, 0.0).values()))
        starts = np.array([uav.position_m for uav in file.uavs])
        slots = tuple(ids[row] for row in nearest_places(starts, places, centred=True))
    there = {uav.id: slot for uav, slot in zip(file.uavs, slots, strict=True) if not uav.joins_s}
    return EpochPlaces({uav: file.uav(uav).position for uav in there}, there, 0.0)


def start_errors(file: ScenarioFile, starts: EpochPlaces | None = None) -> dict[int, float]:
    """Distance [m] of every UAV from its place, from the starts of the file or other ones."""
    starts = starts or starts_of(file)
    offsets, curve = _offsets_at(file, starts.begin_s), trajectory_of(file.leader.trajectory)
    first = np.array(reference(curve, starts.begin_s).position)
    return {
        uav: float(np.linalg.norm(first + offsets[starts.slots[uav]] - position))
        for uav, position in starts.positions_m.items()
    }


def _open_turns(file: ScenarioFile) -> tuple[float, ...]:
    """The turns [rad] that a scenario leaves open, the one to take first; the last one is that of straight paths."""
    formation = file.formation
    together = formation.vacancy == "wait" and not file.leader.successors
    fixed = formation.assignment == "fixed" and formation.approach == "planned"
    rests = not (formation.moves or moves_shape(file.mission) or file.world.obstacles)
    if not (together and fixed and rests and all(uav.joins_s is None for uav in file.uavs)):
        return (0.0,)
    return candidates(planned_pairs(file))


def planned_pairs(file: ScenarioFile) -> Pairs:
    """All pairs of UAVs with their own places, from the starts of the file, in the scale of their keep-outs."""
    starts = np.array([uav.position_m for uav in file.uavs])
    lead = file.uav_ids.index(file.leader.id)
    keep_outs = [file.keep_out_m(uav) for uav in file.uav_ids]
    places = np.concatenate([places_beside_leader(file, uav, np.zeros(1)) for uav in file.uav_ids])
    margin_m = float(file.gains.clearance.margin_m)
    scale = file.formation.keep_out_scale
    return pairs_of((starts - starts[lead]) * scale, places * scale, np.array(keep_outs), margin_m)


@kept
def turn_of(file: ScenarioFile) -> float:
    """The turn of the planned approach [rad]: that of the scenario, or the first open one that its deadline allows."""
    if file.formation.turn_rad is not None:
        return float(file.formation.turn_rad)
    turns, allowed = _open_turns(file), 0.0
    if len(turns) > 1 and min(limits := limits_left(file)) > 0.0:
        starts, deadline_s = starts_of(file), float(file.gains.formation.deadline_s)
        longest = ((turn, max(_bounds(file, starts, limits, turn).values())) for turn in turns)
        allowed = next((turn for turn, need in longest if _RESERVE * need <= deadline_s), 0.0)
    return allowed


def shortest_deadlines(file: ScenarioFile, limits: MotionLimits) -> dict[int, float]:
    """Shortest deadline [s] for each UAV, with what a mission leaves of the limits, both above 0."""
    starts, turn = starts_of(file), turn_of(file)
    bounds = _bounds(file, starts, limits, turn)
    return {uav: shortest_below(file, starts, uav, bound, turn) for uav, bound in bounds.items()}


def longest_need(file: ScenarioFile, limits: MotionLimits, turn: float | None = None) -> Need:
    """The UAV whose shortest deadline is the longest, the first by number; as `shortest_deadlines`, for less work."""
    turn, starts = turn_of(file) if turn is None else turn, starts_of(file)
    bounds, longest = _bounds(file, starts, limits, turn), Need(0, -math.inf)
    for uav in sorted(bounds, key=lambda one: (-bounds[one], one)):
        if bounds[uav] < longest.deadline_s:  # nor does any that follows need more than its bound
            break
        need = Need(uav, shortest_below(file, starts, uav, bounds[uav], turn))
        longest = max(longest, need, key=lambda one: (one.deadline_s, -one.uav))
    return longest


def shortest_from(file: ScenarioFile, starts: EpochPlaces, uav: int) -> float | None:
    """Shortest deadline [s] for a UAV from where it was at an epoch; None: the mission leaves nothing of the limits."""
    limits, turn = limits_left(file), turn_of(file)
    if min(limits) <= 0.0:
        return None
    bound = _bounds(file, starts, limits, turn)[uav]
    return shortest_below(file, starts, uav, bound, turn)


def _bounds(
    file: ScenarioFile, starts: EpochPlaces, limits: MotionLimits, turn: float
) -> dict[int, float]:
    """A deadline [s] for each UAV that its planned approach keeps beside the leader's motion, in closed form."""
    gain, peaks = gain_of(file.gains, file.gains.formation), approach_peaks(turn)
    settling = 1.0 / max(gain.scale * gain.kappa, 1e-9)
    bounds = {}
    for uav, error_m in start_errors(file, starts).items():
        need = feasible_deadline(error_m, limits.speed_m_s, limits.acceleration_m_s2)
        if file.formation.approach == "planned" and starts.slots[uav] != file.leader.id:
            if turn != 0.0:
                accelerating_s = math.sqrt(peaks.acceleration * error_m / limits.acceleration_m_s2)
                need = max(peaks.speed * error_m / limits.speed_m_s, accelerating_s)
            # It ends a little before the deadline: ptnsbc_core.timebase.plan_duration.
            need = min(need + settling, need / 0.8)
        bounds[uav] = need
    return bounds


def auto_deadline(file: ScenarioFile, source: str) -> float:
    """The deadline [s] that `auto` stands for: the shortest one of all UAVs times `MARGIN`.

    Raises:
        ScenarioError: the leader's motion leaves no speed or no acceleration.
    """
    limits = limits_left(file)
    if min(limits) <= 0.0:
        raise ScenarioError(
            f"{source}: gains.formation.deadline_s: auto: the leader's motion leaves {limits.speed_m_s:.2f} m/s and "
            f"{limits.acceleration_m_s2:.2f} m/s^2: expected both above 0, slow the leader down or raise the limits"
        )
    turn = file.formation.turn_rad
    turn = _open_turns(file)[0] if turn is None else turn
    shortest = longest_need(file, limits, turn).deadline_s
    # The inner loops have to be done before the formation is.
    inner = (file.gains.estimator, file.gains.force, file.gains.torque)
    least = 1.2 * max(loop.deadline_s for loop in inner)
    return round(math.ceil(max(MARGIN * shortest, least) / _STEP_S - 1e-9) * _STEP_S, 6)
