"""Settling time of a flight, and tuning of a scalar for it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ptnsbc_core.curves.trajectory import reference
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario.constants import leader_trajectory
from ptnsbc_sim.swarm import HeadlessFlight

SHARE_OF_START = 0.02
_HALVINGS = 7


class BaselineError(PtnsbcError):
    """A comparison that cannot be flown."""


def formation_errors(flight: HeadlessFlight) -> Array:
    """Formation error (T, N) [m]: of the leader from its trajectory, of a follower from its desired offset."""
    scenario, places = flight.scenario, flight.truth[:, :, :3]
    leader = scenario.uav_ids.index(scenario.leader.id)
    offsets = np.array([scenario.offset(uav) for uav in scenario.uav_ids])
    goals = places[:, leader : leader + 1] + offsets
    path = leader_trajectory(scenario)
    goals[:, leader] = [reference(path, tick * 1e-9).position for tick in flight.t_ns.tolist()]
    return np.asarray(np.linalg.norm(places - goals, axis=2))


def settled_s(flight: HeadlessFlight) -> float | None:
    """Time [s] after which all UAVs stay in their bands; None when one is outside at the end.

    The band is the verdict's: 2 % of the start error or the scenario's tolerance, whichever is larger.
    """
    error = formation_errors(flight)
    band = np.maximum(SHARE_OF_START * error[0], flight.scenario.formation.tolerance_m)
    outside = ~(error <= band)  # NaN counts as outside
    if outside[-1].any():
        return None
    last = np.flatnonzero(outside.any(axis=1))
    return 0.0 if last.size == 0 else float(flight.t_ns[last[-1] + 1]) * 1e-9


def tuned(settles: Callable[[float], float | None], wanted_s: float, ladder: list[float]) -> float:
    """The gentlest value whose flight settles by `wanted_s`.

    Args:
        settles: settling time of a flight with this value.
        wanted_s: latest settling time.
        ladder: values from gentle to firm; the first that settles in time is refined by halving.

    Raises:
        BaselineError: no value settles in time.
    """
    before = None
    for value in ladder:
        found = settles(value)
        if found is not None and found <= wanted_s:
            break
        before = value
    else:
        raise BaselineError(
            f"settling in {wanted_s:g} s: none of {ladder[0]:.3g} to {ladder[-1]:.3g} does; "
            "expected a longer time, or higher limits"
        )
    if before is None:
        return value
    gentle, firm = before, value
    for _ in range(_HALVINGS):
        middle = 0.5 * (gentle + firm)
        found = settles(middle)
        if found is not None and found <= wanted_s:
            firm = middle
        else:
            gentle = middle
    return firm
