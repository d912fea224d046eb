"""What the figures of a flight are put together from."""

from __future__ import annotations

from collections.abc import Sequence

from ptnsbc_core.types import Array
from ptnsbc_tools.plotting.chart import Chart, Curve, Limit, Mark
from ptnsbc_tools.plotting.flight import Shown
from ptnsbc_tools.plotting.style import Look, look
from ptnsbc_tools.plotting.thin import Points, Thinner
from ptnsbc_tools.verdict import Track

FLOOR_M = 1e-4  # of logarithmic axes


def label(flight: Shown, uav: int) -> str:
    """What a UAV is called."""
    return f"UAV {uav} (leader)" if uav == flight.scenario.leader_id else f"UAV {uav}"


def look_of(flight: Shown, uav: int) -> Look:
    """Colour and dash of a UAV."""
    return look(flight.scenario.uav_ids.index(uav))


def curve_of(flight: Shown, uav: int, t: Array, values: Array) -> Curve:
    """A curve of one UAV."""
    return Curve(label(flight, uav), look_of(flight, uav), t, values, (uav,))


def in_time(flight: Shown, track: Track) -> Points | None:
    """What was told in the time shown, None when nothing was."""
    begin, end = track.span(*flight.window_ns)
    if begin == end:
        return None
    found = Thinner(end - begin)
    for block in track.blocks(begin, end):
        found.add(flight.times(block.t_ns), block.values[:, 0])
    return found.points()


def chart_of(
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
    """A chart; None when there is nothing in it."""
    if not any(curve.t.size > 1 for curve in curves):
        return None
    return Chart(key, title, unit, tuple(curves), log, limits, marks, note=note)
