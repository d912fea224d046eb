"""Hover tests of the stand-ins: the response that is found, and everything that ends a test."""

import select
import signal
from types import SimpleNamespace

import pytest

pytest.importorskip("pymavlink")
pytest.importorskip("rclpy")

from mavlink_hover import HoverRig, HoverWorld

from ptnsbc_autopilot.faults import inject
from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_nodes.bridge import hover_test
from ptnsbc_nodes.bridge.identification import TuneError, settings
from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.emergency.orders import KILL, Order, OrderClient, latch
from ptnsbc_nodes.emergency.records import decode_record, record_path, records

# Gain and lag [s] at 0.1, 0.25 and 0.5 Hz by the truth, without a link: docs/autopilot.md, and its test.
TRUE = {
    "arducopter": ((0.96, 0.52), (1.11, 0.46), (0.88, 0.57)),
    "px4": ((0.69, 0.66), (0.58, 0.49), (0.42, 0.40)),
}


@pytest.mark.slow
@pytest.mark.parametrize("gnss", ["rtk", "quiet"])
@pytest.mark.parametrize("kind", TRUE)
def test_the_response_that_is_found_is_that_of_the_stand_in(kind, gnss):
    """Within 5 % of the gain, and 0.04 s of the lag, of which link and setpoint period are 0.01 to 0.03 s."""
    rig = HoverRig(kind, gnss=gnss).run()
    assert rig.test.bridge.procedure.step is Step.DONE, rig.lines[-8:]
    assert not rig.vehicle.armed
    found = rig.test.identified()
    assert [point.gain for point in found.points] == pytest.approx(
        [gain for gain, _ in TRUE[kind]], rel=0.05
    )
    assert [point.lag_s for point in found.points] == pytest.approx(
        [lag_s for _, lag_s in TRUE[kind]], abs=0.04
    )
    assert found.error < 0.06
    assert found.drag_1_s == pytest.approx(1.0 if kind == "px4" else 0.1, abs=0.1)
    assert settings(rig.scenario, found).kappa_1_s == pytest.approx(1.2)


def test_a_follower_is_tested_without_its_leader():
    rig = HoverRig("px4", uav=3).begun()
    assert rig.test.bridge.placement.text.startswith("(-")


def test_a_pilot_who_takes_over_keeps_the_vehicle():
    rig = HoverRig("px4").begun()
    inject(rig.vehicle, "mode", "POSCTL", rig.now_s)
    rig.run(4.0, until=lambda: rig.test.bridge.procedure.step is Step.YIELDED)
    assert rig.vehicle.armed
    assert rig.vehicle.mode_name == "POSCTL"
    with pytest.raises(TuneError, match="the pilot took over"):
        rig.test.points()


def test_the_operators_signal_lands_it():
    rig = HoverRig("arducopter").begun()
    rig.test.land()
    rig.run()
    assert rig.test.bridge.procedure.step is Step.DONE
    with pytest.raises(TuneError, match="the operator ended the test"):
        rig.test.points()


def test_the_operators_kill_stops_its_motors():
    rig = HoverRig("px4").begun()
    rig.test.inputs.take(Order(KILL))
    rig.run(2.0, until=lambda: not rig.vehicle.armed)
    with pytest.raises(TuneError, match="not completed"):
        rig.test.points()


def test_outside_its_box_it_lands():
    rig = HoverRig("px4", box_m=1.5).begun()
    inject(rig.vehicle, "jump", "0.9", rig.now_s)
    rig.run()
    assert rig.test.bridge.procedure.step in (Step.DONE, Step.FAILED)
    assert not rig.vehicle.armed
    with pytest.raises(TuneError, match="left its box"):
        rig.test.points()


@pytest.mark.slow
def test_at_the_fence_it_shows_nothing_and_outside_of_it_lands():
    rig = HoverRig("px4", **{"mavlink.geofence.box_max_m": [0.4, 8, 14]}).run()
    with pytest.raises(TuneError, match=r"setpoints were clamped \(fence\)"):
        rig.test.points()
    rig = HoverRig("px4", box_m=30.0).begun()
    inject(rig.vehicle, "jump", "9.5", rig.now_s)
    rig.run()
    assert not rig.vehicle.armed
    with pytest.raises(TuneError, match="outside the geofence"):
        rig.test.points()


def test_a_battery_that_is_low_lands_it():
    rig = HoverRig("arducopter").begun()
    inject(rig.vehicle, "battery", "0.1", rig.now_s)
    rig.run()
    with pytest.raises(TuneError, match="battery at 10 %"):
        rig.test.points()


@pytest.mark.parametrize("changes", [{}, {"mavlink.setpoint": "attitude"}])
def test_vehicles_that_take_attitudes_are_refused(changes):
    kind = "px4" if changes else "stm32"
    with pytest.raises(TuneError, match="expected setpoint: velocity"):
        HoverRig(kind, **changes)


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
        monkeypatch.setattr(hover_test, "time", clock)
        monkeypatch.setattr(hover_test, "connect", lambda _where: self.world.wire)
        monkeypatch.setattr(hover_test, "runtime_folder", lambda _domain: folder)
        monkeypatch.setattr(hover_test.environment, "prefer_punctuality", lambda: True)
        monkeypatch.setattr(MavlinkLink, "wait", lambda _link, _seconds: self._tick())

    def fly(self, box_m=3.0):
        """The reason why there is no result."""
        with pytest.raises(TuneError) as caught:
            hover_test.fly_hover_test(
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
