"""A hover test of one stand-in on a clock that only tests move, with real MAVLink bytes between both."""

from __future__ import annotations

from mavlink_fleet import BASE_NS, START_S, STEP_S, Wire

from ptnsbc_autopilot.launch import KINDS, Fleet, starts
from ptnsbc_autopilot.server import Codec
from ptnsbc_autopilot.vehicle import COMPANION
from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_nodes.bridge.bridge import WANTED_MESSAGES
from ptnsbc_nodes.bridge.hover_test import HoverTest
from ptnsbc_sim.scenario import load_scenario

NAMES = {"px4": "px4", "arducopter": "ardupilot", "stm32": "generic"}


class HoverWorld:
    """One vehicle, its wire, and the clock of both."""

    def __init__(self, kind, *, gnss="rtk", delay_s=0.005, uav=1, **overrides):
        low = {"mavlink.takeoff_height_m": 1.5}  # soon up, and soon down again
        changes = {"mavlink.autopilot": NAMES[kind], **low, **overrides}
        self.scenario = load_scenario("experiment_4", changes).bridged()
        self.now_s, self.lines = START_S, []
        start = starts(Fleet(None, self.scenario.source, gnss, 0.0, None, 1))[uav - 1]
        self.system, self.codec = start.system, Codec(start.system)
        self.vehicle = KINDS[kind](
            start.system, start.body, self.now_s, boot_time=0.1, say=self.lines.append
        )
        self.wire = Wire(lambda: self.now_s, delay_s)

    @property
    def now_ns(self):
        return BASE_NS + round((self.now_s - START_S) * 1e9)

    def tick(self):
        """Bytes both ways, and a step of the vehicle."""
        self.now_s += STEP_S
        for data in self.wire.due():
            for message in self.codec.decode(data):
                self._send(self.vehicle.handle(message, COMPANION, self.now_s))
        self._send(self.vehicle.step(self.now_s))

    def printed(self, text):
        """Whether a line for the operator has this text."""
        return any(text in line for line in self.lines)

    def _send(self, outgoing):
        for link, message in outgoing:
            if link == COMPANION:
                self.wire.put(self.codec.encode(message))


class HoverRig(HoverWorld):
    """The vehicle, and the hover test that flies it."""

    def __init__(self, kind, *, box_m=3.0, uav=1, **settings):
        super().__init__(kind, uav=uav, **settings)
        link = MavlinkLink(self.wire, self.system, WANTED_MESSAGES, None)
        self.test = HoverTest(
            self.scenario,
            uav,
            link,
            lambda: self.now_s,
            lambda: self.now_ns,
            self.lines.append,
            allow_arming=True,
            box_m=box_m,
        )

    def run(self, seconds=200.0, until=None):
        """Let time pass until the test is over, or `until` is true, which it must become."""
        end = self.now_s + seconds
        while self.now_s < end and not self.test.over:
            self.tick()
            self.test.serve()
            if until is not None and until():
                return self
        assert until is None and self.test.over, self.lines[-12:]
        return self

    def begun(self, after_s=3.0):
        """Until the sinusoids are flown for some seconds."""
        self.run(until=lambda: self.printed("hover test:"))
        begin_s = self.now_s
        return self.run(until=lambda: self.now_s > begin_s + after_s)
