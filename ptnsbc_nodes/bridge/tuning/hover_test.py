"""A hover test flown by a bridge: take-off, sinusoids within a box, landing. No ROS in here.

Everything that keeps a flight safe is the bridge's own: arming, fence, battery, pilot, failsafe, silence. The test only
takes the place of the UAV process. It ends, and the vehicle lands, when it has what it needs, or leaves its box.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.autopilots import AUTOPILOTS
from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_io.wire import HeaderFields, VelocityTemplate
from ptnsbc_nodes.bridge.bridge import Bridge
from ptnsbc_nodes.bridge.ports import BridgeInputs, BridgeOutputs, BridgePorts, Clocks, Log
from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.bridge.tuning.excitation import Excitation, FrequencyPoint, TuneError
from ptnsbc_nodes.bridge.tuning.settings import Identified, identified
from ptnsbc_nodes.comm.legs import FIRST_LEG
from ptnsbc_nodes.emergency.orders import LAND, Order
from ptnsbc_sim.scenario import Scenario, scenario_from_text

_BEGIN_NS = 500_000_000


class _Rows(NamedTuple):
    """Time [s] and velocity along x [m/s], row by row."""

    sent: list[tuple[float, float]]
    flown: list[tuple[float, float]]


class HoverTest:
    """One bridge and the velocities that it flies instead of those of a UAV process."""

    def __init__(
        self,
        scenario: Scenario,
        uav_id: int,
        link: MavlinkLink,
        clocks: Clocks,
        log: Log,
        *,
        allow_arming: bool,
        box_m: float,
    ) -> None:
        """Args as of `Bridge`; `box_m`: side of the box around the place above the take-off [m].

        Raises:
            TuneError: the vehicle takes no velocities, or the box is too small.
        """
        settings = scenario.vehicle_link(uav_id)
        if AUTOPILOTS[settings.autopilot].attitude_only or settings.setpoint != "velocity":
            raise TuneError(
                f"mavlink.vehicles.{uav_id}: {settings.autopilot} by {settings.setpoint}: expected setpoint: velocity; "
                "thrust and delay of vehicles that fly by attitude are found in flight (docs/hardware.md)"
            )
        bare = {"mavlink.acceleration_feed_forward": False}  # the vehicle itself is tested
        self._log = log
        self._excitation = Excitation(box_m)
        self._setpoint = VelocityTemplate("map")
        self.inputs = BridgeInputs(controller_ready=True)
        outputs = BridgeOutputs(
            odom=self._on_odometry,
            track=self._on_odometry,
            origin=lambda _place: None,
            limits=lambda _limits: None,
            lost=lambda: None,
            log=log,
        )
        self.bridge = Bridge(
            scenario_from_text(scenario.text, bare, source=scenario.source),
            uav_id,
            link,
            BridgePorts(self.inputs, outputs, clocks),
            allow_arming,
            alone=True,
        )
        self._clocks = clocks
        self._middle: Array | None = None  # of the box (3,) [m]
        self._begin_s = 0.0
        self._announced = False
        self._rows = _Rows([], [])
        self._problem = ""
        self._complete = False

    @property
    def over(self) -> bool:
        """True if the vehicle has landed, or a pilot has taken over."""
        return self.bridge.procedure.over

    def land(self) -> None:
        """End the test: the vehicle lands."""
        self._end("the operator ended the test")

    def serve(self) -> None:
        """Do what is due now; call it at least at the rate of the setpoints."""
        procedure = self.bridge.procedure
        if procedure.ready and not self._announced:
            self._announced = True
            self.inputs.legs.append(HeaderFields(self._clocks.ros_ns() + _BEGIN_NS, FIRST_LEG))
        self.bridge.serve()
        flown_s = self._clocks.steady_s() - self._begin_s
        if procedure.step is Step.FLY and self._middle is not None:
            if flown_s > self._excitation.end_s and not self._complete:
                self._complete = True
                self._log("hover test: all sinusoids flown, landing")
                self.inputs.take(Order(LAND))
        elif self._middle is not None and not self._complete and not self._problem:
            fault = procedure.fault or "the flight ended"
            self._end(f"{procedure.step.value}: {fault}")

    def _on_odometry(self, stamp_ns: int, odometry: Array) -> None:
        """Answer a state with the velocity of now, as a UAV process does."""
        now_s, velocity = self._clocks.steady_s(), np.zeros(3)
        if self.bridge.procedure.step is Step.FLY and not (self._complete or self._problem):
            if self._middle is None:
                self._middle, self._begin_s = odometry[0:3].copy(), now_s
                self._log(
                    f"hover test: {self._excitation.end_s:.0f} s within "
                    f"{self._excitation.box_m:g} m around {self.bridge.place}"
                )
            away = odometry[0:3] - self._middle
            if self._excitation.left(away):
                self._end(
                    f"the vehicle left its box of {self._excitation.box_m:g} m at {self.bridge.place}"
                )
            velocity = self._excitation.wanted(now_s - self._begin_s, away)
            published = self.bridge.controller.published(stamp_ns)
            self._rows.sent.append((now_s - self._begin_s, float(velocity[0])))
            if published is not None:
                flown = float(velocity_enu(odometry)[0])
                self._rows.flown.append((published.sampled_s - self._begin_s, flown))
        self.inputs.setpoint = self._setpoint.encode(stamp_ns, np.array([*velocity, 0.0, 0.0, 0.0]))

    def _end(self, problem: str) -> None:
        if not self._complete:
            self._problem = self._problem or problem
        self.inputs.take(Order(LAND))

    def points(self) -> list[FrequencyPoint]:
        """The response at each frequency, flown per sent velocity.

        Raises:
            TuneError: the test did not come to its end, or its setpoints were not its own.
        """
        if not self._complete:
            why = self._problem or self.bridge.procedure.fault or "it did not begin"
            raise TuneError(f"hover test not completed: {why}")
        if clamped := sum(self.bridge.stream.guard.clamped.values()):
            kinds = ", ".join(self.bridge.stream.guard.clamped)
            raise TuneError(
                f"{clamped} setpoints were clamped ({kinds}): "
                "expected none; fly farther from the fence, or raise the limits"
            )
        sent, flown = (np.array(rows).reshape(-1, 2) for rows in self._rows)
        return self._excitation.points(sent, flown)

    def identified(self) -> Identified:
        """The vehicle, as far as its parameters leave it open.

        Raises:
            TuneError: see `points`; or its parameters are unknown, or do not explain what it flew.
        """
        points, response = self.points(), self.bridge.response
        if response is None:
            raise TuneError(
                "the vehicle did not answer all parameters of its velocity loop: see above, and docs/hardware.md"
            )
        return identified(response, points, self.delay_s)

    @property
    def delay_s(self) -> float:
        """Delay from a setpoint to the vehicle [s]: half the round trip, and the period of the stream."""
        return 0.5 * self.bridge.maintenance.sync.round_trip_s + 1.0 / self.bridge.rate_hz
