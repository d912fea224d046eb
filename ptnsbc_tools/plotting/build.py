"""The figures of a flight, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ptnsbc_tools.plotting import inputs, loops, space
from ptnsbc_tools.plotting.chart import Chart
from ptnsbc_tools.plotting.flight import Shown

CHARTS: dict[str, Callable[[Shown], Chart | None]] = {
    "errors": space.errors,
    "force": inputs.force,
    "force-first": inputs.force_first,
    "torque": inputs.torque,
    "torque-first": inputs.torque_first,
    "between": space.between,
    "obstacles": space.obstacles,
    "estimator": loops.estimator,
    "gain": loops.gain,
    "conditioning": loops.conditioning,
    "missed": loops.missed,
    "latency": loops.latency,
    "age": loops.age,
}


def charts(flight: Shown) -> Iterator[Chart]:
    """All figures for which something was recorded."""
    if not flight.uavs:
        return
    for make in CHARTS.values():
        chart = make(flight)
        if chart is not None:
            yield chart
