"""Running a node until SIGINT or SIGTERM, with the executor that costs least.

The EventsExecutor receives an Odometry for a quarter of what the SingleThreadedExecutor takes.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import cache
from importlib.metadata import PackageNotFoundError, version

from rclpy.context import Context
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.task import Future

_FOREVER = 1000.0  # [s]; only how long one call lasts, the loop goes on


def make_executor(context: Context) -> Executor:
    """The executor of a node process."""
    return EventsExecutor(context=context)


def spin(executor: Executor, context: Context) -> None:
    """Serve callbacks until the context is shut down, which rclpy's signal handlers do."""
    try:
        if not _from_wheels():
            executor.spin()
            return
        # In the wheels EventsExecutor.spin() is a busy loop that does not notice the shutdown.
        while context.ok():
            executor.spin_until_future_complete(Future(), timeout_sec=_FOREVER)
    except (ExternalShutdownException, KeyboardInterrupt):
        return


class BoundedSpin:
    """Callbacks served for a while at a time, and hardly longer however many messages wait.

    The EventsExecutor looks at its timeout only when its queue is empty. Who listens to more than it can
    take in would never come back from a call of it, and never see the signal that ends it.
    """

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self._over = Future()
        self._end = math.inf

    def serve(self, seconds: float) -> None:
        """Serve callbacks for a while."""
        self._over, self._end = Future(), time.monotonic() + seconds
        self._executor.spin_until_future_complete(self._over, timeout_sec=seconds)

    def look(self) -> None:
        """To be called by callbacks: the last one of a slice whose time is over."""
        if time.monotonic() >= self._end:
            self._end = math.inf
            self._over.set_result(None)

    def drain(self, received: Callable[[], int], quiet_s: float, limit_s: float) -> None:
        """Take in what is still in the queues: until nothing more is `received` for a while, or the limit."""
        end, before = time.monotonic() + limit_s, -1
        while received() != before and time.monotonic() < end:
            before = received()
            self.serve(quiet_s)


@cache
def _from_wheels() -> bool:
    """Whether rclpy is the wheel `ros-rclpy`; apt's distribution is named `rclpy`."""
    try:
        version("ros-rclpy")
    except PackageNotFoundError:
        return False
    return True
