"""Answers of a bridge about its vehicle: to the operator's orders, and as its status on /diagnostics."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from ptnsbc_nodes.bridge.bridge import Bridge
from ptnsbc_nodes.bridge.procedure.steps import FLYING, HEARTBEAT_LOST_S, Companion, Step, Stream
from ptnsbc_nodes.comm.diagnostics import (
    SAFETY,
    Concern,
    DiagnosticLevel,
    SafetyState,
    StatusLog,
    assess,
    diagnostics,
    readiness,
)
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.emergency import (
    PASSING,
    Order,
    OrderPort,
    VehicleRecord,
    latch,
    latched,
    records,
    write_record,
)
from ptnsbc_sim.scenario import Scenario

_NEVER_S = 1e6
_RECORD_S = 1.0
_STATES: Mapping[Step, SafetyState] = {
    Step.APART: SafetyState.HOLD_CLEAR,
    Step.LAND: SafetyState.LAND,
    Step.DISARM: SafetyState.LAND,
    Step.FAILSAFE: SafetyState.STOP,
    Step.RETURN: SafetyState.STOP,
    Step.YIELDED: SafetyState.STOP,
    Step.KILL: SafetyState.STOP,
    Step.FAILED: SafetyState.STOP,
}


class OrderDesk:
    """The orders of the operator to one bridge on this host, and the vehicle's record that answers them.

    The file of the record is at most a second old, and a change is there at once.
    """

    def __init__(
        self, bridge: Bridge, scenario: Scenario, uav_id: int, signing_key: str, folder: Path | None
    ) -> None:
        """Open the port. `signing_key`: path of the key file; `folder`: None without a folder for orders.

        Raises:
            RuntimeFolderError: the port cannot be opened.
        """
        link = scenario.vehicle_link(uav_id)
        name = f"bridge{uav_id}"  # without a namespace: the folder is the fleet's own
        key = str(Path(signing_key).resolve()) if signing_key else ""
        self._fixed = VehicleRecord(
            name, os.getpid(), link.sysid, link.autopilot, link.connect, "", key, link.label
        )
        for left in records(folder) if folder else ():  # by a bridge that has died in flight
            same = (left.name, left.sysid, left.connect) == (name, link.sysid, link.connect)
            if same and left.orphaned:
                bridge.take_over(left.frame)
                self._fixed = replace(
                    left, pid=os.getpid(), signing_key=key, heard=False, ended=False
                )
        self._bridge, self._folder = bridge, folder
        self._kept, self._kept_s = self._fixed, -math.inf
        self._port = OrderPort(folder, name, self.on_order, self.encode) if folder else None
        held = latched(folder) if folder else Order()
        if held.what:  # an order that still holds from before
            bridge.procedure.fail(
                f"the operator's order {held.text!r} still holds: ptnsbc stop --clear releases it"
            )
            bridge.ports.inputs.take(held)
        self.keep()

    def on_order(self, order: Order) -> None:
        """An order of the operator; it is latched, so that this bridge obeys it also after a restart."""
        if self._bridge.ports.inputs.take(order):
            self._bridge.ports.log(f"emergency: {order.text}")
            if self._folder is not None and order.what not in PASSING:
                with suppress(OSError):
                    latch(self._folder, order)

    def encode(self) -> bytes:
        """The record of now as the answer to an order."""
        return vehicle_record(self._bridge, self._fixed).encode()

    def keep(self, *, ended: bool = False) -> VehicleRecord:
        """Write the record of now if its file is older, or says something else; `ended`: the bridge ends in order."""
        record = replace(vehicle_record(self._bridge, self._fixed), ended=ended)
        changed = replace(record, place=self._kept.place) != self._kept
        now_s = self._bridge.ports.steady_s()
        if self._folder is not None and (changed or now_s >= self._kept_s + _RECORD_S):
            self._kept, self._kept_s = record, now_s
            with suppress(OSError):
                write_record(self._folder, record)
        return record

    def close(self) -> None:
        """Leave word of the vehicle, and take no orders any more."""
        self.keep(ended=True)
        if self._port is not None:
            self._port.close()


def vehicle_record(bridge: Bridge, fixed: VehicleRecord) -> VehicleRecord:
    """The knowledge of this bridge about its vehicle now; `fixed` has the part that does not change."""
    vehicle, procedure, peer = bridge.vehicle, bridge.procedure, bridge.link.peer
    silence_s = vehicle.heartbeat_age_s(bridge.ports.steady_s())
    known = replace(
        fixed,
        peer=fixed.peer if peer is None else f"{peer[0]}:{peer[1]}",
        step=procedure.step.value,
        order=bridge.ports.inputs.order.text,
        fault=procedure.fault,
    )
    if math.isinf(silence_s):  # not heard yet: only the bridge before it knew something
        return known
    # A bridge that is done listens no longer, and its vehicle's last word stands.
    rests = procedure.over and not vehicle.armed
    return replace(
        known,
        heard=rests or silence_s < HEARTBEAT_LOST_S,
        armed=vehicle.armed,
        landed=bool(vehicle.landed) or (vehicle.armed and procedure.stands),
        in_pilots_hands=procedure.in_pilots_hands,
        mode=vehicle.mode_name,
        place=bridge.placement.text,
        fate=bridge.fate if vehicle.armed else "",
        frame=bridge.state_publisher.world.frame,
    )


def bridge_status(
    name: str,
    record: VehicleRecord,
    bridge: Bridge,
    missing: Sequence[str],
    endpoints: Endpoints,
    log: StatusLog,
) -> bytes:
    """A DiagnosticArray about one bridge, noted in `log`; `missing` is what the formation waits for."""
    safety = assess(_concerns(bridge, missing, endpoints))
    log.note(safety.level, safety.reason)
    procedure, vehicle, link, stream = bridge.procedure, bridge.vehicle, bridge.link, bridge.stream
    state, report, battery = bridge.state_publisher, bridge.report, vehicle.battery.newest.percent
    age_s = state.controller.age_s(bridge.ports.steady_s())
    following, latency, sync = stream.following.found(), stream.latency, bridge.maintenance.sync
    attitude = stream.attitude if stream.sends_thrust(Stream.PLANNER) else None
    thrust = attitude.thrust_test.found if attitude else None
    sent, newest_ns = state.shared  # of one instant: a reader counts what it lacks
    round_trip = f"round trip {1e3 * sync.round_trip_s:.1f} ms"
    values = {
        **readiness(missing),
        SAFETY: safety.state.text,
        **record.status,
        "objection": bridge.objection,
        "position_m": " ".join(map("{:.3f}".format, report.position or ())),
        "position_error_m": f"{report.error_m:.3f}",
        "height_m": f"{report.height_m:.3f}",
        "battery_percent": "" if battery is None else f"{battery:.0f}",
        "fix": vehicle.gnss.fix,
        "stream": procedure.output.stream.value,
        "setpoint_age_ms": f"{1e3 * age_s:.0f}" if age_s < _NEVER_S else "",
        "velocity_gain": "" if following is None else f"{following.gain:.2f}",
        "velocity_lag_s": "" if following is None else f"{following.lag_s:.2f}",
        "hover_thrust": f"{attitude.hover.value:.3f}" if attitude else "",
        "thrust_slope": f"{attitude.hover.slope:.2f}" if attitude else "",
        "thrust_delay_s": f"{thrust.delay_s:.2f}" if thrust else "",
        "drag_1_s": f"{stream.drag.value:.2f}",
        "timesync": round_trip if sync.synchronised else "one-way",
        "latency_p50_ms": f"{1e3 * latency.percentile_s(50):.3f}",
        "latency_p99_ms": f"{1e3 * latency.percentile_s(99):.3f}",
        "latency_max_ms": f"{1e3 * latency.max_s:.3f}",
        "received": str(link.received),
        "sent": str(link.sent),
        "unsent": str(link.unsent),
        "states_sent": f"{newest_ns} {sent}",
        **{f"states_{why}": str(count) for why, count in state.dropped.items()},
        "states_invalid": str(vehicle.pose.invalid),
        "states_doubted": str(vehicle.pose.rejected),
        "setpoints_foreign": str(state.controller.foreign),
        "setpoints_invalid": str(state.controller.invalid),
        **{f"dropped_{reason}": str(count) for reason, count in link.counts.items()},
        **{f"clamped_{what}": str(count) for what, count in tuple(stream.guard.clamped.items())},
        **endpoints.refusals.values(),
    }
    stamp_ns = bridge.ports.ros_ns()
    return diagnostics(stamp_ns, f"{name}: link", safety.level, safety.reason, values)


def procedure_concern(step: Step, stream: Stream, fault: str) -> Iterator[Concern]:
    """The concerns of a step, and of a `fault` that still counts; none while the flight goes as planned."""
    state = _STATES.get(step, SafetyState.NOMINAL)
    if step in (Step.FLY, Step.HELD) and stream is Stream.HOLD:
        late, away = "the setpoints of the controller are late", "its controller is away"
        reason = f"held where it is: {late if step is Step.FLY else away}"
        yield Concern(SafetyState.HOLD_CLEAR, DiagnosticLevel.WARN, reason)
    elif fault and step is not Step.FLY:
        if step in FLYING:
            state = SafetyState.DEGRADED
        yield Concern(state, DiagnosticLevel.ERROR, f"{step.value}: {fault}")
    elif state is not SafetyState.NOMINAL:
        yield Concern(state, DiagnosticLevel.OK, step.value)


def _concerns(bridge: Bridge, missing: Sequence[str], endpoints: Endpoints) -> Iterator[Concern]:
    """The reasons for the safety state of the bridge: its step of the flight, missing topics, refused messages."""
    procedure, warn = bridge.procedure, DiagnosticLevel.WARN
    yield from procedure_concern(procedure.step, procedure.output.stream, procedure.concern)
    if fault := bridge.state_publisher.fault(bridge.ports.steady_s()):
        yield Concern(SafetyState.DEGRADED, warn, fault)
    if missing:
        yield Concern(SafetyState.NOMINAL, warn, f"waiting for {', '.join(missing)}")
    if refused := endpoints.warning():
        yield Concern(SafetyState.DEGRADED, warn, refused)
    following = bridge.stream.following.found() if bridge.stream.lead is not None else None
    if following is not None and following.unlike:
        yield Concern(SafetyState.DEGRADED, warn, following.unlike)


def companion(values: Mapping[str, str]) -> Companion | None:
    """The report in the status of another bridge; None when the status is not of a bridge."""
    try:
        numbers = tuple(map(float, values["position_m"].split()))
        error_m, height_m = float(values["position_error_m"]), float(values["height_m"])
    except (KeyError, ValueError):
        return None
    if len(numbers) not in (0, 3) or not all(map(math.isfinite, (*numbers, error_m, height_m))):
        return None
    position = numbers if len(numbers) == 3 else None
    return Companion(
        values.get("step", ""), values.get("fault", ""), position, max(error_m, 0.0), height_m
    )
