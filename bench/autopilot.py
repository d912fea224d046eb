"""Stand-in flight controllers: CPU of four in flight under a setpoint stream, and the speed of one without sockets."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from bench.launch import BenchError
from bench.session import Plan, print_progress
from bench.table import Row, Target
from bench.usage import look
from ptnsbc_autopilot.firmware.px4 import Px4
from ptnsbc_autopilot.physics.body import VehicleDescription
from ptnsbc_autopilot.server import Codec
from ptnsbc_io.mavlink.dialect import mavlink

_COUNT, _STREAM_HZ, _READY_S = 4, 50.0, 300.0
_VELOCITY_YAW = 0x09C7  # position, acceleration and yaw rate ignored
_CLIMB_S = 12.0


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
    share = [_fly(plan.of(20.0, 6.0)) for _ in range(plan.of(3, 1))]
    faster = [_fast(plan.of(30.0, 10.0)) for _ in range(plan.of(3, 1))]
    return [
        Row("autopilot, 4 PX4 flying at 50 Hz", share, "cores", target=Target(0.25)),
        Row("autopilot, one as an object", faster, "x real time"),
    ]


def _fly(seconds: float) -> float:
    """Cores that four vehicles need in the air."""
    print_progress("autopilot: four in the air")
    with socket.socket(type=socket.SOCK_DGRAM) as channel:
        channel.bind(("127.0.0.1", 0))
        port = channel.getsockname()[1] + 1
        goals = [("127.0.0.1", port + n) for n in range(_COUNT)]
        where = ("--connect", f"udpin:127.0.0.1:{port}")
        with stand_ins("--count", str(_COUNT), "--boot-time", "0", *where) as pid:
            _stream(channel, goals, _CLIMB_S)
            before = look(pid)
            _stream(channel, goals, seconds)
            after = look(pid)
    return (after.cpu_s - before.cpu_s) / (after.at - before.at)


@contextmanager
def stand_ins(*words: str) -> Iterator[int]:
    """Process id of four stand-ins that have opened their ports."""
    with tempfile.TemporaryFile("w+") as log:
        own = ("autopilot", *words, "--gcs", "", "--gnss", "rtk")
        child = subprocess.Popen(
            [sys.executable, "-m", "ptnsbc_tools.cli", *own],
            stderr=log,
            env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])},
        )
        try:
            _wait_ready(child, log)
            yield child.pid
        finally:
            child.send_signal(signal.SIGINT)
            child.wait()


def _wait_ready(child: subprocess.Popen[bytes], log: IO[str]) -> None:
    end = time.monotonic() + _READY_S
    while time.monotonic() < end and child.poll() is None:
        text = os.pread(log.fileno(), 1 << 16, 0).decode()
        if text.count(" udp ") == _COUNT:
            return
        time.sleep(0.05)
    raise BenchError("autopilot: it did not come up; try it by hand: ptnsbc autopilot")


def _stream(channel: socket.socket, goals: list[tuple[str, int]], seconds: float) -> None:
    """Setpoints that climb slowly, offboard and arming once a second."""
    codecs = [Codec(245, 191) for _ in goals]
    end, due, beat = time.monotonic() + seconds, time.monotonic(), 0
    while due < end:
        for system, (goal, codec) in enumerate(zip(goals, codecs, strict=True), 1):
            for message in _messages(system, beat):
                channel.sendto(codec.encode(message), goal)
        beat += 1
        due += 1.0 / _STREAM_HZ
        time.sleep(max(0.0, due - time.monotonic()))


def _messages(system: int, beat: int) -> list[mavlink.MAVLink_message]:
    frame = mavlink.MAV_FRAME_LOCAL_NED
    setpoint = mavlink.MAVLink_set_position_target_local_ned_message(
        0, system, 1, frame, _VELOCITY_YAW, 0, 0, 0, 0, 0, -0.3, 0, 0, 0, 0, 0
    )
    if beat % int(_STREAM_HZ):
        return [setpoint]
    long = mavlink.MAVLink_command_long_message
    mode = long(system, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, 1, 6, 0, 0, 0, 0, 0)
    arm = long(system, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
    return [setpoint, mode, arm]


def _fast(seconds: float) -> float:
    """Simulated seconds per second of one vehicle without sockets, messages packed."""
    vehicle, codec, t = Px4(1, VehicleDescription(), 0.0, boot_time=0.0), Codec(1), 0.0
    began = time.process_time()
    while t < seconds:
        t += 0.004
        for _, message in vehicle.step(t):
            codec.encode(message)
    return seconds / (time.process_time() - began)
