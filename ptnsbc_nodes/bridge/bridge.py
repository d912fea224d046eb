"""One bridge: link, vehicle, procedure and stream, served by one thread. No ROS in here."""

from __future__ import annotations

from typing import Any

import numpy as np

from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.autopilots import (
    AUTOPILOTS,
    VelocityResponse,
    fate,
    findings,
    hover_thrust,
    limits,
    velocity_response,
)
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_io.wire import decode_velocity, decode_wrench
from ptnsbc_nodes.bridge.link_maintenance import LINK_MESSAGES, LinkMaintenance
from ptnsbc_nodes.bridge.ports import BridgePorts
from ptnsbc_nodes.bridge.procedure.companions import Companion
from ptnsbc_nodes.bridge.procedure.hazards import AbortLimits, FlightMonitor, Sight
from ptnsbc_nodes.bridge.procedure.leader_reference import LeaderReference
from ptnsbc_nodes.bridge.procedure.placement import ON_GROUND_M, Placement
from ptnsbc_nodes.bridge.procedure.procedure import Procedure
from ptnsbc_nodes.bridge.procedure.steps import (
    AWAY_S,
    BEFORE_ARMING,
    Step,
    Stream,
    VehicleSnapshot,
)
from ptnsbc_nodes.bridge.setpoint.setpoint_guard import allowed
from ptnsbc_nodes.bridge.setpoint.setpoint_stream import SetpointStream, StreamInput
from ptnsbc_nodes.bridge.setpoint.velocity_lead import VelocityLead, largest_kappa_1_s
from ptnsbc_nodes.bridge.state_publisher import ControllerSetpoints, StatePublisher, WorldFrame
from ptnsbc_nodes.bridge.vehicle_monitor import VEHICLE_MESSAGES, VehicleMonitor
from ptnsbc_nodes.bridge.vehicle_pose import TRUTH_MESSAGES
from ptnsbc_nodes.emergency.orders import APART
from ptnsbc_sim.scenario import Scenario

WANTED_MESSAGES = frozenset(
    getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
    for name in (*VEHICLE_MESSAGES, *LINK_MESSAGES, *TRUTH_MESSAGES)
)
"""Ids of the messages that a bridge decodes."""
_ANGLES = frozenset({mavlink.MAVLINK_MSG_ID_ATTITUDE})
_ODOMETRY = frozenset({mavlink.MAVLINK_MSG_ID_ODOMETRY})
_NONE: frozenset[int] = frozenset()
_STREAMED_S = 0.1
_DUPLICATE_S = 3.0
_HELD_S = 2.0  # statuses come five times a second
_NOT_COMPARED = (
    "warning: position_velocity: gains.formation.kappa_1_s is not compared with the vehicle"
)
_LEAST_AGES_S = 0.8  # the procedure waits for fresh setpoints for 1 s
_APART_M = 0.4  # from the height of its layer


class Bridge:
    """Everything between one UAV process and one flight controller."""

    def __init__(
        self,
        scenario: Scenario,
        uav_id: int,
        link: MavlinkLink,
        ports: BridgePorts,
        allow_arming: bool,
        awaited: frozenset[int] = frozenset(),
        *,
        alone: bool = False,
    ) -> None:
        """`awaited`: ids of UAVs whose vehicles must be ready before this one arms.

        `alone`: it flies for itself, without leader, formation and gains of the scenario.
        """
        self._alone = alone
        self._scenario, self._uav_id = scenario, uav_id
        abort = scenario.mavlink.abort
        self._monitor = FlightMonitor(
            AbortLimits(
                abort.separation_share,
                abort.swing_m_s,
                abort.away_m_s,
                abort.against_m_s,
                abort.jump_m,
            )
        )
        self._hazard = ""
        self._told_apart = False
        self._unfit = ""  # why its velocity loop cannot follow this scenario
        self._fitted = False  # whether the delay of the link has been compared with the gains
        self.response: VelocityResponse | None = None
        """The response of the vehicle to velocities, by its parameters; None before they are read, or without them."""
        self._mavlink, vehicle_link = scenario.mavlink, scenario.vehicle_link(uav_id)
        autopilot = AUTOPILOTS[vehicle_link.autopilot]
        height_m, log = self._mavlink.takeoff_height_m, ports.outputs.log
        self.ports = ports
        self.vehicle = VehicleMonitor(autopilot, signed=link.signed)
        self.maintenance = LinkMaintenance(link, vehicle_link, self.vehicle)
        self.controller = ControllerSetpoints(
            decode_wrench if vehicle_link.setpoint == "attitude" else decode_velocity
        )
        world = WorldFrame(scenario, uav_id, autopilot.earth_radius_m, alone=alone)
        self.state_publisher = StatePublisher(
            self.vehicle, world, self.maintenance.sync, self.controller, ports
        )
        self.placement = Placement(scenario, uav_id, awaited, self.vehicle, self.state_publisher)
        away_s = AWAY_S if scenario.formation.reconfigures and not alone else 0.0
        self.procedure = Procedure(
            autopilot, height_m, allow_arming, log, self._left_behind, away_s
        )
        self._reference = LeaderReference(scenario, uav_id)
        self._reference.place_velocity(0.0)  # compiled or loaded now, not in flight
        self.stream = SetpointStream(vehicle_link, self._mavlink, self._reference.config)
        self._next_s = ports.clocks.steady_s()

    @property
    def link(self) -> MavlinkLink:
        """The link to the vehicle."""
        return self.maintenance.link

    @property
    def rate_hz(self) -> float:
        """Rate of the setpoints."""
        return self._mavlink.rate_hz

    @property
    def flew(self) -> bool:
        """True if the vehicle has been armed."""
        return self.state_publisher.world.frozen

    def wait_and_serve(self) -> None:
        """Wait for the next message or the next tick, and do what is due."""
        self.link.wait(
            min(self._next_s - self.ports.clocks.steady_s(), 1.0 / self._mavlink.rate_hz)
        )
        self.serve()

    def serve(self) -> None:
        """Take in what has arrived, and do what is due by now."""
        for message in self.link.poll(self.ports.clocks.steady_s()):
            self._on_message(message)
        now_s = self.ports.clocks.steady_s()
        if now_s >= self._next_s:
            # A late tick is not made up for: two setpoints at once are worth one.
            period_s = 1.0 / self._mavlink.rate_hz
            self._next_s = max(self._next_s + period_s, now_s + 0.5 * period_s)
            self._tick(now_s)

    def leave(self) -> None:
        """After landing: leave the mode in which PX4 would arm at once the next time."""
        if self.vehicle.autopilot.packed and self.flew and not self.vehicle.armed:
            self.link.send(self.maintenance.commands.leave_own_mode())

    def _on_message(self, message: Any) -> None:
        now_s = self.ports.clocks.steady_s()
        if message.get_type() in TRUTH_MESSAGES:
            return self.state_publisher.on_truth(message)
        state = self.vehicle.on_message(message, now_s)
        if state is not None:
            output = self.procedure.output
            self.state_publisher.on_state(state, output.in_formation)
            self._learn(now_s)
        return self.maintenance.on_message(message, now_s)

    def _learn(self, now_s: float) -> None:
        """From the newest state: what thrust and drag do to this vehicle."""
        state, stream = self.state_publisher, self.procedure.output.stream
        lifted = stream is Stream.PLANNER or state.height_m > ON_GROUND_M
        if state.odometry is not None and lifted:
            news = self.stream.learn(stream, now_s, state.sampled_s, state.odometry)
            if news:
                self.ports.outputs.log(news)

    def _tick(self, now_s: float) -> None:
        """One period of the stream."""
        self._take_inputs()
        self.link.ignored = self._repeated(now_s)
        self.state_publisher.update_world()
        self._apply_parameters(now_s)
        self._look_out(now_s)
        self._fit_to_link()
        output = self.procedure.advance(self.snapshot(now_s))
        self._tell_apart()
        failsafe = self.procedure.step is Step.FAILSAFE
        self.state_publisher.report_presence(output.in_formation and not failsafe)
        if output.command is not None:
            height_m = self._mavlink.takeoff_height_m
            self.link.send(self.maintenance.commands.message(output.command, height_m))
        self._send_setpoint(output.stream, now_s)
        self.maintenance.urgent = self.procedure.step is Step.KILL
        healthy = self.procedure.step is not Step.FAILED
        self.maintenance.send_due(now_s, healthy, self.state_publisher.clock_jumped(now_s))

    def _repeated(self, now_s: float) -> frozenset[int]:
        """The messages that say what others say: PX4 streams both kinds, angles at 100 Hz without being asked for."""
        pose = self.vehicle.pose
        quaternions = now_s - pose.quaternion_s < _STREAMED_S
        return (_ANGLES if quaternions else _NONE) | (_ODOMETRY if pose.leaves_odometry else _NONE)

    def _tell_apart(self) -> None:
        """Tell the others at once that the formation is given up: this vehicle may land in the same tick."""
        if self.procedure.gave_up and not self._told_apart:
            self.ports.outputs.apart()
            self._told_apart = True

    def _take_inputs(self) -> None:
        inputs = self.ports.inputs
        data, inputs.setpoint = inputs.setpoint, None
        self._reference.update(inputs)
        while inputs.companions:
            self.placement.companions.report(*inputs.companions.pop(0))
        if data is not None:
            self.controller.on_message(data)

    def _apply_parameters(self, now_s: float) -> None:
        """Once all parameters are read: log them, warn, and lower the limits to the vehicle's."""
        values = self.maintenance.take_parameters(now_s)
        if values is None:
            return
        settings, outputs, guard = self._mavlink, self.ports.outputs, self.stream.guard
        for line in findings(self.vehicle.autopilot, values, settings.rate_hz):
            outputs.log(line)
        guard.limits = allowed(settings.limits, limits(values))
        self.stream.attitude.hover.value = hover_thrust(values) or settings.hover_thrust
        outputs.limits(guard.limits)
        found = velocity_response(self.vehicle.autopilot, values)
        if found is not None:
            own = self._scenario.vehicle_link(self._uav_id)
            self.response = found.measured(own.velocity_loop_1_s, own.tilt_lag_s)
            if not self._alone:
                self._fit_to(self.response)

    def _fit_to(self, response: VelocityResponse) -> None:
        """Send velocities so that this vehicle flies what the planner wants, as far as that goes."""
        lead = self._mavlink.acceleration_feed_forward
        if lead:
            self.stream.lead = VelocityLead(response, 1.0 / self._mavlink.rate_hz)
        setpoint = self._scenario.vehicle_link(self._uav_id).setpoint
        if setpoint != "velocity":
            if setpoint == "position_velocity":
                self.ports.outputs.log(_NOT_COMPARED)
            return
        kappa, most = self._scenario.gains.formation.kappa_1_s, largest_kappa_1_s(response, lead)
        self.ports.outputs.log(f"gains.formation.kappa_1_s up to {most:.1f} fits its velocity loop")
        if kappa > most + 1e-9:
            remedy = "" if lead else ", or mavlink.acceleration_feed_forward: true"
            self._unfit = (
                f"gains.formation.kappa_1_s = {kappa:g}: the vehicle's velocity loop would swing: "
                f"expected at most {most:.1f}{remedy}"
            )

    def _fit_to_link(self) -> None:
        """Before arming: whether a vehicle that flies by attitude bears its link; a generic one shows it in flight."""
        stream = self.stream
        by_attitude = stream.sends_thrust(Stream.PLANNER) and not stream.sends_thrust(Stream.HOLD)
        enough = stream.ages.count >= _LEAST_AGES_S * self._mavlink.rate_hz
        if by_attitude and enough and not self._fitted and self.procedure.step in BEFORE_ARMING:
            self._fitted = True
            self.ports.outputs.log(stream.fit_to())

    def snapshot(self, now_s: float) -> VehicleSnapshot:
        """Everything by which the procedure decides."""
        vehicle, odometry, inputs = self.vehicle, self.state_publisher.odometry, self.ports.inputs
        now_ns = self.ports.clocks.ros_ns()
        leg, leaves = self._reference.leg(now_ns), self._reference.leaves(now_ns)
        companions = self.placement.companions
        percent = self._mavlink.battery_land_percent
        battery_low = vehicle.battery.below(percent, now_s)
        rival_s = self.link.duplicate_sysid_s
        rival = rival_s is not None and now_s - rival_s < _DUPLICATE_S
        return VehicleSnapshot(
            now_s=now_s,
            heartbeat_age_s=vehicle.heartbeat_age_s(now_s),
            wrong_vehicle=vehicle.wrong_vehicle,
            parameters_read=self.maintenance.parameters_read,
            parameter_refusal=self.maintenance.parameter_refusal or self._unfit,
            state_fault=self.state_publisher.fault(now_s),
            controller_age_s=self.controller.age_s(now_s),
            controller_ready=inputs.controller_ready,
            controller_held=now_s - inputs.controller_held_s < _HELD_S,
            mode=vehicle.mode,
            mode_name=vehicle.mode_name,
            armed=vehicle.armed,
            landed=vehicle.landed,
            height_m=self.state_publisher.height_m,
            speed_m_s=self.state_publisher.speed_m_s,
            unprepared="" if odometry is None else self.stream.unprepared(odometry),
            leg=None if leg is None else leg.name,
            leaves=leaves,
            battery_low=f"battery at {vehicle.battery.percent:.0f} %, below {percent:g}"
            if battery_low
            else "",
            fence_breach=self._fence_breach(),
            rebooted=vehicle.rebooted,
            duplicate_sysid=vehicle.pose.clock.jumps_to_and_fro(now_s) or rival,
            stop_request="" if inputs.order.what == APART else inputs.order.what,
            hazard=self._hazard or ("told by another bridge" if inputs.order.what == APART else ""),
            apart=abs(self.state_publisher.height_over_world_m - self.stream.layer_m) < _APART_M,
            below=self.placement.below(inputs.near_uavs)
            if leaves or self.procedure.step is Step.APART
            else "",
            pilots_too=inputs.order.pilots_too,
            unfit=self.stream.unfit,
            misplaced=self.placement.misplaced() if self.procedure.step in BEFORE_ARMING else "",
            not_ready=companions.not_ready(now_s),
            not_armed=companions.not_armed(now_s),
            climbs_first=self.placement.climbs_first()
            if self.procedure.step in (*BEFORE_ARMING, Step.ARMED)
            else "",
            companion_out=companions.out(),
            vehicle_warning=", ".join(filter(None, self._vehicle_words())),
        )

    @property
    def report(self) -> Companion:
        """The values that the bridges of the other vehicles must know before the flight."""
        return Companion(
            self.procedure.step.value,
            self.procedure.fault,
            self.placement.position,
            self.placement.error_m,
            self.state_publisher.height_m,
        )

    def flight_s(self) -> float:
        """Time since the first epoch; negative before it."""
        return self._reference.flight_s(self.ports.clocks.ros_ns())

    def _look_out(self, now_s: float) -> None:
        """In formation: whether it must be given up. At the end of it: the height of this vehicle's layer."""
        odometry, step = self.state_publisher.odometry, self.procedure.step
        if odometry is None or step not in (Step.AIRBORNE, Step.FLY, Step.HELD):
            return
        flight_s = self.flight_s()
        leader = self._reference.at(flight_s)
        in_flight = step is not Step.AIRBORNE and not self._alone
        follows = step is Step.FLY and in_flight and self._reference.is_member(flight_s)
        moves = self._reference.place_velocity(flight_s) if follows else np.zeros(3)
        deadline_s = float(self._scenario.gains.formation.deadline_s)
        near = self.ports.inputs.near_uavs
        sight = Sight(
            now_s,
            odometry[0:3].copy(),
            np.array(velocity_enu(odometry)),
            moves,
            self._wanted(odometry),
            near,
            flight_s - deadline_s if follows or self._alone else -1.0,
            self._reference.places(flight_s) if follows else None,
        )
        self._hazard = self._hazard or self.stream.unfit or self._monitor.look(sight)
        middle_m = leader.position[2] if in_flight else self._mavlink.takeoff_height_m
        self.stream.layer_m = self.placement.layer_m(float(middle_m), self.stream.guard)

    def _wanted(self, odometry: Array) -> Array | None:
        """Velocity (3,) [m/s] that the planner wants; None while the vehicle does not fly by it, as at the fence."""
        guard, inputs, newest = self.stream.guard, self.ports.inputs, self.controller.newest
        ahead = guard.ahead(odometry[0:3], np.array(velocity_enu(odometry)))
        if self.procedure.output.stream is not Stream.PLANNER or guard.outside(ahead):
            return None
        if self.stream.sends_thrust(Stream.PLANNER):
            return None if inputs.wanted is None else inputs.wanted.values[0:3]
        return None if newest is None else newest.values[0:3]

    def _fence_breach(self) -> str:
        odometry = self.state_publisher.odometry
        if odometry is None:
            return ""
        return self.stream.guard.breach(odometry[0:3], np.array(velocity_enu(odometry)))

    def _vehicle_words(self) -> tuple[str, ...]:
        """The words of the vehicle itself about a refusal."""
        vehicle = self.vehicle
        health = (
            "" if vehicle.armed or not vehicle.unhealthy else f"not healthy: {vehicle.unhealthy}"
        )
        return self.maintenance.commands.refused, vehicle.warning, health

    @property
    def place(self) -> str:
        """The last known place of the vehicle in the world; empty while none is known."""
        return self.placement.text

    @property
    def fate(self) -> str:
        """The behaviour of the vehicle when this bridge is silent."""
        vehicle = self.vehicle
        return fate(vehicle.autopilot, vehicle.mode, self.maintenance.parameters)

    def _left_behind(self) -> str:
        """The vehicle's state as the last word about it."""
        place = f" at {self.place}" if self.place else ""
        return f"armed{place} in {self.vehicle.mode_name or 'no mode'}: {self.fate}"

    def _send_setpoint(self, stream: Stream, now_s: float) -> None:
        odometry, offset = self.state_publisher.odometry, self.state_publisher.world.offset
        if odometry is None or offset is None:
            return
        flight_s = self.flight_s()
        reply, armed = self.controller.newest, self.vehicle.armed
        message = self.stream.message(
            StreamInput(stream, now_s, odometry, offset, reply, armed, flight_s)
        )
        if message is not None:
            self.link.send(message)
