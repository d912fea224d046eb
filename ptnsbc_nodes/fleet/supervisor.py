"""The processes of a flight on this computer: what ends and what goes on when one of them dies, and their end in order.

- A UAV's process or its bridge ends: it is named, no process waits for it any longer, the others fly on.
- A bridge dies and leaves its vehicle in flight: another one takes it over.
- The recorder ends: the flight goes on without it.
- A bridge stands still for 10 s: it is killed, and the rule above holds.
- The sim ends, or the last UAV: nothing is left to fly, and the flight ends.
- A process for which a lock-step flight waits in vain, or a sim without a sign of life, is killed: the rules above.
- The launcher that leads is gone: simulated vehicles end, real ones fly on, for their operator decides.

Where other computers fly the rest, the computer with the recorder leads: it ends the flight, and tells the others. Each
computer ends its own processes.
"""

from __future__ import annotations

import math
import signal
import time
from importlib import import_module

from ptnsbc_nodes.bridge.procedure.steps import OVER
from ptnsbc_nodes.comm.topics import RECORDER, SIM
from ptnsbc_nodes.emergency import in_pilots_hands, latched, record_path, records, summary
from ptnsbc_nodes.fleet.child_process import BRIDGE, UAV, ChildProcess, end, fault_lines
from ptnsbc_nodes.fleet.fault_injector import FaultInjector
from ptnsbc_nodes.fleet.fleet_node import LauncherNode
from ptnsbc_nodes.fleet.takeoff import Launch, Report
from ptnsbc_nodes.runtime.watchdog import ENDED_S, SIM_ENDED_S, SLOW_ENDED_S

_LOOK_S = 0.05
_AFTER_START_S = 1.0  # the epoch is half a second after the call
_LANDING_CALL_S = 3.0
_LANDING_S = 240.0
_RECORDER_PATIENCE_S = 60.0  # what is still queued belongs into the bag
_PILOTS_S = 10.0  # a pilot lands when it suits the pilot
_OVER_S = 3.0
_GIVEN_UP = {step.value for step in OVER}
_MOST_BRIDGES = 3  # that take over one vehicle, one after the other


class SilenceWatch:
    """Ends processes that give no sign of life."""

    def __init__(self, progress: Report) -> None:
        self._progress = progress
        self._signs: dict[int, tuple[object, int]] = {}
        """By pid the newest sign, and for how many looks it has been the newest."""

    def look(self, child: ChildProcess, sign: object, limit_s: float) -> None:
        """End a process whose sign has stayed the same for `limit_s`."""
        # Looks are counted, not seconds: while the launcher itself is suspended it hears nothing.
        last, looks = self._signs.get(child.pid, (sign, -1))
        looks = looks + 1 if sign == last else 0
        self._signs[child.pid] = sign, looks
        if looks * _LOOK_S >= limit_s:
            self._progress(f"{child.name} (pid {child.pid}) gives no sign of life: it is ended")
            child.send(signal.SIGKILL)


class Supervisor:
    """Watches the processes of this computer in flight, and ends them."""

    def __init__(self, launch: Launch, faults: FaultInjector) -> None:
        self.died: list[ChildProcess] = []  # before their time
        self.lost_elsewhere: list[str] = []  # UAVs that have ended on other computers
        self._options, self._crew, self._node, self._stop, self._progress = launch
        if self._options.backend != "sim":  # it needs pymavlink, and no time in an emergency
            import_module("ptnsbc_nodes.fleet.emergency_stop")
        self._faults = faults
        self._reported: set[str] = set()  # processes whose end has been reported
        self._was_led = False
        self._silence = SilenceWatch(self._progress)

    def watch(self, duration_s: float) -> None:
        """Return when the sim has flown the whole flight, real vehicles must land, or a signal has come.

        A launcher that follows returns when the one that leads says so or is gone.
        """
        if not self._options.leads:
            news = self._node.news
            # A network that loses packets may introduce the topic of the end to one side only: SIM in `gone`.
            while not (news.over or SIM in news.gone or self._stop.came or self._abandoned()):
                self._look()
                if all(child.exit_code is not None for child in self._crew.children):
                    return
            return
        begin_s = time.monotonic() + self._node.leader.begins_in_s() + _AFTER_START_S
        bridged = self._options.bridged
        while self._flying() and not self._stop.came:
            self._look()
            if time.monotonic() > begin_s:
                self._end_silent_sim()
            if bridged and time.monotonic() > begin_s + duration_s:
                return

    def _abandoned(self) -> bool:
        if self._node.news.led:
            self._was_led = True
            return False
        if not self._was_led:
            return False
        self._was_led = False  # reported once
        self._progress("the computer with the recorder is gone")
        # Real vehicles fly on: their operator decides whether they land.
        return not self._options.bridged

    def _flying(self) -> bool:
        """True if both a vehicle's process and a UAV are left, as far as this computer knows."""
        remote_uavs = [name for name in self._remote if name.startswith("uav")]
        vehicles = any(c.command.ends and c.exit_code is None for c in self._crew.children)
        uavs = any(c.command.uavs and c not in self.died for c in self._crew.children)
        return (vehicles or len(self._remote) > len(remote_uavs)) and (uavs or bool(remote_uavs))

    def _look(self) -> None:
        self._node.spin(_LOOK_S)
        self._crew.pass_on_lines(self._progress)
        self._faults.look(self._crew.children)
        self._end_stuck()
        self._end_silent_bridges()
        self._report_exits()

    def _end_stuck(self) -> None:
        """End processes for which a lock-step flight waits in vain (`LockstepWatchdog`)."""
        if not self._options.lockstep:  # a real-time flight waits for no process
            return
        stuck = self._node.status.stuck()
        for child in self._crew.children:
            limit_s = SLOW_ENDED_S if child.name == RECORDER else ENDED_S
            ends = child.name == RECORDER or bool(child.command.uavs)
            stuck_s = max(stuck.get(name, 0.0) for name in child.command.reporters)
            if ends and stuck_s >= limit_s and child.exit_code is None:
                self._progress(f"{child.name} (pid {child.pid}) is stuck: it is ended")
                child.send(signal.SIGKILL)

    def _end_silent_sim(self) -> None:
        """End a sim that gives no sign of life: no UAV can fly on, and a flight must not wait for ever."""
        for child in self._crew.children:
            if child.name == SIM and child.exit_code is None:
                sign = child.log_size, self._node.status.last_s.get(SIM)
                self._silence.look(child, sign, SIM_ENDED_S)

    def _end_silent_bridges(self) -> None:
        """End a bridge that writes no record: another one takes its vehicle over, or the launcher lands it."""
        for child in self._bridges:
            record = record_path(self._node.folder, child.name)
            if child.exit_code is None and child.reports.running and record.exists():
                self._silence.look(child, record.stat().st_mtime_ns, ENDED_S)

    def _report_exits(self) -> None:
        """Report every process that has ended before its time; the others fly on without it."""
        for child in self._crew.children:
            settled = child.exit_code is None or child.name in self._reported
            if settled or self._faults.comes_back(child):
                continue
            self._reported.add(child.name)
            lost = {child.name} if self._options.shared else set()
            if not (child.command.ends and child.exit_code == 0):
                self.died.append(child)
                if not child.fault:  # it has told that, and is named once more at the end
                    self._progress(child.exit_summary())
                if self._is_replaced(child):
                    continue
                lost.update(child.command.lost)
            for name in lost:
                self._node.news.lose(name)
        for name in self._node.news.gone.intersection(self._options.elsewhere) - self._reported:
            self._reported.add(name)
            self._progress(f"{name} has ended, on another computer")
            if name.startswith("uav"):
                self.lost_elsewhere.append(name)

    def _is_replaced(self, child: ChildProcess) -> bool:
        """Start another bridge for the vehicle that a dead one has left in flight; False if there is none for it."""
        folder, name = self._node.folder, child.name
        deaths = sum(dead.name == name for dead in self.died)
        # An order that holds reaches the vehicle past its bridge, from the bridge's own port.
        may_fly = deaths <= _MOST_BRIDGES and not latched(folder).what
        for left in (record for record in records(folder) if record.name == name and record.armed):
            fate = f": {left.fate}" if left.fate else ""
            word = f"{name}: its vehicle was {left.state}{fate}"
            if may_fly and left.orphaned and left.frame and left.step not in _GIVEN_UP:
                self._progress(f"{word}; another bridge takes it over")
                self._reported.discard(name)
                self._crew.start_again(child)
                return True
            past = "nothing reaches" if left.connect.startswith("ros:") else "ptnsbc stop reaches"
            self._progress(f"{word}; {past} it past its bridge")
        return False

    def end(self) -> None:
        """Land what is in the air and end all processes, the recorder last, so that its bag is complete."""
        children = self._crew.children
        signals = self._stop.count if self._bridges else 0
        self._faults.end()
        self._land()
        self._crew.pass_on_lines(self._progress)
        self._node.news.end(_OVER_S)
        # The middleware may hang a process that hears others leave, and then no signal ends it (docs/platform.md).
        self._node.leave()
        end([child for child in children if child.name != RECORDER])
        if names := {bridge.name for bridge in self._bridges}:
            from ptnsbc_nodes.fleet.emergency_stop import land_left_behind

            land_left_behind(
                self._node.folder, names, lambda: self._stop.count > signals, self._progress
            )
        end(children, _RECORDER_PATIENCE_S)
        for child in children:
            if child.exit_code == 0 or child in self.died or child.name in self._reported:
                continue
            if child.exit_code == -signal.SIGKILL and child.reports.summary is not None:
                # The middleware does not always let go of a process.
                self._progress(
                    f"{child.name} (pid {child.pid}) had finished its work but did not exit: killed"
                )
            else:
                self.died.append(child)
                if not child.fault:
                    self._progress(f"at the end: {child.exit_summary()}")
        for line in fault_lines(self.died):
            self._progress(line)
        if text := summary(self._node.folder, names) if names else "":
            self._progress(text)

    @property
    def _bridges(self) -> list[ChildProcess]:
        return [child for child in self._crew.children if child.command.module == BRIDGE]

    @property
    def _remote(self) -> list[str]:
        """The processes of other computers that have not ended."""
        return [name for name in self._options.elsewhere if name not in self._node.news.gone]

    @property
    def _led(self) -> bool:
        """True if the process of a UAV is left: one of them offers the services of the leader."""
        here = (c for c in self._crew.children if c.command.module == UAV)
        remote = any(name.startswith("uav") for name in self._remote)
        return remote or any(c.exit_code is None for c in here)

    def _land(self) -> None:
        """Land what is still in the air, before the processes that fly it are ended."""

        def is_airborne() -> bool:
            return any(child.exit_code is None for child in self._bridges) or (
                self._options.leads and any(name.startswith("bridge") for name in self._remote)
            )

        if not is_airborne():
            return
        if self._options.leads:
            leg = "stop" if self._stop.came else "land"
            call_down(self._node, leg, self._progress, led=self._led)
        elif not self._node.news.over:  # only the vehicles of this computer: others fly on
            for bridge in self._bridges:
                bridge.send(signal.SIGINT)
        limit_s, signals, pilots_s = time.monotonic() + _LANDING_S, self._stop.count, math.inf
        while is_airborne() and self._stop.count == signals:
            self._look()
            now_s = time.monotonic()
            flying = [bridge.name for bridge in self._bridges if bridge.exit_code is None]
            left = bool(flying) and in_pilots_hands(self._node.folder, flying)
            pilots_s = min(pilots_s, now_s + _PILOTS_S) if left else math.inf
            if now_s >= min(limit_s, pilots_s):
                names = ", ".join(flying) or "other computers"
                self._progress(f"not waited for any longer: {names}")
                break


def call_down(node: LauncherNode, leg: str, progress: Report, *, led: bool = True) -> None:
    """Have the leader land the fleet, by `land` or `stop`; without its answer every bridge is told by itself.

    `led`: whether there may be a leader.
    """
    refusal = node.leader.call(leg, _LANDING_CALL_S) if led else ""
    if refusal:
        progress(f"every bridge is told to land by itself: {refusal}")
    if refusal is not None:
        from ptnsbc_nodes.fleet.emergency_stop import order_landing

        for line in order_landing(node.folder, node):
            progress(line)
