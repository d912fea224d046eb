"""A whole MAVLink fleet in one process and on one clock that only tests move.

Bridges, UAV controllers and stand-in flight controllers are the real ones and exchange real MAVLink bytes.
The test replaces the wires between them, ROS and time. So a flight takes only as long as its computation, and has
the same result on every machine.
"""

from __future__ import annotations

import copyreg
import struct
import threading
from collections import deque
from copy import deepcopy
from types import SimpleNamespace

import numpy as np

from ptnsbc_autopilot.launch import KINDS, Fleet, starts
from ptnsbc_autopilot.server import Codec
from ptnsbc_autopilot.vehicle import COMPANION, IMPOSTOR
from ptnsbc_core.agent import OWN, PARENT, Agent, PackedOutputs
from ptnsbc_core.curves.trajectory import reference
from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_io.mavlink.transport import Packet
from ptnsbc_io.wire import HeaderFields, Stamped, VelocityTemplate, WrenchTemplate
from ptnsbc_nodes.bridge.bridge import WANTED_MESSAGES, Bridge
from ptnsbc_nodes.bridge.near_objects import NearObjects
from ptnsbc_nodes.bridge.ports import BridgeInputs
from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.comm.legs import Epochs
from ptnsbc_nodes.emergency import APART, Order
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS
from ptnsbc_nodes.uav.uav_controller import UavController, step_time
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.scenario.constants import PlannerLimits

STEP_S = 0.004  # of the stand-ins
BASE_NS = 1_700_000_000_000_000_000
START_S = 1000.0
AUTOPILOTS = {"px4": "px4", "arducopter": "ardupilot", "stm32": "generic"}
# Parts of a flight that `deepcopy` makes anew.
copyreg.pickle(struct.Struct, lambda one: (struct.Struct, (one.format,)))
copyreg.pickle(type(threading.Lock()), lambda _: (threading.Lock, ()))
copyreg.pickle(PackedOutputs, lambda one: (PackedOutputs, (one.vector,)))
copyreg.pickle(Agent, lambda one: (Agent.resumed, (one._memory.configs[0], one.state)))
HERE, ELSEWHERE = ("127.0.0.1", 14580), ("127.0.0.1", 50000)


def scenario(kind="px4", setpoint="velocity", duration_s=12.0, **overrides):
    """`experiment_4` for stand-ins of one kind, four metres lower: soon up, and soon down again."""
    changes = {
        "timing.duration_s": duration_s,
        "leader.trajectory.centre_m": [0, 0, 4],
        "mavlink.takeoff_height_m": 2.0,
        "mavlink.autopilot": AUTOPILOTS[kind],
        "mavlink.setpoint": setpoint,
        **overrides,
    }
    if kind == "stm32":  # 4 1/s is too much for it, and it would say so before the formation
        settings = load_scenario("experiment_4").mavlink.overrides
        changes["mavlink.overrides"] = {**settings, "gains.force.kappa_1_s": 3.0}
    return load_scenario("experiment_4", changes).bridged()


class Wire:
    """The bridge's end of a link: datagrams arrive after a delay."""

    stream = False

    def __init__(self, clock, delay_s):
        self.clock, self.delay_s = clock, delay_s
        self.to_bridge, self.to_vehicle = deque(), deque()
        self.cut = False

    def put(self, data, sender=HERE):
        if not self.cut:
            self.to_bridge.append((self.clock() + self.delay_s, Packet(data, sender)))

    def receive(self):
        if self.to_bridge and self.to_bridge[0][0] <= self.clock():
            return self.to_bridge.popleft()[1]
        return None

    def send(self, data, address):
        if self.cut or address is None:
            return False
        self.to_vehicle.append((self.clock() + self.delay_s, data))
        return True

    def due(self):
        while self.to_vehicle and self.to_vehicle[0][0] <= self.clock():
            yield self.to_vehicle.popleft()[1]

    def close(self):
        pass


class FleetUav:
    """One vehicle with its bridge and its controller."""

    def __init__(self, fleet, uav_id, start, kind, signer=None):
        scenario = fleet.scenario
        self.id, self.fleet = uav_id, fleet
        self.lines, self.stamps, self.odometry, self.tracks, self.wrenches = [], [], [], [], []
        self.truths = []
        self.setpoints = []  # (time, message) as the vehicle got them
        self.alive = True  # the UAV process
        self.bridge_alive = True  # the bridge process
        self.lost = 0
        kind = kind or start.kind or "px4"
        self.codec, self.other_codec = Codec(start.system), Codec(start.system)
        self.vehicle = KINDS[kind](
            start.system, start.body, fleet.now_s, boot_time=0.1, say=self.on_line
        )
        self.wire = Wire(fleet.now, fleet.delay_s)
        self.edges = edges = CommunicationGraph(scenario, FlightOptions(bridged=True))
        self.limits = None  # of the vehicle, as its bridge tells them
        self.senders = edges.senders(uav_id)
        self.controller = self.new_controller()
        self.estimates = []
        self.epochs = Epochs(scenario)
        self.followed = scenario
        self.near_objects = NearObjects(scenario, uav_id, edges.linked(uav_id))
        attitude = scenario.vehicle_link(uav_id).setpoint == "attitude"
        self.setpoint_template = WrenchTemplate("x") if attitude else VelocityTemplate("map")
        self.attitude = attitude
        self.began = False
        self.inputs = BridgeInputs(controller_ready=True)
        ports = SimpleNamespace(
            inputs=self.inputs,
            steady_s=fleet.now,
            ros_ns=fleet.wall_ns,
            odom=self.on_odometry,
            track=self.on_track,
            origin=fleet.set_leader_origin,
            limits=self.on_limits,
            lost=self.on_lost,
            apart=self.on_apart,
            truth=self.on_truth,
            log=self.on_log,
        )
        self.signer, self.ports = signer, ports
        self.begin_bridge()

    def begin_bridge(self, frame=""):
        """A bridge as a process has it that begins; with a frame it takes over from the one that has died."""
        self.inputs.companions.clear()
        self.wire.to_bridge.clear()
        self.inputs.legs += [HeaderFields(*leg) for leg in self.fleet.legs]  # they are latched
        self.link = MavlinkLink(self.wire, self.vehicle.system, WANTED_MESSAGES, self.signer)
        self.bridge = Bridge(
            self.fleet.scenario, self.id, self.link, self.ports, True, self.fleet.awaited
        )
        self.bridge.take_over(frame)
        self.bridge_alive = True

    def new_controller(self):
        """The controller as a process has it that begins."""
        return UavController(self.fleet.scenario, self.id, self.edges)

    def start_again(self):
        """The UAV process that has ended begins anew: legs and limits are latched, all else is forgotten."""
        self.controller, self.began, self.alive = self.new_controller(), False, True
        if self.limits is not None:
            self.on_limits(self.limits)

    def on_line(self, line):
        self.lines.append(line)

    def on_log(self, line):
        self.lines.append(f"{self.fleet.now_s - START_S:7.2f} bridge {line}")

    def on_truth(self, stamp_ns, odometry):
        self.truths.append((stamp_ns, odometry))

    def on_lost(self):
        self.lost += 1

    def on_apart(self):
        for other in self.fleet.uavs.values():
            other.inputs.take(Order(APART))

    def on_limits(self, limits):
        self.limits = limits
        planner = PlannerLimits(limits.planner_m_s, limits.acceleration_m_s2)
        self.controller.config = planner.lowering(self.controller.config)

    def on_odometry(self, stamp_ns, odometry):
        self.stamps.append(stamp_ns)
        self.odometry.append(odometry.copy())
        if self.alive:
            self.controller.inbox.own = Stamped(stamp_ns, odometry)
        self._tell(odometry)

    def on_track(self, stamp_ns, odometry):
        self.tracks.append((self.fleet.now_s, odometry.copy()))
        self._tell(odometry, left=True)

    def _tell(self, odometry, *, left=False):
        for other in self.fleet.uavs.values():
            if other is not self:
                other.near_objects.on_odometry(self.id, self.fleet.now_s, odometry, left=left)

    def announce(self, t0_ns, leg):
        self.epochs.announce(t0_ns, leg)
        self.inputs.legs.append(HeaderFields(t0_ns, leg))

    def mission_s(self, now_ns):
        """The time since the first epoch [s], negative before it."""
        first_ns = self.epochs.first_t0_ns
        return -1.0 if first_ns is None or now_ns < first_ns else (now_ns - first_ns) * 1e-9

    def control(self, now_ns, near):
        """One tick of the UAV process, and what its bridge knows of others at the rate of the sensor."""
        if near:
            self.inputs.near_uavs = self.near_objects.uavs(self.fleet.now_s)
        own = self.controller.inbox.own
        stale_ns = self.controller.config.stale_s * 1e9
        if not self.alive or own is None or now_ns - own.stamp_ns > stale_ns:
            return None
        if near:
            rows = self.near_objects.rows(self.fleet.now_s, own.values[0:3], self.mission_s(now_ns))
            self.controller.inbox.near = Stamped(now_ns, rows)
        leg = self.epochs.at(now_ns, self.id)
        if leg is not None and not self.began:
            self.began = True
            self.controller.restart()
        if self.epochs.scenario is not self.followed:
            self.followed = self.epochs.scenario
            self.controller.follow(self.followed)
        period_ns = self.fleet.scenario.timing.dt_ns
        out = self.controller.step(step_time(now_ns, period_ns, leg, BASE_NS), NO_CUTOFF_NS)
        values = (
            out.wrench if self.attitude else np.array([*out.velocity[0:3], 0, 0, out.velocity[3]])
        )
        self.inputs.wanted = Stamped(own.stamp_ns, out.velocity.copy())
        self.inputs.setpoint = self.setpoint_template.encode(own.stamp_ns, values)
        self.wrenches.append((own.stamp_ns, out.wrench.copy()))
        self.estimates.append((own.stamp_ns, out.leader_estimate.copy()))
        return own, Stamped(own.stamp_ns, out.leader_estimate.copy())

    def exchange(self):
        """Bytes both ways, and a step of the vehicle."""
        now_s = self.fleet.now_s
        for data in self.wire.due():
            for message in self.codec.decode(data):
                if message.get_type().startswith("SET_"):
                    self.setpoints.append((now_s, message))
                self._send(self.vehicle.handle(message, COMPANION, now_s))
        self._send(self.vehicle.step(now_s))
        if self.bridge_alive and not self.bridge.procedure.over:
            self.bridge.serve()

    def _send(self, outgoing):
        for link, message in outgoing:
            if link == COMPANION:
                self.wire.put(self.codec.encode(message))
            elif link == IMPOSTOR:
                self.wire.put(self.other_codec.encode(message), ELSEWHERE)

    @property
    def step(self):
        return self.bridge.procedure.step


class MavlinkFleet:
    """All vehicles of a scenario; `run` moves the clock."""

    KIND = FleetUav

    def __init__(
        self, scenario, kind=None, gnss="rtk", delay_s=0.005, seed=1, spread_m=0.0, count=None
    ):
        self.scenario, self.delay_s, self.now_s = scenario, delay_s, START_S
        self.uavs, self.legs = {}, []
        self.awaited = frozenset(scenario.uav_ids[:count])
        path = scenario.source
        vehicle_starts = starts(Fleet(None, path, gnss, spread_m, None, seed))
        for uav_id, start in list(zip(scenario.uav_ids, vehicle_starts, strict=True))[:count]:
            self.uavs[uav_id] = self.KIND(self, uav_id, start, kind)
        self.ticks = 0

    def set_parameter(self, name, value):
        """A parameter of every vehicle that has it."""
        for uav in self.uavs.values():
            if name in uav.vehicle.parameters:
                uav.vehicle.set_parameter(name, value)

    def leader_error_m(self):
        """How far the leader is from its reference now."""
        leader = self.scenario.leader.id
        uav = self.uavs[leader]
        t = (uav.stamps[-1] - self.legs[0][0]) * 1e-9
        wanted = reference(agent_config(self.scenario, leader).trajectory, t).position
        return float(np.linalg.norm(uav.odometry[-1][0:3] - wanted))

    def set_leader_origin(self, place):
        for uav in self.uavs.values():
            uav.inputs.leader_origin = place

    def now(self):
        return self.now_s

    def wall_ns(self):
        return BASE_NS + round((self.now_s - START_S) * 1e9)

    @property
    def now_ns(self):
        return self.wall_ns()

    def forget(self):
        """Drop what was recorded so far: whoever copies the flight need not copy that."""
        for uav in self.uavs.values():
            logs = uav.stamps, uav.odometry, uav.tracks, uav.wrenches, uav.truths, uav.estimates
            for log in (*logs, uav.setpoints):
                del log[:-1]
        return self

    def copied(self):
        """The same flight at the same moment, of which what happens to one changes nothing in the other."""
        other = deepcopy(self, {id(self.scenario): self.scenario})
        for uav in other.uavs.values():  # a view of an array is copied as an array of its own
            inbox = uav.controller.inbox
            inbox._own_row = inbox._inputs.vector[OWN:PARENT]
            inbox._inputs.near = inbox._inputs.near
        return other

    def announce(self, leg, lead_s=0.5):
        t0_ns = self.now_ns + round(lead_s * 1e9)
        self.legs.append((t0_ns, leg))
        for uav in self.uavs.values():
            uav.announce(t0_ns, leg)

    def tell_setpoint(self, odometry):
        """A setpoint (13,) of a user's program, as the leader takes it and tells all bridges."""
        now_ns = self.now_ns
        epochs = self.uavs[self.scenario.leader.id].epochs
        epochs.scenario = epochs.following(now_ns, odometry)
        for uav in self.uavs.values():
            uav.inputs.taken.append(Stamped(now_ns, odometry))

    def run(self, seconds, until=None):
        """Let time pass; with `until`, only until it becomes true, and it must become true."""
        end = self.now_s + seconds
        while self.now_s < end:
            self.now_s += STEP_S
            for uav in self.uavs.values():
                uav.exchange()
            if (self.now_s - START_S) * self.scenario.timing.control_hz >= self.ticks:
                self.ticks += 1
                self._tick()
            if until is not None and until():
                return self
        assert until is None, f"not within {seconds} s: {self.report()}"
        return self

    def _report(self):
        """What bridges tell each other, five times a second."""
        for uav in self.uavs.values():
            if uav.bridge_alive:
                if uav.step is Step.APART:
                    uav.on_apart()
                for other in self.uavs.values():
                    other.inputs.companions.append((uav.id, uav.bridge.report, self.now_s))

    def _tick(self):
        if self.ticks % (self.scenario.timing.control_hz // 5) == 0:
            self._report()
        near = self.ticks % self.scenario.near_every == 0
        sent = {i: uav.control(self.now_ns, near) for i, uav in self.uavs.items()}
        for uav in self.uavs.values():
            for i in uav.senders.heard_states:
                if sent.get(i) is not None:
                    uav.controller.inbox.state_queues[i].put(sent[i][0])
            for i in uav.senders.heard_estimators:
                if sent.get(i) is not None:
                    uav.controller.inbox.estimate_queues[i].put(sent[i][1])

    def airborne(self):
        return self.run(
            90, until=lambda: all(not u.bridge.procedure.awaited for u in self.uavs.values())
        )

    def form(self):
        self.announce("form")
        return self

    def land(self):
        self.announce("land")
        return self.run(90, until=lambda: all(u.bridge.procedure.over for u in self.uavs.values()))

    def report(self):
        return "\n".join(
            f"{i}: {uav.step} {uav.bridge.procedure.fault}\n  " + "\n  ".join(uav.lines[-12:])
            for i, uav in self.uavs.items()
        )

    def recording(self):
        """The flight as the recording of which a verdict is computed."""
        from ptnsbc_sim.verdict import Recording, Track

        def series(pairs):
            return Track(np.array([t for t, _ in pairs]), np.array([v for _, v in pairs]))

        return Recording(
            scenario=self.scenario,
            odometry={
                i: Track(np.array(u.stamps), np.array(u.odometry)) for i, u in self.uavs.items()
            },
            wrench={i: series(u.wrenches) for i, u in self.uavs.items()},
            # By them a verdict tells where UAVs come and go who was silent.
            estimate={i: series(u.estimates) for i, u in self.uavs.items()}
            if self.scenario.formation.reconfigures
            else {},
            truth={i: series(u.truths) for i, u in self.uavs.items() if u.truths},
            counters={},
            epochs=tuple(self.legs),
        )
