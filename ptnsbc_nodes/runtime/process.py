"""The common part of every node process: arguments, one rclpy node, one thread, an orderly end."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, NoReturn, Protocol

import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime import environment, memory
from ptnsbc_nodes.runtime.executor import make_executor
from ptnsbc_nodes.runtime.lifecycle_node import ManagedNode
from ptnsbc_nodes.runtime.provenance import add_version
from ptnsbc_nodes.runtime.signals import install_handler, keep_exit_code

USER_ERROR = 2
RUNNING = "running"
"""The line that a process writes into its log once it has loaded everything and serves its node."""
FLUSH_S = 5.0  # half of what the launcher waits; a recorder that is busy is seconds behind
_SIGNAL_CHECK_S = 0.2
_LEAST_REST_S = 0.0002  # a timer that is due takes as long to say so
TEARDOWN_S = 20.0  # a launcher kills after 13 s
_OWN_PROCESS: list[bool] = []  # not empty: `run` is all that this process does


class RosArgumentsError(PtnsbcError):
    """Arguments after --ros-args that rclpy refuses."""


class Arguments(argparse.ArgumentParser):
    """Arguments of a node besides those of ROS; a wrong one is refused in one line."""

    def __init__(self, name: str, description: str, *, scenario: bool = True) -> None:
        super().__init__(prog=name, description=description)
        add_version(self)
        self.add_argument(
            "--scenario", required=scenario, help="scenario file, or name of a built-in"
        )
        self.add_argument("--lockstep", action="store_true", help="tick with the simulation")
        self.add_argument(
            "--recorded", action="store_true", help="be ready only when a recorder listens"
        )
        self.add_argument(
            "--bridged", action="store_true", help="flight controllers fly, there is no sim"
        )
        self.add_argument(
            "--punctual",
            action="store_true",
            help="run before all that does not fly, where allowed",
        )

    def error(self, message: str) -> NoReturn:
        """Print one line and exit with 2."""
        print(f"{self.prog}: {message}", file=sys.stderr)
        raise SystemExit(USER_ERROR)


def run(
    parser: argparse.ArgumentParser,
    argv: Sequence[str] | None,
    body: Callable[[argparse.Namespace, list[str]], int],
    *,
    laws: bool = True,
) -> int:
    """Parse and run `body(arguments, argv)`; a user's error is one line on stderr and exit 2.

    Args:
        parser: Of the arguments that are not ROS's.
        argv: The arguments, those of the process by default.
        body: Returns the exit code.
        laws: Whether the process computes the compiled laws.
    """
    full = list(sys.argv if argv is None else (parser.prog, *argv))
    if argv is None:
        _OWN_PROCESS.append(True)
    try:
        environment.prepare()
        arguments = parser.parse_args(without_ros(full[1:]))
        if laws:
            from ptnsbc_nodes.runtime.warmup import spare_linear_algebra

            spare_linear_algebra()
        code = body(arguments, full)
    except PtnsbcError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        code = USER_ERROR
    keep_exit_code(code)
    return code


@contextmanager
def ros_errors() -> Iterator[None]:
    """Complaints of rclpy about arguments inside the `with`, as RosArgumentsError in one line."""
    try:
        yield
    except RuntimeError as error:  # the only class that they have in common
        line = " ".join(str(error).split()).partition(", at /")[0]
        raise RosArgumentsError(line) from None


def without_ros(arguments: Sequence[str]) -> list[str]:
    """The arguments of the program itself.

    Raises:
        RosArgumentsError: ROS does not understand one of the others.
    """
    with ros_errors():
        own: list[str] = remove_ros_args(["program", *arguments])[1:]
    return own


def namespace_of(uav: int | None) -> str:
    """The namespace of a UAV's nodes, inside the namespace of the fleet."""
    return "" if uav is None else f"/uav{uav}"


def report_finished(summary: str) -> None:
    """Tell the launcher, if there is one, that this process has finished its work, and with what result.

    A process may still hang after this, in the shutdown of the middleware, which keeps Python's lock: no handler and no
    thread of ours runs then, and the system's timer ends the process.
    """
    if _OWN_PROCESS:
        signal.setitimer(signal.ITIMER_REAL, TEARDOWN_S)
    descriptor = os.environ.pop(environment.REPORT, None)
    if descriptor is not None:
        with suppress(OSError), os.fdopen(int(descriptor), "w") as pipe:  # the launcher may be gone
            pipe.write(f"{summary}\n")


class _Endpoints(Protocol):
    @property
    def last_word(self) -> Callable[[], None]: ...

    def flush(self, timeout_s: float) -> None: ...


class ProcessLifetime:
    """From the start of a process to SIGINT, SIGTERM or its own end.

    It replaces rclpy's signal handlers: those shut the context down at once, and the last messages of a
    flight could not be waited for.
    """

    def __init__(self) -> None:
        self._done = Future()
        self._signalled = False
        install_handler(self._on_signal)

    def end(self) -> None:
        """Leave after the running callback."""
        if not self._done.done():
            self._done.set_result(None)

    @property
    def over(self) -> bool:
        """True if a signal has come, or `end` was called."""
        return self._signalled or self._done.done()

    def serve(
        self,
        node: Node,
        endpoints: _Endpoints,
        others: Sequence[ManagedNode] = (),
        rest_s: Callable[[], float | None] | None = None,
    ) -> None:
        """Run callbacks of a node, and of others in its process, until the end; then let readers catch up.

        Args:
            node: Served.
            endpoints: Of `node`.
            others: Served beside it.
            rest_s: For a node that uses its messages at ticks only: after a tick the time [s] until the next one, for
                which messages wait, and None after other callbacks. So messages come all at once, and do not wake the
                process one by one.
        """
        executor: Any = make_executor(node.context)
        for one in (node, *others):
            executor.add_node(one)
        memory.settle()
        print(RUNNING, flush=True)
        while not self.over and node.context.ok():
            # Python sees a signal only between two calls.
            if rest_s is None:
                executor.spin_until_future_complete(self._done, timeout_sec=_SIGNAL_CHECK_S)
                continue
            # One callback. The other function leaves 32 bytes behind (rclpy 7.1): too much for one call in each tick.
            executor.spin_once(timeout_sec=_SIGNAL_CHECK_S)
            until_tick_s = rest_s()
            if until_tick_s is not None:
                time.sleep(min(max(until_tick_s, _LEAST_REST_S), _SIGNAL_CHECK_S))
        served = (endpoints, *others)
        for each in served:
            each.last_word()
        limit_s = time.monotonic() + FLUSH_S
        for each in served:
            each.flush(max(limit_s - time.monotonic(), 0.0))
        report_finished("")
        executor.shutdown()

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self._signalled = True


@contextmanager
def ros_context(argv: Sequence[str]) -> Iterator[None]:
    """Inside the `with` nodes can be made; they have the remappings and parameters of `argv`."""
    with ros_errors():
        rclpy.init(args=list(argv), signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield
    finally:
        rclpy.try_shutdown()


@contextmanager
def ros_node(
    name: str, namespace: str, argv: Sequence[str], make: Any = rclpy.create_node, **options: Any
) -> Iterator[Any]:
    """One rclpy node, made by `make`, without the services that slow down each tick."""
    with ros_context(argv), _made(name, namespace, make, **options) as node:
        yield node


@contextmanager
def parameter_node(
    name: str,
    namespace: str,
    argv: Sequence[str],
    overrides: Sequence[Parameter],
    make: Any = rclpy.create_node,
) -> Iterator[Any]:
    """A node that has declared every parameter it was given; `NodeParameters` reads them."""
    with ros_context(argv), node_with_parameters(name, namespace, overrides, make) as node:
        yield node


@contextmanager
def node_with_parameters(
    name: str, namespace: str, overrides: Sequence[Parameter], make: Any
) -> Iterator[Any]:
    """As `parameter_node`, in a context that is there: a process may have several."""
    options = {
        "start_parameter_services": True,
        "parameter_overrides": list(overrides),
        "automatically_declare_parameters_from_overrides": True,
    }
    with _made(name, namespace, make, **options) as node:
        yield node


@contextmanager
def _made(name: str, namespace: str, make: Any, **options: Any) -> Iterator[Any]:
    node = make(name, namespace=namespace, **{"start_parameter_services": False, **options})
    try:
        yield node
    finally:
        node.destroy_node()


def serve_managed(
    node: ManagedNode,
    lifetime: ProcessLifetime,
    *,
    autostart: bool,
    others: Sequence[ManagedNode] = (),
) -> int:
    """Serve a managed node, and others, until the end of their process; returns the exit code."""
    nodes = (node, *others)
    if autostart:
        for one in nodes:
            one.autostart()
    lifetime.serve(node, node, others)
    for one in nodes:
        one.finish()
    return int(any(one.broken for one in nodes))
