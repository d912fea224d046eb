"""The safety state of a bridge, derived from its step of the flight.

The thread of the bridge advances the procedure whatever ROS and the planner do, so these states do not wait for either.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from ptnsbc_nodes.bridge.procedure.steps import FLYING, Step, Stream
from ptnsbc_nodes.comm.diagnostics import Concern, DiagnosticLevel, SafetyState

_STATES: Mapping[Step, SafetyState] = {
    Step.APART: SafetyState.HOLD_CLEAR,
    Step.LAND: SafetyState.LAND,
    Step.DISARM: SafetyState.LAND,
    Step.FAILSAFE: SafetyState.STOP,
    Step.YIELDED: SafetyState.STOP,
    Step.KILL: SafetyState.STOP,
    Step.FAILED: SafetyState.STOP,
}


def procedure_concern(step: Step, stream: Stream, fault: str) -> Iterator[Concern]:
    """The concerns that the procedure of a vehicle raises; none while the flight goes as planned.

    Args:
        step: where in the flight the vehicle is.
        stream: what the setpoint stream carries.
        fault: why the flight did not go as planned.
    """
    state = _STATES.get(step, SafetyState.NOMINAL)
    if step in (Step.FLY, Step.HELD) and stream is Stream.HOLD:
        why = (
            "the setpoints of the controller are late"
            if step is Step.FLY
            else "its controller is away"
        )
        reason = f"held where it is: {why}"
        yield Concern(SafetyState.HOLD_CLEAR, DiagnosticLevel.WARN, reason)
    elif fault and step is not Step.FLY:
        if step in FLYING:
            state = SafetyState.DEGRADED
        yield Concern(state, DiagnosticLevel.ERROR, f"{step.value}: {fault}")
    elif state is not SafetyState.NOMINAL:
        yield Concern(state, DiagnosticLevel.OK, step.value)
