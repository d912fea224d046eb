"""The status of a bridge on /diagnostics: step, fault, link counters and latency."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from ptnsbc_nodes.bridge.bridge import Bridge
from ptnsbc_nodes.bridge.procedure.companions import Companion
from ptnsbc_nodes.bridge.procedure.safety import procedure_concern
from ptnsbc_nodes.bridge.procedure.steps import HEARTBEAT_LOST_S, Stream
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
from ptnsbc_nodes.emergency.records import VehicleRecord

_NEVER_S = 1e6


def vehicle_record(name: str, bridge: Bridge, base: VehicleRecord) -> VehicleRecord:
    """The knowledge of this bridge about its vehicle now; `base` has the part that does not change."""
    vehicle, procedure, peer = bridge.vehicle, bridge.procedure, bridge.link.peer
    silence_s = vehicle.heartbeat_age_s(bridge.ports.clocks.steady_s())
    # After the flight the bridge listens no longer, and the vehicle's last word stands.
    landed = procedure.over and bridge.flew and not vehicle.armed
    return replace(
        base,
        name=name,
        peer="" if peer is None else f"{peer[0]}:{peer[1]}",
        step=procedure.step.value,
        order=bridge.ports.inputs.order.text,
        heard=landed or silence_s < HEARTBEAT_LOST_S,
        armed=vehicle.armed,
        landed=bool(vehicle.landed),
        in_pilots_hands=procedure.in_pilots_hands,
        mode=vehicle.mode_name,
        place=bridge.place,
        fate=bridge.fate if vehicle.armed else "",
        fault=procedure.fault,
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
    values = {
        **readiness(missing),
        SAFETY: safety.state.text,
        **_flight_values(bridge, record),
        **_setpoint_values(bridge),
        **_link_values(bridge),
        **_message_values(bridge),
        **endpoints.refusals.values(),
    }
    log.note(safety.level, safety.reason)
    stamp_ns = bridge.ports.clocks.ros_ns()
    return diagnostics(stamp_ns, f"{name}: link", safety.level, safety.reason, values)


def _flight_values(bridge: Bridge, record: VehicleRecord) -> dict[str, str]:
    """The step of the flight, and the state of the vehicle."""
    report, battery = bridge.report, bridge.vehicle.battery.percent
    place = "" if report.position is None else " ".join(map("{:.3f}".format, report.position))
    return {
        "step": bridge.procedure.step.value,
        "fault": bridge.procedure.fault,
        "mode": bridge.vehicle.mode_name,
        "armed": str(bridge.vehicle.armed).lower(),
        "heard": str(record.heard).lower(),
        "landed": str(record.landed).lower(),
        "in_pilots_hands": str(record.in_pilots_hands).lower(),
        "place": record.place,
        "order": record.order,
        "position_m": place,
        "position_error_m": f"{report.error_m:.3f}",
        "height_m": f"{report.height_m:.3f}",
        "battery_percent": "" if battery is None else f"{battery:.0f}",
        "fix": bridge.vehicle.gnss.fix,
    }


def _setpoint_values(bridge: Bridge) -> dict[str, str]:
    """The setpoints that the vehicle gets, and what was learnt of how it follows them."""
    age_s = bridge.controller.age_s(bridge.ports.clocks.steady_s())
    following = bridge.stream.following.found()
    attitude = bridge.stream.attitude if bridge.stream.sends_thrust(Stream.PLANNER) else None
    thrust = attitude.thrust_test.found if attitude else None
    return {
        "stream": bridge.procedure.output.stream.value,
        "setpoint_age_ms": f"{1e3 * age_s:.0f}" if age_s < _NEVER_S else "",
        "velocity_gain": "" if following is None else f"{following.gain:.2f}",
        "velocity_lag_s": "" if following is None else f"{following.lag_s:.2f}",
        "hover_thrust": f"{attitude.hover.value:.3f}" if attitude else "",
        "thrust_slope": f"{attitude.hover.slope:.2f}" if attitude else "",
        "thrust_delay_s": f"{thrust.delay_s:.2f}" if thrust else "",
        "drag_1_s": f"{bridge.stream.drag.value:.2f}",
    }


def _link_values(bridge: Bridge) -> dict[str, str]:
    """The link to the vehicle."""
    link, latency = bridge.link, bridge.stream.latency
    return {
        "timesync": bridge.maintenance.sync_text,
        "latency_p50_ms": f"{1e3 * latency.percentile_s(50):.3f}",
        "latency_p99_ms": f"{1e3 * latency.percentile_s(99):.3f}",
        "latency_max_ms": f"{1e3 * latency.max_s:.3f}",
        "received": str(link.received),
        "sent": str(link.sent),
        "unsent": str(link.unsent),
    }


def _message_values(bridge: Bridge) -> dict[str, str]:
    """Counters of states, setpoints and MAVLink messages: sent, dropped, clamped."""
    state, controller, pose = bridge.state_publisher, bridge.controller, bridge.vehicle.pose
    shared = state.shared  # both of its numbers are of one instant: a reader counts what it lacks
    return {
        "states_sent": f"{shared.stamp_ns} {shared.messages}",
        "states_old": str(state.dropped["old"]),
        "states_skewed": str(state.dropped["skewed"]),
        "states_invalid": str(pose.invalid),
        "states_doubted": str(pose.rejected),
        "setpoints_foreign": str(controller.foreign),
        "setpoints_invalid": str(controller.invalid),
        **{f"dropped_{reason}": str(count) for reason, count in bridge.link.counts.items()},
        **{f"clamped_{what}": str(count) for what, count in bridge.stream.guard.clamped.items()},
    }


def _concerns(bridge: Bridge, missing: Sequence[str], endpoints: Endpoints) -> Iterator[Concern]:
    """The reasons for the safety state of the bridge: its step of the flight, missing topics, refused messages."""
    procedure, warn = bridge.procedure, DiagnosticLevel.WARN
    yield from procedure_concern(procedure.step, procedure.output.stream, procedure.fault)
    if fault := bridge.state_publisher.fault(bridge.ports.clocks.steady_s()):
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
