"""The common part of every node process: arguments, one rclpy node, one thread, an orderly end."""

from __future__ import annotations

import argparse
import gc
import math
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.runtime import environment, launcher
from ptnsbc_nodes.runtime.node_parameters import fix_parameters
from ptnsbc_nodes.runtime.provenance import add_version
from ptnsbc_nodes.runtime.signals import install_handler, keep_exit_code

if TYPE_CHECKING:
    from ptnsbc_nodes.comm.graph import FlightOptions
    from ptnsbc_sim.scenario import Scenario

USER_ERROR = 2
FLUSH_S = 5.0  # half of what the launcher waits; a recorder that is busy is seconds behind
_SIGNAL_CHECK_S = 0.2
_LEAST_REST_S = 0.0002  # a timer that is due takes as long to say so
TEARDOWN_S = 20.0  # a launcher kills after 13 s
_OWN_PROCESS: list[bool] = []  # not empty: `run` is all that this process does


class RosArgumentsError(PtnsbcError):
    """Arguments after --ros-args that rclpy refuses."""


class Arguments(argparse.ArgumentParser):
    """Arguments of a node besides those of ROS; a wrong one is refused in one line."""

    def __init__(self, name: str, description: str) -> None:
        super().__init__(prog=name, description=description)
        add_version(self)
        self.add_argument("--scenario", required=True, help="scenario file, or name of a built-in")
        self.add_argument(
            "--set",
            dest="settings",
            metavar="KEY=VALUE",
            action="append",
            default=[],
            help="another value of the scenario, in all processes the same; repeatable",
        )
        self.add_argument("--lockstep", action="store_true", help="tick with the simulation")
        self.add_argument(
            "--recorded", action="store_true", help="be ready only when a recorder listens"
        )
        self.add_argument(
            "--bridged", action="store_true", help="flight controllers fly, there is no sim"
        )

    def error(self, message: str) -> NoReturn:
        """Print one line and exit with 2."""
        print(f"{self.prog}: {message}", file=sys.stderr)
        raise SystemExit(USER_ERROR)


def flown(arguments: argparse.Namespace, keys: Mapping[str, Any] | None = None) -> Scenario:
    """The scenario of `Arguments`, with more values by dotted key; None leaves a value as it is."""
    from ptnsbc_sim.scenario import load_scenario
    from ptnsbc_sim.scenario.reading.reader import set_keys

    scenario = load_scenario(arguments.scenario, {**set_keys(arguments.settings), **(keys or {})})
    return scenario.bridged() if arguments.bridged else scenario


def options_of(
    scenario: Scenario, *, lockstep: bool = False, recorded: bool = False, bridged: bool = False
) -> FlightOptions:
    """The options of a flight; a PtnsbcError where its security cannot be had."""
    from ptnsbc_nodes.comm.graph import FlightOptions
    from ptnsbc_nodes.comm.seal import seal_of

    return FlightOptions(lockstep, recorded, bridged, seal_of(scenario))


def run(
    parser: argparse.ArgumentParser,
    argv: Sequence[str] | None,
    body: Callable[[argparse.Namespace, list[str]], int],
) -> int:
    """Parse and run `body(arguments, argv)`, which returns the exit code; a user's error is one line and exit 2.

    `parser` is of the arguments that are not ROS's; `argv` are those of the process by default.
    """
    full = list(sys.argv if argv is None else (parser.prog, *argv))
    if argv is None:
        _OWN_PROCESS.append(True)
    try:
        environment.prepare()
        with ros_errors():
            own = remove_ros_args(full)[1:]
        code = body(parser.parse_args(own), full)
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


def make_executor(context: Context) -> Executor:
    """The executor of a node process: it takes a quarter of what the SingleThreadedExecutor does for an Odometry."""
    return EventsExecutor(context=context)


class BoundedSpin:
    """Calls of an executor that end in time, however many messages wait.

    The EventsExecutor looks at its timeout only when its queue is empty. A node that receives more than it can
    take in would never return from such a call, and would never see the signal that ends it.
    """

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self._over = Future()
        self._end = math.inf

    def serve(self, seconds: float, longest_s: float = 0.0) -> bool:
        """Serve callbacks for a while, and what waits then until `longest_s`; returns whether more may wait."""
        self._over, self._end = Future(), time.monotonic() + max(seconds, longest_s)
        self._executor.spin_until_future_complete(self._over, timeout_sec=seconds)
        self._end = math.inf  # a later word of this call would end another one
        return self._over.done()

    def look(self) -> None:
        """Callbacks call this: it ends a call whose time is over."""
        if time.monotonic() >= self._end:
            self._end = math.inf
            self._over.set_result(None)

    def drain(self, received: Callable[[], int], quiet_s: float, limit_s: float) -> None:
        """Take in what is still in the queues: until nothing more is `received` for a while, or the limit."""
        end, before = time.monotonic() + limit_s, -1
        while received() != before and time.monotonic() < end:
            before = received()
            self.serve(quiet_s)


def report_finished(summary: str) -> None:
    """Report to the launcher, if there is one, that this process has finished its work, and with what result.

    A process may still hang after this, in the shutdown of the middleware, which keeps Python's lock: no handler and no
    thread of ours runs then, and the system's timer ends the process.
    """
    if _OWN_PROCESS:
        signal.setitimer(signal.ITIMER_REAL, TEARDOWN_S)
    launcher.report_finished(summary)


class ProcessLifetime:
    """From the start of a process to SIGINT, SIGTERM or its own end.

    It replaces rclpy's signal handlers: those shut the context down at once, and the last messages of a
    flight could not be waited for.
    """

    def __init__(self) -> None:
        self._done = Future()
        self._signalled = False
        install_handler(self._on_signal)

    def end(self, summary: str = "") -> None:
        """Leave after the running callback; `summary`: the result of the work, for the launcher."""
        if not self._done.done():
            self._done.set_result(summary)

    @property
    def over(self) -> bool:
        """True if a signal has come, or `end` was called."""
        return self._signalled or self._done.done()

    def serve(
        self,
        nodes: Sequence[Node],
        endpoints: Callable[[], Sequence[Endpoints]],
        rest_s: Callable[[], float | None] | None = None,
    ) -> None:
        """Run callbacks of the nodes of this process until the end; then let readers catch up.

        `endpoints` are asked for at the end. `rest_s` is for a node that uses its messages at ticks only: after a tick
        the time [s] until the next one, for which messages wait, and None after other callbacks. So messages come all
        at once, and do not wake the process one by one.
        """
        context = nodes[0].context
        executor: Any = make_executor(context)
        for node in nodes:
            executor.add_node(node)
        gc.collect()
        gc.freeze()  # no collection in flight looks at what was made until now
        launcher.report_running()
        while not self.over and context.ok():
            # Python sees a signal only between two calls.
            if rest_s is None:
                executor.spin_until_future_complete(self._done, timeout_sec=_SIGNAL_CHECK_S)
                continue
            # One callback. The other function leaves 32 bytes behind (rclpy 7.1): too much for one call in each tick.
            executor.spin_once(timeout_sec=_SIGNAL_CHECK_S)
            until_tick_s = rest_s()
            if until_tick_s is not None:
                time.sleep(min(max(until_tick_s, _LEAST_REST_S), _SIGNAL_CHECK_S))
        served = endpoints()
        for each in served:
            each.last_word()
        limit_s = time.monotonic() + FLUSH_S
        for each in served:
            each.flush(max(limit_s - time.monotonic(), 0.0))
        report_finished(self._done.result() or "")
        executor.shutdown()

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self._signalled = True


@contextmanager
def ros_context(
    argv: Sequence[str], context: Context | None = None, domain: int | None = None
) -> Iterator[None]:
    """Inside the `with` nodes can be made; they have the remappings and parameters of `argv`."""
    no = SignalHandlerOptions.NO
    with ros_errors():
        rclpy.init(args=list(argv), context=context, domain_id=domain, signal_handler_options=no)
    try:
        yield
    finally:
        rclpy.try_shutdown(context=context)


@contextmanager
def plain_node(
    name: str, argv: Sequence[str] = (), namespace: str = "", domain: int | None = None
) -> Iterator[tuple[Node, Executor]]:
    """A node without services and its executor, in a context of its own, which `argv` and `domain` are for."""
    context = Context()
    with ros_context(argv, context, domain):
        node = rclpy.create_node(
            name,
            namespace=namespace,
            context=context,
            start_parameter_services=False,
            enable_rosout=False,
        )
        executor = make_executor(context)
        executor.add_node(node)
        try:
            yield node, executor
        finally:
            executor.shutdown()
            node.destroy_node()


@contextmanager
def ros_node(name: str, namespace: str, scenario: Scenario | None = None) -> Iterator[Node]:
    """One node in a context that is there.

    With a `scenario` it has the parameters of `fix_parameters`; without one it has none of the services that slow down
    each tick.
    """
    told = scenario is not None
    node = rclpy.create_node(
        name,
        namespace=namespace,
        start_parameter_services=told,
        automatically_declare_parameters_from_overrides=told,
    )
    try:
        if scenario is not None:
            fix_parameters(node, scenario)
        yield node
    finally:
        node.destroy_node()
