"""Figures of where everybody is: formation errors and separations."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np

from ptnsbc_tools.charts.chart import Chart, Curve, Limit, Mark, Span
from ptnsbc_tools.charts.common import FLOOR_M, chart_of, curve_of, look_of
from ptnsbc_tools.charts.flight import Shown
from ptnsbc_tools.charts.style import DASHES, Look, look
from ptnsbc_tools.limits import SHARE_OF_START
from ptnsbc_tools.verdict.deadline import formation_errors
from ptnsbc_tools.verdict.windows import encounters, joined

MOST_PAIRS = 24  # in one figure; the tightest


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
        tuple(curve_of(flight, uav, t, np.maximum(e, FLOOR_M)) for uav, e in found.items()),
        log=True,
        limits=(Limit(flight.tolerance_m, f"tolerance {flight.tolerance_m:g} m"),),
        marks=(Mark(deadline, f"deadline {deadline:g} s"),),
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
    return chart_of("between", "Separation between UAVs", "m", kept, limits=limits, note=note)


def obstacles(flight: Shown) -> Chart | None:
    """Distances of all UAVs from the centres of all obstacles."""
    grid = flight.grid()
    t, found = flight.times(grid), flight.scenario.obstacles
    curves = []
    for uav, (number, obstacle) in product(flight.uavs, enumerate(found)):
        place = flight.recording.odometry[uav].at(grid)[:, :3]
        distance = np.linalg.norm(place - obstacle.position, axis=1)
        style = Look(look_of(flight, uav).colour, number % len(DASHES))
        curves.append(Curve(f"UAV {uav} – {obstacle.name}", style, t, distance, (uav,)))
    radii = sorted({float(obstacle.keep_out_m) for obstacle in found})
    limits = tuple(Limit(radius, f"keep-out {radius:g} m") for radius in radii)
    kept, note = _tightest(curves), _left_out(curves)
    return chart_of("obstacles", "Separation from obstacles", "m", kept, limits=limits, note=note)
