"""The other vehicles before the flight: ready, armed, and where they stand."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from ptnsbc_nodes.bridge.procedure.companions import HEARD_S, Placement
from ptnsbc_nodes.bridge.procedure.steps import Companion, Step

KEEP_OUT_M, SPACING_M = 0.5, 1.0


def companions(*awaited, own=2, wide=(), error_m=0.0, tolerance_m=0.15):
    """A vehicle at its start, in the origin, that hears the bridges of others."""
    abort = SimpleNamespace(separation_share=0.6)
    mavlink = SimpleNamespace(start_tolerance_m=1.0, climb_spacing_m=SPACING_M, abort=abort)
    scenario = SimpleNamespace(
        mavlink=mavlink,
        formation=SimpleNamespace(tolerance_m=tolerance_m),
        uav_ids=(1, own),
        uav=lambda _uav: SimpleNamespace(position=(0.0, 0.0, 0.0)),
        keep_out_between=lambda _own, uav: 3 * KEEP_OUT_M if uav in wide else KEEP_OUT_M,
    )
    vehicle = SimpleNamespace(gnss=SimpleNamespace(error_m=error_m))
    here = SimpleNamespace(odometry=np.array([0.0, 0.0, 0.3]))
    return Placement(scenario, own, frozenset(awaited), vehicle, here)


def other(step=Step.READY, x=0.0, y=0.0, error_m=0.0, height_m=0.0, fault=""):
    return Companion(step.value, fault, (x, y, 0.0), error_m, height_m)


@pytest.mark.parametrize(
    ("error_m", "tolerance_m", "most"), [(0.9, 2.0, "0.14"), (0.1, 0.06, "0.06"), (0.1, 0.15, "")]
)
def test_a_position_must_be_known_within_the_tolerance_and_what_the_keep_out_leaves(
    error_m, tolerance_m, most
):
    """Four tenths of a keep-out of 0.5 m must hold the errors of two positions."""
    said = companions(error_m=error_m, tolerance_m=tolerance_m).inexact()
    assert bool(said) is bool(most)
    assert not most or f"known to {error_m:.2f} m: expected at most {most} m" in said


def test_nobody_is_awaited_alone():
    alone = companions()
    assert (alone.not_ready(0.0), alone.not_armed(0.0), alone.out()) == ("", "", "")


def test_an_awaited_bridge_must_be_heard_and_its_report_be_fresh():
    three = companions(1, 2, 3)
    assert three.not_ready(0.0) == "bridge1 (not heard), bridge3 (not heard)"
    three.report(1, other(), 0.0)
    three.report(3, other(Step.MODE), 0.0)
    assert three.not_ready(0.1) == "bridge3 (waiting for the mode)"
    three.report(3, other(Step.ARM), 0.2)
    assert three.not_ready(0.3) == ""
    assert (
        three.not_armed(0.3) == "bridge1 (ready to arm, waiting for the others), bridge3 (arming)"
    )
    assert three.not_ready(HEARD_S + 0.1) == "bridge1 (not heard)"


def test_armed_are_those_that_wait_or_fly():
    two = companions(1)
    for step in (Step.ARMED, Step.TAKEOFF, Step.AIRBORNE, Step.FLY):
        two.report(1, other(step), 0.0)
        assert two.not_armed(0.0) == ""


def test_a_bridge_that_is_heard_counts_also_when_nobody_awaits_it():
    heard = companions()
    heard.report(7, other(Step.STATE), 0.0)
    assert heard.not_ready(0.0) == "bridge7 (waiting for a valid position)"


def test_the_own_report_is_none():
    one = companions(own=2)
    one.report(2, other(Step.FAILED), 0.0)
    assert (one.not_ready(0.0), one.out()) == ("", "")


def test_who_gives_up_is_named_with_its_reason():
    one = companions(1)
    one.report(1, other(Step.FAILED, fault="arming refused (not healthy: gps)"), 0.0)
    assert one.out() == "bridge1 failed: arming refused (not healthy: gps)"


@pytest.mark.parametrize(
    ("apart_m", "errors_m", "refused"),
    [(0.02, (0, 0), True), (0.49, (0, 0), True), (0.51, (0, 0), False), (0.6, (0.3, 0.4), True),
     (1.01, (0.3, 0.4), False)],
)  # fmt: skip
def test_vehicles_that_stand_at_one_place_are_not_armed(apart_m, errors_m, refused):
    one = companions(1, error_m=errors_m[0])
    one.report(1, other(x=apart_m, error_m=errors_m[1]), 0.0)
    text = one.misplaced()
    assert bool(text) is refused
    if refused:
        assert f"stands {apart_m:.2f} m from the vehicle of bridge1" in text


def test_who_stands_close_climbs_in_the_order_of_the_ids():
    second = companions(1, 3)
    second.report(1, other(Step.TAKEOFF, x=1.2, height_m=0.5), 0.0)
    second.report(3, other(Step.ARMED, x=1.0), 0.0)
    assert second.climbs_first() == "bridge1"
    second.report(1, other(Step.TAKEOFF, x=1.2, height_m=1.6), 0.2)
    assert second.climbs_first() == ""
    second.report(1, other(Step.ARMED, x=1.6), 0.4)  # far enough: side by side
    assert second.climbs_first() == ""


def test_a_vehicle_with_a_keep_out_of_its_own_needs_more_room():
    pair = companions(1, wide=(1,))
    pair.report(1, other(x=1.4), 0.0)
    assert "expected at least 1.50 m, the keep-out of 1.5 m" in pair.misplaced()
    pair.report(1, other(x=2.4), 0.0)
    assert (pair.misplaced(), pair.climbs_first()) == ("", "bridge1")
