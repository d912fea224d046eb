"""Thrust-and-attitude controller: geometry against scipy, then the closed loop on the plant."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from on_arrays import on_arrays, tuples
from scipy.spatial.transform import Rotation

from ptnsbc_core.algebra import odometry_tuple
from ptnsbc_core.control import quadrotor_control as laws
from ptnsbc_core.control.rigid_body_control import VelocityReference, initial_observer
from ptnsbc_core.kinematics import rotation_from_quaternion, velocity_enu
from ptnsbc_core.timebase import Clock
from ptnsbc_core.types import AdaptationState, ControllerConfig
from ptnsbc_sim.plants.build import plant_config
from ptnsbc_sim.plants.contract import six
from ptnsbc_sim.plants.integrate import advance, initial_state, odometry
from ptnsbc_sim.scenario import agent_config, load_scenario

attitude_error = on_arrays(laws.attitude_error)
desired_rotation = on_arrays(laws.desired_rotation)
rate_reference = on_arrays(laws.rate_reference)
tilt_limited = on_arrays(laws.limit_tilt)

SCENARIO = load_scenario("paper_5")
AGENT = agent_config(SCENARIO, 1)
CONFIG: ControllerConfig = AGENT.controller
WEIGHT = CONFIG.nominal.mass * CONFIG.gravity
DT = 0.01

seeds = st.integers(0, 2**31)
forces = st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(0.5, 30)).map(np.array)


@given(seed=seeds, angle=st.floats(0.0, np.pi - 1e-3))
def test_attitude_error_is_the_rotation_vector(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    turn = angle * axis / np.linalg.norm(axis)
    r = Rotation.random(random_state=rng)
    desired = (r * Rotation.from_rotvec(turn)).as_matrix()
    np.testing.assert_allclose(attitude_error(r.as_matrix(), desired), turn, atol=1e-9)


@given(force=forces, yaw=st.floats(-np.pi, np.pi))
def test_desired_rotation_points_the_thrust_and_keeps_the_heading(
    force: np.ndarray, yaw: float
) -> None:
    r = desired_rotation(force, yaw)
    heading = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(r) == pytest.approx(1.0)
    np.testing.assert_allclose(r[:, 2], force / np.linalg.norm(force), atol=1e-12)
    # body y stays across the heading: tilting never turns the vehicle about its thrust
    assert r[:, 1] @ heading == pytest.approx(0.0, abs=1e-12)
    assert r[:, 0] @ heading > 0.0


def test_desired_rotation_when_level_is_the_yaw() -> None:
    r = desired_rotation(np.array([0.0, 0, 5.0]), 0.7)
    np.testing.assert_allclose(r, Rotation.from_euler("z", 0.7).as_matrix(), atol=1e-15)


@given(force=st.tuples(*[st.floats(-40, 40)] * 3).map(np.array))
def test_tilt_limit(force: np.ndarray) -> None:
    out = tilt_limited(force, CONFIG)
    tilt = np.arctan2(np.hypot(out[0], out[1]), out[2])
    assert tilt <= CONFIG.max_tilt + 1e-12
    assert out[2] == max(force[2], 0.3 * WEIGHT)
    assert out[0] * force[1] == pytest.approx(out[1] * force[0], abs=1e-9)
    if np.hypot(force[0], force[1]) <= out[2] * np.tan(CONFIG.max_tilt):
        np.testing.assert_array_equal(out[:2], force[:2])


@given(turn=st.tuples(*[st.floats(-np.pi, np.pi)] * 3).map(np.array))
def test_rate_reference_can_always_be_braked(turn: np.ndarray) -> None:
    """Half the torque on the heaviest inertia brakes it all the way: w dw/d|angle| <= M / (2 I (1 + range))."""
    rates = rate_reference(turn, 12.0, CONFIG)
    heaviest = (1.0 + CONFIG.mass_range) * np.array(CONFIG.nominal.inertia)
    braking = 0.5 * np.array(CONFIG.max_torque) / heaviest
    assert np.all(np.abs(rates) <= 12.0)
    assert np.all(rates * turn >= 0.0)
    step = 1e-6
    more = rate_reference(turn + step * np.sign(turn), 12.0, CONFIG)
    asked = np.abs(rates) * (np.abs(more) - np.abs(rates)) / step
    assert np.all(asked <= braking * (1.0 + 1e-3) + 1e-3)


def test_rate_reference_is_proportional_near_zero() -> None:
    turn = np.array([0.01, -0.02, 0.015])
    tilt, yaw = CONFIG.attitude_gain
    np.testing.assert_allclose(rate_reference(turn, 12.0, CONFIG), turn * [tilt, tilt, yaw])


def at_rest(attitude: tuple[float, float, float]) -> np.ndarray:
    return initial_state(np.zeros(3), np.array(attitude), plant_config(SCENARIO, 1))


def control(own: np.ndarray, k: int, carried, config: ControllerConfig = CONFIG, velocity=None):
    still = np.zeros(3)
    command = VelocityReference(still if velocity is None else velocity, still, still, still, 0.0)
    clock = Clock(k * DT, k * DT, DT)
    return laws.quadrotor_control(
        odometry_tuple(own), tuples(command), carried, clock, config, 12.0
    )


def fresh(own: np.ndarray) -> AdaptationState:
    return AdaptationState(CONFIG.nominal, (0.0, 0.0), initial_observer(velocity_enu(own)))


@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)])
def test_at_rest_the_first_thrust_carries_the_weight(attitude) -> None:
    """Table 2 starts at (1, 1, 1): the thrust is that of hovering, whatever the attitude is."""
    own = odometry(at_rest(attitude), plant_config(SCENARIO, 1))
    out = control(own, 0, fresh(own))
    np.testing.assert_allclose(out.force, [0, 0, WEIGHT], rtol=1e-12)
    if attitude == (0.0, 0.0, 0.0):
        np.testing.assert_allclose(out.torque, np.zeros(3), atol=1e-12)
        assert not out.saturated


def flown(
    start: np.ndarray, seconds: float, push=None, config: ControllerConfig = CONFIG, plant=None
):
    """Tilt [rad], velocity (T, 3) and observer (T, 3) of a closed loop that asks for standstill."""
    none = six(np.zeros(6))
    push = none if push is None else six(push)
    plant = plant_config(SCENARIO, 1) if plant is None else plant
    plant = plant._replace(amplitude=none, phase=none, offset=push)
    state = start
    carried = fresh(odometry(state, plant))
    tilts, velocities, observers = [], [], []
    for k in range(round(seconds / DT)):
        own = odometry(state, plant)
        out = control(own, k, carried, config)
        carried = out.adapted
        tilts.append(np.arccos(np.clip(rotation_from_quaternion(own[3:7])[2, 2], -1.0, 1.0)))
        velocities.append(velocity_enu(own))
        observers.append(carried.observer.disturbance)
        advance(state, np.array([*out.force, *out.torque]), k * DT, DT, 5, plant)
    return np.array(tilts), np.array(velocities), np.array(observers)


@pytest.mark.slow
@pytest.mark.parametrize(
    "attitude", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (1.0, 1.0, 1.0), (2.5, 0.0, 0.5)]
)
def test_recovery_from_a_tilt(attitude) -> None:
    tilts, velocities, _ = flown(at_rest(attitude), 6.0)
    assert tilts[0] > 0.9
    assert tilts[60:].max() <= CONFIG.max_tilt + 0.1  # upright, or leaning to brake, within 0.6 s
    assert tilts[400:].max() < 0.02
    assert np.abs(velocities[400:]).max() < 0.05


def test_observer_converges_to_a_constant_push() -> None:
    """Without the mass estimate, which would take its share of a vertical push."""
    push = np.array([0.5, -0.3, 0.2, 0.0, 0.0, 0.0])
    config = CONFIG._replace(adaptation=(0.0, 0.0))
    _, velocities, observers = flown(at_rest((0.0, 0.0, 0.0)), 8.0, push, config)
    np.testing.assert_allclose(observers[-1], push[:3], atol=1e-3)
    np.testing.assert_allclose(velocities[-1], np.zeros(3), atol=1e-3)


def test_observer_keeps_the_velocity_error_of_a_push_small() -> None:
    push = np.array([0.8, 0.0, 0.0, 0.0, 0.0, 0.0])
    ends = []
    for bandwidth in (0.0, 8.0):
        config = CONFIG._replace(observer_bandwidth=bandwidth, bound_rate=0.0)
        _, velocities, _ = flown(at_rest((0.0, 0.0, 0.0)), 6.0, push, config)
        ends.append(abs(velocities[-1, 0]))
    # without it the loop's gain (and a drag of 0.1 1/s) leave push / (kappa + drag)
    assert ends[0] == pytest.approx(0.8 / (CONFIG.force.kappa + 0.1), rel=0.02)
    assert ends[1] < 1e-3


@pytest.mark.parametrize("mass", [0.84, 1.2, 1.56])
def test_the_gain_of_the_velocity_is_that_of_the_mass_as_estimated(mass: float) -> None:
    """d f / d v = -m_hat G: a light vehicle has the gain G as any other one once its mass is known."""
    own = odometry(at_rest((0.0, 0.0, 0.0)), plant_config(SCENARIO, 1))
    known = fresh(own)._replace(parameters=CONFIG.nominal._replace(mass=mass))
    step, thrusts = 1e-4, []
    for sign in (1.0, -1.0):
        out = control(own, 500, known, velocity=np.array([0.0, 0.0, sign * step]))
        thrusts.append(out.force[2])
    slope = (thrusts[0] - thrusts[1]) / (2.0 * step)
    assert slope == pytest.approx(mass * CONFIG.force.kappa, rel=1e-6)


def test_a_torque_at_its_limit_does_not_keep_the_mass_from_being_learned() -> None:
    own = odometry(at_rest((0.0, 0.0, 0.0)), plant_config(SCENARIO, 1))
    own[9], own[10] = 0.2, 40.0  # it climbs, so it is lighter than known
    before = fresh(own)
    out = control(own, 50, before)
    assert out.saturated
    model = CONFIG.gravity * own[9]
    learned = CONFIG.nominal.mass - DT * CONFIG.adaptation[0] * model
    assert out.adapted.parameters.mass == pytest.approx(learned, rel=1e-12)
    assert out.adapted.parameters.inertia == CONFIG.nominal.inertia
    assert out.adapted.bound == before.bound


@pytest.mark.parametrize("heading", [2.36, 3.14, 3.93, 5.5])
def test_a_light_and_sluggish_vehicle_comes_level_in_wind(heading: float) -> None:
    """From a start that is tilted by 1 rad about each axis, at 3 m/s against the wind: it went on swinging for ever."""
    plant = plant_config(SCENARIO, 1)
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    unlike = plant._replace(
        mass=0.7 * plant.mass,
        inertia=(plant.inertia[0], 1.3 * plant.inertia[1], plant.inertia[2]),
        wind=8.0 * ahead,
    )
    start = at_rest((1.0, 1.0, 1.0))
    start[7:10] = -3.0 * ahead
    tilts, velocities, _ = flown(start, 5.0, plant=unlike)
    assert np.ptp(tilts[400:]) < 0.1
    assert np.abs(velocities[400:]).max() < 0.1


@pytest.mark.parametrize("scale", [0.8, 1.25])
def test_a_wrong_mass_costs_so_much_height(scale: float) -> None:
    """The integral of the velocity is Gamma (m_0 - m) / g, whatever the gains of the velocity loop are."""
    config = CONFIG._replace(observer_bandwidth=0.0, bound_rate=0.0)
    plant = plant_config(SCENARIO, 1)
    unlike = plant._replace(mass=scale * plant.mass, drag=0.0)
    _, velocities, _ = flown(at_rest((0.0, 0.0, 0.0)), 8.0, config=config, plant=unlike)
    wrong = CONFIG.nominal.mass * (1.0 - scale)
    height = wrong / CONFIG.adaptation[0] / CONFIG.gravity
    assert DT * velocities[:, 2].sum() == pytest.approx(height, rel=0.02)


def test_limits_are_kept_and_told() -> None:
    own = odometry(at_rest((0.0, 0.0, 0.0)), plant_config(SCENARIO, 1))
    own[10:13] = [40.0, -40.0, 40.0]
    out = control(own, 50, fresh(own), velocity=np.array([50.0, 0.0, 50.0]))
    assert out.saturated
    assert out.force[2] == CONFIG.max_thrust
    np.testing.assert_allclose(out.torque, CONFIG.max_torque * np.array([-1, 1, -1]))
    assert out.adapted.parameters == CONFIG.nominal
