"""Beginning together: everybody says when it is connected, and the sim waits for a file."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ptnsbc_nodes.comm.endpoints import Endpoints

READY = "ready"

_LOOK_S = 0.05


def when_ready(
    node: Node, endpoints: Endpoints, go: Path | None, begin: Callable[[], None]
) -> None:
    """Say that every topic has both ends; with `go` call `begin` when that file is there."""
    said = False

    def look() -> None:
        nonlocal said
        if not said and not endpoints.unheard() and not endpoints.unread():
            said = True
            print(READY, file=sys.stderr, flush=True)
        if said and (go is None or go.exists()):
            timer.cancel()
            begin()

    timer = node.create_timer(_LOOK_S, look, clock=Clock(clock_type=ClockType.STEADY_TIME))
