"""The input that a UAV commanded, and its energy (54)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ptnsbc_sim.verdict.coverage import missing
from ptnsbc_sim.verdict.recording import NANO, Recording, seconds
from ptnsbc_sim.verdict.track import BLOCK, lengths, max_of


@dataclass(frozen=True)
class Effort:
    """The input that one UAV commanded."""

    uav: int
    initial_input: float  # |(force, torque)| at the epoch [N, N m]
    initial_above_hover_n: float  # force at the epoch minus the weight
    peak_input: float  # largest |(force, torque)|
    peak_force_n: float
    peak_at_s: float
    energy: float  # integral of |u|^2 (54) [N^2 s]
    energy_above_hover: float  # the same of the force above the weight, and of the torque
    missing: int  # wrench messages missing of one per odometry sent or per control period


def effort(recording: Recording, uav: int) -> Effort | None:
    """Input figures of one UAV; None when its wrench was not recorded in the judged time.

    An input acts until the next one that is recorded: a missing message takes no time out of an integral.
    """
    track = recording.wrench.get(uav)
    if track is None:
        return None
    scenario, start_ns, end_ns = recording.scenario, recording.start_ns, recording.end_ns
    weight = scenario.vehicle(uav).mass_kg * scenario.world.gravity_m_s2
    initial: tuple[float, float] | None = None  # |u| and force at the epoch
    peak = peak_force = -np.inf
    peak_at_s = energy = above_hover = 0.0
    # The last input before the epoch acts at the epoch.
    first, end = max(track.index(start_ns, "right") - 1, 0), track.index(end_ns, "right")
    for begin in range(first, end, BLOCK):
        last = min(begin + BLOCK, end)
        block = track.rows(begin, last)
        next_ns = track.rows(last, last + 1).first_ns if last < end else end_ns
        values = np.asfortranarray(block.values)  # axis by axis in memory
        force, torque = lengths(values[:, :3]), lengths(values[:, 3:])
        edges = np.concatenate((block.t_ns, [next_ns])).clip(start_ns, end_ns)
        lasting_s = (edges[1:] - edges[:-1]) * NANO
        square = torque**2
        energy += float(np.sum((force**2 + square) * lasting_s))
        above_hover += float(np.sum(((force - weight) ** 2 + square) * lasting_s))
        inside = block.index(start_ns, "left")
        if inside == block.size:
            continue
        force, torque = force[inside:], torque[inside:]
        whole = np.hypot(force, torque)
        if initial is None:
            initial = float(whole[0]), float(force[0])
        peak_force = max_of(peak_force, force.max())
        highest = int(np.argmax(whole))  # the first NaN, if there is one
        if whole[highest] > peak or np.isnan(whole[highest]) > np.isnan(peak):
            peak = float(whole[highest])
            peak_at_s = float(seconds(block.t_ns[inside:], start_ns)[highest])
    if initial is None:
        return None
    return Effort(
        uav=uav,
        initial_input=initial[0],
        initial_above_hover_n=initial[1] - weight,
        peak_input=peak,
        peak_force_n=peak_force,
        peak_at_s=peak_at_s,
        energy=energy,
        energy_above_hover=above_hover,
        missing=missing(recording, uav, track),
    )
