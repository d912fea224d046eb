"""Checks of a scenario that concern more than one key, and the communication graph of one without problems."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from graphlib import CycleError, TopologicalSorter

from ptnsbc_core.errors import GainError, TopologyError
from ptnsbc_core.timebase import peak_gain
from ptnsbc_core.topology import Topology, validated_topology
from ptnsbc_io.wire import MOST_NEAR_OBJECTS
from ptnsbc_sim.scenario.mavlink import Geofence, Mavlink, vehicle_link
from ptnsbc_sim.scenario.mission.fault_rules import AUTOPILOT, fault_problems
from ptnsbc_sim.scenario.mission.legs import mission_problems
from ptnsbc_sim.scenario.mission.shapes import shape_problems
from ptnsbc_sim.scenario.mission.trajectories import trajectory_problems
from ptnsbc_sim.scenario.model import NANOSECONDS, Positioning, ScenarioFile, plant_of
from ptnsbc_sim.scenario.obstacles import bodies, obstacle_problems
from ptnsbc_sim.scenario.problems import ScenarioError
from ptnsbc_sim.scenario.requirements import requirement_problems

STABILITY_LIMIT = 2.0
"""An explicit Euler step of a linear decay with rate g is stable for dt g below this."""

_WEIGHTS_SUM = 1e-6

Problems = Iterator[str]


def communication_problems(file: ScenarioFile) -> Problems:
    """Contradictions among tree, links and parents."""
    yield from _members(file)
    yield from _links(file)
    yield from _parents(file)


def _members(file: ScenarioFile) -> Problems:
    ids = {uav.id for uav in file.uavs}
    known = "expected one of the ids under uavs: " + ", ".join(map(str, sorted(ids)))
    if file.leader.id not in ids:
        yield f"leader.id: {file.leader.id}: no start under uavs; {known}"
    links = file.communication
    for child, parent in links.tree.items():
        if child not in ids:
            yield f"communication.tree.{child}: no UAV {child}, its start is missing; {known}"
        elif parent not in ids:
            yield f"communication.tree.{child}: {parent}: no such UAV; {known}"
    for index, uav in enumerate(links.leader_links):
        if uav not in ids:
            yield f"communication.leader_links[{index}]: {uav}: no such UAV; {known}"
    for index, edge in enumerate(links.estimator_edges):
        for end, uav in enumerate(edge):
            if uav not in ids:
                yield f"communication.estimator_edges[{index}][{end}]: {uav}: no such UAV; {known}"


def _links(file: ScenarioFile) -> Problems:
    block = file.communication
    first: dict[tuple[int, int], int] = {}
    for index, link in enumerate(block.links):
        where, ends = f"communication.links[{index}]", (link.sender, link.receiver)
        pair = {ends, ends[::-1]}
        if not (
            block.tree.get(link.receiver) == link.sender
            or link.sender in (block.parents or {}).get(link.receiver, ())
            or (link.sender == file.leader.id and link.receiver in block.leader_links)
            or pair.intersection(block.estimator_edges)
        ):
            yield (
                f"{where}: no messages from UAV {link.sender} to UAV {link.receiver}: expected an edge "
                "of communication.tree, parents, leader_links or estimator_edges"
            )
        if ends in first:
            yield f"{where}: duplicate of communication.links[{first[ends]}], give each link once"
        first.setdefault(ends, index)
    delays = {f"links[{k}].delay_s": link.delay_s for k, link in enumerate(block.links)}
    for key, delay_s in {"delay_s": block.delay_s, **delays}.items():
        if delay_s is not None and delay_s >= block.stale_s:
            yield (
                f"communication.{key}: {delay_s:g}: expected less than communication.stale_s "
                f"({block.stale_s:g}), or the receiver holds for ever"
            )


def _parents(file: ScenarioFile) -> Problems:
    links = file.communication
    if not links.parents:
        return
    for child, weights in links.parents.items():
        where = f"communication.parents.{child}"
        above = links.tree.get(child)
        if above is None or above not in weights:
            known = "no follower" if above is None else f"expected {above}, its parent in the tree"
            yield f"{where}: {known}, among its parents"
        for parent in weights:
            if parent not in links.tree and parent != file.leader.id:
                yield f"{where}.{parent}: no such UAV; expected ids under uavs"
        total = math.fsum(weights.values())
        if abs(total - 1.0) > _WEIGHTS_SUM:
            yield f"{where}: weights sum to {total:g}: expected 1"
    edges = {child: {above} for child, above in links.tree.items()}
    try:
        TopologicalSorter({**edges, **links.parents}).prepare()
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


def graph(file: ScenarioFile, source: str) -> Topology:
    """The communication graph of a file without `problems`.

    Raises:
        TopologyError: the graph cannot carry the formation.
        GainError: the estimator is not stable on this graph.
    """
    links = file.communication
    try:
        topology = validated_topology(
            file.leader.id,
            [uav.id for uav in file.uavs],
            links.tree,
            links.leader_links,
            links.estimator_edges,
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


_CONNECT = re.compile(r"udp(in|out):[^:\s]+:\d{1,5}|serial:[^:\s]+(:\d+)?")
_CONNECT_HELP = "expected udpin:ADDRESS:PORT, udpout:ADDRESS:PORT or serial:DEVICE[:BAUD]"


def _timing(file: ScenarioFile) -> Problems:
    timing, sensor = file.timing, file.sensor
    if NANOSECONDS % timing.control_hz:
        yield (
            f"timing.control_hz: {timing.control_hz}: expected a rate whose period is a whole "
            "number of nanoseconds, such as 50, 100, 200, 250"
        )
    if timing.control_hz % 5:
        yield f"timing.control_hz: {timing.control_hz}: expected a multiple of 5 (/diagnostics)"
    if timing.physics_hz % timing.control_hz:
        yield (
            f"timing.physics_hz: {timing.physics_hz}: expected a multiple of timing.control_hz "
            f"({timing.control_hz})"
        )
    if timing.control_hz % sensor.rate_hz:
        yield (
            f"sensor.rate_hz: {sensor.rate_hz}: expected a divisor of timing.control_hz "
            f"({timing.control_hz})"
        )
    fixes = sensor.positioning
    if fixes is not None:
        yield from _positioning(fixes, timing.control_hz)
    if timing.duration_s * timing.control_hz < 1:
        yield f"timing.duration_s: {timing.duration_s:g}: expected at least one control period"


def _positioning(fixes: Positioning, control_hz: int) -> Problems:
    if control_hz % fixes.rate_hz:
        yield (
            f"sensor.positioning.rate_hz: {fixes.rate_hz}: expected a divisor of "
            f"timing.control_hz ({control_hz})"
        )
    for key in ("latency_s", "unknown_latency_s"):
        late = float(getattr(fixes, key))
        if abs(late * control_hz - round(late * control_hz)) > 1e-9:
            yield (
                f"sensor.positioning.{key}: {late:g}: expected a multiple of the control period, "
                f"{1 / control_hz:g} s"
            )
    if fixes.unknown_latency_s > fixes.latency_s:
        yield (
            f"sensor.positioning.unknown_latency_s: {fixes.unknown_latency_s:g}: expected at most "
            f"latency_s ({fixes.latency_s:g}), which it is a part of"
        )


def _names(file: ScenarioFile) -> Problems:
    first: dict[int, int] = {}
    for index, uav in enumerate(file.uavs):
        if uav.id in first:
            yield (
                f"uavs[{index}].id: {uav.id}: duplicate of uavs[{first[uav.id]}].id, "
                "give every UAV its own id"
            )
        first.setdefault(uav.id, index)
    names: dict[str, int] = {}
    for index, obstacle in enumerate(file.world.obstacles):
        if obstacle.name in names:
            yield (
                f'world.obstacles[{index}].name: "{obstacle.name}": duplicate of '
                f"world.obstacles[{names[obstacle.name]}].name, give every obstacle its own name"
            )
        names.setdefault(obstacle.name, index)


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


def _offsets(file: ScenarioFile) -> Problems:
    followers = [uav.id for uav in file.uavs if uav.id != file.leader.id]
    offsets = file.formation.offsets_m
    for uav in offsets:
        if uav == file.leader.id:
            yield f"formation.offsets_m.{uav}: the leader has no offset from itself, remove it"
        elif uav not in followers:
            ids = ", ".join(map(str, followers)) or "none"
            yield f"formation.offsets_m.{uav}: no such UAV; expected one of the followers: {ids}"
    for uav in followers:
        if uav not in offsets:
            yield f"formation.offsets_m.{uav}: missing: expected its offset from the leader"


def _trajectory(file: ScenarioFile) -> Problems:
    for problem in trajectory_problems(file.leader.trajectory):
        yield f"leader.trajectory.{problem}"


def _sight(file: ScenarioFile) -> Problems:
    shape = file.formation
    own = [uav.keep_out_m for uav in file.uavs if uav.keep_out_m is not None]
    least = min([shape.uav_keep_out_m, *own])
    if shape.sight_m > 0.5 * least:
        yield (
            f"formation.sight_m: {shape.sight_m:g}: expected at most half of the smallest keep-out of a UAV "
            f"({least:g} m), or one UAV may be taken for another"
        )


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
            key = (
                "plant.quadrotor.max_thrust_n"
                if uav.max_force_n is None
                else f"uavs[{index}].max_force_n"
            )
            whose = f" of UAV {uav.id}" if own != plant or uav.mass_scale > 1.0 else ""
            yield (
                f"{key}: {most:g}: expected more than the weight{whose}, {weight:.3g} N, or it cannot hover"
            )


def _mavlink(file: ScenarioFile) -> Problems:
    block = file.mavlink
    ids = tuple(uav.id for uav in file.uavs)
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
    yield from _duplicate_links(block, ids)
    yield from _fence(block.geofence)


def _duplicate_links(block: Mavlink, ids: tuple[int, ...]) -> Problems:
    links = {uav: vehicle_link(block, ids, uav) for uav in ids}
    for what in ("sysid", "connect", "signing_key"):
        first: dict[str, int] = {}
        for uav, link in links.items():
            value = getattr(link, what)
            if value is None:
                continue
            # Whichever address it listens at, a port has one listener.
            key = str(value).rpartition(":")[2] if str(value).startswith("udpin:") else str(value)
            if key in first:
                yield (
                    f"mavlink.vehicles.{uav}.{what}: {value}: duplicate of that of UAV "
                    f"{first[key]}, give every vehicle its own"
                )
            first.setdefault(key, uav)


def _fence(fence: Geofence) -> Problems:
    if (fence.box_min_m is None) != (fence.box_max_m is None):
        yield "mavlink.geofence: one corner of the box: expected box_min_m and box_max_m, or neither"
    elif fence.box_min_m is not None and fence.box_max_m is not None:
        for low, high in zip(fence.box_min_m, fence.box_max_m, strict=True):
            if low >= high:
                yield f"mavlink.geofence.box_max_m: {high:g}: expected more than box_min_m, {low:g}"


def _law(file: ScenarioFile) -> Problems:
    if file.plugins.plant and file.plant.kind != "quadrotor":
        yield f"plugins.plant: {file.plugins.plant}: expected plant.kind: quadrotor, whose state it has"


def _membership(file: ScenarioFile) -> Problems:
    formation = file.formation
    keys = [f"uavs[{k}].joins_s" for k, uav in enumerate(file.uavs) if uav.joins_s is not None]
    keys += [f"uavs[{k}].leaves_s" for k, uav in enumerate(file.uavs) if uav.leaves_s is not None]
    if file.leader.successors:
        keys.append("leader.successors")
    if formation.vacancy == "wait":
        for key in keys:
            yield f"{key}: expected formation.vacancy: keep or close_up, which says what becomes of an empty slot"
        return
    yield from _comings(file)


def _comings(file: ScenarioFile) -> Problems:
    leader, ids = file.leader, [uav.id for uav in file.uavs]
    for index, uav_id in enumerate(leader.successors):
        if uav_id not in ids or uav_id == leader.id or uav_id in leader.successors[:index]:
            yield f"leader.successors[{index}]: {uav_id}: expected followers, each once"
    for index, uav in enumerate(file.uavs):
        if uav.id == leader.id and uav.joins_s is not None:
            yield f"uavs[{index}].joins_s: expected none for the leader, around which the others form"
        if uav.joins_s is not None and uav.leaves_s is not None and uav.leaves_s <= uav.joins_s:
            yield f"uavs[{index}].leaves_s: {uav.leaves_s:g}: expected more than joins_s, {uav.joins_s:g}"


def _faults(file: ScenarioFile) -> Problems:
    ids = {uav.id for uav in file.uavs}
    for index, fault in enumerate(file.faults or ()):
        if fault.rule.strikes == AUTOPILOT:
            yield (
                f"faults[{index}].kind: {fault.kind}: no flight can inject it, stand-ins can: expected "
                f"`ptnsbc inject {fault.kind} --control PORT`, or `ptnsbc autopilot --fault`"
            )
        for problem in fault_problems(fault, ids):
            yield f"faults[{index}].{problem}"


_CHECKS: tuple[Callable[[ScenarioFile], Problems], ...] = (
    _timing,
    _names,
    _obstacles,
    communication_problems,
    _offsets,
    _trajectory,
    requirement_problems,
    shape_problems,
    mission_problems,
    _sight,
    _plant,
    _mavlink,
    _law,
    _membership,
    _faults,
)


def checked(file: ScenarioFile, source: str) -> Topology:
    """The communication graph of `file`; raises on the first thing that does not fit together."""
    for check in _CHECKS:
        for problem in check(file):
            raise ScenarioError(f"{source}: {problem}")
    return graph(file, source)
