"""What a flight may end with after a signal to one of its processes."""

import io
from types import SimpleNamespace

import numpy as np
import pytest
from synthetic_flights import flight

pytest.importorskip("rclpy")

from bench.signals import _exit_codes, _separations, _until
from ptnsbc_sim.verdict.recording import VerdictError


def test_only_a_pause_leaves_no_trace():
    assert _exit_codes("uav1", "pause", faults=False) == {0}
    for victim in ("uav1", "sim", "recorder", "launcher"):
        orders = (_exit_codes(victim, order, faults=False) for order in ("kill", "stop"))
        assert 0 not in set().union(*orders)


def test_the_exit_code_agrees_with_the_words_about_vehicles_that_did_not_fly_as_planned():
    """A vehicle is left to its failsafe by a pause in flight, and by a busy host at any time."""
    assert _exit_codes("bridge3", "pause", faults=True) == {1}
    assert _exit_codes("terminal", "hang up", faults=True) == {1, 130}
    assert _exit_codes("terminal", "hang up", faults=False) == {130}


def entered(begin_s, **changes):
    """The pairs too close where UAV 3, 1.2 m from UAV 4, is 0.8 m nearer for a second; the first leg is at 5 s."""
    errors = {3: lambda t: np.where((t >= begin_s) & (t < begin_s + 1.0), 0.8, 0.0)}
    found = _separations(flight(errors, **{"epochs": ((5 * 10**9, "form"),), **changes}))
    return {(one.first, one.second) for one in found if one.entered}


@pytest.mark.parametrize("begin_s", [0.0, 2.0, 7.0])
def test_distances_are_judged_before_the_first_leg_too(begin_s):
    assert entered(begin_s) == {("uav3", "uav4")}


@pytest.mark.parametrize("seconds", [4.0, 12.0])
def test_a_bag_is_judged_whether_its_first_leg_began_or_not(seconds):
    assert entered(1.0, seconds=seconds) == {("uav3", "uav4")}
    assert not entered(20.0, seconds=seconds)


def test_a_bag_that_lacks_a_uav_is_wrong():
    whole = flight().odometry
    with pytest.raises(VerdictError, match="expected odometry of every UAV"):
        list(_separations(flight(odometry={1: whole[1]})))


def test_a_bag_without_an_instant_of_all_uavs_is_wrong():
    whole = flight().odometry
    apart = {**whole, 1: whole[1].rows(0, 600), 2: whole[2].rows(900, 1200)}
    with pytest.raises(VerdictError, match="no instant at which all UAVs are recorded"):
        list(_separations(flight(odometry=apart)))


@pytest.mark.parametrize(
    ("said", "words"),
    [("fleet started\nmore\n", ""), ("a\nerror: no\n", "the fleet did not start: a error: no")],
)
def test_a_fleet_that_does_not_start_ends_no_series(said, words):
    launcher = SimpleNamespace(stderr=io.StringIO(said))
    assert _until("started", launcher) == words
