"""Pre-flight checks of what happens in flight: trajectory, legs, UAVs that come and go, faults."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np

from ptnsbc_core.behaviours.recovery import recovery_duration
from ptnsbc_core.curves.trajectory import curve_samples, reference
from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.approach.deadline import leg_room
from ptnsbc_sim.scenario.constants import leader_trajectory, recovery_config
from ptnsbc_sim.scenario.mavlink import Geofence
from ptnsbc_sim.scenario.mission.fault_rules import NEVER_NS, PROCESS, modelled
from ptnsbc_sim.scenario.mission.legs import FIRST, FormLeg, TakeOffLeg, Word, leg_names
from ptnsbc_sim.scenario.mission.route import places_beside_leader
from ptnsbc_sim.scenario.mission.stream import SetpointTrajectory
from ptnsbc_sim.scenario.mission.trajectories import extremes
from ptnsbc_sim.scenario.slots import Formations, Membership
from ptnsbc_tools.check.finding import ERROR, INFO, WARNING, Findings, judge
from ptnsbc_tools.check.geometry import moving_spacing


def legs(scenario: Scenario) -> Findings:
    """Each leg against the limits of the vehicle, and the last one against the length of the flight."""
    found = scenario.legs
    ends = [*(one.begin_s for one in found[1:]), scenario.timing.duration_s]
    for one, end_s in zip(found, ends, strict=False):
        if isinstance(one.leg, FormLeg) and one.number == FIRST:
            continue  # checks of the deadline are about it
        yield judge(*leg_room(scenario, one, end_s), severity=ERROR)
    late = [one for one in found if one.due_s > scenario.timing.duration_s]
    if late:
        leg = f"leg {late[0].name} is due at {late[0].due_s:.2f} s"
        value, limit = f"{scenario.timing.duration_s:g} s, {leg}", f">= {late[-1].due_s:.2f} s"
        yield judge("timing.duration_s", value, limit, "fly for longer, or begin the leg earlier")


def words(scenario: Scenario) -> Findings:
    """The legs that wait for a word, as they are flown when each word is said as soon as the last leg is done."""
    mission, first, said = scenario.mission, len(scenario.legs), scenario
    while mission is not None and said.legs[-1].number < len(mission.legs):
        last = said.legs[-1]  # the next word is said when it is done
        said = said.with_words((*said.words, Word(last.number + 1, last.end_s)))
    if mission is None or first == len(said.legs):
        return
    value = f"{leg_names(mission)[first]} waits for a word"
    limit = "without one neither it nor a leg after it is flown, headless as in a fleet"
    yield judge(f"mission.legs[{first}].on", value, limit)
    for one in (legs, moving_spacing, trajectory):
        known = set(one(scenario))
        for finding in one(said):
            # In flight a leg that does not fit is refused: it may be said later, from another place.
            if finding not in known and (one is legs or finding.severity != INFO):
                severity = INFO if finding.severity == INFO else WARNING
                yield replace(finding, severity=severity, value=f"said at once, {finding.value}")


_KEY = "leader.trajectory"
_LEAST_SPEED_M_S = 0.05  # below it a path has no heading to speak of
_JUMP_M_S = 0.01  # change of the velocity from one piece of a curve to the next that counts as none
_SAMPLES = 5000


def _extremes(scenario: Scenario) -> Findings:
    """Speed, acceleration, jerk and turn against what the vehicle follows."""
    path = scenario.leader.trajectory
    most, limits = extremes(path, scenario.timing.duration_s), scenario.gains.filter
    value = f"at most {most.speed_m_s:.3g} m/s, {most.acceleration_m_s2:.3g} m/s^2, {most.jerk_m_s3:.3g} m/s^3"
    limit, advice = "speed and acceleration below the limits of gains.filter", ""
    if scenario.plant.kind == "quadrotor":  # it has to tilt
        jerk_limit = scenario.world.gravity_m_s2 * limits.max_rate_rad_s
        limit = f"jerk <= {jerk_limit:.3g} m/s^3, gravity times gains.filter.max_rate_rad_s"
        if most.jerk_m_s3 > jerk_limit > 0.0:
            advice = "slow it down, or use through: minimum_snap"
    yield judge(_KEY, value, limit, advice)
    if most.jump_m_s > _JUMP_M_S:
        value = f"its velocity jumps by {most.jump_m_s:.3g} m/s"
        advice = "let the rows of the file begin and end at rest, or end the flight before them"
        yield judge(_KEY, value, f"<= {_JUMP_M_S:g} m/s", advice)
    if getattr(path, "heading", "fixed") == "path":
        still = most.slowest_m_s < _LEAST_SPEED_M_S
        slowest = f"horizontal speed down to {most.slowest_m_s:.3g} m/s"
        value = f"path: {slowest}, turns by up to {most.turn_rad_s:.3g} rad/s"
        limit = f">= {_LEAST_SPEED_M_S:g} m/s, <= {limits.max_rate_rad_s:g} rad/s"
        advice = ""
        if still:
            advice = "a path has no heading where it stands still: set heading: fixed, or yaws_rad"
        elif most.turn_rad_s > limits.max_rate_rad_s:
            advice = "widen its curves, or slow it down"
        yield judge(f"{_KEY}.heading", value, limit, advice, ERROR if still else WARNING)


def _outside(places: Array, fence: Geofence) -> Array:
    """The distance [m] of each of the places (T, 3) from the fence, at most 0 inside."""
    far = np.full(len(places), -np.inf)
    if fence.radius_m is not None:
        far = np.maximum(far, np.hypot(places[:, 0], places[:, 1]) - fence.radius_m)
    if fence.box_min_m is not None and fence.box_max_m is not None:
        beyond = np.maximum(fence.box_min_m - places, places - fence.box_max_m)
        far = np.maximum(far, beyond.max(axis=1))
    return far


def _region(scenario: Scenario) -> Findings:
    """Height above the ground, and the fence, of every place of the formation."""
    times = np.linspace(0.0, scenario.timing.duration_s, _SAMPLES)
    block = scenario.leader.trajectory
    if isinstance(block, SetpointTrajectory) and scenario.takes_setpoints:
        corners = itertools.product(*zip(block.low_m, block.high_m, strict=True))
        path = np.array(list(corners), dtype=np.float64)  # (8, 3) of the region
    else:
        path = curve_samples(leader_trajectory(scenario), times)[:, :3]
    times, legs = times[: len(path)], scenario.legs
    up_s = legs[0].due_s if legs and isinstance(legs[0].leg, TakeOffLeg) else 0.0
    places = {uav: path + places_beside_leader(scenario, uav, times) for uav in scenario.uav_ids}
    up = times >= up_s
    heights = {uav: float(at[up, 2].min(initial=np.inf)) for uav, at in places.items()}
    lowest = min(heights, key=lambda uav: heights[uav])
    value = f"the place of UAV {lowest} comes down to {heights[lowest]:.2f} m"
    advice = "raise the trajectory, or the formation" if heights[lowest] <= 0.0 else ""
    yield judge(_KEY, value, "> 0 m, the ground", advice, ERROR)
    fence = scenario.mavlink.geofence
    outside = {uav: float(_outside(at, fence).max()) for uav, at in places.items()}
    uav = max(outside, key=lambda one: outside[one])
    if outside[uav] > 0.0:
        value = f"the place of UAV {uav} goes {outside[uav]:.2f} m outside"
        limit = "every place of the formation inside"
        advice = "widen the fence, or move the trajectory"
        yield judge("mavlink.geofence", value, limit, advice, ERROR)


def trajectory(scenario: Scenario) -> Findings:
    """The leader's trajectory and the places of the others along it."""
    yield from _extremes(scenario)
    yield from _region(scenario)


def membership(scenario: Scenario) -> Findings:
    """The times of joining and leaving, who leads at which time, and what becomes of empty slots."""
    if not scenario.formation.reconfigures:
        return
    yield from _times(scenario)
    yield from _lead(scenario)
    if scenario.formation.vacancy == "close_up" and max(scenario.topology.depth.values()) < 2:
        value = "close_up, and no UAV of communication.tree is behind a follower"
        limit = "a tree with lines, along which UAVs move up"
        advice = "set keep, which does the same here, or let followers have parents among them"
        yield judge("formation.vacancy", value, limit, advice)


def _times(scenario: Scenario) -> Findings:
    """The times of the UAVs against the length of the flight, and against the way to the place at its limits."""
    end_s = scenario.timing.duration_s
    for index, uav in enumerate(scenario.uavs):
        for verb in ("joins", "leaves"):
            key, at_s = f"{verb}_s", getattr(uav, f"{verb}_s")
            if at_s is not None and at_s >= end_s:
                value = f"{at_s:g} s: UAV {uav.id} never {verb}"
                limit, advice = f"< timing.duration_s, {end_s:g} s", f"lower {key}, or fly longer"
                yield judge(f"uavs[{index}].{key}", value, limit, advice)
        joins_s = uav.joins_s
        if joins_s is None or joins_s >= end_s:
            continue
        leader = np.array(reference(leader_trajectory(scenario), joins_s).position)
        place = leader + places_beside_leader(scenario, uav.id, np.array([joins_s]))[0]
        away_m = float(np.linalg.norm(place - scenario.uav(uav.id).position))
        needed_s = joins_s + recovery_duration(away_m, recovery_config(scenario, uav.id))
        until_s = min(end_s, uav.leaves_s or math.inf)
        away = f"UAV {uav.id} is {away_m:.2f} m from its place then"
        value = f"{joins_s:g} s: {away}, and needs until {needed_s:.2f} s"
        limit = f"<= {until_s:g} s, when the flight ends or the UAV leaves"
        advice = "join earlier or nearer, or fly longer" if needed_s > until_s else ""
        yield judge(f"uavs[{index}].joins_s", value, limit, advice)


def _lead(scenario: Scenario) -> Findings:
    """The leaders, by the plan and by the faults that end processes; what is lost unforeseen is not known here."""
    line, stale_ns = scenario.leader.successors, nanoseconds(float(scenario.communication.stale_s))
    plan_ns = {uav.id: (uav.joins_ns, uav.leaves_ns) for uav in scenario.uavs}
    gone_ns = {uav: [(0, joins), (leaves, NEVER_NS)] for uav, (joins, leaves) in plan_ns.items()}
    for fault in modelled(scenario.faults):
        if fault.rule.strikes == PROCESS and fault.struck_uav is not None:
            since, until = fault.window_ns(0)
            gone_ns[fault.struck_uav].append((since + stale_ns, until))
    formations, leader = Formations(scenario), scenario.leader.id
    away: set[int] = set()
    changes_ns = {at_ns for spans in gone_ns.values() for span in spans for at_ns in span}
    for at_ns in sorted(at for at in changes_ns if seconds(at) < scenario.timing.duration_s):
        absent = {
            uav
            for uav, spans in gone_ns.items()
            if any(since <= at_ns < until for since, until in spans)
        }
        if leader in absent - away:
            yield from _idle_successors(scenario, seconds(at_ns), absent, away | absent)
        away |= absent
        if formations.of(Membership(frozenset(absent), frozenset(away - absent))) is None:
            planned = not any(plan_ns[uav][0] <= at_ns < plan_ns[uav][1] for uav in (leader, *line))
            at = f"from {seconds(at_ns):g} s on nobody leads: all hold"
            value, limit = f"[{', '.join(map(str, line))}]: {at}", "a successor that is there then"
            advice = "name one, or let the leader or a successor stay"
            yield judge("leader.successors", value, limit, advice, ERROR if planned else WARNING)
            return


def _idle_successors(scenario: Scenario, at_s: float, absent: set[int], away: set[int]) -> Findings:
    """The successors that cannot take over when the leader is away."""
    for index, uav in enumerate(scenario.leader.successors):
        if uav in away:
            why = "is away then" if uav in absent else "was away before"
            value = f"UAV {uav} {why}, when the lead is free at {at_s:g} s"
            limit = "a UAV that is there from the begin on until then"
            advice = "name another one, or let it stay"
            yield judge(f"leader.successors[{index}]", value, limit, advice)


def faults(scenario: Scenario) -> Findings:
    """Faults that begin after the flight, and those that not every flight injects."""
    end_s = scenario.timing.duration_s
    for index, fault in enumerate(scenario.faults):
        key = f"faults[{index}]"
        if fault.at_s >= end_s:
            limit = f"< timing.duration_s, {end_s:g} s"
            advice = "it never begins: lower at_s, or fly longer"
            yield judge(f"{key}.at_s", f"{fault.at_s:g} s", limit, advice)
        elif fault not in modelled(scenario.faults):
            yield judge(key, fault.text, "every flight injects it", "only in real time", INFO)
