"""From the first process of a flight to its start: all processes are heard and ready, and nothing speaks against it.

Where other computers fly the rest, the computer with the recorder leads: it waits for all processes, and starts the
flight.
"""

from __future__ import annotations

import math
import os
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from std_srvs.srv import Trigger

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.bridge.procedure.steps import OVER, Step
from ptnsbc_nodes.comm.announcements import ARM_SERVICE, Requests
from ptnsbc_nodes.comm.topics import RECORDER
from ptnsbc_nodes.fleet.child_process import (
    UAV,
    ChildProcess,
    Crew,
    FleetOptions,
    ProcessCommand,
    end,
)
from ptnsbc_nodes.fleet.fleet_node import LauncherNode
from ptnsbc_nodes.runtime.signals import StopRequest
from ptnsbc_sim.sweep.dry_run import with_starts_at

Report = Callable[[str], None]

_UNHEARD_S = 15.0  # discovery takes a few seconds, on a busy machine too
_LOOK_S = 0.05
_REMINDER_S = 10.0


class FleetError(PtnsbcError):
    """A fleet that could not take off."""


class Launch(NamedTuple):
    """One flight of a launcher: what is flown, by which processes, and who says what of it."""

    options: FleetOptions
    crew: Crew
    node: LauncherNode
    stop: StopRequest
    progress: Report


class TakeOff:
    """The start of the processes of this computer, and of the flight where this computer leads."""

    def __init__(self, launch: Launch) -> None:
        self._options, self._crew, self._node, self._stop, self._progress = launch
        self._check = FlightCheck(self._options, self._node)
        self._introduction = Introduction(launch)
        self._refusal: str | None = "/formation/start was not called"
        self._reminder_s = time.monotonic() + _REMINDER_S

    def run(self, commands: Sequence[ProcessCommand], deadline: float) -> None:
        """Start all processes, a few at a time, wait until all are ready, and start the flight.

        Raises:
            FleetError: a process has ended or refuses, the deadline is over, or dry runs speak against the flight.
        """
        if self._options.leads:
            self._check.serve()
        first = next((k for k, one in enumerate(commands) if one.module == UAV), len(commands))
        self._start(commands[:first], deadline)
        deadline = self._let_arm(deadline)
        self._start(commands[first:], deadline)
        if self._stop.came:
            return
        if self._options.leads:
            self._start_flight(deadline)
            return
        while self._silent() and self._wait(deadline):
            pass
        if not self._stop.came:
            names = ", ".join(child.name for child in self._crew.children)
            self._progress(f"{names}: running; the computer with the recorder starts the flight")

    def _start(self, commands: Sequence[ProcessCommand], deadline: float) -> None:
        # Half of a process's start is loading, half is waiting for its discovery.
        at_once = 2 * (os.cpu_count() or 1)
        for command in commands:
            while len(self._silent()) >= at_once and self._wait(deadline):
                pass
            if not self._stop.came:
                self._crew.start(command)

    def _let_arm(self, deadline: float) -> float:
        """Wait until UAV processes may start, without which nothing arms; return the deadline, later by that wait.

        All bridges here are heard by then: `Introduction` starts none again that may be flying its vehicle.
        """
        check, bridged = self._check, self._options.bridged
        while bridged and self._silent() and self._wait(deadline):
            pass
        while check.holds and check.lost() and self._wait(deadline):
            pass
        if not check.holds or self._stop.came:
            return deadline
        began_s = time.monotonic()
        if objection := check.before_arming():
            raise FleetError(f"from where the vehicles stand nothing is armed: {objection}")
        if self._options.objection is not None:
            self._progress("dry runs from where the vehicles stand are met: they may arm")
        if self._options.wait:
            self._progress("the vehicles arm when an operator calls /formation/arm")
            while not check.may_arm and self._wait(math.inf):
                pass
        check.holds = False
        return deadline + time.monotonic() - began_s

    def _start_flight(self, deadline: float) -> None:
        while self._missing() and self._wait(deadline):
            pass
        self._begin(deadline)
        if not self._stop.came:
            count = len(self._crew.children) + len(self._options.elsewhere)
            begins_in_s = self._node.leader.begins_in_s()
            after = f", and the mission begins in {begins_in_s:.0f} s" if begins_in_s > 1.0 else ""
            self._progress(f"{count} processes are ready: started{after}")

    def _begin(self, deadline: float) -> None:
        """Call for the first leg, or wait for it; a mission that begins by the clock has begun when it is announced."""
        leader, by_clock = self._node.leader, self._options.starts_by_clock
        leader.listen_for_start()  # without which the leader of real vehicles refuses to begin
        if self._options.wait:
            self._progress(
                "all are ready: the flight begins when an operator calls /formation/start"
            )
            while not leader.begun and self._wait(math.inf):
                pass
            return
        while self._refusal and not leader.begun and self._wait(deadline):
            self._refusal = leader.start(patience_s=2.0)
        self._node.status.mute()
        while by_clock and not leader.begun and self._wait(deadline):
            pass

    def _missing(self) -> dict[str, str]:
        """The processes that must be ready before the flight and are not, and what each waits for."""
        names = [name for child in self._crew.children for name in child.command.reporters]
        awaited = [name for name in (*names, *self._options.elsewhere) if name != RECORDER]
        return self._node.status.missing(awaited)

    def _silent(self) -> list[ChildProcess]:
        """Processes that have been started but not heard of: they load the CPU."""

        def is_heard(child: ChildProcess) -> bool:
            if child.name == RECORDER:  # it has no status on /diagnostics
                return child.reports.running
            return self._node.status.waiting.keys() >= set(child.command.reporters)

        return [child for child in self._crew.children if not is_heard(child)]

    def _wait(self, deadline: float) -> bool:
        """Wait a little; False when a signal has come, FleetError when it takes too long."""
        self._node.spin(_LOOK_S)
        self._crew.pass_on_lines(self._progress)
        self._introduction.look()
        for child in self._crew.children:
            if child.exit_code is not None and not self._stop.came:
                raise FleetError(f"before the flight: {child.exit_summary()}")
            if child.life == 1 and not child.reports.running:
                for name in self._node.status.waiting.keys() & set(child.command.reporters):
                    raise FleetError(  # it cannot have reported
                        f"{name} of another fleet is in domain {self._node.domain}: expected another domain "
                        "(--domain N, or no ROS_DOMAIN_ID), or a --namespace of its own"
                    )
        if time.monotonic() > deadline:
            late, children = self._missing(), self._crew.children
            tails = [c.tail() for c in children if late.keys() & set(c.command.reporters)]
            first = [f"not ready in time: {', '.join(late)}"] if late else []
            raise FleetError("\n".join([*first, self._waiting_for(), *tails[:1]]))
        if self._options.shared and time.monotonic() > self._reminder_s:
            self._reminder_s = time.monotonic() + _REMINDER_S
            self._progress(self._waiting_for())
        return not self._stop.came

    def _waiting_for(self) -> str:
        """A line for each process that is not ready; why the flight is not started when all are."""
        logs = {name: str(c.log) for c in self._crew.children for name in c.command.reporters}
        lines = [
            f"  {name} waits for {what}; {logs.get(name, 'on another computer')}"
            for name, what in self._missing().items()
        ]
        return "\n".join(lines) or f"all are ready, but {self._refusal}"


class FlightCheck:
    """The check of a flight from where its vehicles are, once, before anything arms.

    No vehicle arms without its UAV process. The launcher starts these processes once all bridges know where their
    vehicles stand, none of them objects, and a flight from there, at the take-off height, is not refused by
    `FleetOptions.objection`.
    """

    def __init__(self, options: FleetOptions, node: LauncherNode) -> None:
        self.may_arm = False  # an operator has called /formation/arm, and it was accepted
        self._options, self._node = options, node
        self._met = False  # nothing speaks against arming
        judged = options.objection is not None or options.wait
        self.holds = judged and options.bridged  # vehicles are kept from arming

    def serve(self) -> None:
        """Answer /formation/arm, by which an operator lets the vehicles arm."""

        def join() -> None:
            endpoints = self._node.endpoints
            requests = Requests(endpoints, (ARM_SERVICE,), signed=self._node.seal is not None)

            def answer(_request: Any, response: Any) -> Any:
                reason = requests.refusal(ARM_SERVICE) or self.refusal()
                response.success = not reason
                response.message = reason or "the vehicles arm, and take off"
                self.may_arm = self.may_arm or not reason
                return response

            name = f"{endpoints.fleet}/formation/{ARM_SERVICE}"
            self._node.node.create_service(Trigger, name, answer)

        self._node.attach(join)

    def refusal(self) -> str:
        """The reason why an operator must not let the vehicles arm now; empty when nothing speaks against it."""
        if not self._options.bridged:
            return "simulated vehicles need no arming: /formation/start begins the flight"
        if not self._options.wait:
            return "the vehicles arm by themselves: with --wait the fleet leaves it to an operator"
        if not self.holds:
            return "the vehicles may arm already"
        lost, vehicles = self.lost(), self._node.status.vehicles
        if lost:
            steps = (f"{n}: {vehicles[n].step if n in vehicles else 'not heard'}" for n in lost)
            return "; ".join(steps)
        return "" if self._met else "dry runs from where the vehicles stand are flown: try again"

    def before_arming(self) -> str:
        """Judge the flight from above where the vehicles stand; without an objection they may arm."""
        status, starts = self._node.status, dict[int, tuple[float, ...]]()
        if told := [f"{name}: {text}" for name, text in status.objections.items() if text]:
            return "; ".join(told)
        for uav in self._options.scenario.uav_ids:
            name = f"bridge{uav}"
            x, y, z = status.places[name]
            # It may be airborne already, in a pilot's hands.
            vehicle, height_m = status.vehicles[name], 0.0
            if vehicle.landed or not vehicle.armed:
                height_m = self._options.scenario.mavlink.takeoff_height_m
            starts[uav] = (x, y, z + height_m)
        objection = self._objection(starts)
        self._met = not objection
        return objection

    def lost(self) -> list[str]:
        """Bridges that do not know where their vehicle is."""
        early = {step.value for step in (Step.HEARTBEAT, Step.PARAMETERS, Step.STATE, *OVER)}
        vehicles, places = self._node.status.vehicles, self._node.status.places
        names = [f"bridge{uav}" for uav in self._options.scenario.uav_ids]
        return [name for name in names if name not in places or vehicles[name].step in early]

    def _objection(self, places: dict[int, tuple[float, ...]]) -> str:
        judge = self._options.objection
        try:
            return "" if judge is None else judge(with_starts_at(self._options.scenario, places))
        except PtnsbcError as error:  # nobody may start from there
            return str(error)


class Introduction:
    """Notices processes that a discovery server has left out for good, and has them introduced once more."""

    def __init__(self, launch: Launch) -> None:
        self._options, self._crew, self._node, _, self._progress = launch
        self._introduced_s: dict[str, float] = {}  # since when processes have been heard
        self._running_s: dict[str, float] = {}  # since when processes have loaded
        self._restarts: Counter[str] = Counter()

    def look(self) -> None:
        """Start the first process again that has been unheard for too long, or join the network again."""
        now_s = time.monotonic()
        unheard = [child for child in self._crew.children if not self._is_introduced(child, now_s)]
        loaded = [child for child in unheard if self._is_running(child, now_s)]
        # As long as others are found, and while the machine is busy with loading, it may just be slow.
        last_s = max([*self._introduced_s.values(), *self._running_s.values()], default=now_s)
        for child in loaded:
            if now_s < last_s + _UNHEARD_S * 2 ** self._restarts[child.name]:
                continue
            self._restarts[child.name] += 1
            if not self._node.status.waiting and self._restarts[child.name] % 2:
                self._progress("no process is heard: the launcher joins the network again")
                self._node.rejoin()
                self._restarts.update(other.name for other in loaded if other is not child)
                return
            self._progress(f"{child.name} (pid {child.pid}) is not heard: it is started again")
            end([child])
            self._crew.start_again(child)
            del self._running_s[child.name]
            return

    def _is_introduced(self, child: ChildProcess, now_s: float) -> bool:
        if child.name not in self._introduced_s:
            heard = self._node.status.waiting.keys() >= set(child.command.reporters)
            if heard or (child.name == RECORDER and self._node.sees(RECORDER)):
                self._introduced_s[child.name] = now_s
        return child.name in self._introduced_s

    def _is_running(self, child: ChildProcess, now_s: float) -> bool:
        if child.name not in self._running_s and child.reports.running:
            self._running_s[child.name] = now_s
        return child.name in self._running_s and not self._may_fly(child)

    def _may_fly(self, child: ChildProcess) -> bool:
        """True if its real vehicle may arm meanwhile: there is a UAV process, for which its bridge does not wait."""
        led = child.command.module == UAV or {*child.command.lost} & {*self._options.elsewhere}
        vehicles = self._node.status.vehicles
        waits = any(
            vehicles[name].step == Step.CONTROLLER.value
            for name in (f"bridge{uav}" for uav in child.command.uavs)
            if name in vehicles
        )
        return self._options.bridged and bool(led) and not waits
