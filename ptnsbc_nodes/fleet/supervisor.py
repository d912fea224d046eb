"""The processes of a flight on this computer: started, watched, ended in order.

Where other computers fly the rest, the computer with the recorder leads: it waits for all processes, starts
the flight, ends it, and tells the others. Each computer starts and ends its own processes.
"""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.comm.topics import RECORDER, SIM
from ptnsbc_nodes.emergency.records import in_pilots_hands, last_word
from ptnsbc_nodes.fleet.child_process import ChildProcess, ProcessCommand, end
from ptnsbc_nodes.fleet.coordinator_node import Coordinator
from ptnsbc_nodes.fleet.emergency_stop import order_landing
from ptnsbc_nodes.fleet.fault_injector import FaultInjector
from ptnsbc_nodes.fleet.flight_check import FlightCheck
from ptnsbc_nodes.fleet.introduction import Introduction
from ptnsbc_nodes.fleet.process_list import FleetOptions, names
from ptnsbc_nodes.runtime.signals import StopRequest
from ptnsbc_nodes.runtime.watchdog import ENDED_S, RECORDER_ENDED_S, SIM_ENDED_S

Report = Callable[[str], None]

BRIDGE = "ptnsbc_nodes.bridge.bridge_main"
_LOOK_S = 0.05
_EPOCH_S = 0.5  # from the call to the epoch
_AFTER_START_S = 1.0  # the epoch is half a second after the call
_LANDING_CALL_S = 3.0
_LANDING_S = 240.0
_RECORDER_PATIENCE_S = 60.0  # what is still queued belongs into the bag
_PILOTS_S = 10.0  # a pilot lands when it suits the pilot
_OVER_S = 3.0
_REMINDER_S = 10.0


class FleetError(PtnsbcError):
    """A fleet that could not take off."""


class Supervisor:
    """The running processes of this computer."""

    def __init__(
        self, options: FleetOptions, coordinator: Coordinator, stop: StopRequest, progress: Report
    ) -> None:
        self.children: list[ChildProcess] = []
        self.died: list[ChildProcess] = []
        self.lost_elsewhere: list[str] = []  # UAVs that have ended on other computers
        self._options = options
        self._coordinator = coordinator
        self._check = FlightCheck(options, coordinator)
        self._stop = stop
        self._progress = progress
        all_names = names(options.scenario, options.backend) if options.shared else []
        self._elsewhere = [name for name in all_names if name not in options.only]
        self._reported: set[str] = set()  # processes whose end has been reported
        self._refusal: str | None = "/formation/start was not called"
        self._reminder = time.monotonic() + _REMINDER_S
        self._was_led = False
        self._introduction = Introduction(coordinator, progress, self._start_again)
        self._sim_sign: object = None  # the newest sign of life of the sim
        self._sim_lines = self._quiet_looks = 0
        self._faults = FaultInjector(options, progress, self._launch_again)
        if options.scenario.faults is not None:
            coordinator.listen_for_faults(options.scenario.uav_ids, self._faults.add)
        if options.shared:
            coordinator.share(leads=options.leads)

    def start(
        self,
        commands: Sequence[ProcessCommand],
        settings: Mapping[str, str],
        log_dir: Path,
        deadline: float,
    ) -> None:
        """Start all processes, a few at a time, wait until all are ready, and start the flight."""
        # Half of a process's start is loading, half is waiting for its discovery.
        at_once = 2 * (os.cpu_count() or 1)
        self._launch = partial(ChildProcess, environment=settings, log_dir=log_dir)
        if self._options.leads:
            self._coordinator.serve_arming(self._check.refusal)
        for command in commands:
            while len(self._silent()) >= at_once and self._wait(deadline):
                pass
            if self._stop.came:
                return
            self.children.append(self._launch(command))
            self._manage(command)
        if self._options.leads:
            self._start_flight(deadline)
        else:
            self._wait_for_own(deadline)

    def _start_flight(self, deadline: float) -> None:
        while self._check.holds and not self._check.located() and self._wait(deadline):
            pass
        if self._check.holds and not self._stop.came:
            if objection := self._check.before_arming():
                raise FleetError(f"from where the vehicles stand nothing is armed: {objection}")
            if self._options.objection is not None:
                self._progress("dry runs from where the vehicles stand are met: they may arm")
            deadline += self._wait_for_arming()
            self._check.release()
        awaited = self._awaited()
        while self._coordinator.missing(awaited) and self._wait(deadline):
            pass
        if not self._stop.came and (objection := self._check.before_start()):
            raise FleetError(f"from the measured positions the flight is not started: {objection}")
        if self._options.wait:
            self._wait_for_operator()
        else:
            self._begin(deadline)
        if not self._stop.came:
            count = len(self.children) + len(self._elsewhere)
            begins_in_s = self._coordinator.begins_in_s()
            after = f", and the mission begins in {begins_in_s:.0f} s" if begins_in_s > 1.0 else ""
            self._faults.begin(time.monotonic() + (begins_in_s or _EPOCH_S))
            self._progress(f"{count} processes are ready: started{after}")

    def _begin(self, deadline: float) -> None:
        """Call for the first leg; with a mission that begins by the clock, until the leader has told when."""
        by_clock = self._options.starts_by_clock
        if by_clock:
            self._coordinator.listen_for_start()
        while self._refusal and self._wait(deadline):
            self._refusal = self._coordinator.start(patience_s=2.0)
        while by_clock and not self._coordinator.begun and self._wait(deadline):
            pass

    def _wait_for_arming(self) -> float:
        """Wait until an operator lets the vehicles arm, if one does; returns for how long [s]."""
        began = time.monotonic()
        if self._options.wait:
            self._progress("the vehicles arm when an operator calls /formation/arm")
            while not self._coordinator.may_arm and self._wait(math.inf):
                pass
        return time.monotonic() - began

    def _wait_for_operator(self) -> None:
        self._coordinator.listen_for_start()
        self._progress("all are ready: the flight begins when an operator calls /formation/start")
        while not self._coordinator.begun and self._wait(math.inf):
            pass

    def _wait_for_own(self, deadline: float) -> None:
        while self._silent() and self._wait(deadline):
            pass
        if not self._stop.came:
            own = ", ".join(child.name for child in self.children)
            self._progress(f"{own}: running; the computer with the recorder starts the flight")

    def watch(self, duration_s: float) -> None:
        """Return when the sim has flown the whole flight, real vehicles must land, or a signal has come."""
        if not self._options.leads:
            self._follow()
            return
        begin_s = time.monotonic() + self._coordinator.begins_in_s() + _AFTER_START_S
        over_s = begin_s + duration_s
        bridged = self._options.backend == "mavlink"
        while self._flying() and not self._stop.came:
            self._look()
            if time.monotonic() > begin_s:
                self._end_silent_sim()
            if bridged and time.monotonic() > over_s:
                return

    def _follow(self) -> None:
        """Return when the launcher that leads says so or is gone, when the sim has ended, or when a signal has come."""
        while not (self._coordinator.over or self._stop.came or self._abandoned()):
            self._look()
            # A network that loses packets may introduce the topic of the end to one side only.
            if SIM in self._coordinator.gone:
                return
            if all(child.exit_code is not None for child in self.children):
                return

    def _abandoned(self) -> bool:
        if self._coordinator.led:
            self._was_led = True
            return False
        if not self._was_led:
            return False
        self._was_led = False  # reported once
        self._progress("the computer with the recorder is gone")
        # Real vehicles fly on: their operator decides whether they land.
        return self._options.backend == "sim"

    def _flying(self) -> bool:
        """True if both a vehicle's process and a UAV are left, as far as this computer knows."""
        remote = [name for name in self._elsewhere if name not in self._coordinator.gone]
        remote_uavs = [name for name in remote if name.startswith("uav")]
        vehicles = any(c.command.ends and c.exit_code is None for c in self.children)
        uavs = any(c.command.uavs and c not in self.died for c in self.children)
        return (vehicles or len(remote) > len(remote_uavs)) and (uavs or bool(remote_uavs))

    def _look(self) -> None:
        self._coordinator.spin(_LOOK_S)
        self._pass_on_lines()
        self._faults.look(self.children)
        self._end_stuck()
        self._report_exits()

    def _end_stuck(self) -> None:
        """End processes for which a lock-step flight waits in vain (`LockstepWatchdog`)."""
        if not self._options.lockstep:  # a real-time flight waits for no process
            return
        stuck = self._coordinator.stuck()
        for child in self.children:
            limit_s = RECORDER_ENDED_S if child.name == RECORDER else ENDED_S
            ends = child.name == RECORDER or bool(child.command.uavs)
            stuck_s = max(stuck.get(name, 0.0) for name in child.command.reporters)
            if ends and stuck_s >= limit_s and child.exit_code is None:
                self._progress(f"{child.name} (pid {child.pid}) is stuck: it is ended")
                child.send(signal.SIGKILL)

    def _end_silent_sim(self) -> None:
        """End a sim that gives no sign of life: no UAV can fly on, and a flight must not wait for ever."""
        sign = self._sim_lines, self._coordinator.last_status_s(SIM)
        # Looks are counted, not seconds: while the launcher itself is suspended it hears nothing.
        self._quiet_looks = self._quiet_looks + 1 if sign == self._sim_sign else 0
        self._sim_sign = sign
        for child in self.children:
            silent = child.name == SIM and self._quiet_looks * _LOOK_S >= SIM_ENDED_S
            if silent and child.exit_code is None:
                self._progress(f"{SIM} (pid {child.pid}) gives no sign of life: it is ended")
                child.send(signal.SIGKILL)

    def _pass_on_lines(self) -> None:
        """Pass on what the sim and the bridges say of the flight."""
        for child in self.children:
            if child.command.ends:
                lines = child.new_lines()
                self._sim_lines += len(lines) if child.name == SIM else 0
                for line in lines:
                    if line.startswith(f"{child.name}: "):
                        self._progress(line)

    def _land(self) -> None:
        """Land what is still in the air, before the processes that fly it are ended."""
        bridges = [c for c in self.children if c.command.ends and c.name != SIM]
        remote = [name for name in self._elsewhere if name.startswith("bridge")]

        def airborne() -> bool:
            return any(child.exit_code is None for child in bridges) or (
                self._options.leads and any(name not in self._coordinator.gone for name in remote)
            )

        if not airborne():
            return
        if self._options.leads:
            self._call_down()
        elif not self._coordinator.over:  # only the vehicles of this computer: others fly on
            for bridge in bridges:
                bridge.send(signal.SIGINT)
        limit_s, signals = time.monotonic() + _LANDING_S, self._stop.count
        pilots_s = float("inf")
        while airborne() and self._stop.count == signals:
            self._look()
            now_s = time.monotonic()
            flying = [bridge.name for bridge in bridges if bridge.exit_code is None]
            left = bool(flying) and in_pilots_hands(self._folder, flying)
            pilots_s = min(pilots_s, now_s + _PILOTS_S) if left else float("inf")
            if now_s >= min(limit_s, pilots_s):
                self._progress(
                    f"not waited for any longer: {', '.join(flying) or 'other computers'}"
                )
                break
        self._name_armed(bridges)

    @property
    def _folder(self) -> Path:
        """The folder in which the bridges keep their records."""
        return self._coordinator.runtime_folder()

    def _name_armed(self, bridges: Sequence[ChildProcess]) -> None:
        """Name each vehicle that is still armed, with place, mode and what it does now."""
        for bridge in bridges:
            is_bridge = bridge.command.module == BRIDGE
            if is_bridge and (word := last_word(self._folder, bridge.name)):
                self._progress(f"{bridge.name}: {word}")

    def _call_down(self) -> None:
        leg = "stop" if self._stop.came else "land"
        refusal = self._coordinator.call(leg, _LANDING_CALL_S)
        if refusal is not None:
            self._progress(f"{refusal}: every bridge is told to land by itself")
            for line in order_landing(self._coordinator):
                self._progress(line)

    def end(self) -> None:
        """End all processes, the recorder last, so that its bag is complete."""
        self._faults.end()
        self._land()
        self._pass_on_lines()
        self._coordinator.end(_OVER_S)
        # The middleware may hang a process that hears others leave, and then no signal ends it (docs/platform.md).
        self._coordinator.leave()
        end([child for child in self.children if child.name != RECORDER])
        end(self.children, _RECORDER_PATIENCE_S)
        for child in self.children:
            if child.exit_code == 0 or child in self.died or child.name in self._reported:
                continue
            if child.exit_code == -signal.SIGKILL and child.reports.summary is not None:
                # The middleware does not always let go of a process.
                self._progress(
                    f"{child.name} (pid {child.pid}) had finished its work but did not exit: killed"
                )
            else:
                if not child.command.beside:
                    self.died.append(child)
                self._progress(f"at the end: {child.exit_summary()}")

    def _awaited(self) -> list[str]:
        """The processes that must be ready before the flight."""
        started = (child.command for child in self.children if not child.command.beside)
        own = [name for command in started for name in command.reporters]
        return [name for name in (*own, *self._elsewhere) if name != RECORDER]

    def _silent(self) -> list[str]:
        """Processes that have been started but not heard of: they load the CPU."""
        return [child.name for child in self.children if not self._heard(child)]

    def _heard(self, child: ChildProcess) -> bool:
        if child.name == RECORDER:  # it has no status on /diagnostics
            return child.reports.running
        if child.command.beside:
            return child.reports.running or child.exit_code is not None
        return self._coordinator.waiting.keys() >= set(child.command.reporters)

    def _wait(self, deadline: float) -> bool:
        """Wait a little; False when a signal has come, FleetError when it takes too long."""
        self._coordinator.spin(_LOOK_S)
        self._pass_on_lines()
        self._introduction.look(self.children)
        for child in self.children:
            ended = child.exit_code is not None and not child.command.beside
            if ended and not self._stop.came:
                raise FleetError(f"before the flight: {child.exit_summary()}")
            for name in set(child.command.reporters).intersection(self._coordinator.refused):
                raise FleetError(self._refused(name, child))
        if time.monotonic() > deadline:
            raise FleetError(self._late())
        if self._options.shared and time.monotonic() > self._reminder:
            self._reminder = time.monotonic() + _REMINDER_S
            self._progress("\n".join(self._waiting_for()) or f"all are ready, but {self._refusal}")
        return not self._stop.came

    def _refused(self, name: str, child: ChildProcess) -> str:
        if not child.reports.running:  # it cannot have answered
            return (
                f"{name} of another fleet is in domain {self._coordinator.domain}: expected another domain "
                "(--domain N, or no ROS_DOMAIN_ID), or a --namespace of its own"
            )
        return f"{name} refused to be activated, {child.log}\n{child.tail()}"

    def _start_again(self, child: ChildProcess) -> None:
        end([child])
        self._launch_again(child)

    def _launch_again(self, child: ChildProcess) -> None:
        """Start a process that has ended once more, in its place."""
        command = child.command
        if child.name == RECORDER:  # the bag that is there is its own, and empty
            command = replace(command, arguments=(*command.arguments, "--overwrite"))
        self.children[self.children.index(child)] = self._launch(command)
        self._manage(command)

    def _manage(self, command: ProcessCommand) -> None:
        if command.managed:
            self._coordinator.manage(command.name, command.managed)

    def _late(self) -> str:
        lines = self._waiting_for()
        if not lines:
            return f"all are ready, but {self._refusal}"
        late = self._coordinator.missing(self._awaited())
        tail = [c.tail() for c in self.children if late.keys() & set(c.command.reporters)][:1]
        return "\n".join([f"not ready in time: {', '.join(late)}", *lines, *tail])

    def _waiting_for(self) -> list[str]:
        logs = {name: str(c.log) for c in self.children for name in c.command.reporters}
        return [
            f"  {name} waits for {what}; {logs.get(name, 'on another computer')}"
            for name, what in self._coordinator.missing(self._awaited()).items()
        ]

    def _report_exits(self) -> None:
        """Report every process that has ended before its time; the others fly on without it."""
        for child in self.children:
            if child.exit_code is None or child.name in self._reported:
                continue
            if self._faults.comes_back(child):
                continue
            self._reported.add(child.name)
            if child.command.beside:
                self._progress(f"{child.exit_summary()}; the flight goes on without it")
                continue
            lost = {child.name} if self._options.shared else set()
            if not (child.command.ends and child.exit_code == 0):
                self.died.append(child)
                self._progress(child.exit_summary())
                self._name_armed([child])
                lost.update(child.command.lost)
            for name in lost:
                self._coordinator.lose(name)
        for name in self._coordinator.gone.intersection(self._elsewhere) - self._reported:
            self._reported.add(name)
            self._progress(f"{name} has ended, on another computer")
            if name.startswith("uav"):
                self.lost_elsewhere.append(name)
