"""A node process ends on SIGINT and on SIGTERM, quickly and with exit code 0."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

NODE = textwrap.dedent(
    """
    from ptnsbc_nodes.runtime import environment
    environment.prepare()
    import rclpy
    from ptnsbc_nodes.runtime.executor import make_executor, spin
    rclpy.init()
    context = rclpy.get_default_context()
    node = rclpy.create_node("spinner")
    executor = make_executor(context)
    executor.add_node(node)
    node.create_timer(0.05, lambda: print("tick", flush=True))
    spin(executor, context)
    print("end", flush=True)
    """
)


@pytest.mark.ros
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_ends_on_signal(domain, how):
    process = subprocess.Popen(
        [sys.executable, "-c", NODE],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[3],
        env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "tick\n"
    before = time.monotonic()
    process.send_signal(how)
    out, _ = process.communicate(timeout=10)
    assert process.returncode == 0
    assert out.endswith("end\n")
    assert time.monotonic() - before < 5.0


@pytest.mark.ros
def test_waits_without_burning_the_processor(domain):
    """EventsExecutor.spin() of the wheels is a busy loop; ours must not be."""
    code = NODE.replace("0.05", "0.5") + "import time; print(time.process_time(), flush=True)\n"
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[3],
        env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
    )
    assert process.stdout is not None
    for _ in range(5):
        process.stdout.readline()
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate(timeout=10)
    # Start included, which takes about 0.7 s; a busy loop would add the 2.5 s of waiting.
    assert float(out.split()[-1]) < 2.0


@pytest.mark.ros
def test_a_slice_ends_although_more_is_waiting(ros):
    """A recorder that is behind must see the signal that ends it, and take in the rest for so long at most."""
    from rclpy.duration import Duration
    from std_msgs.msg import Empty

    from ptnsbc_nodes.runtime.executor import BoundedSpin

    node, slices, heard = ros.node("behind"), BoundedSpin(ros.executor), []

    def hear(message):
        heard.append(message)
        slices.look()

    node.create_subscription(Empty, "many", hear, 100)
    publisher = node.create_publisher(Empty, "many", 100)
    ros.spin_until(publisher.get_subscription_count)
    ros.spin_for(
        0.01
    )  # what has come before the executor knows the subscription is one event to it
    for _ in range(100):
        publisher.publish(Empty())
    assert publisher.wait_for_all_acked(Duration(seconds=5))
    slices.serve(0.0)
    assert len(heard) < 100
    slices.drain(lambda: len(heard), quiet_s=0.2, limit_s=10.0)
    assert len(heard) == 100
