"""Hover tests of the stand-ins: the response that is found, and everything that ends a test."""

import math
import select
import signal
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("pymavlink")
pytest.importorskip("rclpy")

from mavlink_hover import HoverRig, HoverWorld

from ptnsbc_autopilot.fault_lines import inject
from ptnsbc_core.types import PROFILE_SOFT, LoopGain
from ptnsbc_io.mavlink.autopilots import VelocityResponse
from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_nodes.bridge import bridge, hover_test
from ptnsbc_nodes.bridge.hover_test import (
    Excitation,
    FrequencyPoint,
    Identified,
    TuneError,
    approach,
    identified,
    impulse_response,
    settings,
)
from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.emergency import (
    KILL,
    Order,
    OrderClient,
    decode_record,
    latch,
    record_path,
    records,
)
from ptnsbc_sim.scenario import load_scenario

# Gain and lag [s] at 0.1, 0.25 and 0.5 Hz by the truth, without a link: docs/autopilot.md, and its test.
TRUE = {
    "arducopter": ((0.96, 0.52), (1.11, 0.46), (0.88, 0.57)),
    "px4": ((0.69, 0.66), (0.58, 0.49), (0.42, 0.40)),
}


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "gnss"), [("px4", "rtk"), ("arducopter", "quiet")])
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
        self.folder, self.world = folder, HoverWorld("px4")
        self.at, self._due_s = lambda: None, None
        self.during = []  # records, as they were when `at` was called
        clock = SimpleNamespace(
            monotonic=lambda: self.world.now_s, time_ns=lambda: self.world.now_ns
        )
        monkeypatch.setenv("ROS_DOMAIN_ID", "7")
        monkeypatch.setattr(hover_test, "time", clock)
        monkeypatch.setattr(bridge, "connect", lambda _where: self.world.wire)
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


PERIOD_S = 0.02


def flown(made, gain=1.0, lag_s=0.0, noise_m_s=0.0, drift_m_s2=0.0):
    """What was sent, and what a vehicle of this gain and lag flew."""
    random = np.random.default_rng(3)
    t = np.arange(0.0, made.end_s, PERIOD_S)
    sent = np.array([made.wanted(at, np.zeros(3))[0] for at in t])
    late = np.array([made.wanted(at - lag_s, np.zeros(3))[0] for at in t])
    seen = gain * late + drift_m_s2 * t + noise_m_s * random.standard_normal(len(t))
    return np.stack((t, sent), axis=1), np.stack((t + 0.007, np.interp(t + 0.007, t, seen)), axis=1)


@pytest.mark.parametrize(("gain", "lag_s"), [(1.0, 0.0), (0.6, 0.5), (1.2, 0.3)])
def test_gain_and_lag_are_found_beside_noise_and_drift(gain, lag_s):
    made = Excitation(3.0)
    for point in made.points(*flown(made, gain, lag_s, noise_m_s=0.03, drift_m_s2=0.01)):
        assert point.gain == pytest.approx(gain, rel=0.03)
        assert point.lag_s == pytest.approx(lag_s, abs=0.02)


def test_a_vehicle_that_flies_by_itself_is_refused():
    made = Excitation(3.0)
    with pytest.raises(TuneError, match="not asked for"):
        made.points(*flown(made, noise_m_s=0.6))


def test_too_few_states_are_refused():
    made = Excitation(3.0)
    sent, seen = flown(made)
    with pytest.raises(TuneError, match=r"samples at 0\.1 Hz"):
        made.points(sent, seen[::50])


@pytest.mark.parametrize("box_m", [1.2, 2.0, 3.0, 6.0])
def test_the_sinusoids_take_at_most_the_box_and_half_a_metre_per_second(box_m):
    made = Excitation(box_m)
    place, widest = np.zeros(3), 0.0
    for at in np.arange(0.0, made.end_s, PERIOD_S):
        velocity = made.wanted(at, place)
        assert abs(velocity[0]) <= 0.5 + 0.3
        place = place + PERIOD_S * velocity
        widest = max(widest, abs(place[0]))
    assert 0.1 < widest < 0.5 * box_m


def test_the_middle_of_the_box_is_held():
    made = Excitation(3.0)
    assert made.wanted(0.0, np.array([0.5, -0.5, 4.0])) == pytest.approx([-0.1, 0.1, -0.3])


def test_the_box():
    made = Excitation(3.0)
    assert not made.left(np.array([1.4, -1.4, 1.4]))
    assert made.left(np.array([0.0, -1.6, 0.0]))


def test_a_box_that_shows_nothing_is_refused_with_the_least():
    with pytest.raises(TuneError, match=r"--box 0.3: expected at least 0.6 m"):
        Excitation(0.3)
    assert math.isfinite(Excitation(0.6).end_s)


ARDUPILOT = VelocityResponse(2.0, 1.0, 0.5, 1.0, 2.0, (0.15, 0.227))
PX4 = VelocityResponse(1.8, 0.4, 0.2, 0.0, None, (0.1, 0.06))
HERTZ = (0.1, 0.25, 0.5)

# Measured on PX4 1.16-dev and ArduCopter 4.7-dev: docs/autopilot.md, "How they follow a velocity".
MEASURED = {
    ARDUPILOT: ((0.98, 0.52), (1.10, 0.47), (0.85, 0.63)),
    PX4: ((0.67, 0.59), (0.59, 0.48), (0.44, 0.40)),
}


def points_of(pairs):
    return [
        FrequencyPoint(hertz, gain * np.exp(-2j * math.pi * hertz * lag_s))
        for hertz, (gain, lag_s) in zip(HERTZ, pairs, strict=True)
    ]


@pytest.mark.parametrize("response", [ARDUPILOT, PX4])
@pytest.mark.parametrize(
    ("gain", "lag", "drag"), [(1.0, 1.0, 0.2), (1.3, 0.7, 1.0), (0.7, 1.5, 0.4)]
)
def test_the_numbers_of_a_vehicle_are_found_from_its_response(response, gain, lag, drag):
    true = Identified(
        response.measured(gain * response.gain, lag * response.tilt_lag_s), drag, 0.02, ()
    )
    found = identified(response, [true.expected(hertz) for hertz in HERTZ], 0.02)
    assert found.response.gain == pytest.approx(true.response.gain, rel=1e-3)
    assert found.response.tilt_lag_s == pytest.approx(true.response.tilt_lag_s, rel=1e-3)
    assert found.drag_1_s == pytest.approx(drag, abs=1e-3)
    assert found.error < 1e-4


@pytest.mark.parametrize("response", MEASURED)
def test_what_was_measured_on_real_autopilots_is_explained_within_three_hundredths(response):
    found = identified(response, points_of(MEASURED[response]), 0.0)
    assert found.error < 0.035
    assert found.drag_1_s == pytest.approx(1.1 if response is PX4 else 0.3, abs=0.1)


def test_a_response_that_no_such_vehicle_has_is_refused():
    with pytest.raises(TuneError, match="its parameters give at best"):
        identified(PX4, points_of(((1.0, 0.1), (0.3, 0.9), (1.5, 0.1))), 0.02)


def scenario(**overrides):
    return load_scenario("experiment_4", overrides).bridged()


@pytest.mark.parametrize("response", [ARDUPILOT, PX4])
def test_settings_that_fit_are_left_alone(response):
    own = scenario()
    fits = settings(own, Identified(response, 0.2, 0.02, ()))
    assert fits.kappa_1_s == own.gains.formation.kappa_1_s < fits.largest_kappa_1_s
    assert fits.filter_1_s == own.gains.filter.bandwidth_1_s
    assert fits.deadline_s == own.gains.formation.deadline_s > fits.shortest_deadline_s


def test_settings_that_do_not_fit_become_the_next_that_do():
    vehicle = Identified(ARDUPILOT.measured(None, 0.45), 0.2, 0.06, ())
    own = scenario(
        **{
            "mavlink.overrides": {
                "gains.formation.deadline_s": 3,
                "formation.task": "relative_position",
            }
        }
    )
    fits = settings(own, vehicle)
    assert fits.kappa_1_s == fits.largest_kappa_1_s < own.gains.formation.kappa_1_s
    assert fits.filter_1_s >= 1.0 / 0.04 - 1e-9 > own.gains.filter.bandwidth_1_s
    assert fits.deadline_s == fits.shortest_deadline_s > 3


@pytest.mark.parametrize(
    ("vehicle", "text"),
    [
        (Identified(ARDUPILOT.measured(2.0, 1.5), 0.2, 0.02, ()), "make its velocity loop faster"),
        (Identified(PX4, 0.2, 0.11, ()), "expected less than 100 ms"),
    ],
)
def test_a_vehicle_that_nothing_fits_is_refused(vehicle, text):
    with pytest.raises(TuneError, match=text):
        settings(scenario(), vehicle)


def test_behind_a_vehicle_without_lag_the_approach_is_the_time_base():
    """A velocity that is flown at once leaves the residual at the deadline, and nothing after it."""
    at_once = np.zeros(4000)
    at_once[0] = 1.0
    loop = LoopGain(10.0, 0.02, 1.0, 1.2, PROFILE_SOFT)
    t, left = approach(loop, at_once)
    assert left[0] == 1.0
    assert np.abs(left[t >= 10.0]).max() < 1e-6


def test_a_slower_vehicle_needs_a_later_deadline():
    quick, slow = (
        impulse_response(Identified(PX4.measured(None, lag_s), 1.0, 0.02, ()), lead=False)
        for lag_s in (0.1, 0.5)
    )
    loop = LoopGain(6.0, 0.05, 1.0, 0.5, PROFILE_SOFT)
    (t, best), (_, worst) = approach(loop, quick), approach(loop, slow)
    assert np.abs(best[t >= 6.0]).max() < np.abs(worst[t >= 6.0]).max()
