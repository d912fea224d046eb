"""Figures of what the actuators are asked for."""

from __future__ import annotations

import numpy as np

from ptnsbc_tools.plotting.chart import Chart, Curve, Limit
from ptnsbc_tools.plotting.common import chart_of, curve_of
from ptnsbc_tools.plotting.flight import Shown
from ptnsbc_tools.plotting.thin import Thinner
from ptnsbc_tools.verdict.recording import NANO


def _inputs(flight: Shown, columns: slice, until_s: float | None) -> tuple[Curve, ...]:
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
        curves.append(curve_of(flight, uav, *found.points()))
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
