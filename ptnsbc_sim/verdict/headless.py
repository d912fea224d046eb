"""A headless flight as the input of a verdict."""

from __future__ import annotations

from ptnsbc_core.types import Array
from ptnsbc_sim.counters import counters_of, status_every
from ptnsbc_sim.disturbances.faults import gone
from ptnsbc_sim.swarm import HeadlessFlight
from ptnsbc_sim.verdict.recording import FORMATION, Recording, with_landing
from ptnsbc_sim.verdict.track import Series


def recording_of(flight: HeadlessFlight) -> Recording:
    """The input of a verdict from a flight, without a bag."""
    scenario, track, rows = flight.scenario, flight.track, list(enumerate(flight.scenario.uav_ids))
    start_ns = int(flight.t_ns[0])
    silent = gone(scenario)  # a UAV whose process is dead sends nothing

    def sent(values: Array, every: int = 1) -> dict[int, Series]:
        """Tracks of values (T / every, N, ...) without those of silent ticks."""
        t_ns, missing = flight.t_ns[::every], silent[::every]
        return {
            uav: Series(t_ns[~missing[:, row]], values[~missing[:, row], row])
            if missing[:, row].any()
            else Series(t_ns, values[:, row])
            for row, uav in rows
        }

    return Recording(
        scenario=scenario,
        odometry={uav: Series(flight.t_ns, track.odometry[:, row]) for row, uav in rows},
        wrench=sent(track.wrench),
        estimate=sent(track.estimate),
        truth={uav: Series(flight.t_ns, track.truth[:, row]) for row, uav in rows}
        if len(track.truth)
        else {},
        counters=sent(counters_of(track.diagnostics, scenario), status_every(scenario)),
        epochs=with_landing(scenario, ((start_ns, FORMATION),)),
        slots={start_ns: flight.slots} if flight.slots else {},
    )
