"""What ends a formation in flight, from states alone."""

import math

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from ptnsbc_core.curves.trajectory import reference as leader_at
from ptnsbc_io.wire import HeaderFields
from ptnsbc_nodes.bridge.ports import BridgeInputs
from ptnsbc_nodes.bridge.procedure.hazards import FlightMonitor, LeaderReference, Sight
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.scenario.mavlink import Abort
from ptnsbc_sim.scenario.mission.route import places_beside_leader

LIMITS = Abort(separation_share=0.6, swing_m_s=1.0, away_m_s=2.0, against_m_s=1.0, jump_m=1.0)
NOBODY, DT = np.empty((0, 8)), 0.02


def fly(
    path,
    seconds,
    *,
    others=NOBODY,
    limits=LIMITS,
    settled_s=-100.0,
    reference=(0, 0, 0),
    wanted=lambda _t: None,
    places=None,
    error_m=0.0,
):
    """The first reason and its time, for a vehicle on `path(t) -> position`."""
    monitor = FlightMonitor(limits)
    for k in range(round(seconds / DT)):
        t = k * DT
        velocity = (np.array(path(t + 1e-4)) - np.array(path(t - 1e-4))) / 2e-4
        near = others(t) if callable(others) else others
        moves = np.array(reference(t) if callable(reference) else reference, dtype=float)
        told = wanted(t)
        told = None if told is None else np.array(told, dtype=float)
        reason = monitor.look(
            Sight(t, np.array(path(t)), velocity, moves, told, near, settled_s + t, places, error_m)
        )
        if reason:
            return reason, t
    return "", None


def still(_t):
    return (0.0, 0.0, 8.0)


def one_at(x, y, z, *velocity):
    return np.array([[x, y, z, 0.5, *(velocity or (0, 0, 0)), 0]], dtype=float)


@pytest.mark.parametrize(("distance_m", "ends"), [(0.29, True), (0.31, False), (0.6, False)])
def test_a_vehicle_below_the_bound(distance_m, ends):
    reason, _ = fly(still, 2.0, others=one_at(distance_m, 0, 8))
    assert ("0.29 m from another vehicle" in reason) is ends


def test_the_bound_is_a_share_of_the_keep_out_of_the_pair():
    wide, narrow = one_at(0.9, 0, 8), one_at(0.4, 0, 8)
    assert fly(still, 2.0, others=np.vstack((wide, narrow))) == ("", None)
    wide[0, 3] = 1.6
    reason, _ = fly(still, 2.0, others=np.vstack((wide, narrow)))
    assert "0.90 m from another vehicle" in reason


@pytest.mark.parametrize(("height_m", "ends"), [(0.8, True), (1.0, False)])
def test_in_the_downwash_the_bound_is_higher(height_m, ends):
    """0.6 of a keep-out that is 1.5 m high, and 0.6 of its width of 0.5 m beside it."""
    above, beside = one_at(0, 0, 8 + height_m), one_at(0.35, 0, 8)
    above[0, 7] = beside[0, 7] = 1.5
    reason, _ = fly(still, 2.0, others=np.vstack((above, beside)))
    assert bool(reason) is ends


@pytest.mark.parametrize(("distance_m", "ends"), [(1.5, True), (1.6, False)])
def test_the_error_of_both_positions_is_added_to_the_bound(distance_m, ends):
    """0.3 m of a keep-out of 0.5 m, and 0.9 m of plain GNSS on each side."""
    reason, _ = fly(still, 2.0, others=one_at(distance_m, 0, 8), error_m=0.9)
    assert ("1.50 m from another vehicle" in reason) is ends


def answered(times, *, limits=LIMITS, **told):
    """The first reason for a vehicle that stands still, and whose setpoints come at these times."""
    monitor = FlightMonitor(limits)
    here = np.array(still(0.0))
    sights = (
        Sight(t, here, np.zeros(3), np.zeros(3), None, NOBODY, -1.0, answered=True, **told)
        for t in times
    )
    return next(filter(None, map(monitor.look, sights)), "")


@pytest.mark.parametrize(("seconds", "ends"), [(1.9, False), (2.1, True)])
def test_a_sensor_that_has_failed_for_two_seconds_ends_the_formation(seconds, ends):
    times = np.arange(0.0, seconds, DT)
    assert answered(times, failed="3d accel") == ("failed on board: 3d accel" if ends else "")
    assert answered(times, failed="3d accel", limits=Abort(unhealthy_s=0.0)) == ""


def test_a_critical_text_ends_the_formation_at_once():
    assert answered([10.0], alarm="EKF variance") == "the vehicle says: EKF variance"
    assert answered([10.0], alarm="EKF variance", limits=Abort(unhealthy_s=0.0)) == ""


@pytest.mark.parametrize(("period_s", "ends"), [(0.02, False), (0.18, False), (0.25, True)])
def test_setpoints_that_are_late_for_half_of_the_time_end_the_formation(period_s, ends):
    reason = answered(np.arange(0.0, 20.0, period_s))
    assert reason.startswith("setpoints late for 5" if ends else "x") is ends
    assert answered(np.arange(0.0, 20.0, period_s), limits=Abort(late_share=0.0)) == ""


def test_one_pause_and_a_silence_for_the_failsafe_are_no_lateness():
    assert answered([*np.arange(0.0, 1.0, DT), *np.arange(1.45, 3.0, DT)]) == ""
    assert answered(np.arange(0.0, 60.0, 0.6)) == ""


def test_a_vehicle_that_comes_fast_is_seen_before_it_is_there():
    """At 4 m/s, as ArduCopter swung: half a second and more before the closest point."""

    def coming(t):
        return one_at(4.0 - 4.0 * t, 0.1, 8, -4.0, 0, 0)

    reason, at_s = fly(still, 2.0, others=coming)
    assert "from another vehicle" in reason
    assert at_s < 0.75  # the closest point is at 1 s
    assert fly(still, 2.0, others=lambda t: one_at(4.0 - 4.0 * t, 1.0, 8, -4.0, 0, 0)) == ("", None)


def test_one_odd_message_is_no_approach():
    assert fly(still, 1.0, others=lambda t: one_at(0.1 if t == 0.5 else 2, 0, 8)) == ("", None)


def test_a_jump_of_the_position_is_an_estimator_reset():
    def path(t):
        return (0.2 * t + (1.5 if t > 1.01 else 0.0), 0.0, 8.0)

    reason, at_s = fly(
        lambda t: path(t), 3.0, limits=LIMITS.model_copy(update=dict(swing_m_s=0, away_m_s=0))
    )
    assert reason == "its position jumped by 1.5 m"
    assert at_s == pytest.approx(1.02)
    assert fly(
        lambda t: (4.0 * t, 0.0, 8.0), 3.0, limits=LIMITS.model_copy(update={"away_m_s": 0})
    ) == ("", None)


@pytest.mark.parametrize("period_s", [2.0, 4.0, 6.0])
def test_a_swing_that_does_not_die_out(period_s):
    rate = 2 * math.pi / period_s

    def path(t):  # 2 m/s at its fastest
        return (2.0 / rate * math.sin(rate * t), 0.0, 8.0)

    reason, at_s = fly(path, 30.0)
    assert "it swings at 2.0 m/s" in reason
    assert at_s < 2.6 * period_s


def test_a_swing_that_dies_out_and_the_leaders_circle_are_none():
    def decaying(t):
        return (1.5 * math.exp(-0.25 * t) * math.sin(2 * t), 0.0, 8.0)

    assert fly(decaying, 30.0) == ("", None)
    rate = 2 * math.pi / 10.0

    def circle(t):  # 1.6 m/s, ten seconds round
        return (2.5 * math.sin(rate * t), 2.5 * math.cos(rate * t), 8.0)

    def along(t):
        return (2.5 * rate * math.cos(rate * t), -2.5 * rate * math.sin(rate * t), 0.0)

    assert fly(circle, 60.0, reference=along) == ("", None)  # the leader's own
    assert "it swings" in fly(circle, 60.0)[0]  # around the leader's


def test_an_error_that_grows_after_the_deadline():
    def running(t):
        return (2.5 * t, 0.0, 8.0)

    assert fly(running, 10.0, settled_s=-20.0) == ("", None)  # on its way to the formation
    reason, at_s = fly(running, 20.0, settled_s=0.0)
    assert "its error grows: 2.5 m/s" in reason
    assert at_s == pytest.approx(8.0, abs=0.05)
    assert fly(running, 20.0, settled_s=0.0, reference=(2.0, 0, 0)) == ("", None)


@pytest.mark.parametrize("speed_m_s", [0.2, 1.0])
def test_an_error_that_grows_slowly_while_the_planner_wants_the_vehicle_back(speed_m_s):
    """A gale carries it off; its planner wants 1.2 1/s of the error, 1 m/s and more from 0.83 m on."""

    def carried(t):
        return (speed_m_s * t, 0.0, 8.0)

    def back(t):
        return (-1.2 * speed_m_s * t, 0.0, 0.0)

    reason, at_s = fly(carried, 20.0, wanted=back)
    assert "its error grows: for 3 s it flies away from its place" in reason
    assert at_s == pytest.approx(1.0 / 1.2 / speed_m_s + 3.0, abs=0.05)
    assert speed_m_s * at_s < 4.0
    assert fly(carried, 20.0, wanted=back, limits=LIMITS.model_copy(update={"against_m_s": 0})) == (
        "",
        None,
    )
    assert fly(carried, 20.0) == ("", None)  # nothing says where it should fly


def test_a_vehicle_that_obeys_or_swings_about_its_place_is_not_carried_off():
    """Beside a leader at 1 m/s: on its way back, behind a detour, and with a swing that dies out."""

    def back(t):
        return (1.0 * t + 6.0 * math.exp(-0.5 * t), 0.0, 8.0)

    def wanted(t):
        return (1.0 - 3.0 * math.exp(-0.5 * t), 0.0, 0.0)

    assert fly(back, 20.0, wanted=wanted, reference=(1, 0, 0)) == ("", None)

    def waits(_t):  # behind an obstacle, as its planner wants it
        return (0.0, 0.0, 8.0)

    assert fly(waits, 20.0, wanted=lambda _t: (0, 0, 0), reference=(1, 0, 0)) == ("", None)

    def decaying(t):
        return (t + 3.0 * math.exp(-0.3 * t) * math.sin(1.5 * t), 0.0, 8.0)

    def about(t):
        return (1.0 - 1.2 * (decaying(t)[0] - t), 0.0, 0.0)

    assert fly(decaying, 30.0, wanted=about, reference=(1, 0, 0)) == ("", None)


def test_a_limit_of_zero_is_off():
    none = Abort(separation_share=0, swing_m_s=0, away_m_s=0, against_m_s=0, jump_m=0)
    assert fly(
        lambda t: (9.0 * math.sin(3 * t), 0, 8), 9.0, others=one_at(0, 0, 8), limits=none
    ) == (
        "",
        None,
    )


@pytest.mark.parametrize(("speed_m_s", "ends"), [(2.5, True), (1.5, False), (-2.5, False)])
def test_where_uavs_come_and_go_a_vehicle_may_be_fast_towards_a_place(speed_m_s, ends):
    """Its way back is longer than that of the others, and it may move up into another slot."""
    places = np.array([[0.0, 0.0, 8.0], [0.0, 3.0, 8.0]])
    beside = 12.0 if speed_m_s < 0.0 else 1.0

    def path(t):
        return (beside + speed_m_s * t, 1.0, 8.0)

    reason, _ = fly(path, 4.5, settled_s=10.0, places=places)
    assert ("m/s away from the motion of its place" in reason) is ends


@pytest.mark.parametrize(("name", "t"), [("split_join", 18.0), ("figure_eight", 9.0)])
def test_the_formations_motion_is_that_of_the_own_place(monkeypatch, name, t):
    """Of the head of a group that leaves, and of the tip of a V that turns."""
    found = load_scenario(name)
    config = agent_config(found, 3)
    around = np.array([t - 1e-4, t + 1e-4])
    leader = np.array([leader_at(config.trajectory, at).position for at in around])
    places = leader + places_beside_leader(found, 3, around)
    flown = LeaderReference(found, 3)
    moves = flown.place_velocity(t)
    np.testing.assert_allclose(moves, (places[1] - places[0]) / 2e-4, atol=1e-6)
    monkeypatch.setattr(type(found.formation), "has_open_slots", True)
    alike = flown.place_velocity(t)
    np.testing.assert_allclose(alike, (leader[1] - leader[0]) / 2e-4, atol=1e-6)
    assert np.linalg.norm(moves - alike) > 0.3


RELAY = {"uavs": [{"id": i, "position_m": [3 * i, 0, 3]} for i in range(1, 8)]}
RELAY["uavs"][4] |= {"joins_s": 14.0, "leaves_s": 30.0}


def following(uav_id, **changes):
    """The reference of a bridge, one second before the first epoch."""
    made = LeaderReference(load_scenario("relay", {**RELAY, **changes}), uav_id)
    made.update(BridgeInputs(legs=[HeaderFields(1_000_000_000, "form")]))
    return made


def test_one_that_leaves_lands_and_the_others_fly_on():
    leaver, other = following(5), following(4)
    for t_s, leg, leaves in ((20, "form", False), (32, "land", True)):
        now_ns = t_s * 1_000_000_000
        assert (leaver.leg(now_ns).name, leaver.leaves(now_ns)) == (leg, leaves)
        assert (other.leg(now_ns).name, other.leaves(now_ns)) == ("form", False)
    leaver.update(BridgeInputs(legs=[HeaderFields(40_000_000_000, "land")]))
    assert leaver.leg(41_000_000_000).name == "land"


def test_one_that_has_not_joined_is_no_member_and_has_no_place():
    found = following(5)
    assert [found.is_member(t) for t in (0.0, 13.9, 14.0, 29.9, 30.0)] == [
        False, False, True, True, False
    ]  # fmt: skip


@pytest.mark.parametrize(("vacancy", "slots"), [("keep", 1), ("close_up", 7)])
def test_the_places_that_a_vehicle_may_have_to_take(vacancy, slots):
    found = following(5, **{"formation.vacancy": vacancy})
    places = found.places(0.0)
    assert places.shape == (slots, 3)
    own = np.array(found.at(0.0).position) - np.array([4.0, 3.0, 0.0])
    assert min(np.linalg.norm(places - own, axis=1)) == pytest.approx(0.0)


def test_where_nobody_comes_or_goes_no_place_is_known():
    found = LeaderReference(load_scenario("experiment_4"), 2)
    assert found.places(0.0) is None
    assert found.is_member(5.0)
    assert not found.leaves(1_000_000_000)
