"""The error of a fleet of four stand-ins in formation, beside that of each vehicle which holds a point by itself.

`python -m bench.accuracy [--kinds px4,ardupilot] [--setpoints velocity,attitude] [--gnss rtk] [--seeds 8]`. Bridges,
UAV controllers and stand-ins are the real ones, on a clock of the tests; each seed draws other errors of the
receivers. With `--udp` each flight is a whole fleet over UDP, in real time, on a machine that has nothing else to do.
The vehicles hover under their own position loops for HOVER_S before the formation starts. All errors are by the truth.
In the world, that of the hover is beside the point that the vehicle holds, which is the mean of its own estimates, and
that of the formation beside the place that the leader's path gives. Beside the leader, the errors of a follower are
those less the leader's: they hold the errors of two receivers. Errors of receivers wander within tens of seconds, so
that one flight says little: the ratio is that of all flights together, with its confidence interval of 95 % and the
ratios of the single flights.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import bootstrap

from bench.session import print_progress
from bench.stand_ins import VEHICLES, program, stand_ins, wait_for, write_scenario
from ptnsbc_core.curves.trajectory import reference_positions
from ptnsbc_core.types import Array
from ptnsbc_io.bag import read_bag
from ptnsbc_io.wire import decode_header, decode_odometry
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.build import leader_trajectory
from ptnsbc_sim.verdict import Verdict, verdict_on
from ptnsbc_tools.library.flight import flight_in

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

HOVER_S = 43.0  # as long as the formation after its deadline: errors of receivers wander
_LIMIT = 1.3  # RMS of the formation against that of the hover
_SETTLED_S = 3.0  # of the hover, after the climb
_STEP_NS = 20_000_000
_HEAD = (
    "| vehicle, setpoints | met | in the world: hover, formation [m] | times "
    "| beside the leader: hover, formation [m] | times | largest; closest [m] |"
)
# ArduPilot then takes attitude targets with a thrust.
_PARAMETERS = {"px4": ("COM_OBL_RC_ACT=5",), "ardupilot": ("GUID_OPTIONS=8",)}


class Case(NamedTuple):
    """One flight to fly."""

    kind: str
    setpoint: str
    gnss: str
    duration_s: float
    seed: int


class Held(NamedTuple):
    """One flight."""

    verdict: str
    exit_code: int  # of the fleet over UDP; 0 on the clock of the tests
    hover_m2: Array
    """Mean squares (2,) in hover [m^2], over the vehicles: beside the point that each holds, and beside the leader."""
    formation_m2: Array
    """The same (2,) in formation, beside the places: of each in the world, and beside the leader."""
    largest_m: float
    closest_m: float


class Motion(NamedTuple):
    """The positions of one vehicle, each series with its stamps [ns] and states (T, 13)."""

    truth: tuple[Array, Array]
    odometry: tuple[Array, Array]

    def true_at(self, times_ns: Array) -> Array:
        """Its positions (T, 3) by the truth [m]."""
        stamps, states = self.truth
        return np.stack([np.interp(times_ns, stamps, states[:, k]) for k in range(3)], axis=1)

    def held_in(self, first_ns: int, last_ns: int) -> Array:
        """The point (3,) that it holds: the mean of its estimates."""
        stamps, states = self.odometry
        within = (first_ns < stamps) & (stamps < last_ns)
        return np.asarray(states[within, :3].mean(axis=0))


def fly_on_clock(case: Case) -> Held:
    """One flight as fast as it goes: the wires, ROS and the time are replaced."""
    from mavlink_fleet import AUTOPILOTS, MavlinkFleet, scenario  # type: ignore[import-not-found]

    stand_in = next(name for name, autopilot in AUTOPILOTS.items() if autopilot == case.kind)
    made = scenario(stand_in, case.setpoint, case.duration_s)
    fleet = MavlinkFleet(made, stand_in, gnss=case.gnss, seed=case.seed)
    for parameter in _PARAMETERS[case.kind]:
        name, _, value = parameter.partition("=")
        fleet.set_parameter(name, float(value))
    fleet.airborne().run(HOVER_S).form().run(case.duration_s + 1.0)
    motions = [
        Motion(_series(uav.truths), (np.array(uav.stamps), np.array(uav.odometry)))
        for uav in fleet.uavs.values()
    ]
    return _held(verdict_on(fleet.recording()), 0, made, motions, fleet.legs[0][0])


def _series(stamped: Iterable[tuple[int, Array]]) -> tuple[Array, Array]:
    stamps, states = zip(*stamped, strict=True)
    return np.array(stamps), np.array(states)


def _held(
    told: Verdict, code: int, scenario: Scenario, motions: Sequence[Motion], epoch_ns: int
) -> Held:
    end_ns = epoch_ns + round(scenario.duration_s * 1e9)
    due_ns = epoch_ns + round(scenario.gains.formation.deadline_s * 1e9)
    times = np.arange(due_ns, end_ns, _STEP_NS, dtype=np.float64)
    since_s = np.asarray((times - epoch_ns) * 1e-9, dtype=np.float64)
    path = reference_positions(leader_trajectory(scenario), since_s)
    places = np.array([path + scenario.offset(uav) for uav in scenario.uav_ids])
    before_ns = epoch_ns - int((HOVER_S - _SETTLED_S) * 1e9)
    waits = np.arange(before_ns, epoch_ns, _STEP_NS, dtype=np.float64)
    points = np.array([one.held_in(before_ns, epoch_ns)[None] for one in motions])
    return Held(
        told.verdict,
        code,
        _mean_squares(np.array([one.true_at(waits) for one in motions]) - points),
        _mean_squares(np.array([one.true_at(times) for one in motions]) - places),
        max(uav.max_error_after_all_m or 0.0 for uav in told.uavs),
        min(pair.distance_m for pair in told.separations),
    )


def _mean_squares(errors: Array) -> Array:
    """Mean squares (2,) [m^2] of errors (N, T, 3), those of the leader first: in the world, and beside the leader."""
    beside = np.concatenate((errors[:1], errors[1:] - errors[:1]))
    return np.array([np.mean(np.sum(one**2, axis=2)) for one in (errors, beside)])


def fly_over_udp(case: Case) -> Held:
    """One flight of processes in real time."""
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        folder = Path(name)
        domain, bag = 81, folder / "bag"
        scenario, control = write_scenario(
            folder, case.duration_s, autopilot=case.kind, setpoint=case.setpoint
        )
        fleet = (
            "fleet",
            scenario,
            "--backend",
            "mavlink",
            "--allow-arming",
            "--wait",
            "--bag",
            bag,
        )
        with (
            stand_ins(
                folder,
                domain,
                scenario,
                control,
                gnss=case.gnss,
                seed=case.seed,
                parameters=_PARAMETERS[case.kind],
            ),
            program(folder, "fleet", domain, "ptnsbc_tools.cli", *fleet) as flight,
        ):
            wait_for(flight, ["calls /formation/arm"])
            _operator(folder, domain, "arm")
            wait_for(flight, [f"bridge{i}: airborne" for i in VEHICLES])
            wait_for(flight, ["calls /formation/start"])
            # The vehicles hover in real time, and nothing but the time marks the end of the measurement.
            time.sleep(HOVER_S)
            _operator(folder, domain, "start", 1)
            code = flight.process.wait()
        flown = flight_in(bag)
        return _held(flown.verdict, code, flown.scenario, *_motions(bag))


def _operator(folder: Path, domain: int, *words: object) -> None:
    with program(folder, "operator", domain, "ptnsbc_tools.cli", "mission", *words) as said:
        if said.process.wait():
            raise SystemExit(said.log.read_text())


def _motions(bag: Path) -> tuple[list[Motion], int]:
    """The motions of all vehicles in a bag, and the epoch [ns]."""
    found = read_bag(bag)
    epochs = (decode_header(one.data) for one in found.messages(["/formation/epoch"]))

    def series(uav: int, topic: str) -> tuple[Array, Array]:
        decoded = (decode_odometry(one.data) for one in found.messages([f"/uav{uav}/{topic}"]))
        return _series((one.stamp_ns, one.values) for one in decoded)

    motions = [Motion(series(i, "truth"), series(i, "odom")) for i in VEHICLES]
    return motions, next(epochs).stamp_ns


def _ratio(hover_m2: Array, formation_m2: Array, axis: int = -1) -> Array:
    """RMS of the formation against that of the hover, of mean squares (flights,) [m^2]."""
    return np.sqrt(formation_m2.mean(axis=axis) / hover_m2.mean(axis=axis))


def _row(kind: str, setpoint: str, flights: Sequence[Held]) -> tuple[str, bool]:
    """The row of the table, and whether all is as it is to be."""
    well = sum(one.verdict == "met" and one.exit_code == 0 for one in flights)
    columns, good = [f"{kind}, {setpoint}", f"{well} of {len(flights)}"], well == len(flights)
    for kind_of_error in range(2):
        hover = np.array([one.hover_m2[kind_of_error] for one in flights])
        formation = np.array([one.formation_m2[kind_of_error] for one in flights])
        ratio = float(_ratio(hover, formation))
        good = good and ratio <= _LIMIT
        interval = ""
        if len(flights) > 1:
            found = bootstrap((hover, formation), _ratio, paired=True, random_state=1)
            low, high = found.confidence_interval
            each = np.sqrt(formation / hover)
            interval = f" ({low:.2f} to {high:.2f}); {each.min():.2f} to {each.max():.2f}"
        rms = (f"{np.sqrt(one.mean()):.3f}" for one in (hover, formation))
        columns += [", ".join(rms), f"{ratio:.2f}{interval}"]
    largest_m = max(one.largest_m for one in flights)
    closest_m = min(one.closest_m for one in flights)
    columns.append(f"{largest_m:.3f}; {closest_m:.2f}")
    return f"| {' | '.join(columns)} |", good


def main() -> None:
    """Fly each kind of vehicle by each kind of setpoint, and print a row for each flight."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", default="px4,ardupilot")
    parser.add_argument("--setpoints", default="velocity,attitude")
    parser.add_argument("--gnss", default="rtk", choices=("rtk", "quiet", "plain", "perfect"))
    parser.add_argument("--duration", type=float, default=50.0, help="of the formation [s]")
    parser.add_argument("--seeds", type=int, default=8, help="flights of each kind")
    parser.add_argument("--udp", action="store_true", help="processes over UDP, in real time")
    options = parser.parse_args()
    fly = fly_over_udp if options.udp else fly_on_clock
    pairs = [(k, one) for k in options.kinds.split(",") for one in options.setpoints.split(",")]
    seeds = range(1, options.seeds + 1)
    cases = [Case(*pair, options.gnss, options.duration, seed) for pair in pairs for seed in seeds]
    print(_HEAD, "| --- | --- | --- | --- | --- | --- | --- |", sep="\n", flush=True)
    good, flights = True, []
    with get_context("spawn").Pool(1 if options.udp else os.cpu_count()) as pool:
        for number, held in enumerate(pool.imap(fly, cases), 1):
            flights.append(held)
            print_progress(f"accuracy: {number} of {len(cases)} flights")
            if len(flights) == options.seeds:
                case = cases[number - 1]
                row, well = _row(case.kind, case.setpoint, flights)
                print(row, flush=True)
                good, flights = good and well, []
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
