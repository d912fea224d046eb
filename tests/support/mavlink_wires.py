"""The other end of a link, for tests: real sockets, real bytes, and nothing that forgives."""

from __future__ import annotations

import math
import select
import socket
import time

from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import Signer


def codec(sysid=1, compid=1):
    return mavlink.MAVLink(None, srcSystem=sysid, srcComponent=compid)


def heartbeat(**changes):
    fields = {
        "type": mavlink.MAV_TYPE_QUADROTOR,
        "autopilot": mavlink.MAV_AUTOPILOT_PX4,
        "base_mode": mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
        "custom_mode": 0,
        "system_status": mavlink.MAV_STATE_STANDBY,
    }
    return mavlink.MAVLink_heartbeat_message(**{**fields, **changes}, mavlink_version=3)


def position(boot_ms, xyz=(0, 0, 0), v=(0, 0, 0)):
    return mavlink.MAVLink_local_position_ned_message(boot_ms, *xyz, *v)


def attitude(boot_ms, yaw_ned=0.0):
    half = 0.5 * yaw_ned
    q = (math.cos(half), 0.0, 0.0, math.sin(half))
    return mavlink.MAVLink_attitude_quaternion_message(boot_ms, *q, 0.1, 0.2, 0.3)


class Far:
    """A UDP socket that plays the vehicle."""

    def __init__(self, port=None, sysid=1, compid=1, key=None):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.to = ("127.0.0.1", port) if port else None
        self.codec = codec(sysid, compid)
        self.decoder = mavlink.MAVLink(None)
        self.signer = Signer(key) if key else None

    @property
    def port(self):
        return self.socket.getsockname()[1]

    def pack(self, message):
        if self.signer is not None:
            self.signer.prepare(self.codec)
        data = message.pack(self.codec)
        self.codec.seq = (self.codec.seq + 1) % 256
        return data

    def send(self, message):
        data = self.pack(message)
        self.raw(data)
        return data

    def raw(self, data):
        self.socket.sendto(data, self.to)

    def receive(self, timeout=2.0):
        """The next message, or None."""
        end = time.monotonic() + timeout
        while (left := end - time.monotonic()) > 0:
            if not select.select([self.socket], [], [], left)[0]:
                return None
            data, self.to = self.socket.recvfrom(65535)
            return self.decoder.decode(bytearray(data))
        return None

    def close(self):
        self.socket.close()


def arrived(link, count=1, now_s=0.0, timeout=2.0):
    """At least `count` accepted messages of a link, or what came until `timeout`."""
    messages, end = [], time.monotonic() + timeout
    while len(messages) < count and time.monotonic() < end:
        link.wait(0.05)
        messages += link.poll(now_s)
    return messages


def settled(link, now_s=0.0):
    """Everything that has been sent to a link so far, on loopback."""
    messages = []
    while select.select([link], [], [], 0.05)[0]:
        messages += link.poll(now_s)
    return messages
