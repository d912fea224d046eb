"""What a bridge tells of itself on /diagnostics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics, readiness

if TYPE_CHECKING:
    from ptnsbc_nodes.bridge.bridge import Bridge

_NEVER_S = 1e6


def report(name: str, stamp_ns: int, bridge: Bridge, missing: Sequence[str]) -> bytes:
    """A DiagnosticArray about one bridge: step, fault, link counters, latency."""
    procedure, vehicle, latency = bridge.procedure, bridge.vehicle, bridge.latency
    age_s = bridge.controller.age_s(bridge.now_s())
    battery, told = vehicle.battery_percent, bridge.told
    values = {
        **readiness(missing),
        "step": procedure.step.value,
        "fault": procedure.fault,
        "mode": vehicle.mode_name,
        "armed": str(vehicle.armed).lower(),
        "battery_percent": "" if battery is None else f"{battery:.0f}",
        "stream": bridge.orders.stream.value,
        "setpoint_age_ms": f"{1e3 * age_s:.0f}" if age_s < _NEVER_S else "",
        "timesync": bridge.sync_text,
        "latency_p50_ms": f"{1e3 * latency.percentile_s(50):.3f}",
        "latency_p99_ms": f"{1e3 * latency.percentile_s(99):.3f}",
        "latency_max_ms": f"{1e3 * latency.max_s:.3f}",
        "received": str(bridge.link.received),
        "sent": str(bridge.link.sent),
        "unsent": str(bridge.link.unsent),
        # Both at one instant: whoever has the bag can count what is missing in it.
        "states_sent": f"{told.stamp_ns} {told.messages}",
        "states_old": str(bridge.teller.old),
        "states_skewed": str(bridge.teller.skewed),
        "states_invalid": str(vehicle.pose.invalid),
        "states_doubted": str(vehicle.pose.doubted),
        "setpoints_foreign": str(bridge.controller.foreign),
        "setpoints_invalid": str(bridge.controller.nonsense),
        **{f"dropped_{reason}": str(count) for reason, count in bridge.link.counts.items()},
        **{f"clamped_{what}": str(count) for what, count in bridge.guard.clamped.items()},
    }
    level, message = _verdict(bridge, missing)
    return diagnostics(stamp_ns, f"{name}: link", level, message, values)


def _verdict(bridge: Bridge, missing: Sequence[str]) -> tuple[DiagnosticLevel, str]:
    procedure = bridge.procedure
    if procedure.fault and procedure.step is not Step.FLY:
        return DiagnosticLevel.ERROR, f"{procedure.step.value}: {procedure.fault}"
    lack = bridge.teller.lack(bridge.now_s())
    if lack:
        return DiagnosticLevel.WARN, lack
    return (
        (DiagnosticLevel.WARN, f"waiting for {' '.join(missing)}")
        if missing
        else (DiagnosticLevel.OK, "")
    )
