"""A hover test flown by a bridge: take-off, sinusoids within a box, landing. No ROS in here.

Everything that keeps a flight safe is the bridge's own: arming, fence, battery, pilot, failsafe, silence. The test only
takes the place of the UAV process. It ends, and the vehicle lands, when it has what it needs, or leaves its box.
`ptnsbc stop` reaches its process as it reaches a bridge of this host, and knows how to reach the vehicle past it.
"""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path

import numpy as np

from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import Array
from ptnsbc_io.files import read_key
from ptnsbc_io.mavlink.autopilots import AUTOPILOTS
from ptnsbc_io.mavlink.link import MavlinkLink, Signer
from ptnsbc_io.mavlink.transport import connect
from ptnsbc_io.wire import HeaderFields, VelocityTemplate
from ptnsbc_nodes.bridge.bridge import WANTED_MESSAGES, Bridge
from ptnsbc_nodes.bridge.identification import (
    Excitation,
    FrequencyPoint,
    Identified,
    TuneError,
    identified,
)
from ptnsbc_nodes.bridge.ports import BridgeInputs, BridgeOutputs, BridgePorts, Clocks, Log
from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.bridge.status import RecordKeeper, new_record
from ptnsbc_nodes.comm.legs import FIRST_LEG
from ptnsbc_nodes.emergency.orders import LAND, Order, OrderPort, latched, runtime_folder
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.signals import StopRequest
from ptnsbc_sim.scenario import Scenario, scenario_from_text

_BEGIN_NS = 500_000_000
_WAIT_S = 0.005


class HoverTest(BridgeOutputs):
    """One bridge, and the velocities that it flies instead of those of a UAV process."""

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
        self._print, self._clocks = log, clocks
        self._excitation = Excitation(box_m)
        self._setpoint = VelocityTemplate("map")
        self._period_s = 1.0 / scenario.mavlink.rate_hz
        self.inputs = BridgeInputs(controller_ready=True)
        bare = {"mavlink.acceleration_feed_forward": False}  # the vehicle itself is tested
        self.bridge = Bridge(
            scenario_from_text(scenario.text, bare, source=scenario.source),
            uav_id,
            link,
            BridgePorts(self.inputs, self, clocks),
            allow_arming,
            alone=True,
        )
        self._middle: Array | None = None  # of the box (3,) [m]
        self._begin_s = 0.0
        self._announced = False
        self._sent: list[tuple[float, float]] = []  # time [s] and velocity along x [m/s]
        self._flown: list[tuple[float, float]] = []  # the same of each state
        self._problem = ""
        self._complete = False

    def log(self, line: str) -> None:
        """A line for the operator."""
        self._print(line)

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
                self.log("hover test: all sinusoids flown, landing")
                self.inputs.take(Order(LAND))
        elif self._middle is not None and not self._complete and not self._problem:
            fault = procedure.fault or "the flight ended"
            self._end(f"{procedure.step.value}: {fault}")

    def odom(self, stamp_ns: int, odometry: Array) -> None:
        """Answer a state with the velocity of now, as a UAV process does."""
        now_s, velocity = self._clocks.steady_s(), np.zeros(3)
        if self.bridge.procedure.step is Step.FLY and not (self._complete or self._problem):
            if self._middle is None:
                self._middle, self._begin_s = odometry[0:3].copy(), now_s
                self.log(
                    f"hover test: {self._excitation.end_s:.0f} s within "
                    f"{self._excitation.box_m:g} m around {self.bridge.placement.text}"
                )
            away = odometry[0:3] - self._middle
            if self._excitation.left(away):
                self._end(
                    f"the vehicle left its box of {self._excitation.box_m:g} m at {self.bridge.placement.text}"
                )
            velocity = self._excitation.wanted(now_s - self._begin_s, away)
            published = self.bridge.state_publisher.controller.published(stamp_ns)
            self._sent.append((now_s - self._begin_s, float(velocity[0])))
            if published is not None:
                flown = float(velocity_enu(odometry)[0])
                self._flown.append((published.sampled_s - self._begin_s, flown))
        self.inputs.setpoint = self._setpoint.encode(stamp_ns, np.array([*velocity, 0.0, 0.0, 0.0]))

    track = odom  # a vehicle that has left the formation is tested as well

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
        sent, flown = (np.array(rows).reshape(-1, 2) for rows in (self._sent, self._flown))
        return self._excitation.points(sent, flown)

    def identified(self) -> Identified:
        """The vehicle, as far as its parameters leave it open.

        Raises:
            TuneError: see `points`; or its parameters are unknown, or do not explain what it flew.
        """
        points, response = self.points(), self.bridge.stream.response
        if response is None:
            raise TuneError(
                "the vehicle did not answer all parameters of its velocity loop: see above, and docs/hardware.md"
            )
        # Half the round trip, and the period of the stream.
        delay_s = 0.5 * self.bridge.maintenance.sync.round_trip_s + self._period_s
        return identified(response, points, delay_s)


def fly_hover_test(
    scenario: Scenario, uav: int, key: Path | None, log: Log, *, allow_arming: bool, box_m: float
) -> Identified:
    """Fly one vehicle and identify it; the first signal lands it, the second one ends this at once.

    Args:
        scenario: the fleet of the vehicle, overrides applied.
        uav: id of its UAV.
        key: key file for signing, instead of the scenario's.
        log: takes lines for the operator.
        allow_arming: whether it may arm; otherwise a pilot arms.
        box_m: side of the box that the vehicle must not leave [m].

    Raises:
        TuneError: no result, with the reason.
    """
    folder = runtime_folder(environment.named_domain())
    if (held := latched(folder)).what:
        raise TuneError(
            f"the operator's order {held.text!r} still holds: expected none; ptnsbc stop --clear releases it"
        )
    settings = scenario.vehicle_link(uav)
    path = str(key or settings.signing_key or "")
    signer = Signer(read_key(Path(path))) if path else None
    clocks = Clocks(time.monotonic, time.time_ns)
    link = MavlinkLink(connect(settings.connect), settings.sysid, WANTED_MESSAGES, signer)
    with closing(link):
        test = HoverTest(scenario, uav, link, clocks, log, allow_arming=allow_arming, box_m=box_m)
        environment.prefer_punctuality()
        record = new_record(scenario, uav, str(Path(path).resolve()) if path else "")
        keeper = RecordKeeper(test.bridge, record, folder)
        port = OrderPort(folder, record.name, test.inputs.take, keeper.encode)
        try:
            with StopRequest() as request:
                while not test.over:
                    link.wait(_WAIT_S)
                    test.serve()
                    if request.count > 1:
                        raise KeyboardInterrupt
                    if request.came:
                        test.land()
                    keeper.keep()
            test.bridge.leave()
        finally:
            port.close()
            keeper.keep(ended=True)
    return test.identified()
