"""Figures of what goes on inside: estimator, gain, conditioning, ticks, latency, links."""

from __future__ import annotations

import numpy as np

from ptnsbc_tools.charts.chart import Chart, Curve, Limit, Mark
from ptnsbc_tools.charts.common import FLOOR_M, chart_of, curve_of, in_time
from ptnsbc_tools.charts.flight import Shown
from ptnsbc_tools.charts.style import look

_FLOOR_MS = 0.1


def estimator(flight: Shown) -> Chart | None:
    """How far off each follower's idea of the leader's place is."""
    if not flight.has_leader:
        return None
    grid = flight.grid()
    leader = flight.recording.odometry[flight.scenario.leader_id].at(grid)[:, :3]
    curves = []
    for uav in flight.scenario.followers:
        series = flight.recording.estimate.get(uav)
        if series is not None:
            error = np.linalg.norm(series.at(grid)[:, :3] - leader, axis=1)
            curves.append(curve_of(flight, uav, flight.times(grid), np.maximum(error, FLOOR_M)))
    deadline = flight.scenario.gains.estimator.deadline_s
    marks = (Mark(deadline, f"its deadline {deadline:g} s"),)
    return chart_of(
        "estimator", "Error of the estimated leader", "m", curves, marks=marks, log=True
    )


def _told(flight: Shown, key: str) -> list[Curve]:
    curves = []
    for uav in flight.uavs:
        series = flight.status.planner.get(uav, {}).get(key)
        if series is not None:
            t, values = in_time(flight, series)
            curves.append(curve_of(flight, uav, t, values))
    return curves


def gain(flight: Shown) -> Chart | None:
    """Gain of the formation loop: the time base until the deadline, kappa after it."""
    deadline = flight.scenario.gains.formation.deadline_s
    marks = (Mark(deadline, f"deadline {deadline:g} s"),)
    return chart_of("gain", "Gain of the formation loop", "1/s", _told(flight, "gain"), marks=marks)


def conditioning(flight: Shown) -> Chart | None:
    """Smallest singular value of each task: near zero the task cannot be solved."""
    curves = _told(flight, "sigma_min")
    return chart_of("conditioning", "Smallest singular value of the task", "", curves)


def missed(flight: Shown) -> Chart | None:
    """Ticks missed since the epoch."""
    curves = []
    for curve in _told(flight, "missed_ticks"):
        if curve.values.size:
            gained = curve.values - curve.values[0]
            curves.append(Curve(curve.label, curve.look, curve.t, gained, curve.uavs))
    if not any(curve.values.any() for curve in curves):
        return None
    return chart_of("missed", "Missed ticks", "", curves)


def latency(flight: Shown) -> Chart | None:
    """Age of the wrenches that reach the simulator."""
    curves = []
    for number, name in enumerate(("p50", "p99", "max")):
        series = flight.status.sim.get(f"latency_{name}_ms")
        if series is not None and series.values.any():
            t, values = in_time(flight, series)
            curves.append(Curve(name, look(number), t, values, ()))
    period = 1e3 / flight.scenario.control_hz
    limits = (Limit(period, f"control period {period:g} ms"),)
    note = "Age of a wrench when it arrives; percentiles since the start."
    return chart_of("latency", "Latency of the loop", "ms", curves, limits=limits, note=note)


def age(flight: Shown) -> Chart | None:
    """How old what a UAV knew of its neighbours was, step by step."""
    curves = []
    for uav in flight.uavs:
        if uav in flight.status.age_ms:
            t, values = in_time(flight, flight.status.age_ms[uav])
            curves.append(curve_of(flight, uav, t, np.maximum(values, _FLOOR_MS)))
    stale = 1e3 * flight.scenario.file.communication.stale_s
    limits = (Limit(stale, f"stale, {stale:g} ms"),)
    note = "The oldest that went into each step, by the clocks of sender and receiver."
    title = "Messages from neighbours: age"
    return chart_of("age", title, "ms", curves, limits=limits, note=note, log=True)
