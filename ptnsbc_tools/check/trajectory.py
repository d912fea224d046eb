"""Pre-flight checks of the leader's trajectory along the whole of it: jerk, heading, joints, height, fence."""

from __future__ import annotations

import itertools

import numpy as np

from ptnsbc_core.curves.trajectory import reference_positions
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.build import leader_trajectory, places_beside_leader
from ptnsbc_sim.scenario.mavlink import Geofence
from ptnsbc_sim.scenario.mission.curves import extremes
from ptnsbc_sim.scenario.mission.legs import TakeOffLeg
from ptnsbc_sim.scenario.mission.stream import SetpointTrajectory
from ptnsbc_tools.check.finding import ERROR, INFO, WARNING, Finding, Findings

_KEY = "leader.trajectory"
_LEAST_SPEED_M_S = 0.05  # below it a path has no heading to speak of
_JUMP_M_S = 0.01  # change of the velocity from one piece of a curve to the next that counts as none
_SAMPLES = 5000


def _extremes(scenario: Scenario) -> Findings:
    """Speed, acceleration, jerk and turn against what the vehicle follows."""
    path = scenario.leader.trajectory
    most, limits = extremes(path, scenario.timing.duration_s), scenario.gains.filter
    jerk_limit = (
        scenario.world.gravity_m_s2 * limits.max_rate_rad_s
    )  # a quadrotor has to tilt for it
    tilts = scenario.plant.kind == "quadrotor"
    rough = tilts and most.jerk_m_s3 > jerk_limit > 0.0
    yield Finding(
        WARNING if rough else INFO,
        _KEY,
        f"at most {most.speed_m_s:.3g} m/s, {most.acceleration_m_s2:.3g} m/s^2, {most.jerk_m_s3:.3g} m/s^3",
        f"jerk <= {jerk_limit:.3g} m/s^3, gravity times gains.filter.max_rate_rad_s"
        if tilts
        else "speed and acceleration below the limits of gains.filter",
        "slow it down, or use through: minimum_snap" if rough else "",
    )
    if most.jump_m_s > _JUMP_M_S:
        yield Finding(
            WARNING,
            _KEY,
            f"its velocity jumps by {most.jump_m_s:.3g} m/s",
            f"<= {_JUMP_M_S:g} m/s",
            "let the rows of the file begin and end at rest, or end the flight before them",
        )
    if getattr(path, "heading", "fixed") == "path":
        still = most.slowest_m_s < _LEAST_SPEED_M_S
        fast = most.turn_rad_s > limits.max_rate_rad_s
        yield Finding(
            ERROR if still else WARNING if fast else INFO,
            f"{_KEY}.heading",
            f"path: horizontal speed down to {most.slowest_m_s:.3g} m/s, turns by up to {most.turn_rad_s:.3g} rad/s",
            f">= {_LEAST_SPEED_M_S:g} m/s, <= {limits.max_rate_rad_s:g} rad/s",
            "a path has no heading where it stands still: set heading: fixed, or yaws_rad"
            if still
            else "widen its curves, or slow it down"
            if fast
            else "",
        )


def _outside(places: Array, fence: Geofence) -> Array:
    """The distance [m] of each of the places (T, 3) from the fence, at most 0 inside."""
    far = np.full(len(places), -np.inf)
    if fence.radius_m is not None:
        far = np.maximum(far, np.hypot(places[:, 0], places[:, 1]) - fence.radius_m)
    if fence.box_min_m is not None and fence.box_max_m is not None:
        beyond = np.maximum(fence.box_min_m - places, places - fence.box_max_m)
        far = np.maximum(far, beyond.max(axis=1))
    return far


def _path(scenario: Scenario, times: Array) -> Array:
    """Positions (T, 3) of the leader [m]; the corners (8, 3) of the region if setpoints come from a topic."""
    path = scenario.leader.trajectory
    if isinstance(path, SetpointTrajectory) and scenario.takes_setpoints:
        corners = itertools.product(*zip(path.low_m, path.high_m, strict=True))
        return np.array(list(corners), dtype=np.float64)
    return reference_positions(leader_trajectory(scenario), times)


def _up_s(scenario: Scenario) -> float:
    """The time [s] from which every UAV is off the ground: the end of the take-off of a mission."""
    legs = scenario.legs
    return legs[0].due_s if legs and isinstance(legs[0].leg, TakeOffLeg) else 0.0


def _region(scenario: Scenario) -> Findings:
    """Height above the ground, and the fence, of every place of the formation."""
    times = np.linspace(0.0, scenario.timing.duration_s, _SAMPLES)
    path = _path(scenario, times)
    times = times[: len(path)]
    places = {uav: path + places_beside_leader(scenario, uav, times) for uav in scenario.uav_ids}
    up = times >= _up_s(scenario)
    heights = {uav: float(at[up, 2].min(initial=np.inf)) for uav, at in places.items()}
    lowest = min(heights, key=lambda uav: heights[uav])
    height = heights[lowest]
    yield Finding(
        ERROR if height <= 0.0 else INFO,
        _KEY,
        f"the place of UAV {lowest} comes down to {height:.2f} m",
        "> 0 m, the ground",
        "raise the trajectory, or the formation" if height <= 0.0 else "",
    )
    outside = {
        uav: float(_outside(at, scenario.mavlink.geofence).max()) for uav, at in places.items()
    }
    uav = max(outside, key=lambda one: outside[one])
    if outside[uav] > 0.0:
        yield Finding(
            ERROR,
            "mavlink.geofence",
            f"the place of UAV {uav} goes {outside[uav]:.2f} m outside",
            "every place of the formation inside",
            "widen the fence, or move the trajectory",
        )


def trajectory(scenario: Scenario) -> Findings:
    """The leader's trajectory and the places of the others along it."""
    yield from _extremes(scenario)
    yield from _region(scenario)
