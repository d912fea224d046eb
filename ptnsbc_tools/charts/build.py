"""The figures of a flight: errors, inputs, separations, estimator, gain, timing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import combinations, product

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_tools.charts.chart import Chart, Curve, Limit, Mark, Span
from ptnsbc_tools.charts.flight import Shown
from ptnsbc_tools.charts.style import DASHES, Look, look
from ptnsbc_tools.limits import SHARE_OF_START
from ptnsbc_tools.verdict import Series
from ptnsbc_tools.verdict.deadline import formation_errors
from ptnsbc_tools.verdict.windows import encounters, joined

FLOOR_M = 1e-4  # of logarithmic axes
_FLOOR_MS = 0.1
MOST_PAIRS = 24  # in one figure; the tightest


def _label(flight: Shown, uav: int) -> str:
    return f"UAV {uav} (leader)" if uav == flight.scenario.leader_id else f"UAV {uav}"


def _look(flight: Shown, uav: int) -> Look:
    return look(flight.scenario.uav_ids.index(uav))


def _curve(flight: Shown, uav: int, t: Array, values: Array) -> Curve:
    return Curve(_label(flight, uav), _look(flight, uav), t, values, (uav,))


def _spans(flight: Shown) -> tuple[Span, ...]:
    """Time in which the error of anybody is excused."""
    counters = flight.recording.counters
    found = [w for uav in flight.uavs for w in encounters(flight.scenario, counters, uav)]
    end = float(flight.times(flight.grid()[-1:])[0])
    spans = (flight.seconds(window) for window in joined(found))
    return tuple(Span(begin, min(close, end)) for begin, close in spans if begin < end)


def errors(flight: Shown) -> Chart | None:
    """Distance of every UAV from its place."""
    if flight.problem:
        return None
    grid = flight.recording.grid()
    positions = flight.recording.positions(grid)
    found = formation_errors(flight.recording, grid, positions)
    t = flight.times(grid)
    starts = [SHARE_OF_START * float(e[0]) for e in found.values() if np.isfinite(e[0])]
    widest = max([flight.tolerance_m, *starts])
    deadline = flight.scenario.gains.formation.deadline_s
    return Chart(
        "errors",
        "Formation error",
        "m",
        tuple(_curve(flight, uav, t, np.maximum(e, FLOOR_M)) for uav, e in found.items()),
        log=True,
        limits=(Limit(flight.tolerance_m, f"tolerance {flight.tolerance_m:g} m"),),
        marks=(Mark(deadline, f"deadline {deadline:g} s"),),
        band=(FLOOR_M, widest),
        spans=_spans(flight),
        note=f"Distance from its place; of the leader, from its trajectory. Green: widest band, "
        f"{widest:.2f} m. Grey: somebody keeps clear of something, or has just done so.",
    )


def _inputs(flight: Shown, columns: slice, until_s: float | None) -> tuple[Curve, ...]:
    curves = []
    grid = flight.grid()
    for uav in flight.uavs:
        series = flight.recording.wrench.get(uav)
        if series is None:
            continue
        inside = (series.t_ns >= grid[0]) & (series.t_ns <= grid[-1])
        t = flight.times(series.t_ns[inside])
        size = np.linalg.norm(series.values[inside][:, columns], axis=1)
        chosen = slice(None) if until_s is None else (t >= 0) & (t <= until_s)
        if t[chosen].size > 1:
            curves.append(_curve(flight, uav, t[chosen], size[chosen]))
    return tuple(curves)


def _force_limits(flight: Shown) -> tuple[Limit, ...]:
    scenario = flight.scenario
    weight = scenario.mass_kg * scenario.gravity_m_s2
    limits = [Limit(weight, f"weight {weight:.1f} N")]
    rotors = scenario.file.plant.quadrotor
    if scenario.plant_kind == "quadrotor" and rotors is not None:
        most = float(rotors.max_thrust_n)
        limits.append(Limit(most, f"most the rotors give, {most:.1f} N"))
    return tuple(limits)


def force(flight: Shown) -> Chart | None:
    """Size of the commanded force."""
    curves = _inputs(flight, slice(0, 3), None)
    return _chart("force", "Input: force", "N", curves, limits=_force_limits(flight))


def force_first(flight: Shown) -> Chart | None:
    """The first second of it, in which a law that is armed far from its goal shows its jump."""
    curves = _inputs(flight, slice(0, 3), 1.0)
    limits = _force_limits(flight)
    return _chart("force-first", "Input: force, first second", "N", curves, limits=limits)


def torque(flight: Shown) -> Chart | None:
    """Size of the commanded torque."""
    return _chart("torque", "Input: torque", "N m", _inputs(flight, slice(3, 6), None))


def torque_first(flight: Shown) -> Chart | None:
    """The first second of it."""
    curves = _inputs(flight, slice(3, 6), 1.0)
    return _chart("torque-first", "Input: torque, first second", "N m", curves)


def _tightest(curves: list[Curve]) -> tuple[Curve, ...]:
    # nanmin of nothing warns; a pair without a number is the least interesting
    closest = [float(np.min(np.where(np.isfinite(c.values), c.values, np.inf))) for c in curves]
    order = sorted(range(len(curves)), key=lambda k: (closest[k], k))[:MOST_PAIRS]
    return tuple(curves[k] for k in sorted(order))


def _left_out(curves: list[Curve]) -> str:
    left = len(curves) - MOST_PAIRS
    return f"The {MOST_PAIRS} tightest of {len(curves)} pairs." if left > 0 else ""


def between(flight: Shown) -> Chart | None:
    """Distances of all pairs of UAVs."""
    grid = flight.grid()
    t, ids = flight.times(grid), flight.scenario.uav_ids
    places = {uav: flight.recording.odometry[uav].at(grid)[:, :3] for uav in flight.uavs}
    curves = []
    for a, b in combinations(flight.uavs, 2):
        distance = np.linalg.norm(places[a] - places[b], axis=1)
        style = Look(look(ids.index(a)).colour, (ids.index(b) - ids.index(a) - 1) % len(DASHES))
        curves.append(Curve(f"UAV {a} – {b}", style, t, distance, (a, b)))
    keep_out = flight.scenario.uav_keep_out_m
    limits = (Limit(keep_out, f"keep-out {keep_out:g} m"),)
    kept, note = _tightest(curves), _left_out(curves)
    return _chart("between", "Separation between UAVs", "m", kept, limits=limits, note=note)


def obstacles(flight: Shown) -> Chart | None:
    """Distances of all UAVs from the centres of all obstacles."""
    grid = flight.grid()
    t, found = flight.times(grid), flight.scenario.obstacles
    curves = []
    for uav, (number, obstacle) in product(flight.uavs, enumerate(found)):
        place = flight.recording.odometry[uav].at(grid)[:, :3]
        distance = np.linalg.norm(place - obstacle.position, axis=1)
        style = Look(_look(flight, uav).colour, number % len(DASHES))
        curves.append(Curve(f"UAV {uav} – {obstacle.name}", style, t, distance, (uav,)))
    radii = sorted({float(obstacle.keep_out_m) for obstacle in found})
    limits = tuple(Limit(radius, f"keep-out {radius:g} m") for radius in radii)
    kept, note = _tightest(curves), _left_out(curves)
    return _chart("obstacles", "Separation from obstacles", "m", kept, limits=limits, note=note)


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
            curves.append(_curve(flight, uav, flight.times(grid), np.maximum(error, FLOOR_M)))
    deadline = flight.scenario.gains.estimator.deadline_s
    marks = (Mark(deadline, f"its deadline {deadline:g} s"),)
    return _chart("estimator", "Error of the estimated leader", "m", curves, marks=marks, log=True)


def _told(flight: Shown, key: str) -> list[Curve]:
    curves = []
    for uav in flight.uavs:
        series = flight.status.planner.get(uav, {}).get(key)
        if series is not None:
            t, values = _in_time(flight, series)
            curves.append(_curve(flight, uav, t, values))
    return curves


def _in_time(flight: Shown, series: Series) -> tuple[Array, Array]:
    grid = flight.grid()
    inside = (series.t_ns >= grid[0]) & (series.t_ns <= grid[-1])
    return flight.times(series.t_ns[inside]), series.values[inside, 0]


def gain(flight: Shown) -> Chart | None:
    """Gain of the formation loop: the time base until the deadline, kappa after it."""
    deadline = flight.scenario.gains.formation.deadline_s
    marks = (Mark(deadline, f"deadline {deadline:g} s"),)
    return _chart("gain", "Gain of the formation loop", "1/s", _told(flight, "gain"), marks=marks)


def conditioning(flight: Shown) -> Chart | None:
    """Smallest singular value of each task: near zero the task cannot be solved."""
    curves = _told(flight, "sigma_min")
    return _chart("conditioning", "Smallest singular value of the task", "", curves)


def missed(flight: Shown) -> Chart | None:
    """Ticks missed since the epoch."""
    curves = []
    for curve in _told(flight, "missed_ticks"):
        if curve.values.size:
            gained = curve.values - curve.values[0]
            curves.append(Curve(curve.label, curve.look, curve.t, gained, curve.uavs))
    if not any(curve.values.any() for curve in curves):
        return None
    return _chart("missed", "Missed ticks", "", curves)


def latency(flight: Shown) -> Chart | None:
    """Age of the wrenches that reach the simulator."""
    curves = []
    for number, name in enumerate(("p50", "p99", "max")):
        series = flight.status.sim.get(f"latency_{name}_ms")
        if series is not None and series.values.any():
            t, values = _in_time(flight, series)
            curves.append(Curve(name, look(number), t, values, ()))
    period = 1e3 / flight.scenario.control_hz
    limits = (Limit(period, f"control period {period:g} ms"),)
    note = "Age of a wrench when it arrives; percentiles since the start."
    return _chart("latency", "Latency of the loop", "ms", curves, limits=limits, note=note)


def age(flight: Shown) -> Chart | None:
    """How old what a UAV knew of its neighbours was, step by step."""
    curves = []
    for uav in flight.uavs:
        if uav in flight.status.age_ms:
            t, values = _in_time(flight, flight.status.age_ms[uav])
            curves.append(_curve(flight, uav, t, np.maximum(values, _FLOOR_MS)))
    stale = 1e3 * flight.scenario.file.communication.stale_s
    limits = (Limit(stale, f"stale, {stale:g} ms"),)
    note = "The oldest that went into each step, by the clocks of sender and receiver."
    title = "Messages from neighbours: age"
    return _chart("age", title, "ms", curves, limits=limits, note=note, log=True)


def _chart(
    key: str,
    title: str,
    unit: str,
    curves: list[Curve] | tuple[Curve, ...],
    *,
    log: bool = False,
    limits: tuple[Limit, ...] = (),
    marks: tuple[Mark, ...] = (),
    note: str = "",
) -> Chart | None:
    if not any(curve.t.size > 1 for curve in curves):
        return None
    return Chart(key, title, unit, tuple(curves), log, limits, marks, note=note)


CHARTS: dict[str, Callable[[Shown], Chart | None]] = {
    "errors": errors,
    "force": force,
    "force-first": force_first,
    "torque": torque,
    "torque-first": torque_first,
    "between": between,
    "obstacles": obstacles,
    "estimator": estimator,
    "gain": gain,
    "conditioning": conditioning,
    "missed": missed,
    "latency": latency,
    "age": age,
}


def charts(flight: Shown) -> Iterator[Chart]:
    """All figures for which something was recorded."""
    if not flight.uavs:
        return
    for make in CHARTS.values():
        chart = make(flight)
        if chart is not None:
            yield chart
