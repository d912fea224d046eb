"""The hazards that end a formation in flight, seen on board of one vehicle: too near, swinging, running away, a jump.

A vehicle that calls itself unhealthy, and processes that are late, end it as well.

`FlightMonitor` is pure: states in, a reason out. It looks at the vehicle as it flies and at the velocity that its
planner wants, not at what was sent, so that it sees the same for every kind of setpoint.
"""

from __future__ import annotations

import math
from collections import deque
from inspect import unwrap
from typing import NamedTuple

import numpy as np

from ptnsbc_core.curves.shape import places
from ptnsbc_core.curves.trajectory import Reference, reference
from ptnsbc_core.nanoseconds import SECOND_NS
from ptnsbc_core.tasks.near_constraints import ABOVE
from ptnsbc_core.types import Array
from ptnsbc_nodes.bridge.ports import BridgeInputs, BridgePorts
from ptnsbc_nodes.bridge.procedure.steps import STOP_S, Lasting, Step, Stream
from ptnsbc_nodes.bridge.setpoint.setpoint_stream import SetpointStream
from ptnsbc_nodes.bridge.state_publisher import StatePublisher
from ptnsbc_nodes.bridge.vehicle_monitor import VehicleMonitor
from ptnsbc_nodes.comm.legs import Epochs, Leg
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.constants import leader_trajectory
from ptnsbc_sim.scenario.mavlink import Abort

_SOON_S = 0.5  # the predicted paths count so far ahead
_TOO_NEAR_S = 0.2  # one odd message is no approach
_SWINGS, _SWINGS_S = 4, 15.0  # so many reversals within this time
_GROWING = 0.8  # the newest swing as a share of the first of them: below, the motion dies out
_AWAY_S, _AGAINST_S = 3.0, 3.0
_SETTLED_S = 5.0  # after the deadline
_GAP_S = 0.5  # after a longer silence the next place is no jump
_ALARM_S = 1.0  # a text of the vehicle counts for so long
# A setpoint that comes longer after the one before is late; over this time.
_LATE_S, _WINDOW_S = 0.1, 3.0
# Interpreted: one point takes no longer, and a bridge needs no compiler for a leader on a circle.
_leader_at = unwrap(reference)


class Sight(NamedTuple):
    """The observations of one instant."""

    now_s: float
    position: Array  # (3,) [m], world
    velocity: Array  # (3,) [m/s], world
    reference_m_s: Array  # (3,) velocity of its place in the formation
    wanted_m_s: Array | None  # (3,) what its planner wants; None while it does not fly by it
    others: Array  # (M, 8) x y z keep-out vx vy vz above of the other vehicles
    settled_s: float  # time since the formation's deadline; negative before it
    places: Array | None = None
    """(K, 3) the places that it may have to take, where UAVs come and go: on its way to one it is faster than it."""
    error_m: float = 0.0  # of its position, and about that of the positions of others
    answered: bool = False  # a setpoint of its planner has come since the last look
    failed: str = ""  # its sensors, by its own word
    alarm: str = ""  # what it has just said that is critical


class FlightMonitor:
    """Looks at every new state of the vehicle while it flies in formation."""

    def __init__(self, limits: Abort) -> None:
        self._limits = limits
        self._last: Sight | None = None
        self._near, self._fast, self._astray = Lasting(), Lasting(), Lasting()
        self._failed, self._answered_s = Lasting(), math.inf
        self._late: deque[tuple[float, float]] = deque(maxlen=round(_WINDOW_S / _LATE_S))
        """Late setpoints: when each came, and how late it was [s]."""
        self._peak = np.zeros(2)  # of the present swing
        self._swings: deque[tuple[float, float]] = deque(maxlen=_SWINGS)  # when, and how fast

    def look(self, sight: Sight) -> str:
        """The reason why the formation must end; empty when it may go on."""
        checks = (self._jump, self._too_near, self._swinging, self._away, self._against)
        reasons = [check(sight) for check in (self._unwell, self._behind, *checks)]
        self._last = sight
        return next(filter(None, reasons), "")

    def _unwell(self, sight: Sight) -> str:
        limit_s = self._limits.unhealthy_s
        failed_s = self._failed.update(bool(sight.failed), sight.now_s)
        if limit_s and failed_s >= limit_s:
            return f"failed on board: {sight.failed}"
        return f"the vehicle says: {sight.alarm}" if limit_s and sight.alarm else ""

    def _behind(self, sight: Sight) -> str:
        """The lateness of setpoints; a longer silence is the failsafe's business."""
        now_s, limit_s = sight.now_s, self._limits.late_share * _WINDOW_S
        if not sight.answered or not limit_s:
            return ""
        gap_s, self._answered_s = now_s - self._answered_s, now_s
        if _LATE_S < gap_s <= STOP_S:
            self._late.append((now_s, gap_s - _LATE_S))
        late_s = sum(late_s for came_s, late_s in self._late if came_s > now_s - _WINDOW_S)
        share = f"setpoints late for {100.0 * late_s / _WINDOW_S:.0f} % of {_WINDOW_S:g} s"
        less = "give the computers of UAV process and bridge less work"
        return f"{share}: {less}" if late_s >= limit_s else ""

    def _jump(self, sight: Sight) -> str:
        last, limit_m = self._last, self._limits.jump_m
        if last is None or not limit_m:
            return ""
        elapsed_s = sight.now_s - last.now_s
        if not 0.0 < elapsed_s <= _GAP_S:
            return ""
        expected = last.position + elapsed_s * 0.5 * (last.velocity + sight.velocity)
        jump_m = math.dist(sight.position, expected)
        return f"its position jumped by {jump_m:.1f} m" if jump_m > limit_m else ""

    def _too_near(self, sight: Sight) -> str:
        share = self._limits.separation_share
        if not share or not len(sight.others):
            self._near.update(False, sight.now_s)
            return ""
        away = sight.others[:, 0:3] - sight.position
        closing = sight.others[:, 4:7] - sight.velocity
        for height in away[:, 2], closing[:, 2]:  # in the scale of the keep-outs
            height *= sight.others[:, 3] / np.maximum(sight.others[:, 3], sight.others[:, ABOVE])
        speed2 = np.einsum("ij,ij->i", closing, closing)
        soonest = -np.einsum("ij,ij->i", away, closing) / np.maximum(speed2, 1e-9)
        when = np.clip(soonest, 0.0, _SOON_S)
        apart_m = np.linalg.norm(away + when[:, None] * closing, axis=1)
        limits_m = share * sight.others[:, 3] + math.sqrt(2.0) * sight.error_m
        nearest = int(np.argmin(apart_m - limits_m))
        nearest_m = float(apart_m[nearest])
        near = nearest_m < limits_m[nearest]
        if self._near.update(near, sight.now_s) < _TOO_NEAR_S:
            return ""
        return f"{nearest_m:.2f} m from another vehicle, now or within {_SOON_S:g} s"

    def _swinging(self, sight: Sight) -> str:
        """Reversals of the horizontal velocity against the reference that do not die out."""
        limit_m_s = self._limits.swing_m_s
        motion = (sight.velocity - sight.reference_m_s)[0:2]
        speed_m_s = math.hypot(motion[0], motion[1])
        if not limit_m_s or speed_m_s < limit_m_s:
            return ""
        if float(motion @ self._peak) >= 0.0:
            if speed_m_s > math.hypot(self._peak[0], self._peak[1]):
                self._peak = motion
            return ""
        self._swings.append((sight.now_s, math.hypot(self._peak[0], self._peak[1])))
        self._peak = motion
        if len(self._swings) < _SWINGS or sight.now_s - self._swings[0][0] > _SWINGS_S:
            return ""
        first_m_s, newest_m_s = self._swings[0][1], self._swings[-1][1]
        if newest_m_s < _GROWING * first_m_s:
            return ""
        return f"it swings at {newest_m_s:.1f} m/s, {_SWINGS} times to and fro without dying out"

    def _away(self, sight: Sight) -> str:
        """Faster than its place for seconds, when the formation should long have been there."""
        limit_m_s = self._limits.away_m_s
        motion = sight.velocity - sight.reference_m_s
        speed_m_s = math.hypot(*motion)
        if sight.places is not None:
            off = sight.position - sight.places
            apart_m = np.maximum(np.linalg.norm(off, axis=1), 1e-9)
            speed_m_s = float(np.min(off @ motion / apart_m))
        fast = bool(limit_m_s) and sight.settled_s >= _SETTLED_S and speed_m_s >= limit_m_s
        if self._fast.update(fast, sight.now_s) < _AWAY_S:
            return ""
        return f"its error grows: {speed_m_s:.1f} m/s away from the motion of its place for {_AWAY_S:g} s"

    def _against(self, sight: Sight) -> str:
        """Told to correct its place one way while it flies the other, for seconds: its error grows, at any speed."""
        limit_m_s = self._limits.against_m_s
        wanted = sight.reference_m_s if sight.wanted_m_s is None else sight.wanted_m_s
        correction, motion = wanted - sight.reference_m_s, sight.velocity - sight.reference_m_s
        wanted_m_s = math.hypot(*correction)
        large = bool(limit_m_s) and wanted_m_s >= limit_m_s
        astray = large and float(motion @ correction) < 0.0
        if self._astray.update(astray, sight.now_s) < _AGAINST_S:
            return ""
        return (
            f"its error grows: for {_AGAINST_S:g} s it flies away from its place, "
            f"towards which its planner wants {wanted_m_s:.1f} m/s"
        )


class LeaderReference:
    """Legs and trajectory of a flight, brought up to date by what arrives."""

    def __init__(self, scenario: Scenario, uav_id: int) -> None:
        self._scenario, self._uav_id = scenario, uav_id
        self._epochs = Epochs(scenario)
        self.config = agent_config(scenario, uav_id)

    def update(self, inputs: BridgeInputs) -> None:
        """Take in the legs and the setpoints of the leader that have arrived."""
        while inputs.legs:
            if self._epochs.announce(*inputs.legs.pop(0)):
                self.config = agent_config(self._epochs.scenario, self._uav_id)
        while inputs.taken:
            self._epochs.take(inputs.taken.pop(0))
            self.config = self.config._replace(trajectory=leader_trajectory(self._epochs.scenario))

    def leg(self, now_ns: int) -> Leg | None:
        """The leg in force for the vehicle; None before the first."""
        return self._epochs.at(now_ns, self._uav_id)

    def leaves(self, now_ns: int) -> bool:
        """True if the vehicle lands while the others fly on."""
        own, others = self.leg(now_ns), self._epochs.at(now_ns)
        return own is not None and own != others

    def flight_s(self, now_ns: int) -> float:
        """Time since the first epoch; negative before it."""
        leg = self.leg(now_ns)
        return -1.0 if leg is None else (now_ns - leg.first_t0_ns) * 1e-9

    def at(self, flight_s: float) -> Reference:
        """The leader's motion so many seconds after the first epoch; before it, that of the epoch."""
        return _leader_at(self.config.trajectory, max(flight_s, 0.0))

    def place_velocity(self, flight_s: float) -> Array:
        """Velocity (3,) [m/s] of the vehicle's place: that of the leader's reference, and that of a shape that moves.

        Where slots are open a bridge does not hear who takes which, and the leader's has to do.
        """
        config, t = self.config, max(flight_s, 0.0)
        velocity = np.array(self.at(t).velocity)
        if config.shape.moving and not self._scenario.formation.has_open_slots:
            velocity += places(config.shape, config.trajectory, t).own.velocity
        return velocity

    def is_member(self, flight_s: float) -> bool:
        """True if the vehicle belongs to the formation by the scenario: it has joined, and has not left."""
        uav = self._scenario.uav(self._uav_id)
        return uav.joins_ns <= flight_s * SECOND_NS < uav.leaves_ns

    def places(self, flight_s: float) -> Array | None:
        """The places (K, 3) [m] that the vehicle may have to take where UAVs come and go; None elsewhere."""
        scenario = self._scenario
        if not scenario.formation.reconfigures:
            return None
        closes_up = scenario.formation.vacancy == "close_up"
        slots = scenario.uav_ids if closes_up else (self._uav_id,)
        leader = np.array(self.at(flight_s).position)
        return leader + np.array([scenario.offset(slot) for slot in slots])


class FormationWatch:
    """Looks at one vehicle in formation: whether it must be given up, and the height of its layer at the end of it."""

    def __init__(
        self,
        scenario: Scenario,
        uav_id: int,
        ports: BridgePorts,
        vehicle: VehicleMonitor,
        state: StatePublisher,
        stream: SetpointStream,
    ) -> None:
        self.reference = LeaderReference(scenario, uav_id)
        self.reference.place_velocity(0.0)  # compiled or loaded now, not in flight
        self._monitor = FlightMonitor(scenario.mavlink.abort)
        self._scenario, self._ports = scenario, ports
        self._vehicle, self._state, self._stream = vehicle, state, stream
        self.hazard = ""
        """Reason for which the formation must be given up; it stays."""
        self.middle_m = scenario.mavlink.takeoff_height_m
        """Height [m] about which the layers of all vehicles lie."""

    def look(
        self, now_s: float, step: Step, sent: Stream, *, answered: bool, error_m: float
    ) -> None:
        """Look at the newest state of the vehicle in a step of its flight, in which the stream carries `sent`.

        `answered`: a setpoint has come since the last look; `error_m`: of its position.
        """
        odometry = self._state.odometry
        if odometry is None or step not in (Step.AIRBORNE, Step.FLY, Step.HELD):
            return
        flight_s = self.reference.flight_s(self._ports.ros_ns())
        follows = step is Step.FLY and self.reference.is_member(flight_s)
        deadline_s = float(self._scenario.gains.formation.deadline_s)
        velocity = self._state.velocity
        alarm, said_s = self._vehicle.alarm
        sight = Sight(
            now_s,
            odometry[0:3].copy(),
            velocity,
            self.reference.place_velocity(flight_s) if follows else np.zeros(3),
            self._wanted(odometry, velocity) if sent is Stream.PLANNER else None,
            self._ports.inputs.near_uavs,
            flight_s - deadline_s if follows else -1.0,
            self.reference.places(flight_s) if follows else None,
            error_m,
            answered,
            self._vehicle.failed,
            alarm if now_s - said_s < _ALARM_S else "",
        )
        self.hazard = self.hazard or self._stream.fit.unfit or self._monitor.look(sight)
        if step is not Step.AIRBORNE:
            self.middle_m = float(self.reference.at(flight_s).position[2])

    def _wanted(self, odometry: Array, velocity: Array) -> Array | None:
        """Velocity (3,) [m/s] that the planner wants; None where the vehicle does not fly by it, as at the fence."""
        guard, newest = self._stream.guard, self._state.controller.newest
        if guard.outside(guard.ahead(odometry[0:3], velocity)):
            return None
        if self._stream.sends_thrust(Stream.PLANNER):
            wanted = self._ports.inputs.wanted
            return None if wanted is None else wanted.values[0:3]
        return None if newest is None else newest.values[0:3]

    def fence_breach(self) -> str:
        """Reason for which the vehicle must land; empty while it is inside of the fence."""
        odometry = self._state.odometry
        if odometry is None:
            return ""
        return self._stream.guard.breach(odometry[0:3], self._state.velocity)
