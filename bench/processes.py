"""Processes of a flight seen from beside: their CPU and memory, their statuses, and a bare node to compare with."""

from __future__ import annotations

import os
import re
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from subprocess import PIPE, Popen, TimeoutExpired
from typing import NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions

from bench.session import own_domain
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.wire import decode_diagnostics
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.topics import READY
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.node_process import BoundedSpin, make_executor

_PERIOD_S = 0.5
_SLICE_S = 0.1
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 2**20
_ROLE = re.compile(r"ptnsbc_nodes\.(uav|sim|recording|bridge)\.|bench\.processes (node)")


class Usage(NamedTuple):
    """One process, or the mean over those of a role."""

    cores: float  # CPU time per wall time
    rss_mb: float  # memory, shared libraries counted in every process
    pss_mb: float  # memory, shared libraries divided among the processes that map them


class Sample(NamedTuple):
    """CPU time and memory of one process at one moment."""

    at: float  # [s], monotonic
    cpu_s: float
    rss_mb: float


class Sampler:
    """Samples the child processes twice a second inside the `with` block, in a thread."""

    def __init__(self) -> None:
        self._samples: dict[tuple[str, int], list[Sample]] = defaultdict(list)
        # [MB], by pid; looked at once, because the kernel visits every page for it.
        self._shares: dict[int, float] = {}
        self._began = float("inf")
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Sampler:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def begin(self) -> None:
        """Ignore the samples before now."""
        self._began = time.monotonic()

    def usage(self) -> dict[str, Usage]:
        """By role: uav and bridge (mean), sim, recorder; a role with less than two samples is left out."""
        found: dict[str, list[Usage]] = defaultdict(list)
        for (role, pid), samples in self._samples.items():
            counted = [sample for sample in samples if sample.at >= self._began]
            if len(counted) > 1:
                first, last = counted[0], counted[-1]
                cores = (last.cpu_s - first.cpu_s) / (last.at - first.at)
                found[role].append(Usage(cores, last.rss_mb, self._shares.get(pid, 0.0)))
        return {role: _mean(each) for role, each in found.items()}

    def growth(self, settle_s: float, until_s: float) -> dict[str, float]:
        """By role: largest growth of a process from `settle_s` to `until_s`, as a share of what it had at first.

        Both count from `begin`. A process that ends reads the compiler's pages again.
        """
        found: dict[str, float] = {}
        for (role, _), samples in self._samples.items():
            first_s, last_s = self._began + settle_s, self._began + until_s
            counted = [sample for sample in samples if first_s <= sample.at <= last_s]
            loaded = samples[0].at < self._began  # one that starts again in flight loads only then
            if loaded and len(counted) > 1:
                share = counted[-1].rss_mb / counted[0].rss_mb - 1.0
                found[role] = max(found.get(role, share), share)
        return found

    def _run(self) -> None:
        while not self._over.wait(_PERIOD_S):
            for pid in children(os.getpid()):
                self._look(pid)

    def _look(self, pid: int) -> None:
        try:
            words = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
            sample = look(pid)
            if sample.at >= self._began and pid not in self._shares:
                self._shares[pid] = _share_mb(pid)
        except OSError:  # it has just ended
            return
        if role := _ROLE.search(words):
            name = (role[1] or role[2]).replace("recording", "recorder")
            self._samples[name, pid].append(sample)


def look(pid: int) -> Sample:
    """CPU time and memory of a process until now; OSError when it has ended."""
    fields = _stat(pid)
    cpu_s = (int(fields[11]) + int(fields[12])) / _TICKS_PER_S
    return Sample(time.monotonic(), cpu_s, int(fields[21]) * _PAGE_MB)


def _share_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return next(float(line.split()[1]) / 1024 for line in lines if line.startswith("Pss:"))


def _stat(pid: int) -> list[str]:
    """Fields of /proc/<pid>/stat from the state on: the name before may hold blanks."""
    return Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()


def children(parent: int) -> list[int]:
    """The processes that this one has started."""
    found = []
    for entry in filter(str.isdecimal, os.listdir("/proc")):
        with suppress(OSError):  # it has just ended
            if int(_stat(int(entry))[1]) == parent:
                found.append(int(entry))
    return found


def _mean(each: list[Usage]) -> Usage:
    count = len(each)
    return Usage(*(sum(column) / count for column in zip(*each, strict=True)))


class Observer:
    """One node in a context and a thread of its own; use it as a context manager."""

    def __init__(self, domain: int) -> None:
        environment.prepare()
        self._raw: list[tuple[float, bytes]] = []
        self._over = threading.Event()
        self._context = Context()
        rclpy.init(
            context=self._context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO
        )
        self._node = rclpy.create_node(
            "bench", context=self._context, start_parameter_services=False, enable_rosout=False
        )
        for topic in (topics.DIAGNOSTICS, READY):
            self._node.create_subscription(
                DiagnosticArray, topic.name, self._on_status, 50, raw=True
            )
        self._executor = make_executor(self._context)
        self._executor.add_node(self._node)
        self._slices = BoundedSpin(self._executor)
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Observer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._executor.remove_node(self._node)
        self._slices.serve(0.0)
        self._node.destroy_node()
        self._executor.shutdown()
        rclpy.shutdown(context=self._context)

    def newest(self) -> dict[str, dict[str, str]]:
        """The last values of every node, by the name before the colon."""
        return {
            status.name.partition(":")[0]: status.values
            for _, data in list(self._raw)
            for status in decode_diagnostics(data).statuses
        }

    def first_at(self) -> float | None:
        """The time of the first status [s], monotonic; None before it."""
        return self._raw[0][0] if self._raw else None

    def _on_status(self, data: bytes) -> None:
        self._raw.append((time.monotonic(), data))

    def _run(self) -> None:
        while not self._over.is_set():
            self._slices.serve(_SLICE_S)


class BenchError(PtnsbcError):
    """A run from which no figure can be read."""


def missed_percent(uavs: Sequence[Mapping[str, str]]) -> float:
    """The share of their ticks that UAVs missed, by their statuses."""
    missed, ticks = (sum(int(row[key]) for row in uavs) for key in ("missed_ticks", "ticks"))
    return 100.0 * missed / max(missed + ticks, 1)


def bare_node(hz: float, seconds: float) -> Usage:
    """Usage of a node that publishes one status `hz` times a second, and does nothing else."""
    words = [sys.executable, "-m", "bench.processes", "node", f"{hz:g}"]
    with own_domain(), Sampler() as sampler, Popen(words, stdout=PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()  # the node has begun
        sampler.begin()
        with suppress(TimeoutExpired):
            process.wait(seconds)
        process.kill()
    return sampler.usage()["node"]


def _serve(hz: float) -> None:
    rclpy.init()
    node = rclpy.create_node("bare", start_parameter_services=False, enable_rosout=False)
    publisher = node.create_publisher(DiagnosticArray, topics.DIAGNOSTICS.name, 10)
    node.create_timer(1.0 / hz, lambda: publisher.publish(DiagnosticArray()))
    print("begun", flush=True)
    while rclpy.ok():
        rclpy.spin_once(node, timeout_sec=0.1)


if __name__ == "__main__":
    _serve(float(sys.argv[2]))
