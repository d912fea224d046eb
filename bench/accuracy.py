"""The error of a fleet of four stand-ins in formation, beside that of each vehicle which holds a point by itself.

`python -m bench.accuracy [--kinds px4,ardupilot] [--setpoints velocity,attitude] [--gnss rtk] [--duration 50]`. Each
row is a whole fleet over UDP, in real time, on a machine that has nothing else to do. The vehicles hover under their
own position loops for HOVER_S before the operator starts the formation. All errors are by the truth: of the formation
against its places, and of the hover against the point that the vehicle holds, which is the mean of its own estimates.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.stand_ins import VEHICLES, program, stand_ins, wait_for, write_scenario
from ptnsbc_core.types import Array
from ptnsbc_io.bag import read_bag
from ptnsbc_io.wire import decode_header, decode_odometry
from ptnsbc_tools.library.flight import flight_in

HOVER_S = 43.0  # as long as the formation after its deadline: errors of receivers wander
_LIMIT = 1.3  # RMS of the formation against that of the hover
_SETTLED_S = 3.0  # of the hover, after the climb
# ArduPilot then takes attitude targets with a thrust.
_PARAMETERS = {"px4": ("COM_OBL_RC_ACT=5",), "ardupilot": ("GUID_OPTIONS=8",)}


class Held(NamedTuple):
    """One flight."""

    verdict: str
    exit_code: int
    hover_m: Array
    """RMS distance (4,) of each vehicle from the point that it holds [m]."""
    formation_m: Array
    """RMS error (4,) of each vehicle after the deadline [m]."""
    largest_m: float
    closest_m: float


def fly(kind: str, setpoint: str, gnss: str, duration_s: float) -> Held:
    """One flight of four vehicles of one kind."""
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        folder = Path(name)
        domain, bag = 81, folder / "bag"
        scenario, control = write_scenario(folder, duration_s, autopilot=kind, setpoint=setpoint)
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
            stand_ins(folder, domain, scenario, control, gnss=gnss, parameters=_PARAMETERS[kind]),
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
        told = flight_in(bag).verdict
        return Held(
            told.verdict,
            code,
            np.array([_hover_m(bag, i) for i in VEHICLES]),
            np.array([uav.rmse_after_m for uav in told.uavs]),
            max(uav.max_error_after_all_m or 0.0 for uav in told.uavs),
            min(pair.distance_m for pair in told.separations),
        )


def _operator(folder: Path, domain: int, *words: object) -> None:
    with program(folder, "operator", domain, "ptnsbc_tools.cli", "mission", *words) as said:
        if said.process.wait():
            raise SystemExit(said.log.read_text())


def _hover_m(bag: Path, uav: int) -> float:
    """RMS distance of a vehicle by the truth from the mean of its estimates [m] while it waited for the start."""
    found = read_bag(bag)
    epoch_ns = next(
        decode_header(one.data).stamp_ns for one in found.messages(["/formation/epoch"])
    )
    first_ns = epoch_ns - int((HOVER_S - _SETTLED_S) * 1e9)

    def places(topic: str) -> Array:
        all_of_it = (decode_odometry(one.data) for one in found.messages([f"/uav{uav}/{topic}"]))
        return np.array([one.values[:3] for one in all_of_it if first_ns < one.stamp_ns < epoch_ns])

    return rms(np.linalg.norm(places("truth") - places("odom").mean(axis=0), axis=1))


def main() -> None:
    """Fly each kind of vehicle by each kind of setpoint, and print a row for each flight."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", default="px4,ardupilot")
    parser.add_argument("--setpoints", default="velocity,attitude")
    parser.add_argument("--gnss", default="rtk", choices=("rtk", "quiet", "plain", "perfect"))
    parser.add_argument("--duration", type=float, default=50.0, help="of the formation [s]")
    options = parser.parse_args()
    print(
        "| vehicle, setpoints | verdict, exit code | its own hover [m] | formation [m] | times | largest; closest [m] |"
    )
    print("| --- | --- | --- | --- | --- | --- |")
    good = True
    for kind in options.kinds.split(","):
        for setpoint in options.setpoints.split(","):
            held = fly(kind, setpoint, options.gnss, options.duration)
            ratio = rms(held.formation_m) / rms(held.hover_m)
            good = good and held.verdict == "met" and held.exit_code == 0 and ratio <= _LIMIT
            columns = (
                f"{kind}, {setpoint}",
                f"{held.verdict}, {held.exit_code}",
                " ".join(f"{one:.3f}" for one in held.hover_m),
                " ".join(f"{one:.3f}" for one in held.formation_m),
                f"{ratio:.2f}",
                f"{held.largest_m:.3f}; {held.closest_m:.2f}",
            )
            print("|", " | ".join(columns), "|", flush=True)
    sys.exit(0 if good else 1)


def rms(errors_m: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(errors_m))))


if __name__ == "__main__":
    main()
