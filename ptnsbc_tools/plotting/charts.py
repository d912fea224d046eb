"""A recording with its verdict, as figures show it, and the figures of a flight, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.verdict import Recording, Track, Verdict, VerdictError, verdict_on
from ptnsbc_sim.verdict.encounters import Window, encounters, merged, rising
from ptnsbc_sim.verdict.error_figures import SHARE_OF_START
from ptnsbc_sim.verdict.formation_error import formation_errors
from ptnsbc_sim.verdict.recording import NANO, seconds, tolerance_of
from ptnsbc_tools.plotting.chart import (
    DASHES,
    Chart,
    Curve,
    Limit,
    Look,
    Mark,
    Points,
    Span,
    ThinnedCurves,
    Thinner,
    look,
)
from ptnsbc_tools.reading.bag_reader import ReadOptions, StatusSeries, read_recording, read_status

_BEFORE_S = 2.0  # shown of the time before the epoch

FLOOR_M = 1e-4  # of logarithmic axes
MOST_PAIRS = 24  # in one figure
_FLOOR_MS = 0.1
_MOST_LIMITS = 6  # lines of keep-outs in one figure


@dataclass(frozen=True)
class FlightView:
    """The part of a flight that is shown."""

    recording: Recording
    status: StatusSeries
    tolerance_m: float
    verdict: Verdict | None
    problem: str  # why there is no verdict, else empty
    bag: Path | None = None

    @property
    def name(self) -> str:
        """The name of the bag, or of the scenario without one."""
        if self.bag is None:
            return self.scenario.name
        return self.bag.stem if self.bag.is_file() else self.bag.resolve().name

    @property
    def scenario(self) -> Scenario:
        """The scenario as it was flown; without a verdict nobody knows who took which slot."""
        return self.recording.scenario if self.verdict is None else self.recording.flown

    @property
    def uavs(self) -> tuple[int, ...]:
        """UAVs whose odometry is recorded."""
        return tuple(uav for uav in self.scenario.uav_ids if uav in self.recording.odometry)

    def _instants(self) -> tuple[Track, int, int]:
        """The track whose stamps are the instants shown, and which of its samples they are."""
        tracks = [self.recording.odometry[uav] for uav in self.uavs]
        last = min(track.last_ns for track in tracks)
        first = max(
            min(track.first_ns for track in tracks),
            self.recording.start_ns - round(_BEFORE_S / NANO),
        )
        begin, end = tracks[0].span(first, last)
        return (tracks[0], begin, end) if end - begin > 1 else (tracks[0], 0, tracks[0].size)

    @property
    def samples(self) -> int:
        """Number of instants shown."""
        _, begin, end = self._instants()
        return end - begin

    @property
    def window_ns(self) -> Window:
        """First and last instant shown: from just before the epoch as long as every UAV is recorded."""
        track, begin, end = self._instants()
        return track.rows(begin, begin + 1).first_ns, track.rows(end - 1, end).last_ns

    def grids(self) -> Iterator[NDArray[np.int64]]:
        """Instants shown, block by block."""
        track, begin, end = self._instants()
        for block in track.blocks(begin, end):
            yield block.t_ns

    def times(self, stamps: NDArray[np.int64]) -> Array:
        """Seconds (T,) after the epoch."""
        return seconds(stamps, self.recording.start_ns)

    def seconds(self, window: Window) -> tuple[float, float]:
        """A window in seconds after the epoch."""
        begin, end = ((edge - self.recording.start_ns) * NANO for edge in window)
        return begin, end

    def avoiding(self, uav: int) -> list[Window]:
        """Spans in which a UAV was avoiding something."""
        return self._rising(uav, "avoidance_active_s")

    def deadlocks(self, uav: int) -> list[Window]:
        """Spans in which a UAV was in a deadlock."""
        return self._rising(uav, "deadlock_s")

    def _rising(self, uav: int, name: str) -> list[Window]:
        counters = self.recording.counters.get(uav)
        return [] if counters is None else merged(rising(counters, name))


def view_of(
    recording: Recording,
    status: StatusSeries,
    tolerance_m: float | None = None,
    bag: Path | None = None,
) -> FlightView:
    """Judge a recording, or say why that fails; the tolerance is that of the scenario by default."""
    limit_m = tolerance_of(recording, tolerance_m)
    try:
        verdict, problem = verdict_on(recording, limit_m), ""
    except PtnsbcError as error:
        verdict, problem = None, str(error)
    return FlightView(recording, status, limit_m, verdict, problem, bag)


def read_view(bag: Path, options: ReadOptions) -> FlightView:
    """Read a bag and judge it.

    Raises:
        PtnsbcError: no bag, cut, damaged, or without a scenario.
    """
    return view_of(read_recording(bag, options), read_status(bag), options.tolerance, bag)


def _look_of(flight: FlightView, uav: int) -> Look:
    return look(flight.scenario.uav_ids.index(uav))


def _curve_of(flight: FlightView, uav: int, t: Array, values: Array) -> Curve:
    leader = " (leader)" if uav == flight.scenario.leader.id else ""
    return Curve(f"UAV {uav}{leader}", _look_of(flight, uav), t, values, (uav,))


def _samples(flight: FlightView, track: Track | None) -> Points | None:
    """The samples of a track in the time shown, None when there are none."""
    begin, end = (0, 0) if track is None else track.span(*flight.window_ns)
    if track is None or begin == end:
        return None
    found = Thinner(end - begin)
    for block in track.blocks(begin, end):
        found.add(flight.times(block.t_ns), block.values[:, 0])
    return found.points()


def _chart(
    key: str,
    title: str,
    unit: str,
    curves: Sequence[Curve],
    *,
    log: bool = False,
    limits: tuple[Limit, ...] = (),
    marks: tuple[Mark, ...] = (),
    note: str = "",
) -> Chart | None:
    """A chart; None when it would be empty."""
    if not any(curve.t.size > 1 for curve in curves):
        return None
    return Chart(key, title, unit, tuple(curves), log, limits, marks, note=note)


# Formation errors and separations


def _excused(flight: FlightView) -> tuple[Span, ...]:
    """Times in which the error of some UAV is excused."""
    windows = encounters(flight.recording)
    found = [(one.begin_ns, one.back_ns) for uav in flight.uavs for one in windows[uav]]
    _, end = flight.seconds(flight.window_ns)
    spans = (flight.seconds(window) for window in merged(found))
    return tuple(Span(begin, min(close, end)) for begin, close in spans if begin < end)


def _leg_errors(flight: FlightView, leg: Recording) -> dict[int, Points]:
    """The error of every UAV over one leg; empty when the leg was not flown."""
    found = ThinnedCurves[int](leg.samples)
    try:
        for block in leg.blocks():
            for uav, error in formation_errors(leg, block).items():
                found.add(uav, flight.times(block.stamps), error)
    except VerdictError:
        return {}
    return found.points()


def _with_gaps(pieces: list[Points]) -> Points:
    """One curve with a gap between its pieces."""
    t = [np.append(piece.t, piece.t[-1]) for piece in pieces]
    values = [np.append(np.maximum(piece.values, FLOOR_M), np.nan) for piece in pieces]
    return Points(np.concatenate(t)[:-1], np.concatenate(values)[:-1])


def deadlines(flight: FlightView) -> tuple[Mark, ...]:
    """The deadline of each formation leg."""
    within = flight.scenario.gains.formation.deadline_s
    begun = [(t0_ns - flight.recording.start_ns) * NANO for t0_ns in flight.recording.forms]
    return tuple(
        Mark(begin + within, f"deadline {within:g} s" + (f", leg {number}" if number > 1 else ""))
        for number, begin in enumerate(begun, start=1)
    )


def errors(flight: FlightView) -> Chart | None:
    """Distance of every UAV from its place in the formation."""
    if flight.problem:
        return None
    recording = flight.recording
    numbers = range(len(recording.forms))
    legs = [_leg_errors(flight, replace(recording, leg=number)) for number in numbers]
    legs = [leg for leg in legs if leg]
    curves = [_curve_of(flight, u, *_with_gaps([leg[u] for leg in legs])) for u in flight.uavs]
    begun = [SHARE_OF_START * float(points.values[0]) for leg in legs for points in leg.values()]
    widest = max([flight.tolerance_m, *(start for start in begun if np.isfinite(start))])
    end = float(max(curve.t[-1] for curve in curves))
    return Chart(
        "errors",
        "Formation error",
        "m",
        tuple(curves),
        log=True,
        limits=(Limit(flight.tolerance_m, f"tolerance {flight.tolerance_m:g} m"),),
        marks=tuple(mark for mark in deadlines(flight) if mark.t <= end),
        band=(FLOOR_M, widest),
        band_label=f"widest band, {widest:.2f} m",
        spans=_excused(flight),
        spans_label="excused near objects",
        note="Distance from its place; of the leader, from its trajectory.",
    )


def _tightest(curves: list[Curve]) -> tuple[Curve, ...]:
    # nanmin of nothing warns; a pair without a finite distance comes last
    closest = [float(np.min(np.where(np.isfinite(c.values), c.values, np.inf))) for c in curves]
    order = sorted(range(len(curves)), key=lambda k: (closest[k], k))[:MOST_PAIRS]
    return tuple(curves[k] for k in sorted(order))


def _left_out(curves: list[Curve]) -> str:
    left = len(curves) - MOST_PAIRS
    return f"The {MOST_PAIRS} tightest of {len(curves)} pairs." if left > 0 else ""


def _positions(flight: FlightView) -> Iterator[tuple[Array, dict[int, Array]]]:
    """Times (T,) [s] and positions (T, 3) [m] of all UAVs, block by block."""
    tracks = flight.recording.odometry
    for grid in flight.grids():
        yield flight.times(grid), {uav: tracks[uav].at(grid)[:, :3] for uav in flight.uavs}


def between(flight: FlightView) -> Chart | None:
    """Distances of all pairs of UAVs."""
    ids, found = flight.scenario.uav_ids, ThinnedCurves[tuple[int, int]](flight.samples)
    for t, places in _positions(flight):
        for pair in combinations(flight.uavs, 2):
            found.add(pair, t, np.linalg.norm(places[pair[0]] - places[pair[1]], axis=1))
    curves = []
    for (a, b), points in found.points().items():
        style = Look(look(ids.index(a)).colour, (ids.index(b) - ids.index(a) - 1) % len(DASHES))
        curves.append(Curve(f"UAV {a} – {b}", style, *points, (a, b)))
    scenario = flight.scenario
    keep_outs = sorted({scenario.keep_out_between(*pair) for pair in combinations(ids, 2)})
    limits = tuple(
        Limit(keep_out, f"keep-out {keep_out:g} m") for keep_out in keep_outs[:_MOST_LIMITS]
    )
    kept, note = _tightest(curves), _left_out(curves)
    return _chart("between", "Separation between UAVs", "m", kept, limits=limits, note=note)


def obstacles(flight: FlightView) -> Chart | None:
    """Distances of all UAVs from all obstacles: from the centres of spheres, from the surfaces of all others."""
    known, found = flight.scenario.world.bodies, ThinnedCurves[tuple[int, int]](flight.samples)
    recording = flight.recording
    later_s = (recording.start_ns - recording.first_ns) * NANO  # t counts from the judged leg
    for t, places in _positions(flight):
        for uav, (number, one) in product(flight.uavs, enumerate(known)):
            found.add((uav, number), t, one.distances(places[uav], t + later_s))
    curves = []
    for (uav, number), points in found.points().items():
        style = Look(_look_of(flight, uav).colour, number % len(DASHES))
        curves.append(Curve(f"UAV {uav} – {known[number].name}", style, *points, (uav,)))
    radii = sorted({float(one.keep_out_m) for one in known})
    limits = tuple(Limit(radius, f"keep-out {radius:g} m") for radius in radii)
    kept, note = _tightest(curves), _left_out(curves)
    return _chart("obstacles", "Separation from obstacles", "m", kept, limits=limits, note=note)


# Inputs


def _inputs(flight: FlightView, columns: slice, until_s: float | None = None) -> list[Curve]:
    """The size of some columns of the wrench, of the first `until_s` seconds or of all the time shown."""
    curves = []
    first_ns, last_ns = flight.window_ns
    if until_s is not None:
        epoch_ns = flight.recording.start_ns
        first_ns = max(first_ns, epoch_ns)
        last_ns = min(last_ns, epoch_ns + round(until_s / NANO))
    for uav in flight.uavs:
        track = flight.recording.wrench.get(uav)
        begin, end = (0, 0) if track is None else track.span(first_ns, last_ns)
        if track is None or end - begin < 2:
            continue
        found = Thinner(end - begin)
        for block in track.blocks(begin, end):
            size = np.linalg.norm(block.values[:, columns], axis=1)
            found.add(flight.times(block.t_ns), size)
        curves.append(_curve_of(flight, uav, *found.points()))
    return curves


def _force_limits(flight: FlightView) -> tuple[Limit, ...]:
    scenario = flight.scenario
    vehicles = [scenario.vehicle(uav) for uav in flight.uavs]
    weights = sorted({one.mass_kg * scenario.world.gravity_m_s2 for one in vehicles})
    limits = [Limit(weight, f"weight {weight:.1f} N") for weight in weights]
    if scenario.plant.kind == "quadrotor":
        for most in sorted(
            {float(one.quadrotor.max_thrust_n) for one in vehicles if one.quadrotor}
        ):
            limits.append(Limit(most, f"most the rotors give, {most:.1f} N"))
    return tuple(limits[:_MOST_LIMITS])


def force(flight: FlightView) -> Chart | None:
    """Size of the commanded force."""
    curves = _inputs(flight, slice(0, 3))
    return _chart("force", "Input: force", "N", curves, limits=_force_limits(flight))


def force_first(flight: FlightView) -> Chart | None:
    """The commanded force of the first second; a law that starts far from its goal jumps there."""
    curves = _inputs(flight, slice(0, 3), 1.0)
    limits = _force_limits(flight)
    return _chart("force-first", "Input: force, first second", "N", curves, limits=limits)


def torque(flight: FlightView) -> Chart | None:
    """Size of the commanded torque."""
    return _chart("torque", "Input: torque", "N m", _inputs(flight, slice(3, 6)))


def torque_first(flight: FlightView) -> Chart | None:
    """The commanded torque of the first second."""
    curves = _inputs(flight, slice(3, 6), 1.0)
    return _chart("torque-first", "Input: torque, first second", "N m", curves)


# Estimator, gain, conditioning, ticks, latency, links


def estimator(flight: FlightView) -> Chart | None:
    """Error of each follower's estimate of the leader's position."""
    leader_id = flight.scenario.leader.id
    if leader_id not in flight.uavs:
        return None
    tracks = flight.recording.estimate
    estimates = {uav: tracks[uav] for uav in flight.scenario.followers if uav in tracks}
    truth = flight.recording.odometry[leader_id]
    found = ThinnedCurves[int](flight.samples)
    for grid in flight.grids():
        leader = truth.at(grid)[:, :3]
        for uav, track in estimates.items():
            error = np.linalg.norm(track.at(grid)[:, :3] - leader, axis=1)
            found.add(uav, flight.times(grid), np.maximum(error, FLOOR_M))
    curves = [_curve_of(flight, uav, *points) for uav, points in found.points().items()]
    deadline = flight.scenario.gains.estimator.deadline_s
    marks = (Mark(deadline, f"its deadline {deadline:g} s"),)
    return _chart("estimator", "Error of the estimated leader", "m", curves, marks=marks, log=True)


def _planner_values(flight: FlightView, key: str) -> list[Curve]:
    curves = []
    for uav in flight.uavs:
        points = _samples(flight, flight.status.planner.get(uav, {}).get(key))
        if points is not None:
            curves.append(_curve_of(flight, uav, *points))
    return curves


def gain(flight: FlightView) -> Chart | None:
    """Gain of the formation loop: the time base until the deadline, kappa after it."""
    deadline = flight.scenario.gains.formation.deadline_s
    marks = (Mark(deadline, f"deadline {deadline:g} s"),)
    curves = _planner_values(flight, "gain")
    return _chart("gain", "Gain of the formation loop", "1/s", curves, marks=marks)


def conditioning(flight: FlightView) -> Chart | None:
    """Smallest singular value of each task; near zero the task has no solution."""
    curves = _planner_values(flight, "sigma_min")
    return _chart("conditioning", "Smallest singular value of the task", "", curves)


def missed(flight: FlightView) -> Chart | None:
    """Ticks missed since the epoch."""
    curves = [
        replace(curve, values=curve.values - curve.values[0])
        for curve in _planner_values(flight, "missed_ticks")
    ]
    if not any(curve.values.any() for curve in curves):
        return None
    return _chart("missed", "Missed ticks", "", curves)


def latency(flight: FlightView) -> Chart | None:
    """Age of the wrenches when they reach the simulator."""
    curves = []
    for number, name in enumerate(("p50", "p99", "max")):
        points = _samples(flight, flight.status.sim.get(f"latency_{name}_ms"))
        if points is not None and points.values.any():
            curves.append(Curve(name, look(number), *points, ()))
    period = 1e3 / flight.scenario.timing.control_hz
    limits = (Limit(period, f"control period {period:g} ms"),)
    note = "Age of a wrench when it arrives; percentiles since the start."
    return _chart("latency", "Latency of the loop", "ms", curves, limits=limits, note=note)


def age(flight: FlightView) -> Chart | None:
    """Age of the oldest message of a neighbour that went into each step."""
    curves = []
    for uav in flight.uavs:
        points = _samples(flight, flight.status.age_ms.get(uav))
        if points is not None:
            curves.append(_curve_of(flight, uav, points.t, np.maximum(points.values, _FLOOR_MS)))
    stale = 1e3 * flight.scenario.communication.stale_s
    limits = (Limit(stale, f"stale, {stale:g} ms"),)
    note = "The oldest that went into each step, by the clocks of sender and receiver."
    title = "Messages from neighbours: age"
    return _chart("age", title, "ms", curves, limits=limits, note=note, log=True)


CHARTS: dict[str, Callable[[FlightView], Chart | None]] = {
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


def charts(flight: FlightView) -> Iterator[Chart]:
    """All figures for which data is recorded."""
    for make in CHARTS.values() if flight.uavs else ():
        chart = make(flight)
        if chart is not None:
            yield chart
