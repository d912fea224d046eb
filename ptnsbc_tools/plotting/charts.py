"""A recording with its verdict, as figures show it, and the figures of a flight, by name."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.legs import FIRST, LandLeg
from ptnsbc_sim.verdict import Recording, Track, Verdict, VerdictError, verdict_on
from ptnsbc_sim.verdict.encounters import Window, encounters, merged, rising
from ptnsbc_sim.verdict.error_figures import SHARE_OF_START
from ptnsbc_sim.verdict.formation_error import formation_errors
from ptnsbc_sim.verdict.recording import FORMATION, seconds_since, tolerance_of
from ptnsbc_sim.verdict.track import lengths
from ptnsbc_sim.verdict.verdict import legs_without_deadline
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

_POINTS = 3000  # of a curve: the extremes of a thousand spans, as many as a figure has pixels


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
    floor: float = 0.0  # lower end of the vertical axis; above zero the axis is logarithmic
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


_Key = TypeVar("_Key")


def thinned(
    total: int, blocks: Iterable[tuple[Array, Mapping[_Key, Array]]], points: int = _POINTS
) -> dict[_Key, Points]:
    """Curves of `total` samples, which arrive block by block, reduced to the extremes of each of many spans.

    A block is times (T,) [s], ascending, and values (T,) of each curve. A span that has NaN or infinity in it keeps the
    first of these too, so that a gap stays a gap.
    """
    spans = max((points - 2) // 3, 1)  # three points of each, and both ends
    span = 1 if total <= points else -(-total // spans)
    parts = defaultdict[_Key, list[Points]](list)
    for t, values in blocks:
        for key, of_key in values.items():
            kept = _extremes(of_key, span) if span > 1 and t.size else slice(None)
            parts[key].append(Points(t[kept], of_key[kept]))
    return {
        key: Points(*map(np.concatenate, zip(*pieces, strict=True)))
        for key, pieces in parts.items()
    }


def _extremes(values: Array, span: int) -> NDArray[np.int64]:
    """Indices of both ends, and of the smallest, the largest and the first non-finite value of each span."""
    begins = np.arange(0, values.size, span)
    rows = np.full((begins.size, span), np.nan)
    rows.flat[: values.size] = values
    finite = np.isfinite(rows)
    outside = np.arange(rows.size).reshape(rows.shape) >= values.size
    bad = np.argmax(~finite & ~outside, axis=1)
    kept = [
        (begins + bad)[(~finite & ~outside).any(axis=1)],
        *(
            (begins + np.argmin(np.where(finite, sign * rows, np.inf), axis=1))[finite.any(axis=1)]
            for sign in (1.0, -1.0)
        ),
        [0, values.size - 1],
    ]
    return np.unique(np.concatenate(kept).astype(np.int64))


_BEFORE_S = 2.0  # shown of the time before the epoch

FLOOR_M = 1e-4  # of logarithmic axes
MOST_DISTANCES = 24  # in one figure
_FLOOR_MS = 0.1
_NEAR_M = 0.1  # of an axis that reaches from keep-outs to obstacles far away
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
    _made: dict[str, Chart | None] = field(default_factory=dict, repr=False, compare=False)

    def chart(self, key: str) -> Chart | None:
        """The figure of this name in `CHARTS`; None without data for it."""
        if key not in self._made:
            self._made[key] = CHARTS[key](self) if self.uavs else None
        return self._made[key]

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

    @cached_property
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
        return self._instants[2] - self._instants[1]

    @property
    def window_ns(self) -> Window:
        """First and last instant shown: from just before the epoch as long as every UAV is recorded."""
        track, begin, end = self._instants
        return track.rows(begin, begin + 1).first_ns, track.rows(end - 1, end).last_ns

    def grids(self) -> Iterator[NDArray[np.int64]]:
        """Instants shown, block by block."""
        track, begin, end = self._instants
        return (block.t_ns for block in track.blocks(begin, end))

    def times(self, stamps: NDArray[np.int64]) -> Array:
        """Seconds (T,) after the epoch."""
        return seconds_since(stamps, self.recording.start_ns)

    def seconds(self, window: Window) -> tuple[float, float]:
        """A window in seconds after the epoch."""
        begin, end = (seconds(edge - self.recording.start_ns) for edge in window)
        return begin, end

    def rising(self, uav: int, name: str) -> list[tuple[float, float]]:
        """Spans [s] in which a counter of a UAV rises, one of `COUNTERS`."""
        windows = rising(self.recording.counters, name).get(uav, [])
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


def _curve_of(flight: FlightView, uav: int, t: Array, values: Array) -> Curve:
    scenario = flight.scenario
    leader = " (leader)" if uav == scenario.leader.id else ""
    return Curve(f"UAV {uav}{leader}", look(scenario.uav_ids.index(uav)), t, values, (uav,))


def _samples(
    flight: FlightView, track: Track | None, size: Callable[[Array], Array]
) -> Points | None:
    """The sizes of the rows of a track in the time shown, None when there are none."""
    begin, end = (0, 0) if track is None else track.span(*flight.window_ns)
    if track is None or begin == end:
        return None
    blocks = track.blocks(begin, end)
    sizes = ((flight.times(block.t_ns), {0: size(block.values)}) for block in blocks)
    return thinned(end - begin, sizes)[0]


def _only(rows: Array) -> Array:
    """The values of a track of one column."""
    return rows[:, 0]


def _curves_of(
    flight: FlightView, tracks: Mapping[int, Track], size: Callable[[Array], Array] = _only
) -> list[Curve]:
    """The curves of the UAVs that have samples in the time shown."""
    points = {uav: _samples(flight, tracks.get(uav), size) for uav in flight.uavs}
    return [_curve_of(flight, uav, *of) for uav, of in points.items() if of is not None]


def _chart(key: str, title: str, unit: str, curves: Sequence[Curve], **more: Any) -> Chart | None:
    """A chart, `more` of its fields by name; None when it would be empty."""
    shown = any(curve.t.size > 1 for curve in curves)
    return Chart(key, title, unit, tuple(curves), **more) if shown else None


# Formation errors and separations


def _leg_errors(flight: FlightView, leg: Recording) -> dict[int, Points]:
    """The error of every UAV over one leg; empty when the leg was not flown."""
    blocks = (
        (flight.times(one.stamps), dict(zip(flight.uavs, formation_errors(leg, one), strict=True)))
        for one in leg.blocks()
    )
    try:
        return thinned(leg.samples, blocks)
    except VerdictError:
        return {}


def timeline(flight: FlightView) -> tuple[Mark, ...]:
    """The deadlines, and when each leg and each change of the shape begins and is due, as far as it is recorded."""
    recording, scenario = flight.recording, flight.scenario
    within, words = scenario.gains.formation.deadline_s, defaultdict[float, list[str]](list)

    def note(t_s: float, word: str) -> None:
        words[round(t_s, 3)].append(word)

    for number, t0_ns in enumerate(recording.forms, start=1):
        begin_s, of_leg = seconds(t0_ns - recording.start_ns), f", leg {number}"
        note(begin_s + within, f"deadline {within:g} s" + (of_leg if number > 1 else ""))
        if number > 1:
            note(begin_s, f"form{of_leg}")
    before_s = seconds(recording.start_ns - recording.first_ns)
    steps: list[tuple[str, float, float | None]] = [
        (leg.name, leg.begin_s, None if isinstance(leg.leg, LandLeg) else leg.due_s)
        for leg in scenario.legs
        if leg.number != FIRST
    ]
    if scenario.mission is None:
        steps = [
            (f"change {number}", change.at_s, change.at_s + change.over_s)
            for number, change in enumerate(scenario.formation.changes, 1)
        ]
    for name, begin_s, due_s in steps:
        note(begin_s - before_s, name)
        if due_s is not None:
            note(due_s - before_s, f"{name} due")
    for t0_ns, leg in recording.epochs:
        t_s = seconds(t0_ns - recording.start_ns)
        if leg != FORMATION and round(t_s, 3) not in words:
            note(t_s, leg)
    begin_s, end_s = flight.seconds(flight.window_ns)
    shown = sorted((t_s, ", ".join(names)) for t_s, names in words.items())
    return tuple(Mark(t_s, name) for t_s, name in shown if max(begin_s, 0.0) < t_s <= end_s)


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
        values = [np.append(piece.values, np.nan) for piece in pieces]
        curves.append(_curve_of(flight, uav, np.concatenate(t)[:-1], np.concatenate(values)[:-1]))
    near = merged((one.begin_ns, one.back_ns) for uav in flight.uavs for one in windows[uav])
    shown_s = flight.seconds(flight.window_ns)[1]
    excused = (flight.seconds(window) for window in near)
    begun = [SHARE_OF_START * float(points.values[0]) for leg in legs for points in leg.values()]
    widest = max([flight.tolerance_m, *(start for start in begun if np.isfinite(start))])
    without = {
        round(seconds(begin_ns - recording.start_ns), 3)
        for begin_ns, _ in legs_without_deadline(recording)
    }
    marks = (
        mark._replace(label=f"{mark.label}: formation over") if mark.t in without else mark
        for mark in timeline(flight)
    )
    return Chart(
        "errors",
        "Formation error",
        "m",
        tuple(curves),
        floor=FLOOR_M,
        limits=(Limit(flight.tolerance_m, f"tolerance {flight.tolerance_m:g} m"),),
        marks=tuple(marks),
        band=(FLOOR_M, widest),
        band_label=f"widest band, {widest:.2f} m",
        spans=tuple((a, min(b, shown_s)) for a, b in excused if a < shown_s),
        spans_label="excused near objects",
        note="Distance from its place; of the leader, from its trajectory.",
    )


def _distances(
    key: str,
    title: str,
    curves: list[Curve],
    keep_outs: Iterable[float],
    note: str,
    floor: float = 0.0,
) -> Chart | None:
    """A chart of the least distances, with the keep-outs as limits."""
    # nanmin of nothing warns; a curve without a finite distance comes last
    closest = [float(np.min(np.where(np.isfinite(c.values), c.values, np.inf))) for c in curves]
    order = sorted(range(len(curves)), key=lambda k: (closest[k], k))[:MOST_DISTANCES]
    radii = sorted(set(keep_outs))[:_MOST_LIMITS]
    left_out = f" The {MOST_DISTANCES} least of {len(curves)}."
    return _chart(
        key,
        title,
        "m",
        [curves[k] for k in sorted(order)],
        floor=floor,
        limits=tuple(Limit(radius, f"keep-out {radius:g} m") for radius in radii),
        note=note + (left_out if len(curves) > MOST_DISTANCES else ""),
    )


def _positions(flight: FlightView) -> Iterator[tuple[Array, dict[int, Array]]]:
    """Times (T,) [s] and positions (T, 3) [m] of all UAVs, block by block."""
    tracks = flight.recording.odometry
    for grid in flight.grids():
        yield flight.times(grid), {uav: tracks[uav].at(grid)[:, :3] for uav in flight.uavs}


def between(flight: FlightView) -> Chart | None:
    """The distance of every UAV from the nearest other one."""
    pairs, scale = list(combinations(flight.uavs, 2)), flight.scenario.formation.keep_out_scale

    def nearest(places: Mapping[int, Array]) -> dict[int, Array]:
        least: dict[int, Array] = {}
        for pair in pairs:
            distance = np.linalg.norm((places[pair[0]] - places[pair[1]]) * scale, axis=1)
            least |= {uav: np.fmin(least.get(uav, distance), distance) for uav in pair}
        return least

    points = thinned(flight.samples, ((t, nearest(places)) for t, places in _positions(flight)))
    curves = [_curve_of(flight, uav, *points[uav]) for uav in flight.uavs if uav in points]
    keep_outs = {flight.scenario.keep_out_between(*pair) for pair in pairs}
    note = "Of each UAV, to the nearest other one."
    return _distances("between", "Separation between UAVs", curves, keep_outs, note)


def obstacles(flight: FlightView) -> Chart | None:
    """The distance of every obstacle from the nearest UAV."""
    bodies, recording = flight.scenario.world.bodies, flight.recording
    later_s = seconds(recording.start_ns - recording.first_ns)  # t counts from the judged leg

    def nearest(t: Array, places: Iterable[Array]) -> dict[int, Array]:
        return {
            number: np.fmin.reduce([body.distances(place, t + later_s) for place in places])
            for number, body in enumerate(bodies)
        }

    blocks = ((t, nearest(t, list(places.values()))) for t, places in _positions(flight))
    points = thinned(flight.samples, blocks)
    curves = [Curve(bodies[k].name, look(k), *of_body, ()) for k, of_body in points.items()]
    radii = (float(body.keep_out_m) for body in bodies)
    note = "Of the nearest UAV: from the centre of a sphere, from the surface of all others."
    return _distances("obstacles", "Separation from obstacles", curves, radii, note, _NEAR_M)


# Inputs


def force(flight: FlightView) -> Chart | None:
    """The size of the commanded force."""
    curves = _curves_of(flight, flight.recording.wrench, lambda rows: lengths(rows[:, :3].T))
    return _chart("force", "Input: force", "N", curves, limits=_force_limits(flight))


def torque(flight: FlightView) -> Chart | None:
    """The size of the commanded torque."""
    curves = _curves_of(flight, flight.recording.wrench, lambda rows: lengths(rows[:, 3:].T))
    return _chart("torque", "Input: torque", "N m", curves)


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

    def errors_at(grid: NDArray[np.int64]) -> dict[int, Array]:
        leader = truth.at(grid)[:, :3]
        return {
            uav: np.linalg.norm(track.at(grid)[:, :3] - leader, axis=1)
            for uav, track in estimates.items()
        }

    blocks = ((flight.times(grid), errors_at(grid)) for grid in flight.grids())
    points = thinned(flight.samples, blocks)
    curves = [_curve_of(flight, uav, *of_uav) for uav, of_uav in points.items()]
    deadline = flight.scenario.gains.estimator.deadline_s
    marks = (Mark(deadline, f"its deadline {deadline:g} s"),)
    return _chart(
        "estimator", "Error of the estimated leader", "m", curves, marks=marks, floor=FLOOR_M
    )


def gain(flight: FlightView) -> Chart | None:
    """Gain of the formation loop: the time base until the deadline, kappa after it."""
    deadline = flight.scenario.gains.formation.deadline_s
    marks = (Mark(deadline, f"deadline {deadline:g} s"),)
    curves = _curves_of(flight, flight.status.get("gain", {}))
    return _chart("gain", "Gain of the formation loop", "1/s", curves, marks=marks)


def conditioning(flight: FlightView) -> Chart | None:
    """Smallest singular value of each task; near zero the task has no solution."""
    curves = _curves_of(flight, flight.status.get("sigma_min", {}))
    return _chart("conditioning", "Smallest singular value of the task", "", curves)


def missed(flight: FlightView) -> Chart | None:
    """Ticks missed since the epoch."""
    told = _curves_of(flight, flight.status.get("missed_ticks", {}))
    curves = [replace(curve, values=curve.values - curve.values[0]) for curve in told]
    some = any(curve.values.any() for curve in curves)
    return _chart("missed", "Missed ticks", "", curves) if some else None


def latency(flight: FlightView) -> Chart | None:
    """Age of the wrenches when they reach the simulator."""
    curves = []
    for number, name in enumerate(("p50", "p99", "max")):
        points = _samples(flight, flight.status.get(f"latency_{name}_ms", {}).get(0), _only)
        if points is not None and points.values.any():
            curves.append(Curve(name, look(number), *points, ()))
    period = 1e3 / flight.scenario.timing.control_hz
    limits = (Limit(period, f"control period {period:g} ms"),)
    note = "Age of a wrench when it arrives; percentiles since the start."
    return _chart("latency", "Latency of the loop", "ms", curves, limits=limits, note=note)


def age(flight: FlightView) -> Chart | None:
    """Age of the oldest message of a neighbour that went into each step."""
    curves = _curves_of(flight, flight.status.get("age_ms", {}))
    stale = 1e3 * flight.scenario.communication.stale_s
    limits = (Limit(stale, f"stale, {stale:g} ms"),)
    note = "The oldest that went into each step, by the clocks of sender and receiver."
    title = "Messages from neighbours: age"
    return _chart("age", title, "ms", curves, limits=limits, note=note, floor=_FLOOR_MS)


CHARTS: dict[str, Callable[[FlightView], Chart | None]] = {
    make.__name__: make
    for make in (
        errors, force, torque, between, obstacles, estimator, gain, conditioning, missed, latency, age
    )
}  # fmt: skip
"""The figures of a flight, by name."""


def charts(flight: FlightView) -> Iterator[Chart]:
    """All figures for which data is recorded."""
    return (chart for key in CHARTS if (chart := flight.chart(key)) is not None)
