"""The process of a hover test: vehicle, clock and folder are those of the test, sockets and signals are real."""

import select
import signal
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("pymavlink")

from mavlink_hover import HoverWorld

from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_nodes.bridge.tuning import process
from ptnsbc_nodes.bridge.tuning.excitation import TuneError
from ptnsbc_nodes.emergency.orders import KILL, Order, OrderClient, latch
from ptnsbc_nodes.emergency.records import decode_record, record_path, records

PATIENCE_S = 30.0


class HoverProcess:
    """A flight of `fly_hover_test`; `at` is called once, soon after the sinusoids have begun."""

    def __init__(self, folder, monkeypatch):
        self.folder, self.world = folder, HoverWorld("px4", **{"mavlink.takeoff_height_m": 1.5})
        self.at, self._due_s = lambda: None, None
        self.during = []  # records, as they were when `at` was called
        clock = SimpleNamespace(
            monotonic=lambda: self.world.now_s, time_ns=lambda: self.world.now_ns
        )
        monkeypatch.setenv("ROS_DOMAIN_ID", "7")
        monkeypatch.setattr(process, "time", clock)
        monkeypatch.setattr(process, "connect", lambda _where: self.world.wire)
        monkeypatch.setattr(process, "runtime_folder", lambda _domain: folder)
        monkeypatch.setattr(process.environment, "prefer_punctuality", lambda: True)
        monkeypatch.setattr(MavlinkLink, "wait", lambda _link, _seconds: self._tick())

    def fly(self, box_m=3.0):
        """The reason why there is no result."""
        with pytest.raises(TuneError) as caught:
            process.fly_hover_test(
                self.world.scenario,
                1,
                None,
                self.world.lines.append,
                allow_arming=True,
                box_m=box_m,
            )
        return str(caught.value)

    def ask(self, order):
        """The record with which the process answers an order."""
        client = OrderClient(self.folder)
        try:
            assert client.send("bridge1", order)
            assert select.select([client], [], [], PATIENCE_S)[0]
            return decode_record(client.answers()[0])
        finally:
            client.close()

    def _tick(self):
        self.world.tick()
        if self._due_s is None and self.world.printed("hover test:"):
            self._due_s = self.world.now_s + 0.5
        if self._due_s is not None and self.world.now_s > self._due_s:
            self._due_s = float("inf")
            self.during = list(records(self.folder))
            self.at()


@pytest.fixture
def hover(tmp_path, monkeypatch):
    return HoverProcess(tmp_path, monkeypatch)


def test_the_first_signal_lands_the_vehicle_and_its_record_outlives_the_process(hover):
    hover.at = lambda: signal.raise_signal(signal.SIGINT)
    assert "the operator ended the test" in hover.fly()
    assert not hover.world.vehicle.armed
    for _ in range(5):
        hover.world.tick()
    assert hover.world.vehicle.mode_name == "HOLD"  # in OFFBOARD it would arm at once the next time
    (flying,), (after,) = hover.during, records(hover.folder)
    assert (flying.name, flying.armed, flying.mode, flying.ended) == (
        "bridge1", True, "OFFBOARD", False,
    )  # fmt: skip
    assert (after.armed, after.ended) == (False, True)


def test_the_second_signal_ends_it_at_once_and_leaves_word_of_the_vehicle(hover):
    def twice():
        assert hover.ask(Order()).armed  # a question by the socket
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)

    hover.at = twice
    with pytest.raises(KeyboardInterrupt):
        hover.fly()
    (after,) = records(hover.folder)
    assert (after.armed, after.ended) == (True, True)
    assert hover.world.vehicle.armed


def test_the_operators_kill_reaches_it_by_the_socket(hover):
    answers = []
    hover.at = lambda: answers.append(hover.ask(Order(KILL)))
    hover.fly()
    assert not hover.world.vehicle.armed
    assert (answers[0].name, answers[0].armed) == ("bridge1", True)
    assert hover.world.printed("failed: motors stopped by the operator")


def test_an_order_that_still_holds_is_refused_before_anything_is_opened(hover):
    latch(hover.folder, Order(KILL))
    assert "ptnsbc stop --clear releases it" in hover.fly()
    assert not record_path(hover.folder, "bridge1").exists()


def test_a_test_that_cannot_be_flown_closes_its_link(hover, monkeypatch):
    closed = []
    monkeypatch.setattr(hover.world.wire, "close", lambda: closed.append(True))
    assert "--box 0.1: expected at least" in hover.fly(box_m=0.1)
    assert closed == [True]
