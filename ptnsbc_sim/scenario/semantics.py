"""Checks of a scenario that concern more than one key, and the communication graph of one without problems."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise

from ptnsbc_core.errors import GainError, TopologyError
from ptnsbc_core.nanoseconds import SECOND_NS
from ptnsbc_core.timebase import peak_gain
from ptnsbc_core.topology import Topology, validated_topology
from ptnsbc_io.wire import LARGEST_POSITION_M, MOST_NEAR_OBJECTS
from ptnsbc_sim.scenario.fields import AUTO, number_in
from ptnsbc_sim.scenario.gains import Gains, Loop
from ptnsbc_sim.scenario.mission.fault_rules import fault_problems
from ptnsbc_sim.scenario.mission.legs import (
    ChangeLeg,
    FormLeg,
    JoinLeg,
    LandLeg,
    LegBlock,
    SplitLeg,
    TakeOffLeg,
    begin_of,
    leg_names,
    schedule,
    utc_time,
)
from ptnsbc_sim.scenario.mission.shapes import Reshaping
from ptnsbc_sim.scenario.mission.trajectories import first_place, trajectory_problems
from ptnsbc_sim.scenario.model import ScenarioFile, plant_of
from ptnsbc_sim.scenario.obstacles import bodies, obstacle_problems
from ptnsbc_sim.scenario.problems import Problem, Problems, ScenarioError, one_of, unless
from ptnsbc_sim.scenario.requirements import requirement_problems

STABILITY_LIMIT = 2.0
"""An explicit Euler step of a linear decay with rate g is stable for dt g below this."""

_WEIGHTS_SUM = 1e-6
_LATE_S = 1e-9  # by which the end of a leg may miss the begin of the next one


def _repeated(keys: Iterable[Hashable]) -> Iterator[tuple[int, int]]:
    """The index of each key that stands before too, and the first index of it."""
    first: dict[Hashable, int] = {}
    for index, key in enumerate(keys):
        if first.setdefault(key, index) != index:
            yield index, first[key]


def _members(file: ScenarioFile) -> Problems:
    ids, links = file.uav_ids, file.communication
    known = one_of(ids)
    for index, first in _repeated(ids):
        value = f"{ids[index]}: duplicate of uavs[{first}].id"
        yield Problem(f"uavs[{index}].id", value, "every UAV to have its own id")
    leader = file.leader.id
    yield from unless(leader in ids, "leader.id", f"{leader}: no such UAV", known)
    named = [(f"tree.{edge[0]}", uav) for edge in links.tree.items() for uav in edge]
    named += [(f"leader_links[{index}]", uav) for index, uav in enumerate(links.leader_links)]
    for index, edge in enumerate(links.estimator_edges):
        named += [(f"estimator_edges[{index}][{end}]", uav) for end, uav in enumerate(edge)]
    for key, uav in named:
        yield from unless(uav in ids, f"communication.{key}", f"{uav}: no such UAV", known)


def _links(file: ScenarioFile) -> Problems:
    block = file.communication
    ends = [(link.sender, link.receiver) for link in block.links]
    for index, (sender, receiver) in enumerate(ends):
        edge = (
            sender in (block.tree.get(receiver), *(block.parents or {}).get(receiver, ()))
            or (sender == file.leader.id and receiver in block.leader_links)
            or {(sender, receiver), (receiver, sender)}.intersection(block.estimator_edges)
        )
        value = f"no messages from UAV {sender} to UAV {receiver}"
        expected = "an edge of communication.tree, parents, leader_links or estimator_edges"
        yield from unless(edge, f"communication.links[{index}]", value, expected)
    for index, first in _repeated(ends):
        value = f"duplicate of communication.links[{first}]"
        yield Problem(f"communication.links[{index}]", value, "each link once")
    delays = {f"links[{k}].delay_s": link.delay_s for k, link in enumerate(block.links)}
    less = f"less than communication.stale_s ({block.stale_s:g}), or the receiver holds for ever"
    for key, delay_s in {"delay_s": block.delay_s, **delays}.items():
        in_time = delay_s is None or delay_s < block.stale_s
        yield from unless(in_time, f"communication.{key}", delay_s, less)


def _parents(file: ScenarioFile) -> Problems:
    tree, parents = file.communication.tree, file.communication.parents or {}
    ids = (file.leader.id, *tree)
    for child, weights in parents.items():
        where, above = f"communication.parents.{child}", tree.get(child)
        known = "a follower" if above is None else f"{above}, its parent in the tree, among them"
        yield from unless(above in weights, where, list(weights), known)
        for parent in weights:
            key, value = f"{where}.{parent}", f"{parent}: no such UAV"
            yield from unless(parent in ids, key, value, one_of(ids))
        total = math.fsum(weights.values())
        yield from unless(abs(total - 1.0) <= _WEIGHTS_SUM, where, f"weights sum to {total:g}", "1")
    if parents:
        edges = {child: {above} for child, above in tree.items()}
        try:
            TopologicalSorter({**edges, **parents}).prepare()
        except CycleError as error:
            cycle = " -> ".join(map(str, reversed(error.args[1])))
            expected = "parents on the leader's side"
            yield Problem("communication.parents", f"cycle {cycle}", expected)


def estimator_peak(file: ScenarioFile) -> float:
    """Largest gain [1/s] of the estimator's time base, 0 without one."""
    gains = file.gains.estimator
    return peak_gain(gains.deadline_s, gains.residual) if gains.time_base else 0.0


def estimator_step(file: ScenarioFile, topology: Topology) -> float:
    """Step times fastest rate of the estimator, stable below STABILITY_LIMIT.

    dt (peak gain / lambda_min + k1 + k2 / boundary) lambda_max, see docs/method.md.
    """
    gains = file.gains.estimator
    peak = estimator_peak(file) / topology.lambda_min
    rate = peak + gains.k1_1_s + gains.k2 / gains.boundary
    return float(rate * topology.lambda_max / file.timing.control_hz)


_CONNECT = re.compile(r"(udpin|udpout|tcp):[^:\s]+:\d{1,5}|serial:[^:\s]+(:\d+)?")


def _is_port(connect: str) -> bool:
    return connect.startswith("serial") or 0 < int(connect.rpartition(":")[2]) < 65536


def _timing(file: ScenarioFile) -> Problems:
    timing, fixes, hz = file.timing, file.sensor.positioning, file.timing.control_hz
    whole = "a rate whose period is a whole number of nanoseconds, such as 50, 100, 200, 250"
    yield from unless(SECOND_NS % hz == 0, "timing.control_hz", hz, whole)
    yield from unless(hz % 5 == 0, "timing.control_hz", hz, "a multiple of 5 (/diagnostics)")
    multiple = f"a multiple of timing.control_hz ({hz})"
    yield from unless(timing.physics_hz % hz == 0, "timing.physics_hz", timing.physics_hz, multiple)
    rates = {"": file.sensor.rate_hz} | ({"positioning.": fixes.rate_hz} if fixes else {})
    divisor = f"a divisor of timing.control_hz ({hz})"
    for block, rate_hz in rates.items():
        yield from unless(hz % rate_hz == 0, f"sensor.{block}rate_hz", rate_hz, divisor)
    if fixes:
        for key in ("latency_s", "unknown_latency_s"):
            late = getattr(fixes, key)
            on_tick = abs(late * hz - round(late * hz)) <= 1e-9
            period = f"a multiple of the control period, {1 / hz:g} s"
            yield from unless(on_tick, f"sensor.positioning.{key}", late, period)
        most, unknown = fixes.latency_s, fixes.unknown_latency_s
        key, expected = "unknown_latency_s", f"at most latency_s ({most:g}), which it is a part of"
        yield from unless(unknown <= most, f"sensor.positioning.{key}", unknown, expected)
    duration_s = timing.duration_s
    period = "at least one control period"
    yield from unless(duration_s * hz >= 1, "timing.duration_s", duration_s, period)


def _deadlines(file: ScenarioFile) -> Problems:
    for key in Gains.model_fields:
        loop = getattr(file.gains, key)
        known = not isinstance(loop, Loop) or math.isfinite(loop.deadline_s)
        yield from unless(known, f"gains.{key}.deadline_s", f'"{AUTO}"', number_in("s"))


def _obstacles(file: ScenarioFile) -> Problems:
    obstacles, key = file.world.obstacles, "world.obstacles"
    for index, first in _repeated(obstacle.name for obstacle in obstacles):
        value = f'"{obstacles[index].name}": duplicate of {key}[{first}].name'
        yield Problem(f"{key}[{index}].name", value, "every obstacle to have its own name")
    for index, obstacle in enumerate(obstacles):
        for problem in obstacle_problems(obstacle):
            yield problem.below(f"{key}[{index}]")
            return
    names = {obstacle.name: index for index, obstacle in enumerate(obstacles)}
    seen = len(file.uavs)
    for index, obstacle in enumerate(obstacles):
        for body in bodies(obstacle):
            seen += 1
            if names.setdefault(body.name, index) != index:
                value = f'"{body.name}": a box of {key}[{index}] has it'
                where = f"{key}[{names[body.name]}].name"
                yield Problem(where, value, "every obstacle to have its own name")
    value = f"{seen} bodies with the UAVs and the boxes of maps"
    most = f"at most {MOST_NEAR_OBJECTS}, of which a near-object sensor tells"
    yield from unless(seen <= MOST_NEAR_OBJECTS, key, value, most)


def _formation(file: ScenarioFile) -> Problems:
    formation, key = file.formation, "formation.offsets_m"
    known = one_of(file.followers, "followers")
    for uav in formation.offsets_m:
        if uav == file.leader.id:
            yield Problem(f"{key}.{uav}", "the leader has no offset from itself", "none")
        yield from unless(uav in file.followers, f"{key}.{uav}", "no such UAV", known)
    for uav in file.followers:
        given = uav in formation.offsets_m
        yield from unless(given, f"{key}.{uav}", "missing", "its offset from the leader")
    keep_outs = (uav.keep_out_m for uav in file.uavs if uav.keep_out_m)
    least = min([formation.uav_keep_out_m, *keep_outs])
    half = f"at most half of the smallest keep-out of a UAV ({least:g} m), or one UAV may be taken for another"
    sight_m = formation.sight_m
    yield from unless(sight_m <= 0.5 * least, "formation.sight_m", sight_m, half)
    above_m, beside_m = formation.uav_keep_out_above_m, formation.uav_keep_out_m
    higher = above_m is None or above_m >= beside_m
    wide = f"at least formation.uav_keep_out_m ({beside_m:g} m)"
    yield from unless(higher, "formation.uav_keep_out_above_m", above_m, wide)
    for problem in trajectory_problems(file.leader.trajectory):
        yield problem.below("leader.trajectory")
    places = {f"uavs[{k}].position_m": uav.position_m for k, uav in enumerate(file.uavs)}
    near = f"a place less than {LARGEST_POSITION_M:g} m from the origin: move it, or give lat, lon and alt"
    for key, place in {"leader.trajectory": first_place(file.leader.trajectory), **places}.items():
        yield from unless(math.hypot(*place) < LARGEST_POSITION_M, key, list(place), near)


def _changes(file: ScenarioFile) -> Problems:
    end_s = 0.0
    for index, change in enumerate(file.formation.changes):
        where, at_s = f"formation.changes[{index}]", change.at_s
        expected = f"at least {end_s:g}, the end of the change before"
        yield from unless(at_s >= end_s, f"{where}.at_s", at_s, expected)
        end_s = change.at_s + change.over_s
        yield from _places(change, file.followers, where)


def _places(change: Reshaping, followers: tuple[int, ...], where: str) -> Problems:
    for uav in sorted(set(followers).symmetric_difference(change.offsets_m or followers)):
        expected = f"an offset of each follower {list(followers)}, and of no other UAV"
        yield Problem(f"{where}.offsets_m.{uav}", "", expected)


def _leg_times(file: ScenarioFile) -> Problems:
    mission = file.mission
    if mission is None:
        return
    names, start = leg_names(mission), mission.start
    for index, leg in enumerate(mission.legs):
        where, name = f"mission.legs[{index}]", names[index]
        unique = name not in names[:index]
        yield from unless(unique, f"{where}.name", name, "a name that no other leg has")
        if leg.at is None:
            continue
        yield from unless(leg.at_s is None, f"{where}.at", "", "either at or at_s")
        begins = "mission.start, from which the flight counts"
        yield from unless(start, f"{where}.at", "", begins)
        follows = start is not None and utc_time(leg.at).follows(utc_time(start))
        often = f"a time that recurs as mission.start, {start}, does, or more often; a date where that is one"
        yield from unless(follows, f"{where}.at", leg.at, often)
    for before, one in pairwise(schedule(mission, file.gains.formation.deadline_s)):
        at_s = begin_of(mission, one.leg)
        in_turn = at_s is None or at_s >= before.end_s - _LATE_S
        key = f"mission.legs[{one.number - 1}].{'at_s' if one.leg.at is None else 'at'}"
        expected = f"at least {before.end_s:g} s, when the leg before is done"
        yield from unless(in_turn, key, f"{at_s or 0.0:g} s", expected)


def _legs(file: ScenarioFile) -> Problems:
    legs = file.mission.legs if file.mission else ()
    for index, leg in enumerate(legs):
        where, expected = f"mission.legs[{index}]", _order(legs, index)
        yield from unless(not expected, f"{where}.kind", leg.kind, expected)
        timed = leg.at_s or leg.at is not None or leg.on is not None
        first = "no at_s, at or on: the first leg begins with the first epoch"
        yield from unless(index or not timed, where, "", first)
        path = getattr(leg, "trajectory", None)
        for problem in () if path is None else trajectory_problems(path):
            yield problem.below(f"{where}.trajectory")
        if isinstance(leg, SplitLeg):
            known = one_of(file.followers, "followers")
            yield from unless(leg.head in file.followers, f"{where}.head", leg.head, known)
        if isinstance(leg, ChangeLeg):
            yield from _places(leg, file.followers, where)


def _order(legs: Sequence[LegBlock], index: int) -> str:
    """What is expected where a leg may not stand; empty where it may. Groups part also by legs that wait for a word."""
    leg, first = legs[index], legs[0]
    apart = [other for other in legs[:index] if isinstance(other, SplitLeg | JoinLeg)][-1:]
    if index == 0 and not isinstance(leg, FormLeg | TakeOffLeg):
        return "form or take_off, with which a mission begins"
    if index and isinstance(leg, TakeOffLeg):
        return "no take_off after the first leg: UAVs that fly go_to a height"
    if index == 1 and isinstance(first, TakeOffLeg) and not isinstance(leg, FormLeg):
        return "form, which follows take_off"
    if isinstance(leg, FormLeg) and index > isinstance(first, TakeOffLeg):
        return "change, with which a later leg takes another shape"
    if isinstance(leg, SplitLeg) and apart and isinstance(apart[0], SplitLeg):
        return "a leg of kind join before it"
    if isinstance(leg, JoinLeg) and not (apart and isinstance(apart[0], SplitLeg)):
        return "a leg of kind split before it"
    if isinstance(leg, LandLeg) and index + 1 < len(legs):
        return "no leg after it"
    return ""


def _plant(file: ScenarioFile) -> Problems:
    plant, rotors = file.plant, file.plant.kind == "quadrotor"
    given = not rotors or plant.quadrotor is not None
    expected = "its limits, or plant.kind: rigid_body_6dof"
    yield from unless(given, "plant.quadrotor", "missing", expected)
    gravity, expected = (
        file.world.gravity_m_s2,
        "more than 0, without which a quadrotor cannot steer",
    )
    yield from unless(gravity > 0.0 or not rotors, "world.gravity_m_s2", gravity, expected)
    limit = "quadrotor.max_thrust_n" if rotors else "rigid_body.max_force_n"
    for index, uav in enumerate(file.uavs):
        pitch, key = uav.attitude_rad[1], f"uavs[{index}].attitude_rad[1]"
        below = "below pi/2, where Euler rates are singular, or plant.kind: quadrotor"
        yield from unless(rotors or abs(math.cos(pitch)) > 1e-6, key, pitch, below)
        own = plant_of(plant, uav)
        weight = own.mass_kg * max(uav.mass_scale, 1.0) * gravity
        most = own.rotor_limits.max_thrust_n if rotors else own.rigid_body.max_force_n
        key = f"plant.{limit}" if uav.max_force_n is None else f"uavs[{index}].max_force_n"
        whose = f" of UAV {uav.id}" if own != plant or uav.mass_scale > 1.0 else ""
        expected = f"more than the weight{whose}, {weight:.3g} N, or it cannot hover"
        yield from unless(most > weight, key, most, expected)
    expected = "plant.kind: quadrotor, whose state it has"
    fits = rotors or not file.plugins.plant
    yield from unless(fits, "plugins.plant", file.plugins.plant, expected)


def _mavlink(file: ScenarioFile) -> Problems:
    block, fence, ids = file.mavlink, file.mavlink.geofence, file.uav_ids
    connections = "udpin:ADDRESS:PORT, udpout:…, tcp:… or serial:DEVICE[:BAUD]"
    for uav, vehicle in block.vehicles.items():
        where, connect = f"mavlink.vehicles.{uav}", vehicle.connect
        yield from unless(uav in ids, where, "no such UAV", one_of(ids))
        known = connect is None or (_CONNECT.fullmatch(connect) and _is_port(connect))
        yield from unless(known, f"{where}.connect", f'"{connect}"', connections)
    for key in block.overrides:
        below = key.split(".")[0] in ("gains", "formation")
        yield from unless(below, f"mavlink.overrides.{key}", "", "a key below gains or formation")
    links = {uav: file.vehicle_link(uav) for uav in ids}
    for link in links.values():
        known = link.autopilot != "ros" or link.ros is not None
        yield from unless(known, "ros", "missing", "topics, for mavlink.autopilot: ros")
    for uav in file.ros.vehicles if file.ros else ():
        yield from unless(uav in ids, f"ros.vehicles.{uav}", "no such UAV", one_of(ids))
    keys = "ros.name ros.output mavlink.sysid mavlink.connect mavlink.signing_key"
    for name, what in (key.split(".") for key in keys.split()):
        of = {uav: link.ros if name == "ros" else link for uav, link in links.items()}
        values = {uav: getattr(vehicle, what, None) for uav, vehicle in of.items()}
        own = {uav: str(value) for uav, value in values.items() if value is not None}
        # Whichever address it listens at, a port has one listener.
        ports = [
            end.rpartition(":")[2] if end.startswith("udpin:") else end for end in own.values()
        ]
        for index, first in _repeated(ports):
            uav, other = list(own)[index], list(own)[first]
            value = f"{own[uav]}: duplicate of that of UAV {other}"
            yield Problem(f"{name}.vehicles.{uav}.{what}", value, "every vehicle to have its own")
    low, high = fence.box_min_m, fence.box_max_m
    if (low is None) != (high is None):
        yield Problem(
            "mavlink.geofence", "one corner of the box", "box_min_m and box_max_m, or neither"
        )
    for least, most in zip(low or (), high or (), strict=False):
        expected = f"more than box_min_m, {least:g}"
        yield from unless(least < most, "mavlink.geofence.box_max_m", most, expected)


def _membership(file: ScenarioFile) -> Problems:
    leader, followers = file.leader, file.followers
    times = [(f"uavs[{index}]", uav) for index, uav in enumerate(file.uavs)]
    given = [f"{key}.joins_s" for key, uav in times if uav.joins_s is not None]
    given += [f"{key}.leaves_s" for key, uav in times if uav.leaves_s is not None]
    given += ["leader.successors"] * bool(leader.successors)
    vacancy = "formation.vacancy: keep or close_up, which says what becomes of an empty slot"
    for key in given:
        yield from unless(file.formation.reconfigures, key, "", vacancy)
    for index, uav_id in enumerate(leader.successors):
        follows = uav_id in followers and uav_id not in leader.successors[:index]
        yield from unless(follows, f"leader.successors[{index}]", uav_id, "followers, each once")
    for key, uav in times:
        if uav.joins_s is not None:
            none = "none for the leader, around which the others form"
            yield from unless(uav.id != leader.id, f"{key}.joins_s", uav.joins_s, none)
            later = uav.leaves_s is None or uav.leaves_s > uav.joins_s
            more = f"more than joins_s, {uav.joins_s:g}"
            yield from unless(later, f"{key}.leaves_s", uav.leaves_s, more)


def _faults(file: ScenarioFile) -> Problems:
    for index, fault in enumerate(file.faults):
        for problem in fault_problems(fault, file.uav_ids):
            yield problem.below(f"faults[{index}]")


_CHECKS: tuple[Callable[[ScenarioFile], Problems], ...] = (
    _timing,
    _deadlines,
    _obstacles,
    _members,
    _links,
    _parents,
    _formation,
    requirement_problems,
    _changes,
    _leg_times,
    _legs,
    _plant,
    _mavlink,
    _membership,
    _faults,
)


def checked(file: ScenarioFile, source: str) -> Topology:
    """The communication graph of `file`, all of which fits together.

    Raises:
        ScenarioError: the first thing that does not.
        TopologyError: the graph cannot carry the formation.
        GainError: the estimator is not stable on this graph.
    """
    for check in _CHECKS:
        for problem in check(file):
            raise ScenarioError(f"{source}: {problem}")
    links = file.communication
    try:
        topology = validated_topology(
            file.leader.id, file.uav_ids, links.tree, links.leader_links, links.estimator_edges
        )
    except TopologyError as error:
        raise TopologyError(f"{source}: {error}") from None  # it names its own keys
    step = estimator_step(file, topology) if len(file.uavs) > 1 else 0.0
    if step >= STABILITY_LIMIT:
        raise GainError(
            f"{source}: gains.estimator: dt (Xi/lambda_min + k1 + k2/boundary) lambda_max = "
            f"{step:.3g}: expected < {STABILITY_LIMIT:g}; raise gains.estimator.boundary or "
            "deadline_s, give more leader_links, or raise timing.control_hz"
        )
    return topology
