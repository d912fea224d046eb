"""A headless flight as a Recording, and as the bag that a lock-step fleet would record of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from ptnsbc_core.agent import load_diagnostics
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_io.bag import BagWriter
from ptnsbc_io.bag.writer import check_replaceable
from ptnsbc_io.wire import HeaderTemplate, Stamped, encode_clock, encode_near
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import WORLD_FRAME, AgentMessages, Transforms
from ptnsbc_nodes.comm.announcements import Decision, encode_slots
from ptnsbc_nodes.runtime.provenance import provenance
from ptnsbc_nodes.uav.uav_controller import UavFaults
from ptnsbc_sim.counters import UavCounters, status_every
from ptnsbc_sim.disturbances.faults import gone
from ptnsbc_sim.swarm import HeadlessFlight
from ptnsbc_sim.verdict.recording import FORMATION
from ptnsbc_tools import ros
from ptnsbc_tools.reading.bag_reader import SCENARIO_ATTACHMENT

Message = tuple[str, bytes]  # topic, CDR


class _UavMessages:
    """The messages of one UAV and its sensors."""

    def __init__(self, flight: HeadlessFlight, row: int) -> None:
        uav = flight.scenario.uav_ids[row]
        self._flight = flight
        self._row = row
        self._near_every = flight.swarm.wiring.near_every
        self._truth = topics.truth(uav).name
        self._names = [topic.name for topic in topics.of_uav(uav)]
        faults = UavFaults(flight.scenario, uav)
        faults.begin(0)
        self._encoder = AgentMessages(uav, faults=faults.sending)
        self._gone = gone(flight.scenario)[:, row]

    def at(self, tick: int, stamp_ns: int) -> Iterator[Message]:
        odom, near, state, estimate, velocity, wrench = self._names
        track, row, encoder = self._flight.track, self._row, self._encoder
        own = encoder.odometry(Stamped(stamp_ns, track.odometry[tick, row]))
        yield odom, own
        if len(track.truth):
            yield self._truth, encoder.odometry(Stamped(stamp_ns, track.truth[tick, row]))
        if tick % self._near_every == 0:
            yield near, encode_near(stamp_ns, WORLD_FRAME, self._flight.near(tick, row))
        if self._gone[tick]:
            return
        yield state, encoder.reported(stamp_ns, track.reported[tick, row])
        yield estimate, encoder.estimate(stamp_ns, track.estimate[tick, row])
        yield velocity, encoder.velocity(stamp_ns, track.velocity[tick, row])
        yield wrench, encoder.wrench(stamp_ns, track.wrench[tick, row])


class _StatusMessages:
    """/diagnostics of all UAVs and of the sim, and the markers; both five times a second."""

    def __init__(self, flight: HeadlessFlight) -> None:
        from ptnsbc_nodes.comm.drawing import Scene

        scenario = flight.scenario
        self._flight = flight
        self._every = status_every(scenario)
        self._dt = seconds(scenario.timing.dt_ns)
        self._counters = [UavCounters() for _ in scenario.uav_ids]
        self._gone = gone(scenario)
        self._scene = Scene(scenario)

    def at(self, tick: int, stamp_ns: int) -> Iterator[Message]:
        """Messages of one tick, in the order that a lock-step bag gives them."""
        for row, counters in enumerate(self._counters):
            if self._gone[tick, row]:  # its process begins anew, or never
                self._counters[row] = type(counters)()
                continue
            counters.add(load_diagnostics(self._flight.track.diagnostics[tick, row]), self._dt)
        if tick % self._every:
            return
        for data in sorted(self._diagnostics(tick, stamp_ns)):
            yield topics.DIAGNOSTICS.name, data
        scenario, places = self._flight.scenario, self._flight.track.odometry[tick, :, 0:3]
        obstacles = scenario.world.body_positions(seconds(tick * scenario.timing.dt_ns))
        yield topics.MARKERS.name, self._scene.markers(stamp_ns, places, obstacles)

    def _diagnostics(self, tick: int, stamp_ns: int) -> Iterator[bytes]:
        from ptnsbc_nodes.comm.diagnostics import (
            SAFETY,
            DiagnosticLevel,
            assess,
            diagnostics,
            readiness,
        )
        from ptnsbc_nodes.uav.uav_node import PlannerSight, planner_concerns

        landing_ns = self._flight.scenario.landing_ns
        mode = FORMATION if landing_ns is None or stamp_ns < landing_ns else "land"
        for row, counters in enumerate(self._counters):
            uav = self._flight.scenario.uav_ids[row]
            if self._gone[tick, row]:
                continue
            safety = assess(planner_concerns(PlannerSight(holding=counters.holding)))
            values = {
                **readiness([]),
                "mode": mode,
                SAFETY: safety.state.text,
                "missed_ticks": "0",
                **counters.values(),
            }
            yield diagnostics(stamp_ns, f"uav{uav}: planner", safety.level, safety.reason, values)
        still = {f"latency_{name}_ms": "0.000" for name in ("p50", "p99", "max")}
        values = {**readiness([]), "ticks": str(tick), "missed_ticks": "0", **still}
        yield diagnostics(stamp_ns, "sim: world", DiagnosticLevel.OK, "", values)


def messages(flight: HeadlessFlight) -> Iterator[tuple[int, list[Message]]]:
    """Stamp [ns] and sorted messages of every tick."""
    uavs = [_UavMessages(flight, row) for row in range(len(flight.scenario.uav_ids))]
    status = _StatusMessages(flight)
    transforms = Transforms(flight.scenario.uav_ids)
    for tick, stamp in enumerate(flight.t_ns):
        stamp_ns = int(stamp)
        found: list[Message] = [(topics.CLOCK.name, encode_clock(stamp_ns))]
        if tick == 0:
            found.append((topics.EPOCH.name, HeaderTemplate(FORMATION).encode(stamp_ns)))
            if flight.slots:
                found.append((topics.SLOTS.name, encode_slots(Decision(stamp_ns, flight.slots))))
        for uav in uavs:
            found.extend(uav.at(tick, stamp_ns))
        made = [transforms.of(topic, data) for topic, data in found]
        found.extend((topics.TF.name, data) for data in made if data is not None)
        found.extend(status.at(tick, stamp_ns))
        found.sort(key=lambda message: message[0])
        # DDS pads a message with zeros to a multiple of four bytes.
        yield stamp_ns, [(topic, data + bytes(-len(data) % 4)) for topic, data in found]


def prepare_bag(directory: Path, *, overwrite: bool) -> None:
    """Refuse a bag that cannot be written, before the flight and not after it."""
    with ros.required():
        import_module("ptnsbc_nodes.recording.recorder")
        import_module("ptnsbc_nodes.comm.drawing")
    check_replaceable(directory, overwrite=overwrite)


def write_flight(
    flight: HeadlessFlight,
    directory: Path,
    *,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a flight into a bag and return its folder; `progress` gets the ticks done and their total now and then."""
    prepare_bag(directory, overwrite=overwrite)
    from ptnsbc_nodes.recording.recorder import topic_info

    scenario = flight.scenario
    infos: list[Any] = [
        topic_info(topic, lockstep=True)
        for topic in topics.in_bag(
            scenario.uav_ids,
            with_truth=scenario.imperfect,
            with_slots=scenario.formation.has_open_slots,
            with_stream=scenario.takes_setpoints,
        )
    ]
    attachments = {SCENARIO_ATTACHMENT: scenario.text.encode()}
    every = max(len(flight.t_ns) // 100, 1)
    with BagWriter(
        directory,
        infos,
        attachments=attachments,
        metadata={"mode": "headless", "scenario": scenario.name} | provenance(),
        overwrite=overwrite,
    ) as writer:
        for tick, (stamp_ns, found) in enumerate(messages(flight), start=1):
            for topic, data in found:
                writer.write(topic, stamp_ns, data)
            if progress is not None and (tick % every == 0 or tick == len(flight.t_ns)):
                progress(tick, len(flight.t_ns))
    return writer.directory
