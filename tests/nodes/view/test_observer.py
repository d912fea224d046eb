"""The health of processes that a test plays, as an observer hears it."""

import threading

import pytest

pytest.importorskip("rclpy")

from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.view.observer import Observer

pytestmark = pytest.mark.ros


def test_an_observer_names_who_is_silent_and_who_reports_an_error(ros):
    ends = Endpoints(ros.node("uav1"), lockstep=False)
    send, over = ends.publisher(topics.DIAGNOSTICS, 0), threading.Event()
    ros.node("recorder")

    def report():
        while not over.wait(0.05):
            send(diagnostics(0, "uav1: planner", DiagnosticLevel.WARN, "waits for uav2", {}))
            send(diagnostics(0, "uav2: planner", DiagnosticLevel.ERROR, "no odometry", {}))

    reporter = threading.Thread(target=report)
    reporter.start()
    try:
        with Observer(ros.domain, "", "health") as observer:
            assert observer.ailments(["uav1", "recorder"], 60.0) == {}
            found = observer.ailments(["uav1", "uav2", "uav3"], 2.0)
    finally:
        over.set()
        reporter.join()
    assert found == {"uav2": "no odometry", "uav3": "silent"}
