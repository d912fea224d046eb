"""A flight procedure with a vehicle of a few lines, without waiting."""

from __future__ import annotations

from dataclasses import replace

from ptnsbc_io.mavlink.autopilots import PX4
from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_nodes.bridge.procedure.procedure import Procedure
from ptnsbc_nodes.bridge.procedure.steps import (
    CommandRequest,
    Step,
    Stream,
    VehicleSnapshot,
)

DT = 0.05


HEIGHT = 3.0


class Flight:
    """A procedure, and a vehicle that obeys it until a test changes that."""

    def __init__(self, autopilot=PX4, allow_arming=True, away_s=0.0):
        self.lines = []
        self.procedure = Procedure(autopilot, HEIGHT, allow_arming, self.lines.append, away_s)
        self.autopilot = autopilot
        self.snapshot = VehicleSnapshot(
            now_s=0.0,
            heartbeat_age_s=0.1,
            parameters_read=True,
            controller_age_s=0.05,
            controller_ready=True,
            mode=FlightMode.HOLD,
            mode_name="4",
            landed=True,
        )
        self.history = []  # (time, step, output)
        self.ignored = set()  # commands that the vehicle ignores
        self.obeys = True

    @property
    def step(self):
        return self.procedure.step

    def run(self, seconds=1000.0, until=None, **changes):
        """Let time pass with `changes` in the snapshot, until a step or for some seconds."""
        self.snapshot = replace(self.snapshot, **changes)
        end = self.snapshot.now_s + seconds
        while self.snapshot.now_s < end and self.step is not until:
            output = self.procedure.advance(self.snapshot)
            self.history.append((self.snapshot.now_s, self.step, output))
            self.snapshot = replace(self.snapshot, now_s=self.snapshot.now_s + DT)
            if self.obeys:
                self._obey(output)
        if until is not None:
            assert self.step is until, self.lines
        return self

    def _obey(self, output):
        new = {}
        command = None if output.command in self.ignored else output.command
        if command is CommandRequest.OWN_MODE:
            new["mode"] = FlightMode.OWN
        elif command is CommandRequest.ARM:
            new["armed"] = True
        elif command is CommandRequest.LAND:
            new["mode"] = FlightMode.LAND
        elif command in (CommandRequest.DISARM, CommandRequest.KILL):
            new["armed"] = False
        climbing = command is CommandRequest.TAKEOFF or output.stream is Stream.CLIMB
        if self.snapshot.armed and climbing:
            new.update(height_m=HEIGHT, landed=False)
        if self.snapshot.mode is FlightMode.LAND and self.snapshot.armed:
            height = self.snapshot.height_m - 0.7 * DT
            new["height_m"] = max(height, 0.0)
            new.update({"landed": True, "armed": False} if height < 0.0 else {})
        self.snapshot = replace(self.snapshot, **new)

    def streams(self, since_s=0.0):
        return {output.stream for t, _, output in self.history if t >= since_s}

    def requested(self, since_s=0.0):
        return [output.command for t, _, output in self.history if output.command and t >= since_s]

    def flying(self):
        return self.run(until=Step.AIRBORNE).run(until=Step.FLY, leg="form").run(1.0)
