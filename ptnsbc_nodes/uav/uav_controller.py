"""One UAV in flight: its control step, memory and counters, the legs, its slot and its faults.

A UAV process and a re-run of its bag call the same. Of a fleet with open slots one UAV decides them by the odometry of
all, and each takes its own.

No ROS in here.
"""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.agent import NEAR_AGE, OWN, PARENT, Agent, PackedOutputs
from ptnsbc_core.behaviours.neighbour import UNKNOWN
from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_core.step import epoch_begins
from ptnsbc_core.types import (
    AVOIDANCE_OFF,
    MODE_FORMATION,
    MODE_HOLD,
    NEVER_RECEIVED_S,
    AgentState,
    Array,
    NeighbourMotions,
)
from ptnsbc_io.wire import HeaderFields, Stamped
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import DecidedSlots, Decision, LostProcess
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.legs import Epochs, Leg
from ptnsbc_nodes.uav.inbox import Inbox
from ptnsbc_sim.counters import UavCounters
from ptnsbc_sim.disturbances.faults import without_position
from ptnsbc_sim.plugins.uav_plugins import UavPlugins
from ptnsbc_sim.roles import RoleChange, UavRole, moved_on
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.constants import PlannerLimits
from ptnsbc_sim.scenario.mission.fault_rules import FaultBlock
from ptnsbc_sim.scenario.slots import Formations, Slots, optimal_slots, with_slots


class StepTime(NamedTuple):
    """The instant of a step, its length and its leg."""

    now_ns: int
    elapsed_ns: int  # since the previous step: whole control periods
    mode: int  # MODE_*
    t0_ns: int  # epoch of the leg; before the first leg the start of the process
    first_t0_ns: int  # epoch of the first leg
    flying: bool  # a leg is in force: the step counts


def step_time(now_ns: int, elapsed_ns: int, leg: Leg | None, start_ns: int) -> StepTime:
    """The step at `now_ns`; before the first leg the UAV hovers, and its time counts from `start_ns`."""
    if leg is None:
        return StepTime(now_ns, elapsed_ns, MODE_HOLD, start_ns, start_ns, False)
    return StepTime(now_ns, elapsed_ns, leg.mode, leg.t0_ns, leg.first_t0_ns, True)


class RoleHolder(UavRole):
    """The role of one UAV from step to step, and what it knows of its own pauses."""

    def __init__(self, scenario: Scenario, uav_id: int) -> None:
        super().__init__(Formations(scenario), uav_id)

    def restart(self, known: Scenario | None = None) -> None:
        """Forget the members seen so far: the next step is the first."""
        super().restart(known or self.formations.scenario)
        self._began_ns: int | None = None
        self._looked_ns: int | None = None

    def follow(self, scenario: Scenario) -> Scenario:
        """Fly by the mission as it goes on after a word; returns the scenario with the present graph."""
        self.formations = Formations(scenario)
        self.flown = self.formations.of(self.members) or scenario
        return self.flown

    @property
    def leads(self) -> bool:
        """True if the UAV leads by the members that it sees."""
        return self.flown is not None and self.flown.leader.id == self.uav

    def holds(self, mode: int) -> bool:
        """True if the UAV has to hold in a leg, because it is no member yet."""
        return mode == MODE_FORMATION and self.uav in self.members.absent

    def look(self, now_ns: int, first_t0_ns: int, ages_s: Mapping[int, float]) -> RoleChange | None:
        """Determine the members at a step; returns the new role of the UAV if it changes.

        `ages_s` [s] are those of the newest states that were received, by sender.
        """
        if self._began_ns is None:
            self._began_ns = max(now_ns, first_t0_ns)
        if self._looked_ns is not None:
            self.view.pause(now_ns - self._looked_ns)
        self._looked_ns = now_ns
        others = (uav for uav in self.formations.scenario.uav_ids if uav != self.uav)
        ages = {uav: ages_s.get(uav, NEVER_RECEIVED_S) for uav in others}
        return self.take(now_ns - first_t0_ns, now_ns - self._began_ns, ages)


class UavController:
    """Inbox, control law and counters of one UAV."""

    def __init__(self, scenario: Scenario, uav_id: int, edges: CommunicationGraph) -> None:
        """PluginError as of `UavPlugins`."""
        self._scenario, self._uav, self._edges = scenario, uav_id, edges
        self._plugins = UavPlugins.of(scenario, uav_id)
        self.memory: Array = np.array(self._plugins.memory)
        """Memory (M,) of the law of the user."""
        self._roles = RoleHolder(scenario, uav_id) if scenario.formation.reconfigures else None
        self.config = agent_config(scenario, uav_id)
        self.inbox = Inbox(edges.senders(uav_id))
        self.counters = UavCounters()
        self.slots: Stamped | None = None  # (N,) by ascending UAV, of the epoch that decided them
        self.steps = 0  # of this agent
        self.near_stale = False  # it was slow at the newest step: its near-object sensor is silent
        self._agent: Agent | None = None
        self._agent_config = self.config  # with which the agent began

    def take_slot(self, t0_ns: int, slots: Slots) -> None:
        """Fly by the slot that the epoch at `t0_ns` decided from the next step on, with the limits of the vehicle.

        Parent and leader may be others than before: what was known of their motion is forgotten, and the plan
        begins anew.
        """
        if self.slots is not None and self.slots.stamp_ns == t0_ns:
            return
        held = np.array([slots[uav] for uav in sorted(slots)], dtype=np.float64)
        self.slots = Stamped(t0_ns, held)
        flown, forgotten = with_slots(self._scenario, slots), NeighbourMotions(UNKNOWN, UNKNOWN)
        self.inbox.listen_to(self._edges.of(flown).senders(self._uav))
        self.go_on(flown, estimate_valid=False, motions=forgotten, last_t=math.inf)

    def follow(self, scenario: Scenario) -> None:
        """Fly by the mission as it goes on after a word, in the slot and the role that the UAV has."""
        self._scenario = scenario
        if self.slots is not None:
            held = map(int, self.slots.values.tolist())
            scenario = with_slots(scenario, dict(zip(sorted(scenario.uav_ids), held, strict=True)))
        if self._roles is not None:
            scenario = self._roles.follow(scenario)
        self.go_on(scenario)

    def _take_role(self, at: StepTime, cutoff_ns: int) -> StepTime:
        """Take the role that follows from the present members; returns the step, in hold for an absent UAV."""
        if self._roles is None or not at.flying:
            return at
        ages = {one.sender: one.age_s for one in self.inbox.states(at.now_ns, cutoff_ns)}
        change = self._roles.look(at.now_ns, at.first_t0_ns, ages)
        if change is not None:
            self.inbox.listen_to(self._edges.of(change.after).senders(self._uav))
            moved = {} if self._agent is None else moved_on(self._agent.state, change)._asdict()
            self.go_on(change.after, **moved)
        return at._replace(mode=MODE_HOLD) if self._roles.holds(at.mode) else at

    def go_on(self, scenario: Scenario, **changes: Any) -> None:
        """Fly by the constants of another scenario from the next step on, with the limits of the vehicle.

        Trajectory and shape go on from where those before have come; `changes` are of the agent's state.
        """
        config = agent_config(scenario, self._uav)
        self._plugins = UavPlugins.of(scenario, self._uav)
        self.config = PlannerLimits.of(self.config).applied_to(config)
        if self._agent is not None:
            self._agent_config = self.limits.applied_to(config)
            state = self._agent.state._replace(**changes)
            self._agent = Agent.resumed(self._agent_config, state)

    @property
    def leads(self) -> bool:
        """True if the UAV leads where UAVs may come and go."""
        return self._roles is not None and self._roles.leads

    @property
    def limits(self) -> PlannerLimits:
        """The speed limits with which the agent flies."""
        return PlannerLimits.of(self._agent_config)

    @property
    def state(self) -> AgentState:
        """The agent's state after the newest step; there must have been one."""
        if self._agent is None:
            raise ValueError("state requested before the first step: expected a call of `step`")
        return self._agent.state

    def odometry_stale(self, now_ns: int) -> bool:
        """Real time: True if the own odometry is too old to fly by; False before the first."""
        own = self.inbox.own
        return own is not None and seconds(now_ns - own.stamp_ns) > self.config.stale_s

    def restart(self) -> None:
        """Forget all steps: the next step begins a new agent at the vehicle's position."""
        self._agent = None
        if self._roles is not None:
            self._roles.restart()

    def forget(self) -> None:
        """Begin as a new process does."""
        self.restart()
        self.counters = UavCounters()

    def resume(self, state: AgentState, counters: Array, memory: Array) -> None:
        """Continue from the state, the counters and the memory of another controller."""
        self.memory = memory
        self._agent = Agent.resumed(self.config, state)
        self.counters.restore(counters)
        self._agent_config = self.config

    def step(self, at: StepTime, cutoff_ns: int) -> PackedOutputs:
        """One control step on the messages of the inbox, which must hold the own odometry."""
        at = self._take_role(at, cutoff_ns)
        start_age_s = seconds(at.now_ns - at.first_t0_ns)
        inputs = self.inbox.pack_inputs(at.now_ns, cutoff_ns, at.mode, start_age_s)
        if self._agent is None:
            self._agent = Agent(self.config, inputs.unpack().own)
            self._agent_config = self.config
            self.steps = 0
        self.steps += 1
        dt = seconds(at.elapsed_ns)
        t = seconds(at.now_ns - at.t0_ns)
        plugins, odometry = self._plugins, inputs.vector[OWN:PARENT]
        task = wanted = None
        if plugins.task is not None:
            task = plugins.task.at(self._agent.task_points(inputs, t, dt))
        if plugins.law is not None:  # at rest while it does not count
            wanted = (0.0, 0.0, 0.0)
            if at.mode == MODE_FORMATION:
                if plugins.memory and epoch_begins(self._agent.state, t):
                    self.memory = np.array(plugins.memory)
                heard = self.inbox.states(at.now_ns, cutoff_ns)
                wanted, self.memory = plugins.law.velocity(
                    t, start_age_s, odometry, heard, inputs.near, self.memory
                )
        outputs = self._agent.advance(inputs, t, dt, wanted, task)
        if plugins.controller is not None:
            outputs.wrench[:] = plugins.wrench(
                t, dt, odometry, outputs.velocity, outputs.wrench, self.config
            )
        if self.inbox.own_age_s > 0.0:  # it is sent with the stamp of the odometry
            estimate = outputs.leader_estimate
            estimate[0:3] -= self.inbox.own_age_s * estimate[7:10]
        near_age_s = float(inputs.vector[NEAR_AGE])
        silent_s = near_age_s if near_age_s < NEVER_RECEIVED_S else start_age_s
        clearance = self.config.clearance
        self.near_stale = clearance.rule != AVOIDANCE_OFF and silent_s > clearance.stale_s
        if at.flying:
            self.counters.add(outputs.diagnostics, dt)
        return outputs


class SlotDecider:
    """Decides the slots of an epoch from the newest odometry of all UAVs."""

    def __init__(self, scenario: Scenario, announce: Callable[[Decision], None]) -> None:
        """`announce`: sends a decision."""
        import scipy.optimize  # noqa: F401 - now, and not when a flight waits for the decision

        self.scenario = scenario  # the mission as it goes on after a word
        self._announce = announce
        self._newest: dict[int, Stamped] = {}
        self._epoch_ns: int | None = None  # waits for odometry
        self._first_ns: int | None = None  # the first epoch, from which places that move count

    def on_odometry(self, uav_id: int, own: Stamped) -> None:
        """Take the newest odometry of a UAV."""
        self._newest[uav_id] = own
        if self._epoch_ns is not None:
            self.decide(self._epoch_ns)

    def unknown(self, since_ns: int) -> list[int]:
        """UAVs whose odometry is missing or older than `since_ns`."""
        found = {uav: self._newest.get(uav) for uav in self.scenario.uav_ids}
        return [uav for uav, own in found.items() if own is None or own.stamp_ns < since_ns]

    def decide(self, t0_ns: int) -> None:
        """Decide the slots of the epoch at `t0_ns`: at once, or when all odometry is here."""
        self._epoch_ns = t0_ns
        if self._first_ns is None:
            self._first_ns = t0_ns
        if len(self._newest) == len(self.scenario.uav_ids):
            self._epoch_ns = None
            positions = {uav: at_epoch(own, t0_ns) for uav, own in self._newest.items()}
            since_s = seconds(t0_ns - self._first_ns)
            self._announce(Decision(t0_ns, optimal_slots(self.scenario, positions, since_s)))


def at_epoch(own: Stamped, t0_ns: int) -> Array:
    """Position (3,) [m], ENU, to which a UAV will have moved by the epoch, at the velocity that it measures."""
    ahead_s = seconds(max(t0_ns - own.stamp_ns, 0))
    found: Array = own.values[0:3] + ahead_s * np.array(velocity_enu(own.values))
    return found


class UavFaults:
    """The faults of a scenario that strike one UAV, in the stamps of its flight.

    In lock-step the process carries out its own `kill`: then the flight is the same every time. In real time the
    launcher kills.
    """

    def __init__(self, scenario: Scenario, uav_id: int, *, lockstep: bool = False) -> None:
        self._lockstep = lockstep
        self._own = [fault for fault in scenario.faults if fault.struck_uav == uav_id]
        self._spans: list[tuple[FaultBlock, int, int]] = []  # [ns], once the first epoch is known

    def begin(self, t0_ns: int) -> None:
        """The first epoch is known, from which their times count."""
        self._spans = self._spans or [(fault, *fault.window_ns(t0_ns)) for fault in self._own]

    def strike(self, now_ns: int) -> None:
        """Lock-step: end this process when its time has come."""
        if self._lockstep and self._striking("kill", now_ns):
            os.kill(os.getpid(), signal.SIGKILL)

    def plays_dead(self, now_ns: int) -> bool:
        """Lock-step: whether a restart has this process silent; none can be started at a tick, so it plays that."""
        return self._lockstep and bool(self._striking("restart", now_ns))

    @property
    def sending(self) -> Callable[[Stamped], Stamped] | None:
        """Makes of a state (13,) of this UAV the one that its neighbours get; None without faults: encoding is fast."""
        return self._sent if self._own else None

    def _sent(self, message: Stamped) -> Stamped:
        stamp_ns, values = message
        if self._striking("nan", stamp_ns):
            values = without_position(values)
        shifts = self._striking("clock_offset", stamp_ns)
        return Stamped(stamp_ns + sum(nanoseconds(one.offset_s or 0.0) for one in shifts), values)

    def _striking(self, kind: str, now_ns: int) -> list[FaultBlock]:
        spans = self._spans
        return [
            fault for fault, since, end in spans if fault.kind == kind and since <= now_ns < end
        ]


class FlownStep(NamedTuple):
    """One control step."""

    at: StepTime
    own: Stamped  # the odometry that it flew by
    outputs: PackedOutputs


class UavFlight:
    """One UAV in flight, from the messages that it takes to the step that it makes."""

    def __init__(self, scenario: Scenario, uav_id: int, edges: CommunicationGraph) -> None:
        self.uav = uav_id
        self.scenario = scenario
        self.epochs = Epochs(scenario)
        self.controller = UavController(scenario, uav_id, edges)
        self.inbox = self.controller.inbox
        self.faults = UavFaults(scenario, uav_id, lockstep=edges.options.lockstep)
        self.decided = DecidedSlots(scenario) if scenario.formation.has_open_slots else None
        self.decider: SlotDecider | None = None  # of the leader, where slots are open
        # A bridge brings its vehicle to the start before the first leg.
        self._at_start = not edges.options.bridged

    def leg(self, now_ns: int) -> Leg | None:
        """The leg in force for this UAV."""
        return self.epochs.at(now_ns, self.uav)

    def take_odometry(self, message: Stamped) -> None:
        """The own odometry."""
        self.inbox.own = message
        if self.decider is not None:
            self.decider.on_odometry(self.uav, message)

    def take_near(self, message: Stamped) -> None:
        """The near objects."""
        self.inbox.near = message

    def take_leg(self, leg: HeaderFields) -> bool:
        """A leg, or a word on a leg of the mission; returns whether it is new."""
        is_new = self.epochs.announce(leg.stamp_ns, leg.frame_id)
        if self.epochs.first_t0_ns is not None:
            self.faults.begin(self.epochs.first_t0_ns)
            self.inbox.begin(self.epochs.first_t0_ns)
        return is_new

    def take_lost(self, process: LostProcess) -> None:
        """A process that has ended: nobody waits for its UAV."""
        if process.uav is not None:
            self.inbox.lose(process.uav)

    def take_slot(self, at: StepTime) -> bool:
        """Take the slot of the leg of a step; False while it is open and not decided."""
        if self.decided is None or at.mode != MODE_FORMATION:
            return True
        slots = self.decided.of(at.t0_ns)
        if slots is not None:
            self.controller.take_slot(at.t0_ns, slots)
        return slots is not None

    def slots_fault(self, leg: Leg | None) -> str:
        """The fault of the slots of a leg, empty without one."""
        if self.decided is None or leg is None or leg.mode != MODE_FORMATION:
            return ""
        what = f"no slots of the epoch at {seconds(leg.t0_ns):.3f} s on {topics.SLOTS.name}"
        return "" if self.decided.of(leg.t0_ns) else f"holding: {what}"

    def step(self, at: StepTime, cutoff_ns: int) -> FlownStep:
        """Make a step; a neighbour's message must be stamped before `cutoff_ns` to count."""
        self.faults.strike(at.now_ns)
        mission = self.epochs.scenario
        if mission is not self.scenario:
            self.scenario = mission
            self.controller.follow(mission)
            if self.decider is not None:
                self.decider.scenario = mission
        if at.flying and not self._at_start:
            self._at_start = True
            self.controller.restart()
        if not self.take_slot(at):
            at = at._replace(mode=MODE_HOLD)
        outputs = self.controller.step(at, cutoff_ns)
        assert self.inbox.own is not None  # or no tick is due
        return FlownStep(at, self.inbox.own, outputs)
