"""One bridge: link, vehicle, procedure and stream, served by one thread. No ROS in here."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from ptnsbc_io.mavlink.autopilots import AUTOPILOTS, findings
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import MavlinkLink, link_to
from ptnsbc_io.mavlink.transport import PortTakenError
from ptnsbc_nodes.bridge.link_maintenance import LINK_MESSAGES, LinkMaintenance
from ptnsbc_nodes.bridge.ports import BridgePorts
from ptnsbc_nodes.bridge.procedure.companions import HEARD_S, ON_GROUND_M, Placement, strayed
from ptnsbc_nodes.bridge.procedure.hazards import FormationWatch
from ptnsbc_nodes.bridge.procedure.procedure import Procedure
from ptnsbc_nodes.bridge.procedure.steps import (
    AWAY_S,
    BEFORE_ARMING,
    Companion,
    Step,
    Stream,
    VehicleSnapshot,
)
from ptnsbc_nodes.bridge.setpoint.setpoint_stream import SetpointStream, StreamInput
from ptnsbc_nodes.bridge.state_publisher import StatePublisher
from ptnsbc_nodes.bridge.vehicle_monitor import TRUTH_MESSAGES, VEHICLE_MESSAGES, VehicleMonitor
from ptnsbc_nodes.emergency import APART, PASSING, RETURN
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.mavlink import VehicleLink

WANTED_MESSAGES = frozenset(
    getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
    for name in (*VEHICLE_MESSAGES, *LINK_MESSAGES, *TRUTH_MESSAGES)
)
"""Ids of the messages that a bridge decodes."""
_DUPLICATE_S = 3.0
_PORT_AGAIN_S = 0.05
_LEAST_AGES_S = 0.8  # the procedure waits for fresh setpoints for 1 s
_APART_M = 0.4  # from the height of its layer


def open_link(
    settings: VehicleLink, key: str, over: Callable[[], bool], taken_s: float = 12.0
) -> MavlinkLink:
    """The link to a vehicle; `key`: path of the key file for signing, empty without one.

    A port that is taken is waited for, unless the process is `over`: `ptnsbc stop`, with its patience of 10 s, holds
    that of a bridge that died.

    Raises:
        PtnsbcError: the link cannot be opened.
    """
    until_s = time.monotonic() + taken_s
    while True:
        try:
            return link_to(settings.connect, settings.sysid, WANTED_MESSAGES, key)
        except PortTakenError:
            if over() or time.monotonic() >= until_s:
                raise
            time.sleep(_PORT_AGAIN_S)  # nothing tells when a port is let go


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
    ) -> None:
        """`awaited`: ids of UAVs whose vehicles must be ready before this one arms."""
        self.ports, self._mavlink = ports, scenario.mavlink
        vehicle_link = scenario.vehicle_link(uav_id)
        autopilot = AUTOPILOTS[vehicle_link.autopilot]
        self.vehicle = VehicleMonitor(autopilot, signed=link.signed)
        self.maintenance = LinkMaintenance(link, vehicle_link, self.vehicle)
        self.state_publisher = StatePublisher(
            scenario, uav_id, self.vehicle, self.maintenance.sync, ports
        )
        self.placement = Placement(scenario, uav_id, awaited, self.vehicle, self.state_publisher)
        self.stream = SetpointStream(vehicle_link, scenario.mavlink, agent_config(scenario, uav_id))
        self.watch = FormationWatch(
            scenario, uav_id, ports, self.vehicle, self.state_publisher, self.stream
        )
        away_s = AWAY_S if scenario.formation.reconfigures else 0.0
        height_m, log = scenario.mavlink.takeoff_height_m, ports.log
        self.procedure = Procedure(autopilot, height_m, allow_arming, log, away_s)
        self._told_apart = False
        self._fitted = False  # whether the delay of the link has been compared with the gains
        self._next_s = ports.steady_s()

    @property
    def link(self) -> MavlinkLink:
        """The link to the vehicle."""
        return self.maintenance.link

    @property
    def flew(self) -> bool:
        """True if the vehicle has been armed."""
        return self.state_publisher.world.frozen

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

    @property
    def objection(self) -> str:
        """The reason why its vehicle must not be armed as it stands there; empty without one, and from arming on."""
        if self.procedure.step not in BEFORE_ARMING:
            return ""
        low = self.vehicle.battery.low(self._mavlink.battery_land_percent, self.ports.steady_s())
        inexact = self.placement.inexact()
        return low or inexact or self.placement.misplaced()

    @property
    def fate(self) -> str:
        """The behaviour of the armed vehicle when this bridge is silent."""
        on_ground = "it stands on the ground, its rotors turn"
        return on_ground if self.procedure.stands else self.maintenance.fate

    def take_over(self, frame: str) -> None:
        """Fly on with the vehicle of a bridge that died, in its frame of the world, if this one may fly any."""
        if frame and self.procedure.allow_arming:
            self.state_publisher.world.resume(frame)
            self.link.resumed = True
            self.procedure.takes_over = True

    def flight_s(self) -> float:
        """Time since the first epoch; negative before it."""
        return self.watch.reference.flight_s(self.ports.ros_ns())

    def wait_and_serve(self) -> None:
        """Wait for the next message or the next tick, and do what is due."""
        period_s = 1.0 / self._mavlink.rate_hz
        self.link.wait(min(self._next_s - self.ports.steady_s(), period_s))
        self.serve()

    def serve(self) -> None:
        """Take in what has arrived, and do what is due by now."""
        for message in self.link.poll(self.ports.steady_s()):
            self._on_message(message, self.ports.steady_s())
        now_s = self.ports.steady_s()
        if now_s >= self._next_s:
            # A late tick is not made up for: two setpoints at once are worth one.
            period_s = 1.0 / self._mavlink.rate_hz
            self._next_s = max(self._next_s + period_s, now_s + 0.5 * period_s)
            self._tick(now_s)

    def leave(self) -> None:
        """After landing: leave the mode in which PX4 would arm at once the next time."""
        if self.vehicle.autopilot.packed and self.flew and not self.vehicle.armed:
            self.link.send(self.maintenance.commands.leave_own_mode())

    def _on_message(self, message: Any, now_s: float) -> None:
        publisher, output = self.state_publisher, self.procedure.output
        if message.get_type() in TRUTH_MESSAGES:
            return publisher.on_truth(message)
        state = self.vehicle.on_message(message, now_s)
        if state is not None:
            publisher.on_state(state, output.in_formation)
            lifted = output.stream is Stream.PLANNER or publisher.height_m > ON_GROUND_M
            if publisher.odometry is not None and lifted:
                sampled_s, odometry = publisher.sampled_s, publisher.odometry
                self._log(self.stream.learn(output.stream, now_s, sampled_s, odometry))
        return self.maintenance.on_message(message, now_s)

    def _log(self, line: str) -> None:
        if line:
            self.ports.log(line)

    def _tick(self, now_s: float) -> None:
        procedure, stream, publisher = self.procedure, self.stream, self.state_publisher
        if self.link.missing != self.vehicle.missing:
            self._log(self.link.missing)
        inputs, self.vehicle.missing = self.ports.inputs, self.link.missing
        data, inputs.setpoint = inputs.setpoint, None
        answered = data is not None and publisher.controller.on_message(data)
        self.watch.reference.update(inputs)
        while inputs.companions:
            self.placement.report(*inputs.companions.pop(0))
        self.maintenance.ignore_repetitions(now_s)
        publisher.update_world()
        if (values := self.maintenance.take_parameters(now_s)) is not None:
            for line in findings(self.vehicle.autopilot, values, self._mavlink.rate_hz):
                self._log(line)
            stream.take_parameters(values)
            self.ports.limits(stream.guard.limits)
            self._log(stream.fit_to_vehicle())
        step, sent, error_m = procedure.step, procedure.output.stream, self.placement.error_m
        self.watch.look(now_s, step, sent, answered=answered, error_m=error_m)
        stream.layer_m = self.placement.layer_m(self.watch.middle_m, stream.guard)
        # Before arming: whether a vehicle that flies by attitude bears its link; a generic one shows it in flight.
        by_attitude = stream.sends_thrust(Stream.PLANNER) and not stream.sends_thrust(Stream.HOLD)
        enough = stream.ages.count >= _LEAST_AGES_S * self._mavlink.rate_hz
        if by_attitude and enough and not self._fitted and procedure.step in BEFORE_ARMING:
            self._fitted = True
            self._log(stream.fit_to_link())
        output = procedure.advance(self.snapshot(now_s))
        if procedure.gave_up and not self._told_apart:  # at once: it may land in the same tick
            self.ports.apart()
            self._told_apart = True
        failsafe = procedure.step is Step.FAILSAFE
        publisher.report_presence(output.in_formation and not failsafe)
        if output.command is not None:
            height_m = self._mavlink.takeoff_height_m
            message = self.maintenance.commands.message(output.command, height_m)
            self.link.command(output.command, message)
        odometry, offset = publisher.odometry, publisher.world.offset
        if odometry is not None and offset is not None:
            reply, armed = publisher.controller.newest, self.vehicle.armed
            tick = StreamInput(
                output.stream, now_s, odometry, offset, reply, armed, self.flight_s()
            )
            setpoint = stream.message(tick)
            if setpoint is not None:
                self.link.send(setpoint)
        self.maintenance.urgent = procedure.step is Step.KILL
        healthy = procedure.step is not Step.FAILED
        self.maintenance.send_due(now_s, healthy, publisher.clock_jumped(now_s))

    def snapshot(self, now_s: float) -> VehicleSnapshot:
        """Everything by which the procedure decides."""
        vehicle, publisher, inputs = self.vehicle, self.state_publisher, self.ports.inputs
        placement, maintenance, step = self.placement, self.maintenance, self.procedure.step
        odometry, now_ns = publisher.odometry, self.ports.ros_ns()
        leg, leaves = self.watch.reference.leg(now_ns), self.watch.reference.leaves(now_ns)
        order, told_apart = inputs.order, inputs.order.what == APART
        rival_s = self.link.duplicate_sysid_s
        unhealthy = "" if vehicle.armed else vehicle.unhealthy
        words = (
            maintenance.commands.refused,
            vehicle.warning,
            f"not healthy: {unhealthy}" if unhealthy else "",
        )
        before_arming = step in BEFORE_ARMING
        place = f" at {placement.text}" if placement.text else ""
        return VehicleSnapshot(
            now_s=now_s,
            heartbeat_age_s=vehicle.heartbeat_age_s(now_s),
            wrong_vehicle=vehicle.wrong_vehicle,
            parameters_read=maintenance.parameters_read,
            parameter_refusal=maintenance.parameter_refusal or self.stream.fit.refusal,
            state_fault=publisher.fault(now_s),
            controller_age_s=publisher.controller.age_s(now_s),
            controller_ready=inputs.controller_ready,
            controller_absent=now_s - inputs.controller_heard_s > HEARD_S,
            mode=vehicle.mode,
            mode_name=vehicle.mode_name,
            armed=vehicle.armed,
            landed=vehicle.landed,
            height_m=publisher.height_m,
            speed_m_s=publisher.speed_m_s,
            unprepared="" if odometry is None else self.stream.unprepared(odometry),
            leg=None if leg is None else leg.name,
            leaves=leaves,
            battery_low=vehicle.battery.low(self._mavlink.battery_land_percent, now_s),
            fence_breach=self.watch.fence_breach(),
            rebooted=vehicle.rebooted,
            duplicate_sysid=vehicle.pose.clock.jumps_to_and_fro(now_s)
            or (rival_s is not None and now_s - rival_s < _DUPLICATE_S),
            stop_request="" if order.what in PASSING else order.what,
            told_home=order.what == RETURN and vehicle.autopilot.returns,
            hazard=self.watch.hazard or ("told by another bridge" if told_apart else ""),
            apart=abs(publisher.height_over_world_m - self.stream.layer_m) < _APART_M,
            below=placement.below(inputs.near_uavs) if leaves or step is Step.APART else "",
            pilots_too=order.pilots_too,
            unfit=self.stream.fit.unfit,
            unready=vehicle.unready,
            misplaced=self.objection,
            not_ready=placement.not_ready(now_s),
            not_armed=placement.not_armed(now_s),
            climbs_first=placement.climbs_first() if before_arming or step is Step.ARMED else "",
            strayed=strayed(placement, self._mavlink.start_tolerance_m),
            companion_out=placement.out(),
            vehicle_warning=", ".join(filter(None, words)),
            left_behind=f"armed{place} in {vehicle.mode_name or 'no mode'}: {self.fate}",
        )
