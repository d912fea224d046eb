"""Flights of the experiments, each flown once per process, with what figures and tables ask of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.swarm import HeadlessFlight, fly
from ptnsbc_sim.track import VELOCITY_ERROR
from ptnsbc_tools.reading.flight_recording import recording_of
from ptnsbc_tools.verdict import Verdict, verdict_on
from ptnsbc_tools.verdict.deadline import formation_errors

Setting = Mapping[str, Any]
SCENARIOS = ("paper_5", "paper_5_free", "paper_20", "experiment_4", "experiment_4_calm")
# The printed law has no command filter; ours limits what it asks for.
UNFILTERED = {"gains.filter.max_acceleration_m_s2": 1000.0, "gains.filter.max_speed_m_s": 100.0}
_INITIAL_S = 0.1


@dataclass(frozen=True)
class JudgedFlight:
    """One flight and its verdict."""

    flight: HeadlessFlight
    verdict: Verdict

    @property
    def scenario(self) -> Scenario:
        """What was flown."""
        return self.flight.scenario

    @property
    def times(self) -> Array:
        """(T,) [s] after the epoch."""
        return np.round(self.flight.t_ns * 1e-9, 9)

    @property
    def positions(self) -> Array:
        """(T, N, 3) [m], ENU, where everybody really was."""
        return self.flight.truth[:, :, :3]

    @property
    def force(self) -> Array:
        """|force| (T, N) [N]."""
        return np.asarray(np.linalg.norm(self.flight.track.wrench[:, :, :3], axis=2))

    @property
    def inputs(self) -> Array:
        """|u| (T, N), u = (force [N], torque [N m]), as in (54)."""
        return np.asarray(np.linalg.norm(self.flight.track.wrench, axis=2))

    @property
    def weight_n(self) -> float:
        """Weight of one UAV."""
        return self.scenario.mass_kg * self.scenario.gravity_m_s2

    def errors(self) -> Array:
        """Formation error (T, N) [m], as the verdict defines it."""
        recording = recording_of(self.flight)
        grid = recording.grid()
        found = formation_errors(recording, grid, recording.positions(grid))
        return np.stack([found[uav] for uav in self.scenario.uav_ids], axis=1)

    def initial_input(self) -> float:
        """Largest |u| of any UAV in the first 0.1 s: at t = 0 itself nobody has heard anybody."""
        return float(self.inputs[self.times < _INITIAL_S].max())

    def initial_beyond_hover_n(self) -> float:
        """The same of the force, less the weight."""
        return float(self.force[self.times < _INITIAL_S].max() - self.weight_n)

    def peak_input(self) -> float:
        """Largest |u| of any UAV at any time."""
        return float(self.inputs.max())

    def velocity_error_after(self, seconds: float) -> float:
        """Largest |V - V_r| of any UAV from a time on [m/s]."""
        log = self.flight.track.diagnostics[:, :, VELOCITY_ERROR]
        return float(log[self.times >= seconds].max())

    def settled_s(self) -> float | None:
        """When the last UAV had settled; None when one never did."""
        found = [one.settling_s for one in self.verdict.uavs]
        return None if None in found else max(time for time in found if time is not None)

    def met(self) -> int:
        """How many UAVs kept the deadline."""
        return sum(one.verdict == "met" for one in self.verdict.uavs)

    def worst_at_deadline_m(self) -> float:
        """Largest formation error at the deadline."""
        return max(one.error_at_deadline_m or 0.0 for one in self.verdict.uavs)

    def worst_error_at(self, seconds: float) -> float:
        """Largest formation error at a time [m], whatever the scenario promises."""
        return float(self._errors_at(seconds).max())

    def within_at(self, seconds: float) -> int:
        """How many UAVs are within the tolerance at a time, whatever the scenario promises."""
        tolerance_m = self.verdict.uavs[0].tolerance_m
        return int(np.sum(self._errors_at(seconds) <= tolerance_m))

    def _errors_at(self, seconds: float) -> Array:
        return np.asarray(self.errors()[int(np.searchsorted(self.times, seconds - 1e-9))])

    def worst_after_m(self) -> float:
        """Largest formation error after it, outside encounters."""
        return max(one.max_error_after_m or 0.0 for one in self.verdict.uavs)

    def clearance_m(self) -> float:
        """Smallest distance to any UAV or obstacle, less its keep-out."""
        return min(one.distance_m - one.keep_out_m for one in self.verdict.separations)

    def energy_beyond_hover(self) -> float:
        """(54) without what hovering costs, all UAVs [N^2 s]."""
        return sum(one.energy_above_hover for one in self.verdict.efforts)


def judged(flight: HeadlessFlight) -> JudgedFlight:
    """A flight with its verdict."""
    return JudgedFlight(flight, verdict_on(recording_of(flight)))


_given: dict[str, Any] = {}


def use(settings: Setting) -> None:
    """Change these dotted keys, and no others, in every scenario of this process; an experiment's own come on top."""
    _given.clear()
    _given.update(settings)
    _flown.cache_clear()


@contextmanager
def using(settings: Setting) -> Iterator[None]:
    """The same inside the block."""
    before = dict(_given)
    use(settings)
    try:
        yield
    finally:
        use(before)


def scenario(name: str, changes: Setting | None = None) -> Scenario:
    """A scenario by name, with the keys of this run and of an experiment changed."""
    return load_scenario(name, {**_given, **(changes or {})})


@lru_cache(maxsize=16)
def _flown(name: str, changes: tuple[tuple[str, Any], ...]) -> JudgedFlight:
    return judged(fly(scenario(name, dict(changes))))


def flown(name: str, changes: Setting | None = None) -> JudgedFlight:
    """A scenario by name with dotted keys changed, flown and judged."""
    return _flown(name, tuple(sorted((changes or {}).items())))


def warm() -> None:
    """Read every scenario; compile the laws, or load them from the cache."""
    for name in SCENARIOS:
        scenario(name)  # what cannot be read is said before anything is compiled
    fly(scenario("paper_5", {"timing.duration_s": 0.01}))
