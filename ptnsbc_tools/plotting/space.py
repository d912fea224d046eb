"""Figures of where everybody is: formation errors and separations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_tools.plotting.chart import Chart, Curve, Limit, Mark, Span
from ptnsbc_tools.plotting.common import FLOOR_M, chart_of, curve_of, look_of
from ptnsbc_tools.plotting.flight import Shown
from ptnsbc_tools.plotting.style import DASHES, Look, look
from ptnsbc_tools.plotting.thin import Points, ThinnedCurves
from ptnsbc_tools.verdict import Recording, VerdictError
from ptnsbc_tools.verdict.deadline import formation_errors
from ptnsbc_tools.verdict.recording import NANO
from ptnsbc_tools.verdict.tolerances import SHARE_OF_START
from ptnsbc_tools.verdict.windows import encounters, joined

MOST_PAIRS = 24  # in one figure; the tightest


def _spans(flight: Shown) -> tuple[Span, ...]:
    """Time in which the error of anybody is excused."""
    counters = flight.recording.counters
    found = [w for uav in flight.uavs for w in encounters(flight.scenario, counters, uav)]
    _, end = flight.seconds(flight.window_ns)
    spans = (flight.seconds(window) for window in joined(found))
    return tuple(Span(begin, min(close, end)) for begin, close in spans if begin < end)


def _leg_errors(flight: Shown, leg: Recording) -> dict[int, Points]:
    """Error of every UAV over one leg, in the time of the flight; empty when it was not flown."""
    found = ThinnedCurves[int](leg.samples)
    try:
        for grid in leg.grids():
            for uav, error in formation_errors(leg, grid, leg.positions(grid)).items():
                found.add(uav, flight.times(grid), error)
    except VerdictError:
        return {}
    return found.points()


def _joined(pieces: list[Points]) -> Points:
    """One curve with a gap between its pieces."""
    t = [np.append(piece.t, piece.t[-1]) for piece in pieces]
    values = [np.append(np.maximum(piece.values, FLOOR_M), np.nan) for piece in pieces]
    return Points(np.concatenate(t)[:-1], np.concatenate(values)[:-1])


def deadlines(flight: Shown) -> tuple[Mark, ...]:
    """When each formation leg has to be in its place."""
    within = flight.scenario.gains.formation.deadline_s
    begun = [(t0_ns - flight.recording.start_ns) * NANO for t0_ns in flight.recording.forms]
    return tuple(
        Mark(begin + within, f"deadline {within:g} s" + (f", leg {number}" if number > 1 else ""))
        for number, begin in enumerate(begun, start=1)
    )


def errors(flight: Shown) -> Chart | None:
    """Distance of every UAV from its place."""
    if flight.problem:
        return None
    recording = flight.recording
    numbers = range(len(recording.forms))
    legs = [_leg_errors(flight, replace(recording, leg=number)) for number in numbers]
    legs = [leg for leg in legs if leg]
    curves = []
    for uav in flight.uavs:
        points = _joined([leg[uav] for leg in legs])
        curves.append(curve_of(flight, uav, points.t, points.values))
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
        spans=_spans(flight),
        note=f"Distance from its place; of the leader, from its trajectory. Green: widest band, "
        f"{widest:.2f} m. Grey: somebody keeps clear of something, or has just done so.",
    )


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
    ids, found = flight.scenario.uav_ids, ThinnedCurves[tuple[int, int]](flight.samples)
    for t, places in _places(flight):
        for pair in combinations(flight.uavs, 2):
            found.add(pair, t, np.linalg.norm(places[pair[0]] - places[pair[1]], axis=1))
    curves = []
    for (a, b), points in found.points().items():
        style = Look(look(ids.index(a)).colour, (ids.index(b) - ids.index(a) - 1) % len(DASHES))
        curves.append(Curve(f"UAV {a} – {b}", style, *points, (a, b)))
    keep_out = flight.scenario.uav_keep_out_m
    limits = (Limit(keep_out, f"keep-out {keep_out:g} m"),)
    kept, note = _tightest(curves), _left_out(curves)
    return chart_of("between", "Separation between UAVs", "m", kept, limits=limits, note=note)


def obstacles(flight: Shown) -> Chart | None:
    """Distances of all UAVs from the centres of all obstacles."""
    known, found = flight.scenario.obstacles, ThinnedCurves[tuple[int, int]](flight.samples)
    for t, places in _places(flight):
        for uav, (number, one) in product(flight.uavs, enumerate(known)):
            found.add((uav, number), t, np.linalg.norm(places[uav] - one.position, axis=1))
    curves = []
    for (uav, number), points in found.points().items():
        style = Look(look_of(flight, uav).colour, number % len(DASHES))
        curves.append(Curve(f"UAV {uav} – {known[number].name}", style, *points, (uav,)))
    radii = sorted({float(one.keep_out_m) for one in known})
    limits = tuple(Limit(radius, f"keep-out {radius:g} m") for radius in radii)
    kept, note = _tightest(curves), _left_out(curves)
    return chart_of("obstacles", "Separation from obstacles", "m", kept, limits=limits, note=note)


def _places(flight: Shown) -> Iterator[tuple[Array, dict[int, Array]]]:
    """Times (T,) [s] and positions (T, 3) [m] of all UAVs, block by block."""
    tracks = flight.recording.odometry
    for grid in flight.grids():
        yield flight.times(grid), {uav: tracks[uav].at(grid)[:, :3] for uav in flight.uavs}
