"""The introduction of processes to each other: one that has loaded and that nobody hears is started again."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence

from ptnsbc_nodes.comm.topics import RECORDER, SIM
from ptnsbc_nodes.fleet.child_process import ChildProcess
from ptnsbc_nodes.fleet.coordinator_node import Coordinator

_UNHEARD_S = 15.0  # discovery takes a few seconds, on a busy machine too


class Introduction:
    """Notices processes that a discovery server has left out for good, and has them introduced once more."""

    def __init__(
        self,
        coordinator: Coordinator,
        progress: Callable[[str], None],
        start_again: Callable[[ChildProcess], None],
    ) -> None:
        self._coordinator = coordinator
        self._progress = progress
        self._start_again = start_again
        self._introduced: dict[str, float] = {}  # processes that were heard, and since when
        self._running: dict[str, float] = {}  # processes that have loaded, and since when
        self._restarts: Counter[str] = Counter()

    def look(self, children: Sequence[ChildProcess]) -> None:
        """Start the first process again that has been unheard for too long, or join the network again."""
        now = time.monotonic()
        unheard = [child for child in children if not self._is_introduced(child, now)]
        loaded = [child for child in unheard if self._is_running(child, now)]
        # As long as others are found, and while the machine is busy with loading, it may just be slow.
        last_s = max([*self._introduced.values(), *self._running.values()], default=now)
        for child in loaded:
            if now < last_s + _UNHEARD_S * 2 ** self._restarts[child.name]:
                continue
            self._restarts[child.name] += 1
            if not self._coordinator.waiting and self._restarts[child.name] % 2:
                self._progress("no process is heard: the launcher joins the network again")
                self._coordinator.rejoin()
                self._restarts.update(other.name for other in loaded if other is not child)
                return
            self._progress(f"{child.name} (pid {child.pid}) is not heard: it is started again")
            self._start_again(child)
            del self._running[child.name]
            return

    def _is_introduced(self, child: ChildProcess, now: float) -> bool:
        if child.command.beside:
            return True
        if child.name not in self._introduced:
            heard = self._coordinator.waiting.keys() >= set(child.command.reporters)
            if heard or (child.name == RECORDER and self._coordinator.sees(RECORDER)):
                self._introduced[child.name] = now
        return child.name in self._introduced

    def _is_running(self, child: ChildProcess, now: float) -> bool:
        if child.name not in self._running and child.reports.running:
            self._running[child.name] = now
        # A bridge that was asked to act may be flying its vehicle.
        bridge = child.command.ends and child.name != SIM
        return child.name in self._running and not (bridge and self._coordinator.asked(child.name))
