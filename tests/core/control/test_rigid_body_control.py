"""Controller (39)-(42), (49)-(52) on the plant that it is written for."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from on_arrays import on_arrays, tuples

from ptnsbc_core.algebra import odometry_tuple
from ptnsbc_core.control import rigid_body_control as laws
from ptnsbc_core.control.rigid_body_control import (
    VelocityReference,
    adapt_bound,
    adapt_parameters,
    filter_step,
    initial_observer,
    observer_step,
)
from ptnsbc_core.kinematics import quaternion_from_euler, rotation_from_euler
from ptnsbc_core.timebase import Clock
from ptnsbc_core.types import (
    PROFILE_PAPER,
    AdaptationState,
    ControllerConfig,
    InertialParameters,
    LoopGain,
)
from ptnsbc_sim.plants import rigid_body
from ptnsbc_sim.plants.contract import PlantConfig, six
from ptnsbc_sim.plants.integrate import advance, initial_state, odometry
from ptnsbc_sim.scenario import agent_config, load_scenario

sliding_term = on_arrays(laws.sliding_term)
torque_model = on_arrays(laws.torque_model)
torque_regressor_error = on_arrays(laws.torque_regressor_error)

MASS, INERTIA, GRAVITY = 1.2, np.array([0.019, 0.022, 0.031]), 9.81
seeds = st.integers(0, 2**31)
SCENARIO = load_scenario("paper_5", {"plant.kind": "rigid_body_6dof"})


def psi(numbers: np.ndarray) -> InertialParameters:
    return InertialParameters(float(numbers[0]), tuples(numbers[1:4]))


class Controlled(NamedTuple):
    """What the law gives, as arrays."""

    wrench: np.ndarray
    parameters: np.ndarray
    bound: np.ndarray
    saturated: bool
    velocity_error: float


def control(own, command, parameters, bound, clock, config) -> Controlled:
    """`rigid_body_control` with Psi_hat (4,) and delta_hat (2,)."""
    before = AdaptationState(psi(parameters), tuples(bound), initial_observer((0.0, 0.0, 0.0)))
    out = laws.rigid_body_control(odometry_tuple(own), tuples(command), before, clock, config)
    learned = out.adapted
    return Controlled(
        np.array([*out.force, *out.torque]),
        np.array([learned.parameters.mass, *learned.parameters.inertia]),
        np.array(learned.bound),
        out.saturated,
        out.velocity_error,
    )


NOMINAL = np.array([MASS, *INERTIA])


def config_of(**changes) -> ControllerConfig:
    """Nothing adapts and nothing limits unless asked."""
    base = agent_config(SCENARIO, 1).controller._replace(
        nominal=psi(np.array([MASS, *INERTIA])),
        force=LoopGain(1.0, 1e-3, 1.0, 0.0, PROFILE_PAPER),
        torque=LoopGain(1.0, 1e-3, 1.0, 0.0, PROFILE_PAPER),
        adaptation=(0.0, 0.0),
        bound_rate=0.0,
        bound_leak=0.0,
        max_thrust=1e9,
        max_torque=(1e9, 1e9, 1e9),
    )
    return base._replace(**changes)


def plant_of(push: np.ndarray | None = None, mass: float = MASS) -> PlantConfig:
    none = six(np.zeros(6))
    return PlantConfig(
        0,
        mass,
        tuples(INERTIA),
        GRAVITY,
        np.inf,
        (np.inf, np.inf, np.inf),
        0.0,
        0.0,
        np.zeros(3),
        none,
        none,
        none if push is None else six(push),
    )


def skew(a: np.ndarray) -> np.ndarray:
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def own_of(euler: np.ndarray, velocity: np.ndarray, rates: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros(3), quaternion_from_euler(euler), velocity, rates])


def acceleration(euler, velocity, rates, wrench) -> tuple[np.ndarray, np.ndarray]:
    """World acceleration (3,) and angular acceleration (3,) of the plant under a wrench."""
    x = np.zeros(17)
    x[3:6], x[6:9], x[9:12] = euler, velocity, rates
    out = np.empty(17)
    rigid_body.derivative(x, wrench, np.zeros(6), plant_of(), out)
    r = rotation_from_euler(euler)
    return r @ (out[6:9] + np.cross(rates, velocity)), out[9:12]


def random_motion(seed: int):
    rng = np.random.default_rng(seed)
    euler = rng.uniform(-1.2, 1.2, 3)
    return rng, euler, rng.normal(size=3), rng.normal(size=3)


@given(seed=seeds)
def test_coriolis_terms_do_no_work(seed: int) -> None:
    """C = blkdiag(m S(w), -S(I w)) is skew: V.CV = 0, for any reference V."""
    rates, reference = np.random.default_rng(seed).normal(size=(2, 3))
    turning = torque_model(rates, reference, np.zeros(3), INERTIA)
    assert reference @ turning == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(turning, -skew(INERTIA * rates) @ reference, atol=1e-15)
    # along the motion itself it is Euler's gyroscopic torque
    own = torque_model(rates, rates, np.zeros(3), INERTIA)
    np.testing.assert_allclose(own, np.cross(rates, INERTIA * rates), atol=1e-15)


def test_printed_40_is_no_inertia() -> None:
    """blkdiag(S(w), -Q^-1 S(w) Q): of rank 4 at every body rate, so (39)'s Omega^-1 does not exist."""
    for rates in np.random.default_rng(0).normal(size=(20, 3)):
        q = np.diag(INERTIA)
        printed = np.zeros((6, 6))
        printed[:3, :3] = skew(rates)
        printed[3:, 3:] = -np.linalg.inv(q) @ skew(rates) @ q
        assert np.linalg.matrix_rank(printed) == 4


@given(seed=seeds)
def test_regressor_is_the_derivative_of_the_model(seed: int) -> None:
    rates, reference, dot, error = np.random.default_rng(seed).normal(size=(4, 3))
    columns = torque_regressor_error(rates, reference, dot, error)
    assert columns @ INERTIA == pytest.approx(error @ torque_model(rates, reference, dot, INERTIA))


@given(seed=seeds)
def test_without_error_the_body_does_what_the_reference_does(seed: int) -> None:
    rng, euler, velocity, rates = random_motion(seed)
    command = VelocityReference(
        rotation_from_euler(euler) @ velocity, rng.normal(size=3), rates, rng.normal(size=3), 0.0
    )
    config = config_of()
    own, clock = own_of(euler, velocity, rates), Clock(0.0, 0.0, 0.01)
    out = control(own, command, NOMINAL, np.zeros(2), clock, config)
    linear, angular = acceleration(euler, velocity, rates, out.wrench)
    np.testing.assert_allclose(linear, command.acceleration, atol=1e-11)
    np.testing.assert_allclose(angular, command.rates_dot, atol=1e-11)
    assert out.velocity_error == pytest.approx(0.0, abs=1e-12)
    assert not out.saturated


@given(seed=seeds)
def test_error_dynamics_are_those_of_the_design(seed: int) -> None:
    """World velocity error: R(-G e - delta sat(e)); rate error: I e_dot = I w x e - I(G e + delta sat(e))."""
    rng, euler, velocity, rates = random_motion(seed)
    command = VelocityReference(*rng.normal(size=(4, 3)), 0.0)
    config, bound, clock = config_of(), np.array([0.7, 1.3]), Clock(0.4, 0.4, 0.01)
    own = own_of(euler, velocity, rates)
    out = control(own, command, NOMINAL, bound, clock, config)
    linear, angular = acceleration(euler, velocity, rates, out.wrench)
    r = rotation_from_euler(euler)
    error, rate_error = velocity - r.T @ command.velocity, rates - command.rates
    feedback = sliding_term(error, config.force, bound[0], config.boundary[0], clock)
    np.testing.assert_allclose(linear - command.acceleration, r @ feedback, atol=1e-10)
    turning = sliding_term(rate_error, config.torque, bound[1], config.boundary[1], clock)
    expected = np.cross(INERTIA * rates, rate_error) / INERTIA + turning
    np.testing.assert_allclose(angular - command.rates_dot, expected, atol=1e-10)


def test_sliding_term_by_hand() -> None:
    gain = LoopGain(1.0, 1e-3, 2.0, 3.0, PROFILE_PAPER)
    out = sliding_term(np.array([0.1, -1.0, 0.0]), gain, 0.5, 0.2, Clock(5.0, 5.0, 0.01))
    np.testing.assert_allclose(out, [-0.6 - 0.25, 6.0 + 0.5, 0.0])


def closed_loop(
    state: np.ndarray,
    config: ControllerConfig,
    plant: PlantConfig,
    seconds: float,
    dt: float,
    each=lambda *_: None,
):
    """Rigid body held at zero velocity and rates; `each` sees (error, parameters, bound) at every tick."""
    parameters = np.array([config.nominal.mass, *config.nominal.inertia])
    bound, state = np.zeros(2), state.copy()
    command = VelocityReference(np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), 0.0)
    for k in range(round(seconds / dt)):
        own = odometry(state, plant)
        each(state[6:12], parameters, bound)
        clock = Clock(k * dt, k * dt, dt)
        out = control(own, command, parameters, bound, clock, config)
        parameters, bound = out.parameters, out.bound
        advance(state, out.wrench, k * dt, dt, 1, plant)
    return state, parameters, bound


@pytest.mark.slow
@pytest.mark.parametrize("dt", [0.01, 0.002])
def test_velocity_error_reaches_the_residual_at_tf3(dt: float) -> None:
    plant, config = plant_of(), config_of()
    state = initial_state(np.zeros(3), np.array([0.5, 0.4, 2.0]), plant)
    start = np.array([1.0, -2.0, 0.5])
    state[6:9] = start
    state, _, _ = closed_loop(state, config, plant, 1.0, dt)
    np.testing.assert_allclose(state[6:9], start * 1e-3 / 1.001, rtol=1e-6)


def test_rate_error_reaches_the_residual_at_tf3() -> None:
    """About one axis exactly; tumbling about all three no more than that of the kinetic energy."""
    plant, config = plant_of(), config_of()
    for rates in ([0.0, 2.0, 0.0], [0.6, -0.8, 1.0]):
        state = initial_state(np.zeros(3), np.zeros(3), plant)
        state[9:12] = rates
        energy = np.sum(INERTIA * state[9:12] ** 2)
        state, _, _ = closed_loop(state, config, plant, 1.0, 0.002)
        left = np.sqrt(np.sum(INERTIA * state[9:12] ** 2) / energy)
        assert left == pytest.approx(1e-3 / 1.001, rel=1e-2)


@given(seed=seeds)
def test_lyapunov_rate_is_minus_the_feedback(seed: int) -> None:
    """d/dt (Omega V~.V~ + Gamma Psi~^2) / 2 = -Omega_0 G V~.V~ whatever Psi_hat is: (49) and (50) cancel."""
    rng, euler, velocity, rates = random_motion(seed)
    truth = np.array([MASS, *INERTIA])
    estimate = truth * rng.uniform(0.8, 1.2, 4)
    adaptation = (0.4, 1e-4)
    loop = LoopGain(1.0, 0.1, 1.0, 5.0, PROFILE_PAPER)
    config = config_of(force=loop, torque=loop, adaptation=adaptation, mass_range=0.9)
    command, dt = VelocityReference(*rng.normal(size=(4, 3)), 0.0), 0.01
    clock = Clock(2.0, 2.0, dt)
    own = own_of(euler, velocity, rates)
    out = control(own, command, estimate, np.zeros(2), clock, config)
    linear, angular = acceleration(euler, velocity, rates, out.wrench)
    r = rotation_from_euler(euler)
    error, rate_error = r @ velocity - command.velocity, rates - command.rates
    moved = (out.parameters - estimate) / dt
    gamma = 1.0 / np.array([adaptation[0], *[adaptation[1]] * 3])
    fall = MASS * error @ (linear - command.acceleration)
    fall += INERTIA * rate_error @ (angular - command.rates_dot)
    fall += gamma * (estimate - truth) @ moved
    expected = -5.0 * (MASS * error @ error + INERTIA @ rate_error**2)
    assert fall == pytest.approx(expected, rel=1e-6)


WRONG = np.array([1.0, 0.019, 0.022, 0.031])  # 1.0 kg where there are 1.2


def energies(adaptation: float) -> tuple[np.ndarray, float]:
    """V = (Omega V~.V~ + Gamma Psi~^2) / 2 over 6 s with a wrong mass, and the mass found."""
    truth = np.array([MASS, *INERTIA])
    config = config_of(
        nominal=psi(WRONG),
        force=LoopGain(1.0, 0.1, 1.0, 5.0, PROFILE_PAPER),
        torque=LoopGain(1.0, 0.1, 1.0, 5.0, PROFILE_PAPER),
        adaptation=(adaptation, 0.0),
        mass_range=0.9,
    )
    plant, seen = plant_of(), []

    def note(error, parameters, _):
        kinetic = truth[0] * error[:3] @ error[:3] + truth[1:] @ error[3:] ** 2
        seen.append(0.5 * (kinetic + (parameters[0] - MASS) ** 2 / abs(adaptation)))

    state = initial_state(np.zeros(3), np.array([0.3, -0.2, 1.0]), plant)
    state[6:9] = [0.5, 0.2, -0.4]
    _, parameters, _ = closed_loop(state, config, plant, 6.0, 1e-3, note)
    return np.array(seen), parameters[0]


def test_lyapunov_function_falls_and_the_mass_is_found() -> None:
    energy, mass = energies(0.4)
    assert np.all(np.diff(energy[::500]) < 0.0)
    assert energy[-1] < 1e-6 * energy[0]
    assert mass == pytest.approx(MASS, rel=1e-3)


def test_other_sign_of_50_runs_away() -> None:
    energy, mass = energies(-0.4)
    assert energy[-1] > energy[0]
    assert mass == pytest.approx(0.1)  # at the far end of its range, 1.0 (1 - 0.9)


def test_bound_takes_a_constant_push_into_the_boundary() -> None:
    push = np.array([0.5, -0.3, 0.2, 0.0, 0.0, 0.0])
    config = config_of(
        force=LoopGain(1.0, 1e-2, 1.0, 2.0, PROFILE_PAPER),
        torque=LoopGain(1.0, 1e-2, 1.0, 2.0, PROFILE_PAPER),
        bound_rate=2.5,
        bound_dead_zone=(0.01, 0.02),
        bound_cap=(2.0, 5.0),
        boundary=(0.05, 0.1),
    )
    plant = plant_of(push)
    state = initial_state(np.zeros(3), np.zeros(3), plant)
    with_bound, _, bound = closed_loop(state, config, plant, 10.0, 0.002)
    without, _, _ = closed_loop(state, config._replace(bound_rate=0.0), plant, 10.0, 0.002)
    np.testing.assert_allclose(without[6:9], push[:3] / 2.0, rtol=1e-6)
    assert bound[0] <= 2.0
    # K e + delta e / width = push, or the edge of the dead zone, whichever comes first
    expected = push[:3] / (2.0 + bound[0] / 0.05)
    np.testing.assert_allclose(with_bound[6:9], expected, rtol=1e-2)


def test_limits_are_kept_told_and_freeze_the_adaptation() -> None:
    config = config_of(
        max_thrust=10.0, max_torque=(0.1, 0.2, 0.3), adaptation=(1.0, 1.0), bound_rate=1.0
    )
    own = own_of(np.zeros(3), np.array([9.0, 0, 0]), np.array([50.0, -50, 50]))
    command = VelocityReference(np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), 0.0)
    clock = Clock(0.5, 0.5, 0.01)
    out = control(own, command, NOMINAL, np.zeros(2), clock, config)
    assert out.saturated
    assert np.linalg.norm(out.wrench[:3]) == pytest.approx(10.0)
    np.testing.assert_allclose(out.wrench[3:], [-0.1, 0.2, -0.3])
    np.testing.assert_array_equal(out.parameters, NOMINAL)
    np.testing.assert_array_equal(out.bound, np.zeros(2))


observer_step = on_arrays(observer_step)
observer_at = on_arrays(initial_observer)

DT = 0.01


@pytest.fixture(scope="module")
def config() -> ControllerConfig:
    return agent_config(load_scenario("paper_5"), 1).controller._replace(
        adaptation=(0.4, 0.2),
        mass_range=0.3,
        bound_rate=2.5,
        bound_leak=0.1,
        bound_dead_zone=(0.01, 0.02),
        bound_cap=(2.0, 5.0),
        observer_bandwidth=8.0,
    )


def test_parameters_move_against_the_regressor(config: ControllerConfig) -> None:
    nominal = config.nominal
    out = adapt_parameters(nominal, InertialParameters(1.0, (-0.1, 0.0, 0.2)), DT, config)
    assert out.mass - nominal.mass == pytest.approx(-DT * 0.4, abs=1e-15)
    moved = np.array(out.inertia) - nominal.inertia
    np.testing.assert_allclose(moved, -DT * 0.2 * np.array([-0.1, 0.0, 0.2]), atol=1e-15)


def test_parameters_stay_in_their_range(config: ControllerConfig) -> None:
    nominal = config.nominal
    for sign, edge in ((1.0, 0.7), (-1.0, 1.3)):
        out, much = nominal, sign * 1e4
        for _ in range(100):
            out = adapt_parameters(out, InertialParameters(much, (much, much, much)), DT, config)
        assert out.mass == pytest.approx(edge * nominal.mass)
        np.testing.assert_allclose(out.inertia, edge * np.array(nominal.inertia))


def test_bound_is_capped_where_the_printed_one_grows_for_ever(config: ControllerConfig) -> None:
    """A constant error of 0.2 m/s, as noise leaves it: (51) adds 0.5 m/s^2 every second, for ever."""
    bound = printed = 0.0
    for _ in range(10_000):
        bound = adapt_bound(bound, 0.2, 0, DT, config)
        printed += DT * config.bound_rate * 0.2
    assert printed == pytest.approx(50.0)
    assert bound == 2.0


def test_bound_settles_where_leak_and_growth_meet(config: ControllerConfig) -> None:
    bound = 0.0
    for _ in range(20_000):
        bound = adapt_bound(bound, 0.04, 0, DT, config)
    assert bound == pytest.approx(2.5 * 0.04 / 0.1)


def test_bound_leaks_inside_its_dead_zone(config: ControllerConfig) -> None:
    bound = 1.0
    for _ in range(1000):
        bound = adapt_bound(bound, 0.009, 0, DT, config)
    assert bound == pytest.approx((1.0 - 0.1 * DT) ** 1000)


def push_seen(push: np.ndarray, ticks: int, config: ControllerConfig, dt=DT, frozen=False):
    """Observer after `ticks` of a body under a known acceleration and an unknown `push`."""
    velocity, told = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.0, -0.2])
    observer = observer_at(velocity)
    for _ in range(ticks):
        observer = observer._replace(acceleration=told)
        velocity = velocity + dt * (told + push)
        observer = observer_step(observer, velocity, frozen, dt, config)
    return observer


def test_observer_has_three_poles_at_its_bandwidth(config: ControllerConfig) -> None:
    """The observer misses (1 + w t - (w t)^2) exp(-w t) of a constant push after t."""
    push, dt = np.array([0.5, -0.3, 0.2]), 1e-4
    for ticks in (500, 2000, 5000):
        wt = 8.0 * ticks * dt
        seen = push_seen(push, ticks, config, dt).disturbance
        np.testing.assert_allclose(1.0 - seen / push, (1 + wt - wt * wt) * np.exp(-wt), atol=1e-3)


def test_observer_follows_a_swaying_push_to_second_order(config: ControllerConfig) -> None:
    """At 1 rad/s the share that is missed is |s^2 (s + 3 w) / (s + w)^3| at s = j: 0.046 for w = 8 1/s."""
    dt, s, w = 1e-3, 1j, 8.0
    observer, velocity, missed = observer_at(np.zeros(3)), np.zeros(3), []
    for tick in range(12_000):
        push = np.array([np.sin(tick * dt), 0.0, 0.0])
        velocity = velocity + dt * push
        observer = observer_step(observer, velocity, False, dt, config)
        missed.append(abs(observer.disturbance[0] - push[0]))
    assert max(missed[-7000:]) == pytest.approx(abs(s**2 * (s + 3 * w) / (s + w) ** 3), rel=0.03)


def test_observer_finds_a_constant_push(config: ControllerConfig) -> None:
    push = np.array([0.5, -0.3, 0.2])
    np.testing.assert_allclose(push_seen(push, 600, config).disturbance, push, atol=1e-12)


def test_observer_is_capped_and_can_be_frozen(config: ControllerConfig) -> None:
    push = np.array([9.0, -9.0, 0.0])
    np.testing.assert_allclose(
        push_seen(push, 400, config).disturbance, [2.0, -2.0, 0.0], atol=1e-9
    )
    np.testing.assert_array_equal(
        push_seen(push, 400, config, frozen=True).disturbance, np.zeros(3)
    )


filter_step = on_arrays(filter_step)

vectors = arrays(np.float64, 3, elements=st.floats(-10.0, 10.0))


@given(state=vectors, target=vectors, bandwidth=st.floats(0.1, 500.0), limit=st.floats(0.1, 50.0))
def test_rate_is_limited_and_is_what_the_value_did(
    state: np.ndarray, target: np.ndarray, bandwidth: float, limit: float
) -> None:
    dt = 0.01
    out = filter_step(state, target, np.zeros(3), bandwidth, limit, dt)
    np.testing.assert_allclose(out.value, state + dt * out.rate, atol=1e-12)
    assert np.linalg.norm(out.rate) <= limit * (1.0 + 1e-9)
    # never past the target, whatever the bandwidth
    assert np.linalg.norm(target - out.value) <= np.linalg.norm(target - state) + 1e-9
    asked = min(bandwidth, 1.0 / dt) * (target - state)
    assert out.saturated == (np.linalg.norm(asked) > limit)
    np.testing.assert_allclose(np.cross(out.rate, target - state), np.zeros(3), atol=1e-6)


def test_step_response_is_first_order() -> None:
    state, target = np.zeros(3), np.array([1.0, -2.0, 0.5])
    for k in range(1, 101):
        state = filter_step(state, target, np.zeros(3), 4.0, 1e9, 0.01).value
        np.testing.assert_allclose(state, target * (1.0 - (1.0 - 0.04) ** k), atol=1e-12)


def test_a_switched_command_gives_no_impulse() -> None:
    """The command jumps by 6 m/s: the rate stays at the limit for the 0.6 s that the jump takes."""
    state, target = np.array([-3.0, 0, 0]), np.array([3.0, 0, 0])
    rates = []
    for _ in range(100):
        out = filter_step(state, target, np.zeros(3), 100.0, 10.0, 0.01)
        state = out.value
        rates.append(out.rate[0])
    assert max(rates) == pytest.approx(10.0)
    assert sum(rate > 9.999 for rate in rates) in (59, 60)
    np.testing.assert_allclose(state, target, atol=1e-9)


def test_a_target_with_a_known_rate_is_followed_without_lag() -> None:
    rate, dt = np.array([0.6, -0.4, 0.2]), 0.01
    state = target = np.array([1.0, 2.0, 3.0])
    for _ in range(200):
        state = filter_step(state, target, rate, 20.0, 5.0, dt).value
        target = target + dt * rate
    np.testing.assert_allclose(state, target, atol=1e-12)


def test_the_limit_holds_with_a_lead() -> None:
    out = filter_step(np.zeros(3), np.zeros(3), np.array([9.0, 0.0, 0.0]), 20.0, 5.0, 0.01)
    assert out.saturated
    np.testing.assert_allclose(out.rate, [5.0, 0.0, 0.0])
