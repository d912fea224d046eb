"""Hover tests of the stand-ins: the response that is found, and everything that ends a test."""

import pytest

pytest.importorskip("pymavlink")

from mavlink_hover import HoverRig

from ptnsbc_autopilot.faults import inject
from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.bridge.tuning.excitation import TuneError
from ptnsbc_nodes.bridge.tuning.settings import settings
from ptnsbc_nodes.emergency.orders import KILL, Order

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
    assert rig.test.bridge.place.startswith("(-")


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
