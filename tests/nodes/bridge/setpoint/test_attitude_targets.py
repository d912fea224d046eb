"""Attitude targets: quaternion from a wrench, tilt limit, hover thrust, and the target's own body rates."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_fleet import MavlinkFleet

from ptnsbc_core.control.quadrotor_control import (
    attitude_error,
    desired_rotation,
    quadrotor_control,
)
from ptnsbc_core.control.rigid_body_control import VelocityReference, initial_observer
from ptnsbc_core.curves.trajectory import reference
from ptnsbc_core.kinematics import quaternion_from_euler, rotation_from_quaternion, velocity_enu
from ptnsbc_core.timebase import Clock
from ptnsbc_core.types import AdaptationState
from ptnsbc_nodes.bridge.setpoint.attitude_targets import (
    AttitudeTargets,
    BodyRateEstimator,
    HoverThrust,
    ThrustTest,
    attitude_from_wrench,
    largest_force_kappa_1_s,
    limit_tilt,
    unsaturated_axes,
)
from ptnsbc_sim.scenario import agent_config, load_scenario


@pytest.fixture(scope="module")
def config():
    return agent_config(load_scenario("experiment_4"), 1)


@pytest.fixture(scope="module")
def flown():
    return agent_config(load_scenario("experiment_4").bridged(), 1)


def state(euler=(0, 0, 0), rates=(0, 0, 0), velocity=(0, 0, 0)):
    odometry = np.zeros(13)
    odometry[3:7] = quaternion_from_euler(np.array(euler, dtype=float))
    odometry[7:10], odometry[10:13] = velocity, rates
    return odometry


@pytest.mark.parametrize("euler", [(0, 0, 0), (0.1, -0.2, 0.5), (-0.2, 0.1, 3.0)])
@pytest.mark.parametrize("push", [(0, 0, 0), (0.3, -0.2, 0.1)])
def test_the_wrench_is_read_back_to_the_attitude_that_the_controller_meant(config, euler, push):
    odometry, still = state(euler, (0.1, -0.1, 0.05)), (0.0, 0.0, 0.0)
    yaw = euler[2] + 0.05
    command = VelocityReference(tuple(map(float, push)), still, still, still, yaw)
    controller = config.controller
    before = AdaptationState(
        controller.nominal, (0.0, 0.0), initial_observer(velocity_enu(odometry))
    )
    clock = Clock(5.0, 5.0, 0.01)
    control = quadrotor_control(
        odometry, command, before, clock, controller, config.filter.max_rate
    )
    wrench = np.array([*control.force, *control.torque])
    wanted = attitude_from_wrench(wrench, odometry, 5.0, controller, 0.7)
    gain = controller.force.scale * controller.force.kappa
    force = gain * np.array(push) + np.array([0, 0, 9.81])
    meant = attitude_error(rotation_from_quaternion(odometry[3:7]), desired_rotation(force, yaw))
    read = attitude_error(rotation_from_quaternion(odometry[3:7]), rotation_from_quaternion(wanted))
    if not np.abs(wrench[3:6] / controller.max_torque).max() > 0.99:
        assert read == pytest.approx(meant, abs=0.03)
    assert np.dot(read, meant) >= 0.0


def test_a_torque_at_its_limit_does_not_tell_what_was_meant(config):
    controller = config.controller
    wrench = np.array([0, 0, 12.0, 0.1, -1.5, 0.3])
    assert controller.max_torque == (1.5, 1.5, 0.3)
    assert unsaturated_axes(wrench, controller).tolist() == [True, False, False]


def test_tilt_is_limited_in_the_direction_it_has():
    steep = quaternion_from_euler(np.array([0.0, 1.2, 0.4]))
    limited = limit_tilt(steep, 0.6)
    before, after = (rotation_from_quaternion(q)[:, 2] for q in (steep, limited))
    assert math.acos(after[2]) == pytest.approx(0.6)
    assert math.atan2(after[1], after[0]) == pytest.approx(math.atan2(before[1], before[0]))
    gentle = quaternion_from_euler(np.array([0.1, 0.2, 0.4]))
    assert limit_tilt(gentle, 0.6).tolist() == gentle.tolist()


ALL = np.ones(3, dtype=bool)
DT = 0.02
SETTLED = 100  # targets: two seconds


def quaternion(roll=0.0, pitch=0.0, yaw=0.0):
    return quaternion_from_euler(np.array([roll, pitch, yaw]))


def after(targets, known=ALL):
    """Rates with the last of some targets, one every DT."""
    estimator = BodyRateEstimator()
    for n, target in enumerate(targets):
        rates = estimator.update(target, known, DT * n)
    return rates


def test_a_heading_that_turns_left():
    rates = after([quaternion(yaw=0.5 * DT * n) for n in range(SETTLED)])
    assert rates == pytest.approx([0, 0, 0.5], abs=1e-4)


def test_rates_are_those_of_the_targets_body():
    # Nose up by 30 degrees, the heading turns left by 1 rad/s: in the body that is half a radian of roll.
    # FLU: nose up is a negative pitch, and z of the world is (-sin pitch, 0, cos pitch) = (0.5, 0, 0.866).
    rates = after([quaternion(0.0, -math.pi / 6, DT * n) for n in range(SETTLED)])
    assert rates == pytest.approx([0.5, 0.0, math.sqrt(0.75)], abs=1e-3)


def test_a_new_target_is_no_motion_of_the_old_one():
    turned = quaternion(yaw=1.0)
    assert after([quaternion()] * 50 + [turned] * 50).tolist() == [0, 0, 0]


def test_a_target_that_is_sent_again_does_not_stop():
    estimator = BodyRateEstimator()
    for n in range(SETTLED):
        for _ in range(2):  # the stream is quicker than the controller
            rates = estimator.update(quaternion(yaw=0.5 * DT * n), ALL, DT * n)
    assert rates[2] == pytest.approx(0.5, abs=1e-4)


def test_about_an_axis_at_its_torque_limit_there_is_no_rate():
    targets = [quaternion(yaw=0.5 * DT * n) for n in range(SETTLED)]
    known = np.array([True, True, False])
    assert after(targets, known).tolist() == [0, 0, 0]


def test_after_a_gap_it_begins_anew():
    estimator = BodyRateEstimator()
    for n in range(SETTLED):
        estimator.update(quaternion(yaw=0.5 * DT * n), ALL, DT * n)
    assert estimator.update(quaternion(yaw=1.1), ALL, DT * SETTLED + 1.0).tolist() == [0, 0, 0]


def test_a_vehicle_that_lags_is_not_chased_round():
    """The heading of a target that is at most 0.15 rad ahead, as after a torque at its limit.

    A vehicle that adds the rates to its own would turn for ever if they were the vehicle's.
    """
    estimator, yaw, goal, fastest = BodyRateEstimator(), 0.0, 1.5, 0.0
    for n in range(500):
        ahead = min(goal - yaw, 0.15)
        known = np.array([True, True, goal - yaw < 0.15])
        rates = estimator.update(quaternion(yaw=yaw + ahead), known, DT * n)
        rate = 4.0 * ahead + rates[2]
        fastest = max(fastest, rate)
        yaw += DT * rate
    assert yaw == pytest.approx(goal, abs=0.01)
    assert fastest <= 4.0 * 0.15 + 1e-9


def most(config, delay_s, tilt_lag_s=0.165):
    return largest_force_kappa_1_s(config, delay_s, tilt_lag_s)


def step_response(config, kappa_1_s, delay_s, tilt_lag_s):
    """Places (N,) [m] after a wanted step of 1 m, and none of the formulas: a tilt behind a late target, in time."""
    dt, bound = 1e-3, config.controller.bound_cap[0] / config.controller.boundary[0]
    planner, bandwidth = config.formation.kappa, config.filter.bandwidth
    late = deque([(0.0, 0.0)] * max(round(delay_s / dt), 1))
    place = speed = tilt = rate = wanted = before = slope = 0.0
    out = []
    for _ in range(20000):
        push = bandwidth * (planner * (1.0 - place) - wanted)
        wanted += dt * push
        target = push - (kappa_1_s + bound) * (speed - wanted)
        slope += dt * ((target - before) / dt - slope) / BodyRateEstimator.SMOOTHING_S
        before = target
        late.append((target, slope))
        asked, ahead = late.popleft()
        rate += dt * ((asked - tilt) / (tilt_lag_s - 0.04) + ahead - rate) / 0.04
        tilt += dt * rate
        speed += dt * tilt
        place += dt * speed
        out.append(place)
    return np.array(out)


@pytest.mark.parametrize("delay_s", [0.03, 0.06, 0.1])
@pytest.mark.parametrize("tilt_lag_s", [0.1, 0.165, 0.25])
def test_the_largest_gain_settles_and_twice_as_much_swings(flown, delay_s, tilt_lag_s):
    found = most(flown, delay_s, tilt_lag_s)
    if found > 0.5:
        settled = step_response(flown, found, delay_s, tilt_lag_s)
        assert settled.max() < 1.2
        assert settled[15000:] == pytest.approx(1.0, abs=0.02)
    wild = step_response(flown, 2.0 * found + 2.0, delay_s, tilt_lag_s)
    assert np.abs(wild[15000:] - 1.0).max() > 0.05


def test_a_vehicle_that_flies_no_rates_of_the_target_bears_more_delay_and_less_lag(flown):
    """The rates that are sent make up for the lag of the tilt, and turn a late target too far."""

    def both(delay_s, tilt_lag_s):
        return [
            largest_force_kappa_1_s(flown, delay_s, tilt_lag_s, led=led) for led in (True, False)
        ]

    led, bare = both(0.05, 0.12)
    assert bare > led
    led, bare = both(0.05, 0.35)
    assert bare < led


def test_the_largest_gain_falls_with_the_delay_and_the_lag(flown):
    delays = [most(flown, 0.01 * n) for n in range(20)]
    lags = [most(flown, 0.05, 0.02 * n) for n in range(4, 20)]
    assert delays == sorted(delays, reverse=True)
    assert lags == sorted(lags, reverse=True)
    assert delays[-1] == 0.0


GRAVITY, MOTOR_S = 9.81, 0.02
PERIOD_S, STEPS = 0.02, 5  # of the targets and states; physics between them


@pytest.fixture(scope="module")
def controller():
    return agent_config(load_scenario("experiment_4"), 1).controller


def climbing(height=0.0, climb=0.0):
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
        hover.on_odometry(now, climbing(climb=climb))
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


def hold(controller, craft, seed=1, silent=False):
    """Hold a height by the bridge's own targets until the test is over: the targets, and the largest error [m]."""
    random = np.random.default_rng(seed)
    targets = AttitudeTargets(controller, craft.hover * random.uniform(0.85, 1.15))
    dt, kick = PERIOD_S / STEPS, math.sqrt(2.0 * PERIOD_S)
    height, climb, force, gust, error = 2.0, 0.0, GRAVITY, 0.0, 0.0
    under_way, thrust, off = deque(), craft.hover, []
    for n in range(2000):
        now = n * PERIOD_S
        error += -error * PERIOD_S + craft.noise_m_s * kick * random.standard_normal()
        gust += -gust * PERIOD_S + craft.gust_m_s2 * kick * random.standard_normal()
        seen = climbing(height, climb + error)
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
def test_slope_and_delay_are_found_in_forty_vehicles_in_gusts_and_noise(controller):
    random = np.random.default_rng(3)
    slopes, delays, hovers = [], [], []
    for seed in range(40):
        craft = Craft.drawn(random)
        targets, end_s, _ = hold(controller, craft, seed)
        found = targets.thrust_test.found
        assert found is not None, craft
        slopes.append(found.slope / craft.slope - 1.0)
        delays.append(found.delay_s - craft.delay_s - MOTOR_S)
        hovers.append(targets.hover.value / craft.hover / (1.0 + craft.sag_1_s * end_s) - 1.0)
    assert np.abs(slopes).max() < 0.12
    assert abs(np.mean(slopes)) < 0.02  # no bias: the loop was closed all the time
    assert np.abs(delays).max() < 0.01
    assert np.abs(hovers).max() < 0.03


def test_the_thrust_that_is_sent_knows_what_was_found(controller):
    targets, _, off_m = hold(controller, Craft())
    assert targets.hover.slope == targets.thrust_test.found.slope
    assert off_m < 0.15  # the pattern and the gusts together
    half = targets.hover.normalised(0.5 * GRAVITY) / targets.hover.value
    assert half**targets.hover.slope == pytest.approx(0.5)


def test_a_vehicle_that_does_not_answer_is_taken_as_proportional(controller):
    targets, _, _ = hold(controller, Craft(sag_1_s=0.0), silent=True)
    assert targets.thrust_test.over
    assert targets.thrust_test.found is None
    assert targets.hover.slope == 1.0


def test_there_is_no_nudge_on_the_ground_and_none_after_the_test():
    test = ThrustTest(GRAVITY)
    assert test.nudge(0.0) == 0.0
    test.on_odometry(1.0, 1.0, climbing())
    assert test.nudge(1.01) != 0.0
    assert test.nudge(2.0) == 0.0  # no state for a second
    for n in range(3000):
        test.on_odometry(2.0 + 0.02 * n, 2.0 + 0.02 * n, climbing())
    assert test.over  # nothing was sent: it does not wait for ever
    assert test.nudge(62.0) == 0.0


@pytest.mark.parametrize("silent", ["states", "targets"])
def test_the_test_begins_anew_after_a_hole(silent):
    test, ended_s = ThrustTest(GRAVITY), None
    for n in range(1500):
        now = n * PERIOD_S
        hole = 2.0 < now < 14.0  # longer than the test
        if not (hole and silent == "states"):
            test.on_odometry(now, now, climbing())
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


def late_fleet(count, kappa_1_s, delay_s, **parameters):
    """Stand-ins that take attitude and thrust only, `delay_s` late, with a gain of the velocity loop."""
    overrides = load_scenario("experiment_4").mavlink.overrides
    made = load_scenario(
        "experiment_4",
        {
            "timing.duration_s": 25.0,
            "communication.tree": {2: 1, 3: 1, 4: 1},
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
def test_bare_motors_behind_a_late_link_and_a_sagging_battery_hold_the_height_and_land():
    curve, sag, delay_s, kappa_1_s = 1.7, 0.5, 0.05, 1.8
    motors = {"THR_CURVE": curve, "THR_SAG": sag, "BATT_LIFE_S": 150.0}
    fleet = late_fleet(2, kappa_1_s, delay_s, **motors).airborne().form().run(24.5)
    for uav in fleet.uavs.values():
        attitude, flight = uav.bridge.stream.attitude, uav.vehicle.flight
        assert attitude.hover.slope == pytest.approx(curve, rel=0.12)
        assert attitude.thrust_test.found.delay_s == pytest.approx(delay_s + 0.025, abs=0.01)
        force = 1.0 - sag * (1.0 - flight.battery)
        hover = (flight.hover_share / force) ** (1.0 / curve)
        assert flight.battery < 0.75
        assert attitude.hover.value == pytest.approx(hover, rel=0.05)
    made = fleet.scenario
    flight_s = (fleet.now_ns - fleet.legs[0][0]) * 1e-9
    place = np.array(reference(agent_config(made, 1).trajectory, flight_s).position)
    leader, follower = (uav.vehicle.flight.truth.position_enu for uav in fleet.uavs.values())
    np.testing.assert_allclose(leader, place, atol=0.1)
    np.testing.assert_allclose(follower, place + made.offset(2), atol=0.15)
    fleet.land()
    assert {uav.bridge.procedure.fault for uav in fleet.uavs.values()} == {""}
    assert not any(uav.vehicle.armed for uav in fleet.uavs.values())


@pytest.mark.slow
def test_a_vehicle_whose_targets_come_too_late_for_its_gain_lands_before_the_formation():
    fleet = late_fleet(1, 4.0, 0.06)
    uav = fleet.uavs[1]
    fleet.run(120, until=lambda: uav.bridge.procedure.over)
    assert "gains.force.kappa_1_s = 4: the vehicle would swing" in fleet.report()
    assert uav.bridge.procedure.fault
    assert not uav.vehicle.armed
    assert not fleet.legs
