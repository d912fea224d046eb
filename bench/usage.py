"""CPU and memory of the child processes of this process, from /proc."""

from __future__ import annotations

import os
import re
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

_PERIOD_S = 0.5
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 2**20
_ROLE = re.compile(r"ptnsbc_nodes\.(uav|sim|recording|bridge)\.|--role (uav|sim|recorder)")


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
            for pid in _children():
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


def _children() -> list[int]:
    found = []
    for entry in os.listdir("/proc"):
        if entry.isdecimal():
            try:
                fields = _stat(int(entry))
            except OSError:
                continue
            if int(fields[1]) == os.getpid():
                found.append(int(entry))
    return found


def _mean(each: list[Usage]) -> Usage:
    count = len(each)
    return Usage(*(sum(column) / count for column in zip(*each, strict=True)))
