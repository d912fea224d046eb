"""Lock-step: names the processes that a flight waits for.

The rule: when no UAV has answered the sim for `SAID_S`, the sim prints the processes that it waits for, and
tells the launcher. A UAV that only waits for others still sends its status, so it is alive. The launcher ends
a UAV that has sent none when the wait has lasted `ENDED_S`; the others then fly on without it. A UAV that sends
its status has `SLOW_ENDED_S`, and so has a recorder, because a disk may be slow.

The sim gives a sign of life every two seconds, and five times a second while it waits. The launcher ends one
that has given none for `SIM_ENDED_S`, in real time too.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping

from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics, readiness
from ptnsbc_sim.counters import STATUS_HZ

SAID_S = 3.0
ENDED_S = 10.0
SLOW_ENDED_S = 60.0
SIM_ENDED_S = 30.0
WAITED = "waited_s"
"""Key of /formation/ready: for how long the sim has waited for those in `waiting_for`."""
_REPORT_GAP_S = 1.0  # the sim reports five times a second
_SIGN_OF_LIFE_S = 2.0  # a process that is kept waiting says so five times a second


class LockstepWatchdog:
    """Notices that a flight does not advance."""

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self._send = send
        self._mark: object = None
        self._looks = 0

    def look(self, mark: object, awaited: Callable[[], list[str]]) -> None:
        """Call it `STATUS_HZ` times a second; `mark` changes when the flight advances."""
        # Calls are counted, not seconds: while the sim itself is suspended it waits for no process.
        self._looks = self._looks + 1 if mark == self._mark else 0
        self._mark = mark
        if self._looks < SAID_S * STATUS_HZ:
            return
        names, waited_s = awaited(), self._looks / STATUS_HZ
        message = f"no answer from {' '.join(names)} for {waited_s:.0f} s"
        if self._looks == round(SAID_S * STATUS_HZ):
            print(f"sim: {message}", file=sys.stderr, flush=True)
        values = {**readiness(names), WAITED: f"{waited_s:.1f}"}
        self._send(diagnostics(0, "sim: world", DiagnosticLevel.ERROR, message, values))


class LockstepWait:
    """For how long the sim has reported that it waits, by our own clock: what a report says of it is not believed."""

    def __init__(self) -> None:
        self._since_s: dict[str, float] = {}  # by process
        self._newest_s = float("-inf")

    def reported(self, now_s: float, names: Iterable[str]) -> None:
        """The sim waits for these processes."""
        before = self._since_s if now_s - self._newest_s < _REPORT_GAP_S else {}
        # The sim's first report comes after SAID_S of waiting.
        self._since_s = {name: before.get(name, now_s - SAID_S) for name in names}
        self._newest_s = now_s

    def stuck(self, now_s: float, last_s: Mapping[str, float]) -> dict[str, float]:
        """Processes that are waited for and give no sign of life, or have not answered for `SLOW_ENDED_S`.

        `last_s`: by process the time of its last status. Returns for how long each has been waited for [s]; nothing
        when the reports have ceased.
        """
        if now_s - self._newest_s >= _REPORT_GAP_S:
            return {}
        waited = {name: now_s - since_s for name, since_s in self._since_s.items()}
        return {
            name: waited_s
            for name, waited_s in waited.items()
            if waited_s >= SLOW_ENDED_S or last_s.get(name, 0.0) < now_s - _SIGN_OF_LIFE_S
        }
