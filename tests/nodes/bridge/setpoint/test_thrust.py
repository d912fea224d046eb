"""Thrust at hover, power of the thrust and delay, learnt from how a vehicle moves with its thrust."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_fleet import MavlinkFleet

from ptnsbc_core.curves.trajectory import reference
from ptnsbc_nodes.bridge.setpoint.attitude import AttitudeTargets
from ptnsbc_nodes.bridge.setpoint.thrust import HoverThrust, ThrustTest
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.verdict import verdict_on

GRAVITY, MOTOR_S = 9.81, 0.02
PERIOD_S, STEPS = 0.02, 5  # of the targets and states; physics between them


@pytest.fixture(scope="module")
def config():
    return agent_config(load_scenario("experiment_4"), 1).controller


def state(height=0.0, climb=0.0):
    odometry = np.zeros(13)
    odometry[2], odometry[6], odometry[9] = height, 1.0, climb
    return odometry


def test_hover_thrust_is_learnt_from_what_thrust_does():
    hover = HoverThrust(0.5, GRAVITY)
    climb, now = 0.0, 0.0
    for _ in range(1000):  # it really hovers at 0.4
        thrust = hover.normalised(GRAVITY - 0.5 * climb)
        hover.on_sent(thrust)
        climb += 0.02 * GRAVITY * (thrust / 0.4 - 1.0)
        now += 0.02
        hover.on_odometry(now, state(climb=climb))
    assert hover.value == pytest.approx(0.4, rel=0.03)


class Craft(NamedTuple):
    """A vehicle that moves up and down only, in gusts, with noise on its velocity."""

    slope: float = 1.6
    hover: float = 0.5
    delay_s: float = 0.06
    sag_1_s: float = 0.002  # growth of the thrust at hover
    gust_m_s2: float = 0.1
    noise_m_s: float = 0.005

    @classmethod
    def drawn(cls, random):
        draw = random.uniform
        return cls(
            draw(1, 2), draw(0.3, 0.7), draw(0, 0.2), draw(0, 0.004), draw(0, 0.2), draw(0, 0.01)
        )


def hold(config, craft, seed=1, silent=False):
    """Hold a height by the bridge's own targets until the test is over: the targets, and the largest error [m]."""
    random = np.random.default_rng(seed)
    targets = AttitudeTargets(config, craft.hover * random.uniform(0.85, 1.15))
    dt, kick = PERIOD_S / STEPS, math.sqrt(2.0 * PERIOD_S)
    height, climb, force, gust, error = 2.0, 0.0, GRAVITY, 0.0, 0.0
    under_way, thrust, off = deque(), craft.hover, []
    for n in range(2000):
        now = n * PERIOD_S
        error += -error * PERIOD_S + craft.noise_m_s * kick * random.standard_normal()
        gust += -gust * PERIOD_S + craft.gust_m_s2 * kick * random.standard_normal()
        seen = state(height, climb + error)
        targets.on_odometry(now, now, seen)
        if targets.thrust_test.over:
            break
        point = np.array([0.0, 0.0, 2.0])
        sent = targets.for_point(point, 0.0, seen, now, PERIOD_S, 0.6).thrust
        under_way.append((now + craft.delay_s, craft.hover if silent else sent))
        for k in range(STEPS):
            while under_way and under_way[0][0] <= now + k * dt:
                thrust = under_way.popleft()[1]
            share = thrust / craft.hover / (1.0 + craft.sag_1_s * now)
            force += (GRAVITY * share**craft.slope - force) * dt / (MOTOR_S + dt)
            climb += dt * (force - GRAVITY + gust)
            height += dt * climb
        off.append(height - 2.0)
    return targets, now, float(np.abs(off[200:]).max())


@pytest.mark.slow
def test_slope_and_delay_are_found_in_a_hundred_vehicles_in_gusts_and_noise(config):
    random = np.random.default_rng(3)
    slopes, delays, hovers = [], [], []
    for seed in range(100):
        craft = Craft.drawn(random)
        targets, end_s, _ = hold(config, craft, seed)
        found = targets.thrust_test.found
        assert found is not None, craft
        slopes.append(found.slope / craft.slope - 1.0)
        delays.append(found.delay_s - craft.delay_s - MOTOR_S)
        hovers.append(targets.hover.value / craft.hover / (1.0 + craft.sag_1_s * end_s) - 1.0)
    assert np.abs(slopes).max() < 0.12
    assert abs(np.mean(slopes)) < 0.02  # no bias: the loop was closed all the time
    assert np.abs(delays).max() < 0.01
    assert np.abs(hovers).max() < 0.03


def test_the_thrust_that_is_sent_knows_what_was_found(config):
    targets, _, off_m = hold(config, Craft())
    assert targets.hover.slope == targets.thrust_test.found.slope
    assert off_m < 0.15  # the pattern and the gusts together
    half = targets.hover.normalised(0.5 * GRAVITY) / targets.hover.value
    assert half**targets.hover.slope == pytest.approx(0.5)


def test_a_vehicle_that_does_not_answer_is_taken_as_proportional(config):
    targets, _, _ = hold(config, Craft(sag_1_s=0.0), silent=True)
    assert targets.thrust_test.over
    assert targets.thrust_test.found is None
    assert targets.hover.slope == 1.0


def test_there_is_no_nudge_on_the_ground_and_none_after_the_test():
    test = ThrustTest(GRAVITY)
    assert test.nudge(0.0) == 0.0
    test.on_odometry(1.0, 1.0, state())
    assert test.nudge(1.01) != 0.0
    assert test.nudge(2.0) == 0.0  # no state for a second
    for n in range(3000):
        test.on_odometry(2.0 + 0.02 * n, 2.0 + 0.02 * n, state())
    assert test.over  # nothing was sent: it does not wait for ever
    assert test.nudge(62.0) == 0.0


@pytest.mark.parametrize("silent", ["states", "targets"])
def test_the_test_begins_anew_after_a_hole(silent):
    test, ended_s = ThrustTest(GRAVITY), None
    for n in range(1500):
        now = n * PERIOD_S
        hole = 2.0 < now < 14.0  # longer than the test
        if not (hole and silent == "states"):
            test.on_odometry(now, now, state())
        if test.over:
            ended_s = now
            break
        if not (hole and silent == "targets"):
            test.on_sent(now, 0.5 * math.exp(test.nudge(now)))
    assert ended_s == pytest.approx(14.0 + test.length_s, abs=0.1)
    assert test.found is None  # the vehicle did not move


def test_the_pattern_leaves_neither_speed_nor_height():
    times = np.arange(0.0, 12.0, 1e-3) + 5e-4
    speed = np.cumsum(ThrustTest(GRAVITY)._pattern(times)) * 1e-3
    height = np.cumsum(speed) * 1e-3
    assert speed[-1] == pytest.approx(0.0, abs=1e-9)
    assert np.abs(height).max() < 0.1  # times 0.06 g: 6 cm for a vehicle that nothing holds


def four(kappa_1_s, delay_s, count=None, duration_s=25.0, **parameters):
    """Stand-ins that take attitude and thrust only, `delay_s` late, with a gain of the velocity loop."""
    overrides = load_scenario("experiment_4").mavlink.overrides
    made = load_scenario(
        "experiment_4",
        {
            "timing.duration_s": duration_s,
            "mavlink.autopilot": "generic",
            "mavlink.setpoint": "attitude",
            "mavlink.hover_thrust": 0.6,
            "mavlink.overrides": {**overrides, "gains.force.kappa_1_s": kappa_1_s},
        },
    ).bridged()
    fleet = MavlinkFleet(made, "stm32", gnss="rtk", count=count)
    for name, value in {"THR_DELAY_S": delay_s, **parameters}.items():
        fleet.set_parameter(name, value)
    return fleet


@pytest.mark.slow
@pytest.mark.parametrize(("delay_s", "kappa_1_s"), [(0.02, 2.5), (0.05, 1.8)])
def test_bare_motors_behind_a_late_link_and_a_sagging_battery_hold_the_height(delay_s, kappa_1_s):
    curve, sag = 1.7, 0.5
    motors = {"THR_CURVE": curve, "THR_SAG": sag, "BATT_LIFE_S": 150.0}
    fleet = four(kappa_1_s, delay_s, **motors).airborne().form().run(25.6)
    for uav in fleet.uavs.values():
        attitude, flight = uav.bridge.stream.attitude, uav.vehicle.flight
        assert attitude.hover.slope == pytest.approx(curve, rel=0.12)
        assert attitude.thrust_test.found.delay_s == pytest.approx(delay_s + 0.025, abs=0.01)
        force = 1.0 - sag * (1.0 - flight.battery)
        hover = (flight.hover_share / force) ** (1.0 / curve)
        assert flight.battery < 0.75
        assert attitude.hover.value == pytest.approx(hover, rel=0.05)
    found = verdict_on(fleet.recording())
    assert found.verdict == "met", [(u.uav, u.reason) for u in found.uavs]
    path = agent_config(fleet.scenario, fleet.scenario.leader_id).trajectory
    leader = fleet.uavs[fleet.scenario.leader_id]
    wanted_m = reference(path, 25.0).position[2]
    assert leader.vehicle.flight.truth_enu[2] == pytest.approx(wanted_m, abs=0.1)


@pytest.mark.slow
def test_a_vehicle_whose_targets_come_too_late_for_its_gain_lands_before_the_formation():
    fleet = four(4.0, 0.06, count=1)
    uav = fleet.uavs[1]
    fleet.run(120, until=lambda: uav.bridge.procedure.over)
    assert "gains.force.kappa_1_s = 4: the vehicle would swing" in fleet.report()
    assert uav.bridge.procedure.fault
    assert not uav.vehicle.armed
    assert not fleet.legs
