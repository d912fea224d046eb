"""Pre-flight checks of the geometry: graph, shape, spacing, obstacles, range of the sensor and ways to the slots."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.curves.trajectory import curve_samples
from ptnsbc_core.tasks.formation_tasks import conditioning
from ptnsbc_core.tasks.table import TASKS
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.approach.deadline import (
    leader_motion,
    planned_pairs,
    start_errors,
    turn_of,
)
from ptnsbc_sim.scenario.approach.path import distances
from ptnsbc_sim.scenario.constants import (
    clearance_config,
    leader_trajectory,
    recovery_config,
    reference_offset,
    shape_problem,
    sight_speed,
)
from ptnsbc_sim.scenario.mission.route import places_beside_leader
from ptnsbc_sim.scenario.obstacles import Obstacle
from ptnsbc_sim.scenario.semantics import STABILITY_LIMIT, estimator_peak, estimator_step
from ptnsbc_sim.scenario.slots import with_slots_of_starts
from ptnsbc_sim.verdict.deadline import MOST_EXCUSED
from ptnsbc_sim.verdict.encounters import recovery_s
from ptnsbc_sim.verdict.error_figures import SHARE_OF_START
from ptnsbc_tools.check.finding import ERROR, INFO, WARNING, Findings, judge

_SINGULAR = 0.02  # smallest singular value [1] of a scaled task with which a formation can be held
_PATH_STEP_S = 0.05
_MOST_STEPS = 400_000  # of a path: 20 000 s
_SAMPLES = 5000  # of a flight
_AWAY_M = (0.5, 1.0, 2.0)


def graph(scenario: Scenario) -> Findings:
    """The tree, and the gain that the graph of the leader estimator needs."""
    topology = scenario.topology
    depth = max(topology.depth.values())
    value = f"spanning tree, {len(scenario.uav_ids)} UAVs, depth {depth}"
    yield judge("communication.tree", value, "rooted at the leader")
    if not scenario.followers:
        return
    peak = estimator_peak(scenario) / topology.lambda_min
    step = estimator_step(scenario, topology)
    value = f"lambda_min(H) {topology.lambda_min:.3g}, peak gain {peak:.3g} 1/s, step {step:.2f}"
    advice = "more leader_links raise lambda_min and lower the gain"
    severity = WARNING if step > 0.75 * STABILITY_LIMIT else INFO
    yield judge("gains.estimator", value, f"step < {STABILITY_LIMIT:g}", advice, severity)


def shape(scenario: Scenario) -> Findings:
    """Conditioning of every follower's task at the desired formation.

    A singular one is refused where the task alone closes the errors. The planned approach never hands over to it.
    """
    if scenario.plugins.task is not None:  # loading the scenario has refused a singular one
        return
    task = scenario.formation.task
    others = " or ".join(other for other in TASKS if other != task)
    threshold = scenario.gains.damping.threshold
    planned = scenario.formation.approach == "planned"
    for uav in scenario.followers:
        parent = scenario.communication.parent(uav)
        assert parent is not None  # or the scenario would not have loaded
        if problem := shape_problem(scenario, uav):
            yield judge(*problem, severity=ERROR)
            continue
        sigma = conditioning(
            TASKS[task],
            scenario.offset(uav),
            scenario.offset(parent),
            reference_offset(scenario, uav),
            agent_config(scenario, uav).row_scale,
        )
        singular = not sigma >= (0.0 if planned else _SINGULAR)  # also when it is NaN
        otherwise = f", or relative positions hold UAV {uav}" if planned else " or it is damped"
        value = f"sigma_min of task {task} {sigma:.3f}"
        limit = f">= {_SINGULAR:g}" if singular else f">= {threshold:g}{otherwise}"
        advice = (
            f"move UAV {uav} off the singular shape (for distance_angles a right angle at the "
            f"reference), or use formation.task: {others}"
        )
        advice = advice if singular or sigma < threshold else ""
        severity = ERROR if singular else WARNING
        yield judge(f"formation.offsets_m.{uav}", value, limit, advice, severity)


def spacing(scenario: Scenario) -> Findings:
    """Desired positions and starts against the keep-out distance between UAVs."""
    margin = scenario.gains.clearance.margin_m
    counted = "" if scenario.formation.keep_out_height == 1.0 else ", as if side by side"
    positions = {
        "formation.offsets_m": {uav: scenario.offset(uav) for uav in scenario.uav_ids},
        "uavs position_m": {uav: scenario.uav(uav).position for uav in scenario.uav_ids},
    }
    for key, where in positions.items():
        pairs = []
        for a, b in combinations(scenario.uav_ids, 2):
            distance = float(
                np.linalg.norm((where[a] - where[b]) * scenario.formation.keep_out_scale)
            )
            pairs.append((a, b, distance, scenario.keep_out_between(a, b) + margin))
        near = [pair for pair in pairs if pair[2] < pair[3]]
        closest = sorted(pairs, key=lambda pair: pair[2] - pair[3])[:1]
        advice = "move them apart, or lower formation.uav_keep_out_m" if near else ""
        for a, b, distance, least in near or closest:
            value = f"UAV {a} and UAV {b} {distance:.2f} m apart{counted}"
            yield judge(key, value, f">= {least:g} m", advice, ERROR)
    tolerance_m, keep_out_m = scenario.formation.tolerance_m, scenario.widest_keep_out_m
    if tolerance_m >= keep_out_m:
        limit = f"< {keep_out_m:g} m, formation.uav_keep_out_m"
        advice = "a UAV that far from its place is counted as in it: lower it"
        yield judge("formation.tolerance_m", f"{tolerance_m:g} m", limit, advice)


def moving_spacing(scenario: Scenario) -> Findings:
    """Desired positions of a shape that moves, against the keep-out distance, along the whole flight."""
    if not scenario.formation.moves or len(scenario.uav_ids) < 2:
        return
    key = "formation.changes" if scenario.mission is None else "mission.legs"
    margin = scenario.gains.clearance.margin_m
    scenario = with_slots_of_starts(scenario)
    times = np.linspace(0.0, scenario.timing.duration_s, _SAMPLES)
    places = {uav: places_beside_leader(scenario, uav, times) for uav in scenario.uav_ids}
    gaps = {
        (a, b): np.linalg.norm((places[a] - places[b]) * scenario.formation.keep_out_scale, axis=1)
        for a, b in combinations(scenario.uav_ids, 2)
    }
    a, b = min(gaps, key=lambda pair: float(gaps[pair].min()) - scenario.keep_out_between(*pair))
    keep_out = scenario.keep_out_between(a, b) + margin
    first = int(np.argmin(gaps[a, b]))
    least = float(gaps[a, b][first])
    key = key if scenario.formation.changes else "formation.frame"
    value = f"the places of UAV {a} and UAV {b} come as close as {least:.2f} m at t = {times[first]:.1f} s"
    advice = "widen the shapes, or go through another one" if least < keep_out else ""
    yield judge(key, value, f">= {keep_out:g} m", advice, ERROR)


def starts_clear(scenario: Scenario) -> Findings:
    """Starts against the keep-out distances of obstacles."""
    for index, uav in enumerate(scenario.uav_ids):
        for obstacle in scenario.world.bodies:
            start = scenario.uav(uav).position[None]
            distance = float(obstacle.distances(start, np.zeros(1))[0])
            if distance < obstacle.keep_out_m:
                value = f"UAV {uav} starts {distance:.2f} m from {obstacle.name}"
                limit = f">= {obstacle.keep_out_m:g} m"
                advice = "start it outside, or lower the obstacle's keep_out_m"
                yield judge(f"uavs[{index}].position_m", value, limit, advice, ERROR)


class Meeting(NamedTuple):
    """The path of a UAV in the formation inside the keep-out of an obstacle, after the deadline."""

    obstacle: Obstacle
    uav: int
    first_s: float
    closest_m: float
    speed_m_s: float  # the largest along the path
    seen_s: float  # most from the sensor's range to where it is closest; inf: it is near at the deadline
    inside: NDArray[np.bool_]  # (T,) where the place is inside by more than its band


def meetings(scenario: Scenario) -> Iterator[Meeting]:
    """The obstacles on the path of the formation after the deadline."""
    scenario = with_slots_of_starts(scenario)
    times = np.arange(
        scenario.gains.formation.deadline_s, scenario.timing.duration_s, _path_step_s(scenario)
    )
    if times.size < 2 or not scenario.world.bodies:
        return
    path = curve_samples(leader_trajectory(scenario), times)[:, :3]
    starts_m = start_errors(scenario)
    for obstacle in scenario.world.bodies:
        for uav in scenario.uav_ids:
            band_m = max(scenario.formation.tolerance_m, SHARE_OF_START * starts_m.get(uav, 0.0))
            way = path + places_beside_leader(scenario, uav, times)
            distance = obstacle.distances(way, times)
            inside = distance < obstacle.keep_out_m
            if inside.any():
                first_s, closest_m = float(times[np.argmax(inside)]), float(distance.min())
                speeds = np.linalg.norm(np.gradient(way, times, axis=0), axis=1)
                seen = int(np.argmax(distance <= scenario.sensor.range_m))
                at_most = int(np.argmin(distance)) - seen + 2  # steps, between samples at both ends
                seen_s = at_most * float(times[1] - times[0]) if seen else math.inf
                deep = distance < obstacle.keep_out_m - band_m
                speed = float(speeds.max())
                yield Meeting(obstacle, uav, first_s, closest_m, speed, seen_s, deep)


def _path_step_s(scenario: Scenario) -> float:
    flown_s = scenario.timing.duration_s - scenario.gains.formation.deadline_s
    return max(_PATH_STEP_S, flown_s / _MOST_STEPS)


def encounters(scenario: Scenario) -> Findings:
    """Obstacles on the path of the formation after the deadline."""
    step_s = _path_step_s(scenario)
    if step_s > _PATH_STEP_S and scenario.world.bodies:
        value = f"{scenario.timing.duration_s:g} s: obstacles are looked for every {step_s:.2g} s of the path"
        longest_s = scenario.gains.formation.deadline_s + _MOST_STEPS * _PATH_STEP_S
        limit = f"<= {longest_s:g} s, to look every {_PATH_STEP_S:g} s"
        yield judge("timing.duration_s", value, limit, "check a shorter flight on the same path")
    off = scenario.formation.avoidance == "off"
    met = tuple(meetings(scenario))
    for meeting in met:
        obstacle, uav = meeting.obstacle, meeting.uav
        if not off:
            yield from _seen(scenario, meeting)
            yield from _sight(scenario, meeting)
        value = (
            f"meets UAV {uav} from t = {meeting.first_s:.1f} s, closest {meeting.closest_m:.2f} m"
        )
        limit = f">= {obstacle.keep_out_m:g} m"
        advice = "set formation.avoidance: set_based" if off else "avoided in flight"
        severity = WARNING if off else INFO
        yield judge(f"world.obstacles {obstacle.name}", value, limit, advice, severity)
    yield from _blocked(scenario, met)


def _blocked(scenario: Scenario, met: Iterable[Meeting]) -> Findings:
    """The places that are inside keep-outs after the deadline for longer than the verdict excuses."""
    inside: dict[int, NDArray[np.bool_]] = {}
    for meeting in met if scenario.mission is None else ():
        inside[meeting.uav] = meeting.inside | inside.get(meeting.uav, meeting.inside)
    after_s = scenario.timing.duration_s - scenario.gains.formation.deadline_s
    for uav, at in inside.items():
        if at.mean() > MOST_EXCUSED:
            value = f"the place of UAV {uav} is inside for {at.mean() * after_s:.2f} s after the deadline"
            limit = f"<= {MOST_EXCUSED * after_s:.2f} s, the most that avoidance excuses"
            yield judge("world.obstacles", value, limit, "move it out of the way", ERROR)


def _seen(scenario: Scenario, meeting: Meeting) -> Findings:
    """The time for which a UAV sees an obstacle, against what leaving the keep-out takes with all of its acceleration.

    Below it no law keeps the UAV out.
    """
    name, uav, keep_out_m = meeting.obstacle.name, meeting.uav, meeting.obstacle.keep_out_m
    most = scenario.gains.filter.max_acceleration_m_s2
    needed_s = 1.0 / scenario.sensor.rate_hz + 1.0 / scenario.timing.control_hz
    needed_s += math.sqrt(2.0 * (keep_out_m - meeting.closest_m) / most)
    if meeting.seen_s < needed_s:
        value = f"UAV {uav} sees {name} {meeting.seen_s:.2f} s before it is closest"
        limit = f">= {needed_s:.2f} s, in which {most:g} m/s^2 lead out of its keep-out"
        advice = "slow the leader down, or raise sensor.range_m"
        yield judge("sensor.range_m", value, limit, advice, ERROR)


def _sight(scenario: Scenario, meeting: Meeting) -> Findings:
    """The speed of a UAV towards an obstacle, against what it can stop from within the range of the sensor."""
    name, uav, speed = meeting.obstacle.name, meeting.uav, meeting.speed_m_s
    config, keep_out_m = agent_config(scenario, uav).clearance, meeting.obstacle.keep_out_m
    late, braking = config.lag_s + config.sensor_s, config.deceleration
    room = max(config.range_m - keep_out_m - config.margin_m, 0.0)
    most = sight_speed(config, keep_out_m)
    if speed > most:
        needed = keep_out_m + config.margin_m + speed * late + speed * speed / (2.0 * braking)
        flies = f"UAV {uav} flies towards {name} at up to {speed:.2f} m/s"
        value = f"{flies}, and sees it {room:.2f} m before its keep-out"
        limit = f"<= {most:.2f} m/s, from which it can stop there"
        advice = f"slow the leader down, or raise sensor.range_m to {needed:.2f} m"
        yield judge("sensor.range_m", value, limit, advice)


def recovery(scenario: Scenario) -> Findings:
    """The time after an encounter within which a place is regained."""
    formation = scenario.formation
    if formation.avoidance == "off" or formation.approach != "planned":
        return
    times = ", ".join(f"{recovery_s(scenario, away):.2f} s" for away in _AWAY_M)
    ways = ", ".join(f"{away:g}" for away in _AWAY_M)
    key, value = (
        "formation.recovery_s",
        f"after an encounter that left it {ways} m off a UAV is back in {times}",
    )
    limit = f">= {formation.recovery_s:g} s, and what speed and acceleration need"
    yield judge(key, value, limit)
    leader, _ = leader_motion(scenario)
    if leader <= 0.0:
        return
    for uav in scenario.uav_ids:
        back = recovery_config(scenario, uav)
        config = clearance_config(scenario, uav)
        most = sight_speed(config, _largest_keep_out_m(scenario), back.acceleration)
        if leader + back.speed > most:
            comes = f"UAV {uav} comes back at up to {back.speed:.2f} m/s"
            value = f"beside a leader at {leader:.2f} m/s {comes}"
            limit = (
                f"<= {most:.2f} m/s together, from which it can stop before what stands in its way"
            )
            yield judge(key, value, limit, "slow the leader down, or raise sensor.range_m", INFO)
            return


def _largest_keep_out_m(scenario: Scenario) -> float:
    """The largest keep-out of anything that a UAV may meet."""
    return max([scenario.highest_keep_out_m, *(body.keep_out_m for body in scenario.world.bodies)])


def sensor(scenario: Scenario) -> Findings:
    """Range of the near-object sensor against the largest keep-out distance."""
    reach, range_m = _largest_keep_out_m(scenario), scenario.sensor.range_m
    if range_m <= reach:
        limit = f"> {reach:g} m, the largest keep-out"
        advice = "raise sensor.range_m, or nothing is seen before it is too close"
        yield judge("sensor.range_m", f"{range_m:g} m", limit, advice, ERROR)


def least_distance(first: Array, last: Array) -> float:
    """Least length [m] of a vector (3,) that goes straight from `first` to `last`."""
    way = last - first
    length = float(way @ way)
    share = min(max(-float(first @ way) / length, 0.0), 1.0) if length > 0.0 else 0.0
    return float(np.linalg.norm(first + share * way))


def slots(scenario: Scenario) -> Findings:
    """Distances on the way to open slots, and what they rest on (docs/notes/slots.md)."""
    if not scenario.formation.has_open_slots or len(scenario.uav_ids) < 2:
        return
    held = with_slots_of_starts(scenario)
    pairs = list(combinations(scenario.uav_ids, 2))
    start = {uav: scenario.uav(uav).position for uav in scenario.uav_ids}
    first = [start[a] - start[b] for a, b in pairs]
    last = [held.offset(a) - held.offset(b) for a, b in pairs]
    ends = [min(float(np.linalg.norm(apart)) for apart in end) for end in (first, last)]
    keep_out_m = scenario.widest_keep_out_m
    needed = math.sqrt(2.0) * scenario.highest_keep_out_m
    key, wider = "formation.assignment", "start farther apart, or widen the formation"
    value = f"starts {ends[0]:.2f} m apart or more, slots {ends[1]:.2f} m"
    limit = f">= {needed:.2f} m, which keeps all paths {keep_out_m:g} m apart"
    yield judge(key, value, limit, "" if min(ends) >= needed else wider)
    scale = scenario.formation.keep_out_scale
    gaps = [least_distance(one * scale, two * scale) for one, two in zip(first, last, strict=True)]
    least, (a, b) = min(zip(gaps, pairs, strict=True))
    value = f"UAV {a} and UAV {b} come as close as {least:.2f} m on their ways"
    yield judge(key, value, f">= {keep_out_m:g} m", wider if least < keep_out_m else "")
    if scenario.formation.approach == "task":
        advice = "the paths of a task are not straight and keep no distance"
        yield judge("formation.approach", "task", "planned, where slots are open", advice)


def turn(scenario: Scenario) -> Findings:
    """The turn of the planned approach, and the distance that it keeps (docs/notes/slots.md, "The turn")."""
    angle = turn_of(scenario)
    if angle == 0.0:
        return
    pairs = planned_pairs(scenario)
    straight, turned = (float(distances(pairs, one).min()) for one in (0.0, angle))
    keep_out_m = scenario.widest_keep_out_m
    value = f"{angle:.2f}: planned paths come as close as {turned:.2f} m, straight ones {straight:.2f} m"
    advice = "leave formation.turn_rad out" if turned < keep_out_m else ""
    yield judge("formation.turn_rad", value, f">= {keep_out_m:g} m", advice)
