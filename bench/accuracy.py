"""The error of a fleet of four stand-ins in formation, beside that of each vehicle which holds a point by itself.

`python -m bench.accuracy [--kinds px4,ardupilot] [--setpoints velocity,attitude] [--gnss rtk] [--seeds 8]`. Bridges,
UAV controllers and stand-ins are the real ones, on a clock of the tests; each seed draws other errors of the
receivers. With `--udp` each flight is a whole fleet over UDP, in real time, on a machine that has nothing else to do.
The vehicles hover under their own position loops for HOVER_S before the formation starts. All errors are by the truth:
of the formation against its places, and of the hover against the point that the vehicle holds, which is the mean of
its own estimates. Errors of receivers wander within tens of seconds, so that one flight says little: the last but one
column is the ratio of all flights together, with its confidence interval of 95 % and the ratios of the single flights.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import bootstrap

from bench.session import print_progress
from bench.stand_ins import VEHICLES, program, stand_ins, wait_for, write_scenario
from ptnsbc_core.types import Array
from ptnsbc_io.bag import read_bag
from ptnsbc_io.wire import decode_header, decode_odometry
from ptnsbc_sim.verdict import Verdict, verdict_on
from ptnsbc_tools.library.flight import flight_in

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

HOVER_S = 43.0  # as long as the formation after its deadline: errors of receivers wander
_LIMIT = 1.3  # RMS of the formation against that of the hover
_SETTLED_S = 3.0  # of the hover, after the climb
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
    hover_m: Array
    """RMS distance (4,) of each vehicle from the point that it holds [m]."""
    formation_m: Array
    """RMS error (4,) of each vehicle after the deadline [m]."""
    largest_m: float
    closest_m: float


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
    epoch_ns, _ = fleet.legs[0]
    told = verdict_on(fleet.recording())
    hover_m = [_hover_m(uav.truths, _stamped(uav), epoch_ns) for uav in fleet.uavs.values()]
    return _held(told, 0, hover_m)


def _stamped(uav: Any) -> list[tuple[int, Array]]:
    return list(zip(uav.stamps, uav.odometry, strict=True))


def _held(told: Verdict, code: int, hover_m: Sequence[float]) -> Held:
    return Held(
        told.verdict,
        code,
        np.array(hover_m),
        np.array([uav.rmse_after_m for uav in told.uavs]),
        max(uav.max_error_after_all_m or 0.0 for uav in told.uavs),
        min(pair.distance_m for pair in told.separations),
    )


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
        return _held(flight_in(bag).verdict, code, [_hover_in(bag, i) for i in VEHICLES])


def _operator(folder: Path, domain: int, *words: object) -> None:
    with program(folder, "operator", domain, "ptnsbc_tools.cli", "mission", *words) as said:
        if said.process.wait():
            raise SystemExit(said.log.read_text())


def _hover_in(bag: Path, uav: int) -> float:
    found = read_bag(bag)
    epoch_ns = next(
        decode_header(one.data).stamp_ns for one in found.messages(["/formation/epoch"])
    )

    def all_of(topic: str) -> list[tuple[int, Array]]:
        decoded = (decode_odometry(one.data) for one in found.messages([f"/uav{uav}/{topic}"]))
        return [(one.stamp_ns, one.values) for one in decoded]

    return _hover_m(all_of("truth"), all_of("odom"), epoch_ns)


def _hover_m(
    truth: Sequence[tuple[int, Array]], odometry: Sequence[tuple[int, Array]], epoch_ns: int
) -> float:
    """RMS distance of a vehicle by the truth from the mean of its estimates [m] while it waited for the start."""
    first_ns = epoch_ns - int((HOVER_S - _SETTLED_S) * 1e9)

    def places(series: Sequence[tuple[int, Array]]) -> Array:
        return np.array(
            [values[:3] for stamp_ns, values in series if first_ns < stamp_ns < epoch_ns]
        )

    return rms(np.linalg.norm(places(truth) - places(odometry).mean(axis=0), axis=1))


def _ratio(hover_m: Array, formation_m: Array, axis: int = -1) -> Array:
    """RMS of the formation against that of the hover, of mean squares (flights,) [m^2]."""
    return np.sqrt(formation_m.mean(axis=axis) / hover_m.mean(axis=axis))


def _row(kind: str, setpoint: str, flights: Sequence[Held]) -> tuple[str, bool]:
    """The row of the table, and whether all is as it is to be."""
    hover = np.array([np.mean(np.square(one.hover_m)) for one in flights])
    formation = np.array([np.mean(np.square(one.formation_m)) for one in flights])
    ratio, each = float(_ratio(hover, formation)), np.sqrt(formation / hover)
    interval = ""
    if len(flights) > 1:
        found = bootstrap((hover, formation), _ratio, paired=True, random_state=1)
        low, high = found.confidence_interval
        interval = f" ({low:.2f} to {high:.2f}); {each.min():.2f} to {each.max():.2f}"
    well = sum(one.verdict == "met" and one.exit_code == 0 for one in flights)
    columns = (
        f"{kind}, {setpoint}",
        f"{well} of {len(flights)}",
        f"{np.sqrt(hover.mean()):.3f}",
        f"{np.sqrt(formation.mean()):.3f}",
        f"{ratio:.2f}{interval}",
        f"{max(one.largest_m for one in flights):.3f}; {min(one.closest_m for one in flights):.2f}",
    )
    return f"| {' | '.join(columns)} |", well == len(flights) and ratio <= _LIMIT


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
    print(
        "| vehicle, setpoints | met | its own hover [m] | formation [m] | times | largest; closest [m] |"
    )
    print("| --- | --- | --- | --- | --- | --- |", flush=True)
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


def rms(errors_m: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(errors_m))))


if __name__ == "__main__":
    main()
