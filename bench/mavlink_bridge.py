"""The cost of a MAVLink bridge, and a million broken packets: `python -m bench.mavlink_bridge [--packets N]`.

The cost is that of the link, without ROS: 100 packets a second checked and decoded, as many setpoints packed
and sent, and the time from a packet that came in to the setpoint that answers it. What ROS and the
controller add is in `latency_*` of `bridgeN: link` on /diagnostics of every flight.
"""

from __future__ import annotations

import argparse
import random
import resource
import socket
import sys
import threading
import time

import numpy as np

from ptnsbc_io.mavlink.autopilots import PX4
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import MavlinkLink, Signer
from ptnsbc_io.mavlink.transport import Address, Packet, connect
from ptnsbc_nodes.bridge.bridge import WANTED_MESSAGES
from ptnsbc_nodes.bridge.vehicle_monitor import VehicleMonitor

_KEY = bytes(range(32))
_ARMED = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_SAFETY_ARMED
# Where the vehicle of the fuzzed link is, ENU and FLU, and what a state may stray from it: one step of noise.
_STILL = np.array(
    [2.0, 1.0, 3.0, 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5), 0.1, -0.2, -0.3, 0.1, -0.2, -0.3]
)
_NOISE = 1.1


class _Given:
    """A transport that brings what it is given."""

    stream = False

    def __init__(self) -> None:
        self.packets: list[bytes] = []

    def fileno(self) -> int:
        return -1  # no file: nobody waits for it

    def receive(self) -> Packet | None:
        return Packet(self.packets.pop(), ("127.0.0.1", 1)) if self.packets else None

    def send(self, data: bytes, address: Address | None) -> bool:
        return False  # nothing hears it

    def close(self) -> None:
        self.packets.clear()


def _traffic(signed: bool) -> list[bytes]:
    """Real packets of a vehicle with system id 1."""
    codec, signer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1), Signer(_KEY)
    frames = []
    for n in range(200):
        messages = (
            mavlink.MAVLink_local_position_ned_message(20 * n, 1, 2, -3, 0.1, 0.2, 0.3),
            mavlink.MAVLink_attitude_quaternion_message(20 * n, 1, 0, 0, 0, 0.1, 0.2, 0.3),
            mavlink.MAVLink_heartbeat_message(2, 12, 81, 6 << 16, 4, 3),
            mavlink.MAVLink_command_ack_message(400, 0),
            mavlink.MAVLink_timesync_message(n, n),
        )
        for message in messages:
            if signed:
                signer.prepare(codec)
            frames.append(message.pack(codec))
            codec.seq = (codec.seq + 1) % 256
    return frames


def _broken(rng: random.Random, frames: list[bytes]) -> bytes:
    kind = rng.random()
    if kind < 0.4:
        return rng.randbytes(rng.randint(1, 280))
    data = bytearray(rng.choice(frames))
    for _ in range(rng.randint(1, 6)):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data[: rng.randint(1, len(data))]) if kind < 0.6 else bytes(data)


class _Flight:
    """A vehicle in the air behind a link, and what of it broken packets have changed."""

    def __init__(self, signed: bool) -> None:
        self.given = _Given()
        self.link = MavlinkLink(self.given, 1, WANTED_MESSAGES, Signer(_KEY) if signed else None)
        self._vehicle = VehicleMonitor(PX4, signed=signed)
        self._now_s = 1000.0
        self.passed = self.affected = 0
        for _ in range(3):
            self.real()
        self._told = self._facts()

    def real(self) -> None:
        """The messages of the vehicle itself, on a link without faults: it stands still in the air."""
        boot_ms = round(1e3 * self._now_s)
        for message in (
            mavlink.MAVLink_attitude_quaternion_message(boot_ms, 1, 0, 0, 0, 0.1, 0.2, 0.3),
            mavlink.MAVLink_local_position_ned_message(boot_ms, 1, 2, -3, 0.1, 0.2, 0.3),
            mavlink.MAVLink_heartbeat_message(2, 12, _ARMED, 6 << 16, 4, 3),
        ):
            self._vehicle.on_message(message, self._now_s)
        self._now_s += 0.02

    def broken(self, packets: list[bytes]) -> float:
        """Feed broken packets, and after each that passes what is real; the time it took [s]."""
        self.given.packets = packets
        began = time.perf_counter()
        while self.given.packets:
            for message in self.link.poll(self._now_s):
                self.passed += 1
                sample = self._vehicle.on_message(message, self._now_s)
                strayed = sample is not None and np.abs(sample.odometry - _STILL).max() > _NOISE
                self.affected += strayed or self._facts() != self._told
                self.real()
        return time.perf_counter() - began

    def _facts(self) -> tuple[object, ...]:
        vehicle = self._vehicle
        return vehicle.mode, vehicle.armed, vehicle.landed, vehicle.rebooted, vehicle.wrong_vehicle


def fuzz(packets: int, signed: bool) -> None:
    """Feed broken packets; how many passed, how many changed anything, how fast, and how memory grew."""
    rng, frames = random.Random(1), _traffic(signed)
    known = set(frames)
    flight = _Flight(signed)
    spent, fed, settled_kb = 0.0, 0, 0
    while fed < packets:
        batch = [d for d in (_broken(rng, frames) for _ in range(10_000)) if d not in known]
        fed += len(batch)
        spent += flight.broken(batch)
        settled_kb = settled_kb or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        print(f"{fed} of {packets}", end="\r", file=sys.stderr)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - settled_kb
    counts = ", ".join(f"{name} {count}" for name, count in flight.link.counts.items() if count)
    what = "signed" if signed else "unsigned"
    print(
        f"fuzz {what}: {fed} packets, {flight.passed} with a right checksum, "
        f"{flight.affected} affected anything, {fed / spent:.0f}/s, memory +{grown} kB"
    )
    print(f"  {counts}")


def cost(seconds: float) -> None:
    """CPU of a link that takes 50 states a second in and sends 50 setpoints, and its turnaround."""
    port = _free_port()
    link = MavlinkLink(connect(f"udpin:127.0.0.1:{port}"), 1, WANTED_MESSAGES)
    frames = _traffic(signed=False)
    over = threading.Event()

    def vehicle() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            n = 0
            while not over.wait(0.01):  # position and attitude in turn, 50 Hz each
                stamped = mavlink.MAVLink_timesync_message(0, time.perf_counter_ns())
                codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
                sender.sendto(frames[5 * (n % 200) + n % 2], ("127.0.0.1", port))
                sender.sendto(stamped.pack(codec), ("127.0.0.1", port))
                n += 1

    thread = threading.Thread(target=vehicle, daemon=True)
    thread.start()
    late_ms, began_cpu, end = [], time.thread_time(), time.perf_counter() + seconds
    while time.perf_counter() < end:
        link.wait(0.02)
        for message in link.poll(time.monotonic()):
            if message.get_type() == "TIMESYNC":
                link.send(mavlink.MAVLink_set_position_target_local_ned_message(
                    0, 1, 1, 1, 0x09C7, 0, 0, 0, 1, 2, 3, 0, 0, 0, 0.5, 0))  # fmt: skip
                late_ms.append(1e-6 * (time.perf_counter_ns() - message.ts1))
    used = time.thread_time() - began_cpu
    over.set()
    thread.join()
    link.close()
    p50, p99 = np.percentile(late_ms, [50, 99])
    print(f"link: {100 * used / seconds:.1f} % of a core at {len(late_ms) / seconds:.0f} pairs/s")
    print(f"  packet in to setpoint out: p50 {p50:.2f} ms, p99 {p99:.2f} ms")


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--packets", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=5.0)
    arguments = parser.parse_args()
    cost(arguments.seconds)
    for signed in (False, True):
        fuzz(arguments.packets, signed)


if __name__ == "__main__":
    main()
