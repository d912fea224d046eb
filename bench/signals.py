"""kill -9, STOP, and STOP with CONT of every kind of process at random moments of flights.

`python -m bench.signals [--mode lockstep|real|mavlink] [--times 30] [--duration 40] [--seed 1] [--within S]`. Each run
is a whole fleet: five UAVs and their sim, or with mavlink four UAVs, bridges and stand-ins. At a moment that the seed
draws, in the first S seconds after the start, one process gets its signal; after STOP, CONT comes 1.5 s later or
never. Afterwards the exit code must be the documented one, no process may be left, the bag (mended, where its recorder
was killed) must open, and no two UAVs may have come closer than their keep-out. After a pause of a UAV or a bridge in
flight the code is 1: the setpoints of a vehicle stopped. Where the launcher itself is stopped for good, it is killed
after a while.
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
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.bag import read_bag
from ptnsbc_io.wire import decode_diagnostics
from ptnsbc_nodes.bridge.procedure.steps import FLYING, STOP_S, Step
from ptnsbc_nodes.comm.topics import DIAGNOSTICS
from ptnsbc_nodes.runtime.environment import free_domain
from ptnsbc_sim.verdict.recording import Recording, VerdictError, require_all_uavs
from ptnsbc_sim.verdict.separation import Separation, joined, separations
from ptnsbc_sim.verdict.verdict import verdict_on
from ptnsbc_tools.library.bags import repair
from ptnsbc_tools.reading.bag_reader import read_recording

_VICTIMS = {
    "lockstep": ("uav1", "uav3", "sim", "recorder", "launcher"),
    "real": ("uav1", "uav3", "sim", "recorder", "launcher"),
    "mavlink": ("uav1", "uav3", "bridge1", "bridge3", "recorder", "launcher"),
}
_MOMENTS_S = {"lockstep": 4.0, "real": 12.0, "mavlink": 25.0}  # after the start, the latest
_ORDERS = ("kill", "stop", "pause")
_FLIES = frozenset(step.value for step in FLYING)
_COMES_DOWN = frozenset(step.value for step in (Step.LAND, Step.DISARM, Step.DONE))
_PAUSE_S = 1.5
_STUCK_S = 25.0  # so long a launcher stands still before it is killed
_READY_S = 600.0  # vehicles that do not land are waited for 240 s
_LEFT_S = 30.0
_LAST_WORDS = 6  # lines of a launcher that did not start: the reason, and the end of a log


class Struck(NamedTuple):
    """One flight, and what is wrong with it."""

    victim: str
    order: str
    after_s: float  # from the start of the flight
    exit_code: int | None
    wrong: tuple[str, ...]
    struck: bool = True  # whether the victim still ran at that moment


def struck(
    mode: str, count: int, duration_s: float, seed: int, within_s: float
) -> Iterator[Struck]:
    """So many flights, each with a victim, an order and a moment of its own."""
    chance, victims = random.Random(seed), _VICTIMS[mode]
    for number in range(count):
        victim, order = victims[number % len(victims)], chance.choice(_ORDERS)
        after_s = chance.uniform(0.0, within_s)
        with (
            tempfile.TemporaryDirectory(prefix="signals-") as name,
            free_domain() as domain,  # of two benches at once, one activated a UAV of the other
            _vehicles(Path(name), mode, domain, duration_s) as words,
        ):
            found = _flight(Path(name), domain, words, victim, order, after_s)
        print(f"bench: {found}", file=sys.stderr, flush=True)
        yield found


@contextmanager
def _vehicles(folder: Path, mode: str, domain: int, duration_s: float) -> Iterator[list[str]]:
    """Words of the launcher for this mode; the stand-ins of its vehicles fly meanwhile."""
    length = ["--duration", str(duration_s)]
    if mode != "mavlink":
        yield ["--scenario", "paper_5", *length, *(["--lockstep"] if mode == "lockstep" else [])]
        return
    scenario, control = write_scenario(folder, duration_s)
    with stand_ins(folder, domain, scenario, control):
        yield ["--scenario", str(scenario), *length, "--backend", "mavlink", "--allow-arming"]


def _flight(
    folder: Path, domain: int, words: Sequence[str], victim: str, order: str, after_s: float
) -> Struck:
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    command = [sys.executable, "-m", "ptnsbc_nodes.fleet.fleet_main", *words]
    command += ["--log-dir", str(folder / "logs"), "--bag", str(folder / "bag")]
    launcher = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
    try:
        if refusal := _until_started(launcher):
            return Struck(victim, order, round(after_s, 2), launcher.wait(), (refusal,), False)
        time.sleep(after_s)  # the moment is the experiment
        pid = launcher.pid if victim == "launcher" else _pids(folder).get(victim)
        late = pid is None or launcher.poll() is not None
        struck_ns = time.time_ns()
        if pid is not None and not late:
            _signal(pid, order)
        code = _end(launcher, victim, order)
    finally:
        if launcher.poll() is None:
            launcher.kill()
        launcher.communicate()
    wrong = () if late else tuple(_wrong(folder, victim, order, struck_ns, code))
    return Struck(victim, order, round(after_s, 2), code, wrong, not late)


def _until_started(launcher: subprocess.Popen[str]) -> str:
    """Wait for the start of the flight; the last words of a launcher that ended before it."""
    assert launcher.stderr is not None
    last = deque[str](maxlen=_LAST_WORDS)
    for line in launcher.stderr:
        if line.rstrip().endswith("started"):
            return ""
        last.append(line.strip())
    return f"the fleet did not start: {' '.join(last)}"


def _pids(folder: Path) -> dict[str, int]:
    """The processes of the fleet by name: all of them name its scenario file."""
    mark, found = str(folder / "logs" / "scenario.yaml"), {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdecimal():
            continue
        with suppress(OSError):
            words = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
            if any(mark in word for word in words):
                if "--uav" in words:
                    kind = "bridge" if "ptnsbc_nodes.bridge.bridge_main" in words else "uav"
                    found[f"{kind}{words[words.index('--uav') + 1]}"] = int(entry.name)
                elif "ptnsbc_nodes.sim.sim_main" in words:
                    found["sim"] = int(entry.name)
                elif "ptnsbc_nodes.recording.recorder_main" in words:
                    found["recorder"] = int(entry.name)
    return found


def _signal(pid: int, order: str) -> None:
    with suppress(ProcessLookupError):
        if order == "kill":
            os.kill(pid, signal.SIGKILL)
            return
        os.kill(pid, signal.SIGSTOP)
        if order == "pause":
            time.sleep(_PAUSE_S)
            os.kill(pid, signal.SIGCONT)


def _end(launcher: subprocess.Popen[str], victim: str, order: str) -> int | None:
    """Wait for the end of the flight; a launcher that stands still for good is killed."""
    endless = order == "stop" and victim == "launcher"
    with suppress(subprocess.TimeoutExpired):
        launcher.communicate(timeout=_STUCK_S if endless else _READY_S)
        return launcher.returncode
    launcher.kill()
    with suppress(subprocess.TimeoutExpired):
        launcher.communicate(timeout=_READY_S)
    return launcher.returncode


class BridgeSteps(NamedTuple):
    """The step of a bridge when its process or its controller paused, and once its setpoints were missing."""

    before: str = ""
    after: str = ""


def _exit_codes(victim: str, order: str, steps: BridgeSteps) -> set[int]:
    """The exit codes with which the launcher may end.

    1 when a process died, was ended because it hung, or left a vehicle to its failsafe; either where it was landed
    within the pause.
    """
    if order == "pause":
        if steps.before not in _FLIES:
            return {0}
        return {0, 1} if steps.after in _COMES_DOWN else {1}
    return {-signal.SIGKILL} if victim == "launcher" else {1}


def _steps(bag: Path, victim: str, struck_ns: int) -> BridgeSteps:
    """The steps of the bridge of a UAV by its statuses in the bag; empty for a victim without a bridge."""
    bridge = f"bridge{victim.removeprefix('uav').removeprefix('bridge')}: link"
    before, silent_ns = "", struck_ns + round(1e9 * STOP_S)
    for message in read_bag(bag).messages([DIAGNOSTICS.name]):
        array = decode_diagnostics(message.data)
        for step in (one.values.get("step", "") for one in array.statuses if one.name == bridge):
            if array.stamp_ns > silent_ns:
                return BridgeSteps(before, step)
            before = step if array.stamp_ns <= struck_ns else before
    return BridgeSteps(before)


def _wrong(
    folder: Path, victim: str, order: str, struck_ns: int, code: int | None
) -> Iterator[str]:
    steps = BridgeSteps()
    with suppress(PtnsbcError):  # a bag that cannot be read is reported below
        steps = _steps(folder / "bag", victim, struck_ns) if order == "pause" else steps
    fine = _exit_codes(victim, order, steps)
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
        separations = list(_separations(_recording(folder)))
    except PtnsbcError as error:
        yield f"bag: {' '.join(str(error).split())}"
        return
    for pair in joined([separations]):
        if pair.entered:
            yield f"{pair.first} and {pair.second} {pair.distance_m:.3f} m apart"


def _separations(recording: Recording) -> Iterator[Separation]:
    """The closest approaches at all instants of which every UAV is recorded, and those of the verdict on a flight.

    A process that is struck before the first leg leaves a bag without a flight to judge. Distances are kept there too.

    Raises:
        VerdictError: there is no such instant, or the verdict refuses the flight.
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


def _recording(folder: Path) -> Recording:
    bag = folder / "bag"
    if not bag.exists():
        repair(folder / "bag.part", bag)
    return read_recording(bag)


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 1 when anything is wrong with a flight."""
    parser = argparse.ArgumentParser(prog="python -m bench.signals", description=__doc__)
    parser.add_argument("--mode", choices=list(_VICTIMS), default="lockstep")
    parser.add_argument("--times", type=int, default=30, metavar="N")
    parser.add_argument("--duration", type=float, default=40.0, metavar="S")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--within", type=float, metavar="S", help=f"latest moment; by default {_MOMENTS_S}"
    )
    options = parser.parse_args(arguments)
    within_s = _MOMENTS_S[options.mode] if options.within is None else options.within
    flights = struck(options.mode, options.times, options.duration, options.seed, within_s)
    found = list(flights)
    bad = [one._asdict() for one in found if one.wrong]
    hit = [one for one in found if one.struck]
    cases = Counter(f"{one.order} {one.victim}" for one in hit)
    summary = {"flights": len(found), "struck": len(hit), "mode": options.mode}
    print(json.dumps({**summary, "cases": cases, "wrong": bad}, indent=1))
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
