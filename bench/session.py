"""One run of the benchmark: how much of it, on what machine, and runs that take turns."""

from __future__ import annotations

import os
import platform
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any, TypeVar
from unittest.mock import patch

from ptnsbc_nodes.runtime.environment import free_domain

T = TypeVar("T")

_PACKAGES = ("numpy", "numba", "ros-rclpy", "ros-rmw-fastrtps-cpp")
_JUST_USED: deque[int] = deque(maxlen=9)


@dataclass(frozen=True)
class Plan:
    """The extent of a measurement."""

    quick: bool = False

    def of(self, full: T, quick: T) -> T:
        """The value for a full or for a quick run."""
        return quick if self.quick else full


def print_progress(line: str) -> None:
    """Print progress on stderr."""
    print(f"bench: {line}", file=sys.stderr, flush=True)


def take_turns(
    runs: Mapping[str, Callable[[], T]], repeats: int, label: str = ""
) -> dict[str, list[T]]:
    """Each of `runs` in turn, `repeats` times: A B A B, so that all see the same load."""
    found: dict[str, list[T]] = {name: [] for name in runs}
    for turn in range(repeats):
        for name, run in runs.items():
            if label:
                print_progress(f"{label}: {name}, {turn + 1} of {repeats}")
            found[name].append(run())
    return found


def cpu_seconds(work: Callable[[], object], calls: int = 1) -> float:
    """CPU time of one call [s], averaged over `calls`: other programs do not change it."""
    began = time.thread_time()
    for _ in range(calls):
        work()
    return (time.thread_time() - began) / calls


@contextmanager
def own_domain() -> Iterator[int]:
    """A free ROS domain, another one each time: a fleet that has just ended is not discovered again."""
    with ExitStack() as stack:
        while (domain := stack.enter_context(free_domain())) in _JUST_USED:
            continue
        _JUST_USED.append(domain)
        stack.enter_context(patch.dict(os.environ, ROS_DOMAIN_ID=str(domain)))
        yield domain


class Machine:
    """The machine of the figures, and the load of other programs meanwhile."""

    def __init__(self) -> None:
        self._load = os.getloadavg()
        self._began = time.monotonic()

    def facts(self) -> dict[str, Any]:
        """Cores, load averages before and after, versions."""
        elapsed_s = max(time.monotonic() - self._began, 1e-9)
        return {
            "cores": os.cpu_count(),
            "load_before": [round(load, 2) for load in self._load],
            "load_after": [round(load, 2) for load in os.getloadavg()],
            "elapsed_s": round(elapsed_s, 1),
            "python": platform.python_version(),
            "versions": dict(_versions()),
        }


def sentences(facts: Mapping[str, Any]) -> list[str]:
    """The facts to read above the table."""
    before, after = (" ".join(map(str, facts[key])) for key in ("load_before", "load_after"))
    packages = ", ".join(f"{name} {number}" for name, number in facts["versions"].items())
    return [
        f"{facts['cores']} cores",
        f"load average {before} before, {after} after {facts['elapsed_s']:.0f} s",
        f"Python {facts['python']}, {packages}",
        "headless, recorder: CPU time of one thread, which is wall time on an idle core",
        "medians; every run of a figure alternates with one of its reference",
    ]


def _versions() -> Iterator[tuple[str, str]]:
    for name in _PACKAGES:
        try:
            yield name, version(name)
        except PackageNotFoundError:
            continue
