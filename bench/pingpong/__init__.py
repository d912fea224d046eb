"""The reference of every fleet: the same processes, topics, sizes, QoS and executor, and nothing else.

A process of this package publishes prebuilt messages of which it changes the stamp, and reads the stamp of
what it hears. No laws, no bag. With `--typed` messages are objects, as in any rclpy program; without, they
are bytes that nobody decodes, and a fleet cannot be faster than that.
"""

from bench.pingpong.ready import READY, when_ready
from bench.pingpong.wires import Send, sender

__all__ = ["READY", "Send", "sender", "when_ready"]
