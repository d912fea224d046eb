"""ROS in tests: a domain of our own, and a context, executor and nodes that go away afterwards."""

from __future__ import annotations

import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator

import pytest

# Before any message class is imported: Jazzy's field checks are off otherwise.
os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

from ptnsbc_nodes.runtime import environment

environment.prepare()


@pytest.fixture(autouse=True)
def _own_signal_handlers() -> Iterator[None]:
    """The `main` of a process leaves its handlers installed; a test run keeps its own."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What flies in real time is not flown by one of several workers."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return
    beside = pytest.mark.skip(reason="needs the machine for itself: pytest -m alone, without -n")
    for item in items:
        if "alone" in item.keywords:
            item.add_marker(beside)


@pytest.fixture(scope="session")
def domain() -> Iterator[int]:
    """A domain that nobody beside us takes. Not ROS_DOMAIN_ID: a fleet may be flying there."""
    with environment.free_domain() as number:
        yield number


class Ros:
    """One context with one executor."""

    def __init__(self, domain: int) -> None:
        import rclpy

        from ptnsbc_nodes.runtime.node_process import make_executor

        self.domain = domain
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.executor = make_executor(self.context)
        self._nodes = []

    def node(self, name: str, **options):
        import rclpy

        return self.adopt(rclpy.create_node(name, context=self.context, **options))

    def adopt(self, node):
        """Serve a node that was made with our context, and take it away at the end."""
        self._nodes.append(node)
        self.executor.add_node(node)
        return node

    def remove(self, node) -> None:
        """Take a node away before the end of the test."""
        self._nodes.remove(node)
        self.executor.remove_node(node)
        # The EventsExecutor lets go of a node only when it runs the next time.
        self.spin_for(0.01)
        node.destroy_node()

    def spin_for(self, seconds: float) -> None:
        """Serve callbacks for a while: where nothing must come, there is nothing to wait for."""
        from rclpy.task import Future

        self.executor.spin_until_future_complete(Future(), timeout_sec=seconds)

    def spin_until(self, condition: Callable[[], object], timeout: float = 60.0) -> None:
        """Serve callbacks until `condition()` is true."""
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(f"not within {timeout} s: {condition}")
            self.spin_for(0.02)

    def close(self) -> None:
        import rclpy

        for node in list(self._nodes):
            self.remove(node)
        self.executor.shutdown()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def ros(domain) -> Iterator[Ros]:
    pytest.importorskip("rclpy")
    instance = Ros(domain)
    yield instance
    instance.close()


@pytest.fixture
def sent(monkeypatch) -> Counter[str]:
    """The number of messages that the nodes of this process have published, by topic."""
    from ptnsbc_nodes.comm.endpoints import Endpoints

    counts, publisher = Counter(), Endpoints.publisher

    def counting(self, topic, readers):
        send = publisher(self, topic, readers)

        def count(data):
            counts[topic.name] += 1
            send(data)

        return count

    monkeypatch.setattr(Endpoints, "publisher", counting)
    return counts


@pytest.fixture
def launch(tmp_path):
    """Starts fleets in lock-step as processes of their own; none is left behind."""
    from launched_fleet import Launched

    launched = []

    def start(*arguments: str, domain: int | None = None) -> Launched:
        log_dir = tmp_path / f"logs{len(launched)}"
        launched.append(Launched(log_dir, *arguments, domain=domain))
        return launched[-1]

    yield start
    for fleet in launched:
        if fleet.process.poll() is None:
            fleet.process.kill()
            fleet.process.wait()
