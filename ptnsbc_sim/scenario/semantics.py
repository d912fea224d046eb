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
from ptnsbc_io.wire import MOST_NEAR_OBJECTS
from ptnsbc_sim.scenario.fields import AUTO
from ptnsbc_sim.scenario.gains import Gains, Loop
from ptnsbc_sim.scenario.mission.fault_rules import AUTOPILOT, fault_problems
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
from ptnsbc_sim.scenario.mission.trajectories import trajectory_problems
from ptnsbc_sim.scenario.model import ScenarioFile, plant_of
from ptnsbc_sim.scenario.obstacles import bodies, obstacle_problems
from ptnsbc_sim.scenario.problems import ScenarioError
from ptnsbc_sim.scenario.requirements import requirement_problems

STABILITY_LIMIT = 2.0
"""An explicit Euler step of a linear decay with rate g is stable for dt g below this."""

_WEIGHTS_SUM = 1e-6
_LATE_S = 1e-9  # by which the end of a leg may miss the begin of the next one

Problems = Iterator[str]


def _repeated(keys: Iterable[Hashable]) -> Iterator[tuple[int, int]]:
    """The index of each key that stands before too, and the first index of it."""
    first: dict[Hashable, int] = {}
    for index, key in enumerate(keys):
        if first.setdefault(key, index) != index:
            yield index, first[key]


def _members(file: ScenarioFile) -> Problems:
    ids, links = set(file.uav_ids), file.communication
    known = "expected one of the ids under uavs: " + ", ".join(map(str, sorted(ids)))
    if file.leader.id not in ids:
        yield f"leader.id: {file.leader.id}: no start under uavs; {known}"
    for child in links.tree:
        if child not in ids:
            yield f"communication.tree.{child}: no UAV {child}, its start is missing; {known}"
    named = {f"tree.{child}": parent for child, parent in links.tree.items()}
    named |= {f"leader_links[{index}]": uav for index, uav in enumerate(links.leader_links)}
    for index, edge in enumerate(links.estimator_edges):
        named |= {f"estimator_edges[{index}][{end}]": uav for end, uav in enumerate(edge)}
    for key, uav in named.items():
        if uav not in ids:
            yield f"communication.{key}: {uav}: no such UAV; {known}"


def _links(file: ScenarioFile) -> Problems:
    block = file.communication
    ends = [(link.sender, link.receiver) for link in block.links]
    for index, (sender, receiver) in enumerate(ends):
        if not (
            sender in (block.tree.get(receiver), *(block.parents or {}).get(receiver, ()))
            or (sender == file.leader.id and receiver in block.leader_links)
            or {(sender, receiver), (receiver, sender)}.intersection(block.estimator_edges)
        ):
            yield (
                f"communication.links[{index}]: no messages from UAV {sender} to UAV {receiver}: expected an edge "
                "of communication.tree, parents, leader_links or estimator_edges"
            )
    for index, first in _repeated(ends):
        yield (
            f"communication.links[{index}]: duplicate of communication.links[{first}], give each link once"
        )
    delays = {f"links[{k}].delay_s": link.delay_s for k, link in enumerate(block.links)}
    for key, delay_s in {"delay_s": block.delay_s, **delays}.items():
        if delay_s is not None and delay_s >= block.stale_s:
            yield (
                f"communication.{key}: {delay_s:g}: expected less than communication.stale_s "
                f"({block.stale_s:g}), or the receiver holds for ever"
            )


def _parents(file: ScenarioFile) -> Problems:
    links = file.communication
    parents = links.parents or {}
    for child, weights in parents.items():
        where, above = f"communication.parents.{child}", links.tree.get(child)
        if above is None or above not in weights:
            known = "no follower" if above is None else f"expected {above}, its parent in the tree"
            yield f"{where}: {known}, among its parents"
        for parent in weights:
            if parent not in links.tree and parent != file.leader.id:
                yield f"{where}.{parent}: no such UAV; expected ids under uavs"
        total = math.fsum(weights.values())
        if abs(total - 1.0) > _WEIGHTS_SUM:
            yield f"{where}: weights sum to {total:g}: expected 1"
    if parents:
        edges = {child: {above} for child, above in links.tree.items()}
        try:
            TopologicalSorter({**edges, **parents}).prepare()
        except CycleError as error:
            cycle = " -> ".join(map(str, reversed(error.args[1])))
            yield f"communication.parents: cycle {cycle}: expected parents on the leader's side"


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


_CONNECT = re.compile(r"udp(in|out):[^:\s]+:\d{1,5}|serial:[^:\s]+(:\d+)?")
_CONNECT_HELP = "expected udpin:ADDRESS:PORT, udpout:ADDRESS:PORT or serial:DEVICE[:BAUD]"


def _timing(file: ScenarioFile) -> Problems:
    timing, fixes = file.timing, file.sensor.positioning
    hz = timing.control_hz
    if SECOND_NS % hz:
        yield (
            f"timing.control_hz: {hz}: expected a rate whose period is a whole "
            "number of nanoseconds, such as 50, 100, 200, 250"
        )
    if hz % 5:
        yield f"timing.control_hz: {hz}: expected a multiple of 5 (/diagnostics)"
    if timing.physics_hz % hz:
        yield (
            f"timing.physics_hz: {timing.physics_hz}: expected a multiple of timing.control_hz ({hz})"
        )
    rates = {"": file.sensor.rate_hz} | ({"positioning.": fixes.rate_hz} if fixes else {})
    for block, rate_hz in rates.items():
        if hz % rate_hz:
            yield (
                f"sensor.{block}rate_hz: {rate_hz}: expected a divisor of timing.control_hz ({hz})"
            )
    for key in ("latency_s", "unknown_latency_s") if fixes else ():
        late = float(getattr(fixes, key))
        if abs(late * hz - round(late * hz)) > 1e-9:
            yield (
                f"sensor.positioning.{key}: {late:g}: expected a multiple of the control period, {1 / hz:g} s"
            )
    if fixes and fixes.unknown_latency_s > fixes.latency_s:
        yield (
            f"sensor.positioning.unknown_latency_s: {fixes.unknown_latency_s:g}: expected at most "
            f"latency_s ({fixes.latency_s:g}), which it is a part of"
        )
    if timing.duration_s * hz < 1:
        yield f"timing.duration_s: {timing.duration_s:g}: expected at least one control period"


def _deadlines(file: ScenarioFile) -> Problems:
    for key in Gains.model_fields:
        loop = getattr(file.gains, key)
        if isinstance(loop, Loop) and math.isinf(loop.deadline_s):
            yield (
                f'gains.{key}.deadline_s: "{AUTO}": expected a number in s, or text such as "1.5 s"'
            )


def _names(file: ScenarioFile) -> Problems:
    for index, first in _repeated(file.uav_ids):
        yield (
            f"uavs[{index}].id: {file.uav_ids[index]}: duplicate of uavs[{first}].id, "
            "give every UAV its own id"
        )
    names = [obstacle.name for obstacle in file.world.obstacles]
    for index, first in _repeated(names):
        yield (
            f'world.obstacles[{index}].name: "{names[index]}": duplicate of '
            f"world.obstacles[{first}].name, give every obstacle its own name"
        )


def _obstacles(file: ScenarioFile) -> Problems:
    wrong = False
    for index, obstacle in enumerate(file.world.obstacles):
        for problem in obstacle_problems(obstacle):
            wrong = True
            yield f"world.obstacles[{index}].{problem}"
    if wrong:
        return
    names = {one.name: index for index, one in enumerate(file.world.obstacles)}
    seen = len(file.uavs)
    for index, obstacle in enumerate(file.world.obstacles):
        for body in bodies(obstacle):
            seen += 1
            if names.setdefault(body.name, index) != index:
                yield (
                    f'world.obstacles[{names[body.name]}].name: "{body.name}": a box of world.obstacles[{index}] '
                    "has it, give every obstacle its own name"
                )
    if seen > MOST_NEAR_OBJECTS:
        yield (
            f"world.obstacles: {seen} bodies with the UAVs and the boxes of maps: expected at most "
            f"{MOST_NEAR_OBJECTS}, of which a near-object sensor tells"
        )


def _formation(file: ScenarioFile) -> Problems:
    formation, offsets = file.formation, file.formation.offsets_m
    for uav in offsets:
        if uav == file.leader.id:
            yield f"formation.offsets_m.{uav}: the leader has no offset from itself, remove it"
        elif uav not in file.followers:
            ids = ", ".join(map(str, file.followers)) or "none"
            yield f"formation.offsets_m.{uav}: no such UAV; expected one of the followers: {ids}"
    for uav in file.followers:
        if uav not in offsets:
            yield f"formation.offsets_m.{uav}: missing: expected its offset from the leader"
    least = min(
        [formation.uav_keep_out_m, *(uav.keep_out_m for uav in file.uavs if uav.keep_out_m)]
    )
    if formation.sight_m > 0.5 * least:
        yield (
            f"formation.sight_m: {formation.sight_m:g}: expected at most half of the smallest keep-out of a UAV "
            f"({least:g} m), or one UAV may be taken for another"
        )
    for problem in trajectory_problems(file.leader.trajectory):
        yield f"leader.trajectory.{problem}"


def _changes(file: ScenarioFile) -> Problems:
    end_s = 0.0
    for index, change in enumerate(file.formation.changes):
        where = f"formation.changes[{index}]"
        if change.at_s < end_s:
            yield f"{where}.at_s: {change.at_s:g}: expected at least {end_s:g}, the end of the change before"
        end_s = change.at_s + change.over_s
        yield from _places(change, file.followers, where)


def _places(change: Reshaping, followers: tuple[int, ...], where: str) -> Problems:
    for uav in sorted(set(followers).symmetric_difference(change.offsets_m or followers)):
        yield f"{where}.offsets_m.{uav}: expected an offset of each follower {list(followers)}, and of no other UAV"


def _leg_times(file: ScenarioFile) -> Problems:
    mission = file.mission
    if mission is None:
        return
    names, start = leg_names(mission), mission.start
    for index, leg in enumerate(mission.legs):
        where = f"mission.legs[{index}]"
        if names[index] in names[:index]:
            yield f"{where}.name: {names[index]}: expected a name that no other leg has"
        if leg.at is not None and leg.at_s is not None:
            yield f"{where}.at: expected either at or at_s"
        if leg.at is not None and start is None:
            yield f"{where}.at: expected mission.start, from which the flight counts"
        elif leg.at is not None and not utc_time(leg.at).follows(utc_time(start or "")):
            yield (
                f"{where}.at: {leg.at}: expected a time that recurs as mission.start, {start}, does, or more often; "
                "a date where that is one"
            )
    for before, one in pairwise(schedule(mission, file.gains.formation.deadline_s)):
        at_s = begin_of(mission, one.leg)
        if at_s is not None and at_s < before.end_s - _LATE_S:
            key = "at" if one.leg.at is not None else "at_s"
            yield (
                f"mission.legs[{one.number - 1}].{key}: {at_s:g} s: expected at least {before.end_s:g} s, "
                "when the leg before is done"
            )


def _legs(file: ScenarioFile) -> Problems:
    legs = file.mission.legs if file.mission else ()
    for index, leg in enumerate(legs):
        where = f"mission.legs[{index}]"
        if expected := _order(legs, index):
            yield f"{where}.kind: {leg.kind}: {expected}"
        if index == 0 and (leg.at_s or leg.at is not None or leg.on is not None):
            yield f"{where}: expected no at_s, at or on: the first leg begins with the first epoch"
        path = getattr(leg, "trajectory", None)
        for problem in () if path is None else trajectory_problems(path):
            yield f"{where}.trajectory.{problem}"
        if isinstance(leg, SplitLeg) and leg.head not in file.followers:
            yield f"{where}.head: {leg.head}: expected one of the followers {list(file.followers)}"
        if isinstance(leg, ChangeLeg):
            yield from _places(leg, file.followers, where)


def _order(legs: Sequence[LegBlock], index: int) -> str:
    """What is expected where a leg may not stand; empty where it may. Groups part also by legs that wait for a word."""
    leg, first = legs[index], legs[0]
    apart = [one for one in legs[:index] if isinstance(one, SplitLeg | JoinLeg)][-1:]
    if index == 0 and not isinstance(leg, FormLeg | TakeOffLeg):
        return "expected form or take_off, with which a mission begins"
    if index and isinstance(leg, TakeOffLeg):
        return "expected no take_off after the first leg: UAVs that fly go_to a height"
    if index == 1 and isinstance(first, TakeOffLeg) and not isinstance(leg, FormLeg):
        return "expected form, which follows take_off"
    if isinstance(leg, FormLeg) and index > isinstance(first, TakeOffLeg):
        return "expected change, with which a later leg takes another shape"
    if isinstance(leg, SplitLeg) and apart and isinstance(apart[0], SplitLeg):
        return "expected a leg of kind join before it"
    if isinstance(leg, JoinLeg) and not (apart and isinstance(apart[0], SplitLeg)):
        return "expected a leg of kind split before it"
    if isinstance(leg, LandLeg) and index + 1 < len(legs):
        return "expected no leg after it"
    return ""


def _plant(file: ScenarioFile) -> Problems:
    plant = file.plant
    if plant.kind == "quadrotor" and plant.quadrotor is None:
        yield "plant.quadrotor: missing: expected its limits, or plant.kind: rigid_body_6dof"
    for index, uav in enumerate(file.uavs):
        own = plant_of(plant, uav)
        if own.kind != "quadrotor" or own.quadrotor is None:
            continue
        weight = own.mass_kg * max(uav.mass_scale, 1.0) * file.world.gravity_m_s2
        most = own.quadrotor.max_thrust_n
        if most <= weight:
            general = uav.max_force_n is None
            key = "plant.quadrotor.max_thrust_n" if general else f"uavs[{index}].max_force_n"
            whose = f" of UAV {uav.id}" if own != plant or uav.mass_scale > 1.0 else ""
            yield (
                f"{key}: {most:g}: expected more than the weight{whose}, {weight:.3g} N, or it cannot hover"
            )
    if file.plugins.plant and plant.kind != "quadrotor":
        yield f"plugins.plant: {file.plugins.plant}: expected plant.kind: quadrotor, whose state it has"


def _mavlink(file: ScenarioFile) -> Problems:
    block, fence, ids = file.mavlink, file.mavlink.geofence, file.uav_ids
    for uav, vehicle in block.vehicles.items():
        where = f"mavlink.vehicles.{uav}"
        if uav not in ids:
            known = ", ".join(map(str, ids))
            yield f"{where}: no such UAV; expected one of the ids under uavs: {known}"
        if vehicle.connect is not None and not _CONNECT.fullmatch(vehicle.connect):
            yield f'{where}.connect: "{vehicle.connect}": {_CONNECT_HELP}'
    for key in block.overrides:
        if key.split(".")[0] not in ("gains", "formation"):
            yield f"mavlink.overrides.{key}: expected a key below gains or formation"
    links = {uav: file.vehicle_link(uav) for uav in ids}
    for what in ("sysid", "connect", "signing_key"):
        values = {uav: getattr(link, what) for uav, link in links.items()}
        own = {uav: str(value) for uav, value in values.items() if value is not None}
        # Whichever address it listens at, a port has one listener.
        ports = [
            end.rpartition(":")[2] if end.startswith("udpin:") else end for end in own.values()
        ]
        for index, first in _repeated(ports):
            uav, other = list(own)[index], list(own)[first]
            yield (
                f"mavlink.vehicles.{uav}.{what}: {own[uav]}: duplicate of that of UAV {other}, "
                "give every vehicle its own"
            )
    if (fence.box_min_m is None) != (fence.box_max_m is None):
        yield "mavlink.geofence: one corner of the box: expected box_min_m and box_max_m, or neither"
    for low, high in zip(fence.box_min_m or (), fence.box_max_m or (), strict=False):
        if low >= high:
            yield f"mavlink.geofence.box_max_m: {high:g}: expected more than box_min_m, {low:g}"


def _membership(file: ScenarioFile) -> Problems:
    leader = file.leader
    if not file.formation.reconfigures:
        keys = [
            f"uavs[{index}].{key}"
            for key in ("joins_s", "leaves_s")
            for index, uav in enumerate(file.uavs)
            if getattr(uav, key) is not None
        ]
        for key in keys + ["leader.successors"] * bool(leader.successors):
            yield f"{key}: expected formation.vacancy: keep or close_up, which says what becomes of an empty slot"
        return
    for index, uav_id in enumerate(leader.successors):
        if uav_id not in file.followers or uav_id in leader.successors[:index]:
            yield f"leader.successors[{index}]: {uav_id}: expected followers, each once"
    for index, uav in enumerate(file.uavs):
        if uav.id == leader.id and uav.joins_s is not None:
            yield f"uavs[{index}].joins_s: expected none for the leader, around which the others form"
        if uav.joins_s is not None and uav.leaves_s is not None and uav.leaves_s <= uav.joins_s:
            yield f"uavs[{index}].leaves_s: {uav.leaves_s:g}: expected more than joins_s, {uav.joins_s:g}"


def _faults(file: ScenarioFile) -> Problems:
    for index, fault in enumerate(file.faults or ()):
        if fault.rule.strikes == AUTOPILOT:
            yield (
                f"faults[{index}].kind: {fault.kind}: no flight can inject it, stand-ins can: expected "
                f"`ptnsbc inject {fault.kind} --control PORT`, or `ptnsbc autopilot --fault`"
            )
        for problem in fault_problems(fault, file.uav_ids):
            yield f"faults[{index}].{problem}"


_CHECKS: tuple[Callable[[ScenarioFile], Problems], ...] = (
    _timing,
    _deadlines,
    _names,
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
