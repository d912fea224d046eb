"""How vehicles step: the lock-step scheduler, and in real time what a wrench that is late does to them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from hypothesis import given
from hypothesis import strategies as st

from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm.graph import LEAD_TICKS
from ptnsbc_nodes.sim.stepping import LockstepScheduler, RealTimeWorld
from ptnsbc_sim.plants.build import plant_config
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.world import World

IDS = (1, 2, 3)


def publish_all(scheduler: LockstepScheduler) -> list[int]:
    due = scheduler.due()
    for i in due:
        scheduler.mark_published(i)
    return due


def test_one_vehicle_need_not_wait_for_another():
    scheduler = LockstepScheduler(IDS, 9, (5,))
    assert publish_all(scheduler) == [1, 2, 3]
    assert scheduler.due() == []
    scheduler.step(2)
    assert publish_all(scheduler) == [2]
    assert (scheduler.at(2), scheduler.slowest) == (1, 0)
    assert scheduler.awaited(2)


def test_all_wait_at_a_meeting():
    scheduler = LockstepScheduler(IDS, 9, (2, 3))
    for _ in range(2):
        publish_all(scheduler)
        scheduler.step(1)
    assert (scheduler.at(1), publish_all(scheduler)) == (2, [])
    for i in (2, 3):
        scheduler.step(i)
        publish_all(scheduler)
        scheduler.step(i)
    assert sorted(publish_all(scheduler)) == [1, 2, 3]


@given(
    st.lists(st.sampled_from(IDS), min_size=30, max_size=200),
    st.lists(st.integers(1, 9), min_size=0, max_size=2),
)
def test_any_order_of_answers(answers: list[int], meetings: list[int]):
    scheduler = LockstepScheduler(IDS, 1000, meetings)
    for uav in answers:
        for i in publish_all(scheduler):
            assert scheduler.at(i) - scheduler.slowest <= LEAD_TICKS
            if any(scheduler.at(i) % period == 0 for period in meetings):
                assert {scheduler.at(j) for j in IDS} == {scheduler.at(i)}
        assert any(scheduler.awaited(i) for i in IDS)  # some UAV can always answer
        if scheduler.awaited(uav):
            scheduler.step(uav)
    publish_all(scheduler)
    assert scheduler.awaited(min(IDS, key=scheduler.at))  # and the slowest is never kept waiting


def test_the_state_at_the_end_is_not_published():
    scheduler = LockstepScheduler(IDS, 2, ())
    for _ in range(2):
        for i in publish_all(scheduler):
            scheduler.step(i)
    assert scheduler.slowest == 2
    assert scheduler.due() == []


STALLED = 12  # control periods of 10 ms


@pytest.fixture
def scenario() -> Scenario:
    return load_scenario("figure_eight")


def turning(scenario: Scenario) -> np.ndarray:
    """A wrench (6,) that carries the weight and turns the vehicle."""
    plant = plant_config(scenario, 1)
    return np.array([0.0, 0.0, plant.mass * plant.gravity, 0.4, 0.0, 0.0])


def flown(scenario: Scenario) -> tuple[World, RealTimeWorld]:
    world = World(scenario)
    publishers = SimpleNamespace(publish=lambda _now_ns: None)
    real_time = RealTimeWorld(scenario, world, publishers)
    for tick in range(3):
        now_ns = tick * scenario.timing.dt_ns
        real_time.on_wrench(1, Stamped(now_ns, turning(scenario)), now_ns)
        real_time.tick(now_ns)
    return world, real_time


def tilt(world: World) -> float:
    """Angle [rad] of UAV 1 from the vertical."""
    x, y = world.truth(1)[3:5]
    return float(np.arccos(1.0 - 2.0 * (x * x + y * y)))


def held(scenario: Scenario, periods: int) -> World:
    """A world in which the wrench is held for so long."""
    world = World(scenario)
    for _ in range(periods):
        world.step({1: turning(scenario)})
    return world


def test_a_wrench_in_time_or_one_period_late_acts_as_it_is(scenario: Scenario) -> None:
    world, real_time = flown(scenario)
    for tick in (3, 4):
        real_time.tick(tick * scenario.timing.dt_ns)
    np.testing.assert_array_equal(world.truth(1), held(scenario, 5).truth(1))


@pytest.mark.parametrize("at_once", [False, True], ids=["the UAV", "the sim as well"])
def test_a_vehicle_keeps_its_attitude_while_a_process_stands_still(
    scenario: Scenario, at_once: bool
) -> None:
    """Its last torque turned it by 10 degrees in 0.12 s, and on at 3 rad/s."""
    world, real_time = flown(scenario)
    last = 2 + STALLED
    for tick in [last] if at_once else range(3, last + 1):
        real_time.tick(tick * scenario.timing.dt_ns)
    assert world.tick == last + 1
    over = held(scenario, last + 1)
    assert tilt(over) > 3.0 * tilt(world)
    assert over.truth(1)[10] > 2.0
    assert abs(world.truth(1)[10]) < 0.05
    assert "uav1" not in real_time.hovering(last * scenario.timing.dt_ns)
