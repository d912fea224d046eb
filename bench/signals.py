"""kill -9, STOP, and STOP with CONT of every kind of process at random moments of flights.

`python -m bench.signals [--mode lockstep|real|mavlink] [--times 30] [--duration 40] [--seed 1] [--within S]`. Each run
is a whole fleet: five UAVs and their sim, or with mavlink four UAVs, bridges and stand-ins. At a moment that the seed
draws, in the first S seconds after the start, or of stand-ins after the first arms, one process gets its signal, or the
terminal of the launcher is closed; after STOP, CONT comes 1.5 s later or never. Afterwards the exit code must be the
documented one, no process may be left, every vehicle must stand on the ground disarmed, the bag (mended, where its
recorder was killed) must open, and no two UAVs may have come closer than their keep-out. After a pause the code is 1 if
the fleet names vehicles that did not fly as planned, as those whose setpoints stopped. A launcher that is stopped for
good is killed later.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from bench.stand_ins import stand_ins, write_scenario
from ptnsbc_autopilot.fault_lines import send_fault
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.fleet.child_process import EXECUTABLES
from ptnsbc_nodes.runtime.environment import free_domain
from ptnsbc_sim.verdict.recording import Recording, VerdictError, require_all_uavs
from ptnsbc_sim.verdict.separation import Separation, joined, separations
from ptnsbc_sim.verdict.verdict import verdict_on
from ptnsbc_tools.library.bags import repair
from ptnsbc_tools.reading.bag_reader import read_recording

_SIMULATED = ("uav1", "uav3", "sim", "recorder", "launcher")
_VICTIMS = {
    "lockstep": _SIMULATED,
    "real": _SIMULATED,
    "mavlink": ("uav1", "uav3", "bridge1", "bridge3", "recorder", "launcher", "terminal"),
}
_MOMENTS_S = {"lockstep": 4.0, "real": 12.0, "mavlink": 25.0}  # after the start, the latest
_ORDERS = {"kill": signal.SIGKILL, "stop": signal.SIGSTOP, "pause": signal.SIGSTOP}
_BEGINS = ("arming", "started")
_FAULTS = (
    "not as planned: "  # begins the fleet's lines about vehicles that did not fly as they should
)
_PAUSE_S = 1.5
_STUCK_S = 25.0  # so long a launcher stands still before it is killed
_READY_S = 600.0  # vehicles that do not land are waited for 240 s
_LEFT_S = 30.0


class Strike(NamedTuple):
    """A signal to one process."""

    victim: str
    order: str
    begin: str  # the end of the line of the launcher after which time counts
    after_s: float


class Struck(NamedTuple):
    """One flight, and what is wrong with it."""

    strike: Strike
    exit_code: int | None
    wrong: tuple[str, ...]
    struck: bool = True  # whether the victim still ran at that moment


def struck(
    mode: str, count: int, duration_s: float, seed: int, within_s: float
) -> Iterator[Struck]:
    """So many flights, each with a victim, an order and a moment of its own."""
    chance, victims = random.Random(seed), _VICTIMS[mode]
    for number in range(count):
        victim, order = victims[number % len(victims)], chance.choice(list(_ORDERS))
        order = "hang up" if victim == "terminal" else order
        begin = chance.choice(_BEGINS) if mode == "mavlink" else "started"
        strike = Strike(victim, order, begin, round(chance.uniform(0.0, within_s), 2))
        with (
            tempfile.TemporaryDirectory(prefix="signals-") as name,
            free_domain() as domain,  # of two benches at once, one activated a UAV of the other
            _vehicles(Path(name), mode, domain, duration_s) as (words, control),
        ):
            found = _flight(Path(name), domain, words, strike)
            if control:
                found = found._replace(wrong=(*found.wrong, *_left_armed(control)))
        print(f"bench: {found}", file=sys.stderr, flush=True)
        yield found


@contextmanager
def _vehicles(
    folder: Path, mode: str, domain: int, duration_s: float
) -> Iterator[tuple[list[str], int]]:
    """Words of the launcher for this mode; the stand-ins of its vehicles fly meanwhile, and the port that asks them."""
    words = ["--duration", str(duration_s), "--scenario"]
    if mode != "mavlink":
        yield [*words, "paper_5", *(["--lockstep"] if mode == "lockstep" else [])], 0
        return
    scenario, control = write_scenario(folder, duration_s)
    with stand_ins(folder, domain, scenario, control):
        yield [*words, str(scenario), "--backend", "mavlink", "--allow-arming"], control


def _left_armed(control: int) -> Iterator[str]:
    """The vehicles that are armed or in the air after their fleet has ended, by their own truth."""
    for state in json.loads(send_fault(control, "all state")):
        if state["armed"] or not state["contact"]:
            armed, height_m = "armed" if state["armed"] else "disarmed", state["position_enu_m"][2]
            yield f"vehicle {state['system']} left {armed} at {height_m:.1f} m in {state['mode']}"


def _flight(folder: Path, domain: int, words: Sequence[str], strike: Strike) -> Struck:
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    command = [sys.executable, "-m", "tests.support.fleet_main", *words]
    command += ["--log-dir", str(folder / "logs"), "--bag", str(folder / "bag")]
    launcher = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
    try:
        if refusal := _until(strike.begin, launcher):
            return Struck(strike, launcher.wait(), (refusal,), False)
        time.sleep(strike.after_s)  # the moment is the experiment
        launches = strike.victim in ("launcher", "terminal")
        pid = launcher.pid if launches else _pids(folder).get(strike.victim)
        late = pid is None or launcher.poll() is not None
        if pid and not late:
            _signal(pid, strike.order)
        code = _end(launcher, strike)
    finally:
        if launcher.poll() is None:
            launcher.kill()
        launcher.communicate()
    wrong = () if late else tuple(_wrong(folder, strike, code))
    return Struck(strike, code, wrong, not late)


def _until(begin: str, launcher: subprocess.Popen[str]) -> str:
    """Wait until it says that this has begun; the last words of a launcher that ended before it."""
    assert launcher.stderr is not None
    last = deque[str](maxlen=6)  # the reason, and the end of a log
    for line in launcher.stderr:
        if line.rstrip().endswith(begin):
            return ""
        last.append(line.strip())
    return f"the fleet did not start: {' '.join(last)}"


def _pids(folder: Path) -> dict[str, int]:
    """The processes of the fleet by name: all of them name its scenario file."""
    mark, found = str(folder / "logs" / "scenario.yaml"), {}
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            words = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
            if any(mark in word for word in words):
                kind = next((EXECUTABLES[word] for word in words if word in EXECUTABLES), "other")
                uav = words[words.index("--uav") + 1] if "--uav" in words else ""
                found[f"{kind}{uav}"] = int(entry.name)
    return found


def _signal(pid: int, order: str) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, _ORDERS.get(order, signal.SIGHUP))
        if order == "pause":
            time.sleep(_PAUSE_S)
            os.kill(pid, signal.SIGCONT)


def _end(launcher: subprocess.Popen[str], strike: Strike) -> int | None:
    """Wait for the end of the flight; a launcher that stands still for good is killed."""
    limit_s = _STUCK_S if strike[:2] == ("launcher", "stop") else _READY_S
    while launcher.poll() is None:
        with suppress(subprocess.TimeoutExpired):
            launcher.communicate(timeout=limit_s)
            break
        launcher.kill()
    return launcher.returncode


def _exit_codes(victim: str, order: str, faults: bool) -> set[int]:
    """The exit codes with which the launcher may end.

    1 when a process died, was ended because it hung, or left a vehicle to its failsafe; `faults`: whether the fleet has
    named vehicles that did not fly as planned, which a busy host is enough for.
    """
    if order == "pause":
        return {int(faults)}
    codes = {"launcher": {-signal.SIGKILL}, "terminal": {130}}.get(victim, {1})
    return codes | ({1} if faults else set())


def _wrong(folder: Path, strike: Strike, code: int | None) -> Iterator[str]:
    said = (folder / "logs" / "fleet.log").read_text(errors="replace")
    fine = _exit_codes(strike.victim, strike.order, _FAULTS in said)
    fine |= {2} if strike.begin == "arming" else set()
    if code not in fine:
        yield f"exit code {code}: expected {sorted(fine)}"
    until_s = time.monotonic() + _LEFT_S
    while (left := _pids(folder)) and time.monotonic() < until_s:
        time.sleep(0.2)
    if left:
        yield f"left behind: {' '.join(left)}"
        for pid in left.values():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
    try:
        if not (bag := folder / "bag").exists():
            repair(folder / "bag.part", bag)
        separations = list(_separations(read_recording(bag)))
    except PtnsbcError as error:
        yield f"bag: {' '.join(str(error).split())}"
        return
    for pair in joined([separations]):
        if pair.entered:
            yield f"{pair.first} and {pair.second} {pair.distance_m:.3f} m apart"


def _separations(recording: Recording) -> Iterator[Separation]:
    """The closest approaches at all instants of which every UAV is recorded, and those of the verdict on a flight.

    A process that is struck before the first leg leaves a bag without a flight to judge. Distances are kept there too.
    VerdictError where there is no such instant, or the verdict refuses the flight.
    """
    require_all_uavs(recording)
    begin_ns = max(track.first_ns for track in recording.odometry.values())
    blocks = recording.blocks(begin_ns, recording.last_ns)
    pairs = [pair for block in blocks for pair in separations(recording, block)]
    if not pairs:
        raise VerdictError("no instant at which all UAVs are recorded")
    yield from pairs
    if recording.samples > 1:
        yield from verdict_on(recording).separations


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 1 when anything is wrong with a flight."""
    parser = argparse.ArgumentParser(prog="python -m bench.signals", description=__doc__)
    parser.add_argument("--mode", choices=list(_VICTIMS), default="lockstep")
    parser.add_argument("--times", type=int, default=30, metavar="N")
    parser.add_argument("--duration", type=float, default=40.0, metavar="S")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--within", type=float, metavar="S", help="latest moment")
    options = parser.parse_args(arguments)
    within_s = _MOMENTS_S[options.mode] if options.within is None else options.within
    found = list(struck(options.mode, options.times, options.duration, options.seed, within_s))
    bad = [one._asdict() for one in found if one.wrong]
    cases = Counter(" ".join(one.strike[:3]) for one in found if one.struck)
    summary = {"mode": options.mode, "flights": len(found), "struck": cases.total()}
    print(json.dumps({**summary, "cases": cases, "wrong": bad}, indent=1))
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
