"""Adaptation (50), (51) and the observer: directions, bounds, and the printed bound that never stops growing."""

import numpy as np
import pytest
from on_arrays import on_arrays

from ptnsbc_core.control.adaptation import (
    adapt_bound,
    adapt_parameters,
    initial_observer,
    observer_step,
)
from ptnsbc_core.types import ControllerConfig, InertialParameters
from ptnsbc_sim.scenario import agent_config, load_scenario

observer_step = on_arrays(observer_step)
initial_observer = on_arrays(initial_observer)

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
    observer = initial_observer(velocity)
    for _ in range(ticks):
        observer = observer._replace(acceleration=told)
        velocity = velocity + dt * (told + push)
        observer = observer_step(observer, velocity, frozen, dt, config)
    return observer


def test_observer_has_three_poles_at_its_bandwidth(config: ControllerConfig) -> None:
    """What is left of a constant push after t is (1 + w t - (w t)^2) exp(-w t) of it."""
    push, dt = np.array([0.5, -0.3, 0.2]), 1e-4
    for ticks in (500, 2000, 5000):
        wt = 8.0 * ticks * dt
        seen = push_seen(push, ticks, config, dt).disturbance
        np.testing.assert_allclose(1.0 - seen / push, (1 + wt - wt * wt) * np.exp(-wt), atol=1e-3)


def test_observer_follows_a_swaying_push_to_second_order(config: ControllerConfig) -> None:
    """At 1 rad/s the share that is missed is |s^2 (s + 3 w) / (s + w)^3| at s = j: 0.046 for w = 8 1/s."""
    dt, s, w = 1e-3, 1j, 8.0
    observer, velocity, missed = initial_observer(np.zeros(3)), np.zeros(3), []
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
