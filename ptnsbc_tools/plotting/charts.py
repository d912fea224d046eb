"""A recording with its verdict, as figures show it, and the figures of a flight, by name."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.verdict import Recording, Track, Verdict, VerdictError, verdict_on
from ptnsbc_sim.verdict.encounters import Window, encounters, merged, rising
from ptnsbc_sim.verdict.error_figures import SHARE_OF_START
from ptnsbc_sim.verdict.formation_error import formation_errors
from ptnsbc_sim.verdict.recording import seconds_since, tolerance_of
from ptnsbc_tools.reading.bag_reader import StatusSeries

# The palette of Okabe and Ito, for all common kinds of colour blindness. On a dark page black and the darkest
# blue would be invisible.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#000000", "#F0E442")
DARK_COLOURS = (
    "#4DA6E0", "#E69F00", "#2BBF95", "#F07B2E", "#DD93BB", "#8CD0F5", "#E8E8E8", "#F0E442"
)  # fmt: skip
DASHES = ("-", "--", "-.", ":")
_OTHER_DASH = 3  # of another flight: dots
OBSTACLE = "#7F7F7F"
GOOD = "#009E73"

_IN_MEMORY = 20_000  # points of a curve; no figure shows more


class Look(NamedTuple):
    """The style of one curve."""

    colour: int  # index into COLOURS
    dash: int  # index into DASHES


def look(index: int) -> Look:
    """Colour and dash of UAV number `index`; dashes distinguish UAVs of the same colour."""
    return Look(index % len(COLOURS), (index // len(COLOURS)) % len(DASHES))


@dataclass(frozen=True)
class Curve:
    """One quantity over time."""

    label: str
    look: Look
    t: Array  # (T,) [s] after the epoch
    values: Array  # (T,)
    uavs: tuple[int, ...]  # UAVs that it shows; hidden with any of them
    other: bool = False  # of another flight, drawn beside this one


class Limit(NamedTuple):
    """A horizontal line: an upper or lower limit."""

    value: float
    label: str


class Mark(NamedTuple):
    """A vertical line."""

    t: float  # [s] after the epoch
    label: str


@dataclass(frozen=True)
class Chart:
    """The content of one set of axes."""

    key: str  # name on the command line and of its file
    title: str
    unit: str
    curves: tuple[Curve, ...]
    log: bool = False
    limits: tuple[Limit, ...] = ()
    marks: tuple[Mark, ...] = ()
    band: tuple[float, float] | None = None  # good values
    band_label: str = ""
    spans: tuple[
        tuple[float, float], ...
    ] = ()  # times [s] in which the error of some UAV is excused
    spans_label: str = ""
    note: str = ""

    @property
    def quantity(self) -> str:
        """The label of the vertical axis."""
        name = self.title.split(":")[-1].split(",")[0].strip()
        return name[:1].lower() + name[1:]


def overlaid(charts: Sequence[Chart], others: Sequence[Chart], name: str) -> list[Chart]:
    """The charts with the curves of another flight in the charts of the same key: in the same colours, dotted."""
    by_key, both = {chart.key: chart for chart in others}, []
    for chart in charts:
        if other := by_key.get(chart.key):
            curves = [
                replace(
                    curve,
                    label=f"{curve.label}, {name}",
                    look=Look(curve.look.colour, (curve.look.dash + _OTHER_DASH) % len(DASHES)),
                    other=True,
                )
                for curve in other.curves
            ]
            note = f"{chart.note} Dotted, in the same colours: {name}.".strip()
            chart = replace(chart, curves=(*chart.curves, *curves), note=note)
        both.append(chart)
    return both


class Points(NamedTuple):
    """Samples of one quantity."""

    t: Array  # (P,) [s]
    values: Array  # (P,)


class Thinner:
    """Reduces a curve of `total` samples, which arrives block by block, to the extremes of each of many spans.

    A span that has NaN or infinity in it keeps the first of these too, so that a gap stays a gap.
    """

    def __init__(self, total: int, points: int = _IN_MEMORY) -> None:
        self._short = total <= points
        self._edges = np.linspace(0, total, max((points - 2) // 3, 2) + 1).astype(np.int64)
        self._total = total
        self._taken = 0  # samples of complete spans
        self._open = Points(np.empty(0), np.empty(0))  # samples of the incomplete span
        self._parts: list[Points] = []

    def add(self, t: Array, values: Array) -> None:
        """Take the next samples (T,) [s] and (T,), ascending."""
        if self._short:
            self._parts.append(Points(t, values))
            return
        held = Points(np.append(self._open.t, t), np.append(self._open.values, values))
        seen = self._taken + held.t.size
        first, last = np.searchsorted(self._edges, (self._taken, seen), side="right") - 1
        done = int(self._edges[last]) - self._taken
        if done:
            kept = _extremes(held.values, self._edges[first : last + 1] - self._taken)
            # Both ends of the curve are kept too.
            kept |= {0} if self._taken == 0 else set()
            kept |= {done - 1} if seen == self._total else set()
            chosen = np.array(sorted(kept), dtype=np.int64)
            self._parts.append(Points(held.t[chosen], held.values[chosen]))
        self._open = Points(held.t[done:], held.values[done:])
        self._taken += done

    def points(self) -> Points:
        """The points that are kept."""
        t, values = zip(*self._parts, strict=True)
        return Points(np.concatenate(t), np.concatenate(values))


def thin(t: Array, values: Array, points: int) -> Points:
    """At most `points` points of a curve (T,) [s] and (T,), see `Thinner`."""
    if t.size <= points:
        return Points(t, values)
    thinner = Thinner(t.size, points)
    thinner.add(t, values)
    return thinner.points()


def _extremes(values: Array, edges: NDArray[np.int64]) -> set[int]:
    """Indices of the smallest, the largest and the first non-finite value of each span."""
    kept = set()
    for begin, end in pairwise(edges.tolist()):
        part = values[begin:end]
        bad = np.flatnonzero(~np.isfinite(part))
        if bad.size:
            kept.add(begin + int(bad[0]))
        if bad.size < part.size:
            kept |= {begin + int(np.nanargmin(part)), begin + int(np.nanargmax(part))}
    return kept


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
            self.recording.start_ns - nanoseconds(_BEFORE_S),
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
        return seconds_since(stamps, self.recording.start_ns)

    def seconds(self, window: Window) -> tuple[float, float]:
        """A window in seconds after the epoch."""
        begin, end = (seconds(edge - self.recording.start_ns) for edge in window)
        return begin, end

    def rising(self, uav: int, name: str) -> list[tuple[float, float]]:
        """Spans [s] in which a counter of a UAV rises, one of `COUNTERS`."""
        counters = self.recording.counters.get(uav)
        windows = [] if counters is None else merged(rising(counters, name))
        return [self.seconds(window) for window in windows]


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


def _chart(key: str, title: str, unit: str, curves: Sequence[Curve], **more: Any) -> Chart | None:
    """A chart, `more` of its fields by name; None when it would be empty."""
    shown = any(curve.t.size > 1 for curve in curves)
    return Chart(key, title, unit, tuple(curves), **more) if shown else None


# Formation errors and separations


def _leg_errors(flight: FlightView, leg: Recording) -> dict[int, Points]:
    """The error of every UAV over one leg; empty when the leg was not flown."""
    curves = defaultdict[int, Thinner](lambda: Thinner(leg.samples))
    try:
        for block in leg.blocks():
            for uav, error in formation_errors(leg, block).items():
                curves[uav].add(flight.times(block.stamps), error)
    except VerdictError:
        return {}
    return {uav: curve.points() for uav, curve in curves.items()}


def deadlines(flight: FlightView) -> tuple[Mark, ...]:
    """The deadline of each formation leg."""
    within = flight.scenario.gains.formation.deadline_s
    begun = [seconds(t0_ns - flight.recording.start_ns) for t0_ns in flight.recording.forms]
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
    curves, windows = [], encounters(recording)
    for uav in flight.uavs:  # with a gap between legs
        pieces = [leg[uav] for leg in legs]
        t = [np.append(piece.t, piece.t[-1]) for piece in pieces]
        values = [np.append(np.maximum(piece.values, FLOOR_M), np.nan) for piece in pieces]
        curves.append(_curve_of(flight, uav, np.concatenate(t)[:-1], np.concatenate(values)[:-1]))
    near = merged((one.begin_ns, one.back_ns) for uav in flight.uavs for one in windows[uav])
    shown_s = flight.seconds(flight.window_ns)[1]
    excused = (flight.seconds(window) for window in near)
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
        spans=tuple((a, min(b, shown_s)) for a, b in excused if a < shown_s),
        spans_label="excused near objects",
        note="Distance from its place; of the leader, from its trajectory.",
    )


def _distances(
    key: str, title: str, curves: list[Curve], keep_outs: Iterable[float]
) -> Chart | None:
    """A chart of the tightest pairs, with the keep-outs as limits."""
    # nanmin of nothing warns; a pair without a finite distance comes last
    closest = [float(np.min(np.where(np.isfinite(c.values), c.values, np.inf))) for c in curves]
    order = sorted(range(len(curves)), key=lambda k: (closest[k], k))[:MOST_PAIRS]
    left_out = f"The {MOST_PAIRS} tightest of {len(curves)} pairs."
    return _chart(
        key,
        title,
        "m",
        [curves[k] for k in sorted(order)],
        limits=tuple(Limit(radius, f"keep-out {radius:g} m") for radius in sorted(set(keep_outs))),
        note=left_out if len(curves) > MOST_PAIRS else "",
    )


def _positions(flight: FlightView) -> Iterator[tuple[Array, dict[int, Array]]]:
    """Times (T,) [s] and positions (T, 3) [m] of all UAVs, block by block."""
    tracks = flight.recording.odometry
    for grid in flight.grids():
        yield flight.times(grid), {uav: tracks[uav].at(grid)[:, :3] for uav in flight.uavs}


def between(flight: FlightView) -> Chart | None:
    """Distances of all pairs of UAVs."""
    ids = flight.scenario.uav_ids
    thinners = defaultdict[tuple[int, int], Thinner](lambda: Thinner(flight.samples))
    for t, places in _positions(flight):
        for a, b in combinations(flight.uavs, 2):
            thinners[a, b].add(t, np.linalg.norm(places[a] - places[b], axis=1))
    curves = []
    for (a, b), thinner in thinners.items():
        style = Look(look(ids.index(a)).colour, (ids.index(b) - ids.index(a) - 1) % len(DASHES))
        curves.append(Curve(f"UAV {a} – {b}", style, *thinner.points(), (a, b)))
    keep_outs = {flight.scenario.keep_out_between(*pair) for pair in combinations(ids, 2)}
    shown = sorted(keep_outs)[:_MOST_LIMITS]
    return _distances("between", "Separation between UAVs", curves, shown)


def obstacles(flight: FlightView) -> Chart | None:
    """Distances of all UAVs from all obstacles: from the centres of spheres, from the surfaces of all others."""
    bodies = flight.scenario.world.bodies
    thinners = defaultdict[tuple[int, int], Thinner](lambda: Thinner(flight.samples))
    recording = flight.recording
    later_s = seconds(recording.start_ns - recording.first_ns)  # t counts from the judged leg
    for t, places in _positions(flight):
        for uav, (number, body) in product(flight.uavs, enumerate(bodies)):
            thinners[uav, number].add(t, body.distances(places[uav], t + later_s))
    curves = []
    for (uav, number), thinner in thinners.items():
        style = Look(_look_of(flight, uav).colour, number % len(DASHES))
        name = f"UAV {uav} – {bodies[number].name}"
        curves.append(Curve(name, style, *thinner.points(), (uav,)))
    radii = (float(body.keep_out_m) for body in bodies)
    return _distances("obstacles", "Separation from obstacles", curves, radii)


# Inputs


def _input(flight: FlightView, kind: str, until_s: float | None = None) -> Chart | None:
    """The size of the commanded force or torque, of the first second or of all the time shown."""
    columns, unit = (slice(0, 3), "N") if kind == "force" else (slice(3, 6), "N m")
    curves = []
    first_ns, last_ns = flight.window_ns
    if until_s is not None:
        epoch_ns = flight.recording.start_ns
        first_ns = max(first_ns, epoch_ns)
        last_ns = min(last_ns, epoch_ns + nanoseconds(until_s))
    for uav in flight.uavs:
        track = flight.recording.wrench.get(uav)
        begin, end = (0, 0) if track is None else track.span(first_ns, last_ns)
        if track is None or end - begin < 2:
            continue
        thinner = Thinner(end - begin)
        for block in track.blocks(begin, end):
            size = np.linalg.norm(block.values[:, columns], axis=1)
            thinner.add(flight.times(block.t_ns), size)
        curves.append(_curve_of(flight, uav, *thinner.points()))
    limits = _force_limits(flight) if kind == "force" else ()
    key, when = (kind, "") if until_s is None else (f"{kind}-first", ", first second")
    return _chart(key, f"Input: {kind}{when}", unit, curves, limits=limits)


def _force_limits(flight: FlightView) -> tuple[Limit, ...]:
    scenario = flight.scenario
    vehicles = [scenario.vehicle(uav) for uav in flight.uavs]
    weights = {one.mass_kg * scenario.world.gravity_m_s2 for one in vehicles}
    limits = [Limit(weight, f"weight {weight:.1f} N") for weight in sorted(weights)]
    if scenario.plant.kind == "quadrotor":
        largest = {float(one.quadrotor.max_thrust_n) for one in vehicles if one.quadrotor}
        limits += [Limit(most, f"most the rotors give, {most:.1f} N") for most in sorted(largest)]
    return tuple(limits[:_MOST_LIMITS])


# Estimator, gain, conditioning, ticks, latency, links


def estimator(flight: FlightView) -> Chart | None:
    """Error of each follower's estimate of the leader's position."""
    leader_id = flight.scenario.leader.id
    if leader_id not in flight.uavs:
        return None
    tracks = flight.recording.estimate
    estimates = {uav: tracks[uav] for uav in flight.scenario.followers if uav in tracks}
    truth = flight.recording.odometry[leader_id]
    thinners = defaultdict[int, Thinner](lambda: Thinner(flight.samples))
    for grid in flight.grids():
        leader = truth.at(grid)[:, :3]
        for uav, track in estimates.items():
            error = np.linalg.norm(track.at(grid)[:, :3] - leader, axis=1)
            thinners[uav].add(flight.times(grid), np.maximum(error, FLOOR_M))
    curves = [_curve_of(flight, uav, *thinner.points()) for uav, thinner in thinners.items()]
    deadline = flight.scenario.gains.estimator.deadline_s
    marks = (Mark(deadline, f"its deadline {deadline:g} s"),)
    return _chart("estimator", "Error of the estimated leader", "m", curves, marks=marks, log=True)


def _curves_of(flight: FlightView, tracks: Mapping[int, Track | None]) -> list[Curve]:
    """The curves of the UAVs that have samples in the time shown."""
    points = {uav: _samples(flight, tracks.get(uav)) for uav in flight.uavs}
    return [_curve_of(flight, uav, *of) for uav, of in points.items() if of is not None]


def _planner_values(flight: FlightView, key: str) -> list[Curve]:
    planner = flight.status.planner
    return _curves_of(flight, {uav: tracks.get(key) for uav, tracks in planner.items()})


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
    curves = [
        replace(curve, values=np.maximum(curve.values, _FLOOR_MS))
        for curve in _curves_of(flight, flight.status.age_ms)
    ]
    stale = 1e3 * flight.scenario.communication.stale_s
    limits = (Limit(stale, f"stale, {stale:g} ms"),)
    note = "The oldest that went into each step, by the clocks of sender and receiver."
    title = "Messages from neighbours: age"
    return _chart("age", title, "ms", curves, limits=limits, note=note, log=True)


CHARTS: dict[str, Callable[[FlightView], Chart | None]] = {
    "errors": errors,
    "force": partial(_input, kind="force"),
    # A law that starts far from its goal jumps in the first second.
    "force-first": partial(_input, kind="force", until_s=1.0),
    "torque": partial(_input, kind="torque"),
    "torque-first": partial(_input, kind="torque", until_s=1.0),
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
