"""Figures of what the actuators are asked for."""

from __future__ import annotations

import numpy as np

from ptnsbc_tools.charts.chart import Chart, Curve, Limit
from ptnsbc_tools.charts.common import chart_of, curve_of
from ptnsbc_tools.charts.flight import Shown


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
            curves.append(curve_of(flight, uav, t[chosen], size[chosen]))
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
    return chart_of("force", "Input: force", "N", curves, limits=_force_limits(flight))


def force_first(flight: Shown) -> Chart | None:
    """The first second of it, in which a law that is armed far from its goal shows its jump."""
    curves = _inputs(flight, slice(0, 3), 1.0)
    limits = _force_limits(flight)
    return chart_of("force-first", "Input: force, first second", "N", curves, limits=limits)


def torque(flight: Shown) -> Chart | None:
    """Size of the commanded torque."""
    return chart_of("torque", "Input: torque", "N m", _inputs(flight, slice(3, 6), None))


def torque_first(flight: Shown) -> Chart | None:
    """The first second of it."""
    curves = _inputs(flight, slice(3, 6), 1.0)
    return chart_of("torque-first", "Input: torque, first second", "N m", curves)
