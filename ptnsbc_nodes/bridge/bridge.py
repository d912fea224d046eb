"""One bridge: link, vehicle, procedure and stream, turned by one thread. No ROS in here."""

from __future__ import annotations

from typing import Any

import numpy as np

from ptnsbc_core.types import AgentConfig, Array
from ptnsbc_io.mavlink.autopilots import AUTOPILOTS, findings, hover_thrust, limits, refusal
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_io.wire import Stamped, WireError, decode_velocity, decode_wrench
from ptnsbc_nodes.bridge.commands import Commands
from ptnsbc_nodes.bridge.controller import ControllerSetpoints
from ptnsbc_nodes.bridge.link_maintenance import LinkMaintenance
from ptnsbc_nodes.bridge.ports import BridgeInputs, BridgeOutputs, SharedVehicleState
from ptnsbc_nodes.bridge.procedure.procedure import Procedure
from ptnsbc_nodes.bridge.procedure.steps import ProcedureOutput, Step, Stream, VehicleSnapshot
from ptnsbc_nodes.bridge.setpoint.guard import SetpointGuard, allowed
from ptnsbc_nodes.bridge.setpoint.hover_thrust import HoverThrust
from ptnsbc_nodes.bridge.setpoint.messages import Setpoints
from ptnsbc_nodes.bridge.setpoint.stream import SetpointStream
from ptnsbc_nodes.bridge.state_publisher import Clocks, StatePublisher
from ptnsbc_nodes.bridge.vehicle import VehicleMonitor
from ptnsbc_nodes.bridge.world import WorldFrame
from ptnsbc_nodes.comm.legs import Epochs
from ptnsbc_nodes.runtime.pacing import Latency
from ptnsbc_sim.scenario import Scenario, agent_config

_NAMES = (
    "HEARTBEAT",
    "SYS_STATUS",
    "BATTERY_STATUS",
    "SYSTEM_TIME",
    "PARAM_VALUE",
    "GPS_RAW_INT",
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "ODOMETRY",
    "GPS_GLOBAL_ORIGIN",
    "HOME_POSITION",
    "COMMAND_ACK",
    "TIMESYNC",
    "EXTENDED_SYS_STATE",
    "STATUSTEXT",
)
WANTED_MESSAGES = frozenset(getattr(mavlink, f"MAVLINK_MSG_ID_{name}") for name in _NAMES)
_STATE_HZ = 50.0
_ANGLES = frozenset({mavlink.MAVLINK_MSG_ID_ATTITUDE})
_STREAMED_S = 0.1
_TWIN_S = 3.0


class Bridge:
    """Everything between one UAV process and one flight controller."""

    def __init__(
        self,
        scenario: Scenario,
        uav_id: int,
        link: MavlinkLink,
        outlets: BridgeOutputs,
        clocks: Clocks,
        allow_arming: bool,
    ) -> None:
        block, reached = scenario.mavlink, scenario.vehicle_link(uav_id)
        self.block = block
        self.inlets = BridgeInputs()
        self.link = link
        self._outlets = outlets
        self._clocks = clocks
        self._leads = uav_id == scenario.leader_id
        self._config: AgentConfig = agent_config(scenario, uav_id)
        self._autopilot = autopilot = AUTOPILOTS[reached.autopilot]
        self.setpoint = reached.setpoint
        self._decode = decode_wrench if self.setpoint == "attitude" else decode_velocity
        self.vehicle = VehicleMonitor(autopilot, signed=link.signed)
        self._commands = Commands(autopilot, reached.sysid)
        self._upkeep = LinkMaintenance(
            autopilot, reached.sysid, self._commands, self.vehicle, _STATE_HZ
        )
        self.world = WorldFrame(scenario, uav_id, autopilot.earth_radius_m)
        self.world.begin()
        self.controller = ControllerSetpoints()
        self.teller = StatePublisher(self.vehicle, self.world, self._upkeep.sync, self.controller)
        self.procedure = Procedure(autopilot, block.takeoff_height_m, allow_arming, outlets.say)
        self.guard = SetpointGuard(block.geofence, allowed(block.limits, limits({})))
        self._messages = Setpoints(autopilot, reached.sysid)
        self._stream = self._make_stream(block.hover_thrust)
        self._epochs = Epochs()
        self.orders = ProcedureOutput(Stream.NONE, None, True)
        self.told = SharedVehicleState(0, 0)
        self.latency = Latency()
        self._parameters_told = False
        self.flew = False
        self._ground_m = 0.0
        self._period_s = 1.0 / block.rate_hz
        self._next_s = clocks.steady_s()
        self._was_told = True

    @property
    def sync_text(self) -> str:
        """How the vehicle's clock is known."""
        sync = self._upkeep.sync
        return f"round trip {1e3 * sync.round_trip_s:.1f} ms" if sync.synchronised else "one-way"

    def now_s(self) -> float:
        """Steady clock."""
        return self._clocks.steady_s()

    def turn(self) -> None:
        """Wait for the next message or the next tick, and do what is due."""
        self.link.wait(min(self._next_s - self._clocks.steady_s(), self._period_s))
        self.serve()

    def serve(self) -> None:
        """Take in what has arrived, and do what is due by now."""
        for message in self.link.poll(self._clocks.steady_s()):
            self._hear(message)
        now_s = self._clocks.steady_s()
        if now_s >= self._next_s:
            # A late tick is not made up for: two setpoints at once are worth one.
            self._next_s = max(self._next_s + self._period_s, now_s + 0.5 * self._period_s)
            self.tick(now_s)

    def leave(self) -> None:
        """After landing: leave the mode in which PX4 would arm straight the next time."""
        if self._autopilot.packed and self.flew and self.procedure.step is Step.DONE:
            self.link.send(self._commands.leave())

    def _hear(self, message: Any) -> None:
        now_s = self._clocks.steady_s()
        sample = self.vehicle.hear(message, now_s)
        if sample is not None:
            publish = self._tell if self.orders.told else self._outlets.track
            self.teller.hear(sample, self._clocks, publish)
            if self.orders.stream is Stream.PLANNER and self.teller.odometry is not None:
                self._stream.hover.flown(now_s, self.teller.odometry)
        answer = self._upkeep.heard(message, now_s)
        if answer is not None:
            self.link.send(answer)

    def _tell(self, stamp_ns: int, odometry: Array) -> None:
        self._outlets.odom(stamp_ns, odometry)
        self.told = SharedVehicleState(self.told.messages + 1, stamp_ns)

    def tick(self, now_s: float) -> None:
        """One period of the stream."""
        self._take_in()
        # PX4 sends both; angles come unasked, twice as often, and tell what the quaternion tells.
        twice = now_s - self.vehicle.pose.quaternion_s < _STREAMED_S
        self.link.needless = _ANGLES if twice else frozenset()
        self._find_place()
        self._judge_parameters(now_s)
        seen = self.seen(now_s)
        self.orders = self.procedure.advance(seen)
        self._leave_formation()
        if self.orders.ask is not None:
            height = self.block.takeoff_height_m
            self.link.send(self._commands.message(self.orders.ask, height))
        self._send_setpoint(now_s)
        healthy = self.procedure.step is not Step.FAILED
        suspicious = self.teller.suspicious(now_s)
        for message in self._upkeep.messages(now_s, healthy, suspicious):
            self.link.send(message)

    def _take_in(self) -> None:
        inlets = self.inlets
        data, inlets.setpoint = inlets.setpoint, None
        while inlets.legs:
            self._epochs.announce(*inlets.legs.pop(0))
        if data is None:
            return
        try:
            setpoint: Stamped = self._decode(data)
        except WireError:
            self.controller.nonsense += 1
            return
        self.controller.hear(setpoint)

    def _find_place(self) -> None:
        self.world.vehicle_at(self.vehicle.anchor)
        local = self.teller.newest_local
        place = None if local is None else self.world.stands(local)
        if place is not None:
            self._outlets.origin(place)
        if self.inlets.leader_origin is not None and not self._leads:
            self.world.leader_at(self.inlets.leader_origin)
        if self.vehicle.armed:
            self.flew = True
            self.world.freeze()
        elif self.teller.odometry is not None:
            self._ground_m = float(self.teller.odometry[2])

    def _judge_parameters(self, now_s: float) -> None:
        """Once all are read: print them, warn, and take the limits down."""
        reader = self._upkeep.parameters
        if self._parameters_told or self.vehicle.heartbeat_s is None or not reader.done(now_s):
            return
        self._parameters_told = True
        for line in findings(self._autopilot, reader.values, self.block.rate_hz):
            self._outlets.say(line)
        self.guard.limits = allowed(self.block.limits, limits(reader.values))
        self._stream.hover.value = hover_thrust(reader.values) or self.block.hover_thrust
        self._outlets.limits(self.guard.limits)

    def _refusal(self) -> str:
        """Why this vehicle cannot be flown, as far as its parameters are known."""
        if not self._parameters_told:
            return ""
        values = self._upkeep.parameters.values
        return refusal(self._autopilot, values, self.setpoint) or ""

    def seen(self, now_s: float) -> VehicleSnapshot:
        """Everything the procedure decides by."""
        vehicle, odometry = self.vehicle, self.teller.odometry
        leg = self._epochs.at(self._clocks.ros_ns())
        percent = self.block.battery_land_percent
        low = vehicle.battery_below(percent, now_s)
        rival_s = self.link.rival_heard_s
        lack = self.teller.lack(now_s)
        return VehicleSnapshot(
            now_s=now_s,
            heartbeat_age_s=vehicle.heartbeat_age_s(now_s),
            stranger=vehicle.stranger,
            parameters=self._parameters_told,
            refusal=self._refusal(),
            state=not lack,
            lack=lack,
            controller_age_s=self.controller.age_s(now_s),
            controller_ready=self.inlets.controller_ready,
            mode=vehicle.mode,
            mode_name=vehicle.mode_name,
            armed=vehicle.armed,
            landed=vehicle.landed,
            height_m=0.0 if odometry is None else float(odometry[2]) - self._ground_m,
            speed_m_s=0.0 if odometry is None else float(np.sqrt(odometry[7:10] @ odometry[7:10])),
            turned=odometry is None or self._stream.turned(odometry),
            leg=None if leg is None else leg.name,
            battery_low=f"battery at {vehicle.battery_percent:.0f} %, below {percent:g}"
            if low
            else "",
            fence="" if odometry is None else self.guard.breach(odometry[0:3]),
            rebooted=vehicle.rebooted,
            twin=vehicle.twin(now_s) or (rival_s is not None and now_s - rival_s < _TWIN_S),
            halt=self.inlets.halt,
            complaint=", ".join(filter(None, (self._commands.refused, vehicle.text))),
        )

    def _leave_formation(self) -> None:
        away = not self.orders.told or self.procedure.step is Step.FAILSAFE
        if away and self._was_told:
            self._outlets.lost()
        self._was_told = not away

    def _send_setpoint(self, now_s: float) -> None:
        odometry, offset = self.teller.odometry, self.world.offset
        if odometry is None or offset is None:
            return
        wanted = self.controller.newest
        message = self._stream.message(
            self.orders.stream,
            now_s,
            odometry,
            offset,
            wanted,
            self.vehicle.armed,
            self._flight_s(),
        )
        if message is None:
            return
        self.link.send(message)
        if self.orders.stream is Stream.PLANNER and wanted is not None:
            self.latency.add(now_s - wanted.told.arrived_s)

    def _flight_s(self) -> float:
        """Time since the first epoch [s]; negative before it."""
        now_ns = self._clocks.ros_ns()
        leg = self._epochs.at(now_ns)
        return -1.0 if leg is None else (now_ns - leg.first_t0_ns) * 1e-9

    def _make_stream(self, hover: float) -> SetpointStream:
        return SetpointStream(
            self._autopilot,
            self.setpoint,
            self._config,
            self.guard,
            self._messages,
            HoverThrust(hover, self._config.controller.gravity),
            self.block.acceleration_feed_forward,
            self.block.takeoff_height_m,
        )
