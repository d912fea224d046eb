"""Figures of what goes on inside: estimator, gain, conditioning, ticks, latency, links."""

from __future__ import annotations

import numpy as np

from ptnsbc_tools.plotting.chart import Chart, Curve, Limit, Mark
from ptnsbc_tools.plotting.common import FLOOR_M, chart_of, curve_of, in_time
from ptnsbc_tools.plotting.flight import Shown
from ptnsbc_tools.plotting.style import look
from ptnsbc_tools.plotting.thin import ThinnedCurves

_FLOOR_MS = 0.1


def estimator(flight: Shown) -> Chart | None:
    """How far off each follower's idea of the leader's place is."""
    if not flight.has_leader:
        return None
    tracks = flight.recording.estimate
    told = {uav: tracks[uav] for uav in flight.scenario.followers if uav in tracks}
    truth = flight.recording.odometry[flight.scenario.leader_id]
    found = ThinnedCurves[int](flight.samples)
    for grid in flight.grids():
        leader = truth.at(grid)[:, :3]
        for uav, track in told.items():
            error = np.linalg.norm(track.at(grid)[:, :3] - leader, axis=1)
            found.add(uav, flight.times(grid), np.maximum(error, FLOOR_M))
    curves = [curve_of(flight, uav, *points) for uav, points in found.points().items()]
    deadline = flight.scenario.gains.estimator.deadline_s
    marks = (Mark(deadline, f"its deadline {deadline:g} s"),)
    return chart_of(
        "estimator", "Error of the estimated leader", "m", curves, marks=marks, log=True
    )


def _told(flight: Shown, key: str) -> list[Curve]:
    curves = []
    for uav in flight.uavs:
        series = flight.status.planner.get(uav, {}).get(key)
        points = None if series is None else in_time(flight, series)
        if points is not None:
            curves.append(curve_of(flight, uav, *points))
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
        points = None if series is None else in_time(flight, series)
        if points is not None and points.values.any():
            curves.append(Curve(name, look(number), *points, ()))
    period = 1e3 / flight.scenario.control_hz
    limits = (Limit(period, f"control period {period:g} ms"),)
    note = "Age of a wrench when it arrives; percentiles since the start."
    return chart_of("latency", "Latency of the loop", "ms", curves, limits=limits, note=note)


def age(flight: Shown) -> Chart | None:
    """How old what a UAV knew of its neighbours was, step by step."""
    curves = []
    for uav in flight.uavs:
        series = flight.status.age_ms.get(uav)
        points = None if series is None else in_time(flight, series)
        if points is not None:
            curves.append(curve_of(flight, uav, points.t, np.maximum(points.values, _FLOOR_MS)))
    stale = 1e3 * flight.scenario.file.communication.stale_s
    limits = (Limit(stale, f"stale, {stale:g} ms"),)
    note = "The oldest that went into each step, by the clocks of sender and receiver."
    title = "Messages from neighbours: age"
    return chart_of("age", title, "ms", curves, limits=limits, note=note, log=True)
