"""Flights of the experiments, each flown once per process, with the numbers that tables and claims need."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ptnsbc_core.agent import VELOCITY_ERROR
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.swarm import HeadlessFlight, fly
from ptnsbc_sim.verdict import Verdict, verdict_on
from ptnsbc_sim.verdict.deadline import KEPT
from ptnsbc_sim.verdict.formation_error import formation_errors
from ptnsbc_sim.verdict.recording import recording_of, whole

Setting = Mapping[str, Any]
SCENARIOS = ("paper_5", "paper_5_free", "paper_20", "experiment_4", "experiment_4_calm")
PLANTS = ("rigid_body_6dof", "quadrotor")
PROFILES = ("paper", "soft", "reference")
# The printed law has no command filter; ours limits the commanded acceleration and speed.
UNFILTERED = {"gains.filter.max_acceleration_m_s2": 1000.0, "gains.filter.max_speed_m_s": 100.0}
_INITIAL_S = 0.1


@dataclass(frozen=True)
class FlightCurves:
    """One flight as curves over time."""

    flight: HeadlessFlight

    @property
    def scenario(self) -> Scenario:
        """The plan of the flights."""
        return self.flight.scenario

    @property
    def uavs(self) -> tuple[int, ...]:
        """Ids of the UAVs, in the order of the rows of a track."""
        return self.flight.scenario.uav_ids

    @property
    def deadline_s(self) -> float:
        """Deadline of the formation."""
        return self.flight.scenario.gains.formation.deadline_s

    @property
    def times(self) -> Array:
        """(T,) [s] after the epoch."""
        return np.round(self.flight.t_ns * 1e-9, 9)

    @property
    def positions(self) -> Array:
        """True positions (T, N, 3) [m], ENU."""
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
        return self.scenario.plant.mass_kg * self.scenario.world.gravity_m_s2

    def errors(self) -> Array:
        """Formation error (T, N) [m], as the verdict defines it."""
        recording = recording_of(self.flight)
        return formation_errors(recording, whole(recording)).T

    def errors_at(self, seconds: float) -> Array:
        """Formation error (N,) [m] at a time, whatever the deadline of the scenario is."""
        return np.asarray(self.errors()[int(np.searchsorted(self.times, seconds - 1e-9))])

    def initial_input(self) -> float:
        """Largest |u| of any UAV in the first 0.1 s: at t = 0 itself no UAV has received a message."""
        return float(self.inputs[self.times < _INITIAL_S].max())

    def initial_beyond_hover_n(self) -> float:
        """Largest force of any UAV in the first 0.1 s, less the weight."""
        return float(self.force[self.times < _INITIAL_S].max() - self.weight_n)

    def peak_input(self) -> float:
        """Largest |u| of any UAV at any time."""
        return float(self.inputs.max())

    def velocity_error_after(self, seconds: float) -> float:
        """Largest |V - V_r| of any UAV from a time on [m/s]."""
        log = self.flight.track.diagnostics[:, :, VELOCITY_ERROR]
        return float(log[self.times >= seconds].max())


@dataclass(frozen=True)
class JudgedFlight(FlightCurves):
    """One flight, and its verdict in numbers."""

    verdict: Verdict

    def settled_s(self) -> float | None:
        """The time at which the last UAV settled; None when a UAV never did."""
        times = [uav.settling_s for uav in self.verdict.uavs]
        return None if None in times else max(time for time in times if time is not None)

    def met(self) -> int:
        """The number of UAVs that kept the deadline and their distances."""
        return sum(uav.verdict in KEPT for uav in self.verdict.uavs)

    def met_text(self) -> str:
        """Like `4 of 5`."""
        return f"{self.met()} of {len(self.uavs)}"

    def kept_promise(self) -> bool:
        """Deadline met by all UAVs, and no keep-out entered."""
        return self.verdict.verdict in KEPT

    def worst_at_deadline_m(self) -> float:
        """Largest formation error at the deadline."""
        return max(uav.error_at_deadline_m or 0.0 for uav in self.verdict.uavs)

    def worst_after_m(self) -> float:
        """Largest formation error after the deadline, outside encounters."""
        return max(uav.max_error_after_m or 0.0 for uav in self.verdict.uavs)

    def worst_after_all_m(self) -> float:
        """Largest formation error after the deadline, inside encounters too."""
        return max(uav.max_error_after_all_m or 0.0 for uav in self.verdict.uavs)

    def encounter_s(self) -> float:
        """The longest time that a UAV spent in encounters."""
        return max(uav.encounter_s for uav in self.verdict.uavs)

    def within_at(self, seconds: float) -> int:
        """The number of UAVs within the tolerance at a time, whatever the deadline of the scenario is."""
        return int(np.sum(self.errors_at(seconds) <= self.verdict.uavs[0].tolerance_m))

    def clearance_m(self) -> float:
        """Smallest distance to any UAV or obstacle, less its keep-out."""
        return min(one.distance_m - one.keep_out_m for one in self.verdict.separations)

    def energy_beyond_hover(self) -> float:
        """(54) without what hovering costs, all UAVs [N^2 s]."""
        return sum(one.energy_above_hover for one in self.verdict.efforts)

    def missed_reason(self) -> str:
        """The reason why the worst UAV is not met; empty when all are."""
        missed = [uav for uav in self.verdict.uavs if uav.verdict not in KEPT]
        if not missed:
            return ""
        worst = max(missed, key=lambda uav: uav.error_at_deadline_m or 0.0)
        return f"UAV {worst.uav} {worst.verdict}: {worst.reason}"


def judge(flight: HeadlessFlight) -> JudgedFlight:
    """A flight with its verdict."""
    return JudgedFlight(flight, verdict_on(recording_of(flight)))


_PAPER = {
    "formation.approach": "task",
    "gains.clearance.approach": "linear",
    "gains.clearance.margin_m": 0.02,
}
"""The laws of the paper, where the defaults are others."""

_settings: dict[str, Any] = {}


def use(settings: Setting) -> None:
    """Change these dotted keys in every scenario of this process; the changes of an experiment are applied after."""
    _settings.clear()
    _settings.update(settings)
    _fly_once.cache_clear()


@contextmanager
def using(settings: Setting) -> Iterator[None]:
    """`use` these settings inside the block."""
    before = dict(_settings)
    use(settings)
    try:
        yield
    finally:
        use(before)


def scenario(name: str, changes: Setting | None = None) -> Scenario:
    """A scenario by name, with the keys of this run and of an experiment changed."""
    return load_scenario(name, {**_PAPER, **_settings, **(changes or {})})


@lru_cache(maxsize=16)
def _fly_once(name: str, changes: tuple[tuple[str, Any], ...]) -> JudgedFlight:
    return judge(fly(scenario(name, dict(changes))))


def fly_judged(name: str, changes: Setting | None = None) -> JudgedFlight:
    """A scenario by name with dotted keys changed, flown and judged."""
    return _fly_once(name, tuple(sorted((changes or {}).items())))


def compile_laws() -> None:
    """Read every scenario; compile the laws, or load them from the cache."""
    for name in SCENARIOS:
        scenario(name)  # an unreadable scenario is reported before anything is compiled
    fly(scenario("paper_5", {"timing.duration_s": 0.01}))
