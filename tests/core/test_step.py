"""The control step as a whole: pure, and right when neighbours fall silent or a leg changes."""

from copy import deepcopy
from functools import lru_cache

import numpy as np
import pytest

from ptnsbc_core.agent import Agent, PackedOutputs
from ptnsbc_core.kinematics import store_estimate, velocity_enu
from ptnsbc_core.step import initial_state, step
from ptnsbc_core.types import (
    MODE_FORMATION,
    MODE_HOLD,
    MODE_LAND,
    NEVER_RECEIVED_S,
    AgentConfig,
    AgentInputs,
    Estimate,
)
from ptnsbc_sim.plants.build import plant_config
from ptnsbc_sim.plants.contract import six
from ptnsbc_sim.plants.integrate import advance, odometry
from ptnsbc_sim.plants.integrate import initial_state as plant_state
from ptnsbc_sim.scenario import agent_config, load_scenario

DT, TICK_NS = 0.01, 10_000_000
LEADER_AT = np.array([0.0, 0.0, 8.0])
PLANTS = ("quadrotor", "rigid_body_6dof")


@lru_cache
def scenario_of(plant: str):
    return load_scenario("paper_5_free", {"plant.kind": plant})


def config_of(uav: int, plant: str = "quadrotor") -> AgentConfig:
    return agent_config(scenario_of(plant), uav)


def message(position=LEADER_AT, velocity=(0.0, 0.0, 0.0), yaw: float = 0.0) -> np.ndarray:
    out = np.empty(13)
    store_estimate(
        out, Estimate(tuple(map(float, position)), tuple(map(float, velocity)), yaw), True
    )
    return out


def inputs_of(own: np.ndarray, start_age_s: float, **changes) -> AgentInputs:
    """A pinned follower beside a leader at rest, which is its parent as well."""
    heard = AgentInputs(
        own,
        message(),
        0.01,
        message(),
        0.01,
        np.empty((0, 13)),
        np.empty(0),
        np.empty((0, 8)),
        0.0,
        MODE_FORMATION,
        start_age_s,
    )
    return heard._replace(**changes)


def vector(estimate: Estimate) -> np.ndarray:
    return np.array([*estimate.position, *estimate.velocity, estimate.yaw])


def numbers(value) -> bytes:
    if hasattr(value, "_fields"):
        return b"".join(numbers(part) for part in value)
    return np.asarray(value).tobytes()


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("uav", [1, 2])
def test_step_changes_nothing_and_repeats_itself(plant: str, uav: int) -> None:
    config = config_of(uav, plant)
    state = initial_state(message((0.5, 0.2, 7.0)), config)
    near = np.array([[0.7, 0.4, 7.2, 1.5, 0.1, 0, 0, 0]])
    inputs = inputs_of(message((0.5, 0.2, 7.0), (0.4, 0, 0)), 2.0, near=near)
    before = deepcopy((state, inputs, config))
    first = step(state, inputs, 2.0, DT, config)
    assert numbers((state, inputs, config)[0]) == numbers(before[0])
    assert numbers(inputs) == numbers(before[1])
    for part, old in zip(config, before[2], strict=True):
        assert numbers(part) == numbers(old)
    second = step(state, inputs, 2.0, DT, config)
    assert numbers(first[0]) == numbers(second[0])
    assert numbers(first[1]) == numbers(second[1])
    assert first[1].diagnostics.active_rows == 1
    # nor does what comes out share memory with what went in
    for part in first[0]:
        if isinstance(part, np.ndarray):
            assert not any(
                np.shares_memory(part, old)
                for old in (*state, *inputs)
                if isinstance(old, np.ndarray)
            )


class Flown:
    """One UAV on its plant, with messages that the test makes up."""

    def __init__(self, uav: int, plant: str = "quadrotor", at=(0.0, 0.0, 0.0), config=None):
        self.plant = plant_config(scenario_of(plant), uav)._replace(amplitude=six(np.zeros(6)))
        self.body = plant_state(np.array(at, dtype=float), np.zeros(3), self.plant)
        self.agent = Agent(config or config_of(uav, plant), self.own)
        self.tick = 0
        self.told = []

    @property
    def own(self) -> np.ndarray:
        return odometry(self.body, self.plant)

    def fly(self, seconds: float, **changes) -> np.ndarray:
        """Positions (T, 3) of `seconds`; a callable change is asked for its value at every tick."""
        places = []
        for _ in range(round(seconds / DT)):
            t = self.tick * DT
            now = {key: (say(t) if callable(say) else say) for key, say in changes.items()}
            out = self.agent.step(inputs_of(self.own, t, **now), t, DT)
            self.told.append(PackedOutputs(out.vector.copy()))
            advance(self.body, out.wrench, t, DT, 5, self.plant)
            self.tick += 1
            places.append(self.body[:3].copy())
        return np.array(places)


@pytest.mark.parametrize("plant", PLANTS)
def test_follower_takes_its_place_beside_a_leader_at_rest(plant: str) -> None:
    flown = Flown(2, plant, at=(-3.0, -1.0, 5.0))
    places = flown.fly(6.0)
    wanted = LEADER_AT + scenario_of(plant).offset(2)
    assert np.linalg.norm(places[500] - wanted) < 0.05
    assert not flown.told[-1].diagnostics.holding
    np.testing.assert_allclose(flown.told[-1].diagnostics.error, np.zeros(3), atol=0.02)


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("silent", ["parent_age_s", "leader_age_s"])
def test_a_silent_neighbour_makes_it_hold_where_it_is(plant: str, silent: str) -> None:
    moving = {
        key: lambda t: message(LEADER_AT + np.array([0.5 * t, 0, 0]), (0.5, 0, 0))
        for key in ("parent", "leader")
    }
    flown = Flown(2, plant, at=LEADER_AT + scenario_of(plant).offset(2))
    flown.fly(6.0, **moving)
    stale = config_of(2, plant).stale_s
    last = moving["parent"](6.0)
    flown.fly(stale, parent=last, leader=last, **{silent: lambda t: t - 6.0})
    assert not flown.told[-1].diagnostics.holding
    where = flown.body[:3].copy()
    later = flown.fly(6.0, parent=last, leader=last, **{silent: lambda t: t - 6.0})
    assert flown.told[-1].diagnostics.holding
    assert np.linalg.norm(later[100:] - where, axis=1).max() < 0.4  # what 0.5 m/s takes to stop
    assert np.linalg.norm(velocity_enu(flown.own)) < 0.01
    # heard again, it goes on
    flown.fly(6.0, parent=message(), leader=message())
    assert not flown.told[-1].diagnostics.holding
    assert np.linalg.norm(flown.body[:3] - LEADER_AT - scenario_of(plant).offset(2)) < 0.05


def test_a_neighbour_never_heard_is_waited_for_and_then_held_for() -> None:
    flown = Flown(2, at=(1.0, 2.0, 3.0))
    silence = {"parent_age_s": NEVER_RECEIVED_S, "leader_age_s": NEVER_RECEIVED_S}
    stale = config_of(2).stale_s
    places = flown.fly(3.0, **silence)
    holding = [out.diagnostics.holding for out in flown.told]
    assert not any(holding[: round(stale / DT)])
    assert all(holding[round(stale / DT) + 1 :])
    np.testing.assert_allclose(places, np.tile([1.0, 2.0, 3.0], (300, 1)), atol=1e-3)


def test_a_neighbours_estimate_counts_until_it_is_stale() -> None:
    config = config_of(2)
    here = message((0.5, 0.2, 7.0))
    state = initial_state(here, config)._replace(estimate_valid=True)

    def estimated(ages: list[float], *neighbours: np.ndarray) -> bytes:
        heard = {"estimates": np.array(neighbours), "estimate_age_s": np.array(ages)}
        out = step(state, inputs_of(here, 2.0, **heard), 2.0, DT, config)
        return numbers(out[1].estimate)

    right, wrong = message(), message(LEADER_AT + 100.0)
    stale = config.stale_s
    assert estimated([0.01, stale], right, wrong) != estimated([0.01, stale], right, right)
    assert estimated([0.01, 1.01 * stale], right, wrong) == estimated([0.01], right)


@pytest.mark.parametrize("plant", PLANTS)
def test_hold_leg_stays_in_place_and_land_leg_descends_over_it(plant: str) -> None:
    flown = Flown(1, plant, at=(0.0, 5.0, 6.0))
    flown.fly(8.0)
    assert np.linalg.norm(velocity_enu(flown.own)) > 0.4  # on its circle
    where = flown.body[:3].copy()
    held = flown.fly(8.0, mode=MODE_HOLD)
    assert np.linalg.norm(held - where, axis=1).max() < 0.4
    assert np.linalg.norm(held[-1] - where) < 0.01
    landing = flown.fly(4.0, mode=MODE_LAND)
    assert np.linalg.norm(landing[:, :2] - where[:2], axis=1).max() < 0.02
    speed = (landing[-1, 2] - landing[-101, 2]) / 1.0
    assert speed == pytest.approx(-config_of(1, plant).land_speed, rel=1e-2)
    flown.fly(8.0)
    assert np.linalg.norm(velocity_enu(flown.own)) == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("plant", PLANTS)
def test_another_law_moves_a_follower_only_while_it_does_not_hold(plant: str) -> None:
    own, config = message(np.array([1.0, 2.0, 3.0])), config_of(2, plant)
    state, wanted = initial_state(own, config), (0.2, -0.1, 0.3)
    for mode in (MODE_HOLD, MODE_LAND):
        resting = inputs_of(own, 1.0, mode=mode)
        found = step(state, resting, 1.0, DT, config, wanted)
        assert str(found) == str(step(state, resting, 1.0, DT, config))
    for tick in range(100):
        inputs = inputs_of(own, tick * DT)
        state, out = step(state, inputs, tick * DT, DT, config, wanted)
    np.testing.assert_allclose(out.velocity, wanted, atol=1e-6)


def test_a_second_hold_is_where_the_second_hold_began() -> None:
    flown = Flown(1, at=(0.0, 5.0, 8.0))
    flown.fly(6.0)
    flown.fly(2.0, mode=MODE_HOLD)
    flown.fly(6.0)
    where = flown.body[:3].copy()
    held = flown.fly(6.0, mode=MODE_HOLD)
    assert np.linalg.norm(held[-1] - where) < 0.02


def test_first_message_of_the_leader_is_the_first_estimate() -> None:
    config = config_of(2)
    state = initial_state(message((1.0, 1, 1)), config)
    assert not state.estimate_valid
    leader = message((4.0, 5, 6), (0.0, 0, 0), 0.7)
    after, out = step(state, inputs_of(message((1.0, 1, 1)), 0.0, leader=leader), 0.0, DT, config)
    assert after.estimate_valid
    np.testing.assert_allclose(vector(after.estimate), [4, 5, 6, 0, 0, 0, 0.7], atol=1e-12)
    assert out.estimate == after.estimate


def test_an_unpinned_follower_learns_of_the_leader_from_its_neighbours() -> None:
    config = config_of(3)
    config = config._replace(estimator=config.estimator._replace(pinned=False))
    own = message((1.0, 1, 1))
    state = initial_state(own, config)
    for k in range(600):
        estimates = np.stack([message((4.0 + 0.5 * k * DT, 5, 6), (0.5, 0, 0), 0.3)])
        said = inputs_of(
            own,
            k * DT,
            leader_age_s=NEVER_RECEIVED_S,
            estimates=estimates,
            estimate_age_s=np.array([0.0]),
        )
        state, _ = step(state, said, k * DT, DT, config)
    # of the tick that the message is of, not of the one before
    np.testing.assert_allclose(
        vector(state.estimate), [4.0 + 0.5 * 5.99, 5, 6, 0.5, 0, 0, 0.3], atol=1e-6
    )
    # and not from one that has fallen silent: the estimate goes on with its velocity
    stale = said._replace(estimates=np.stack([message()]), estimate_age_s=np.array([9.0]))
    for k in range(50):
        state, out = step(state, stale, 6.0 + k * DT, DT, config)
    gone_on = [4.0 + 0.5 * 6.49, 5, 6, 0.5, 0, 0, 0.3]
    np.testing.assert_allclose(vector(state.estimate), gone_on, atol=1e-6)
    assert out.estimate_valid


@pytest.mark.parametrize("pinned", [True, False])
def test_a_uav_that_waits_estimates_what_it_receives(pinned: bool) -> None:
    """A process that is started in flight has no leg yet, and its neighbours use its estimate at once."""
    config = config_of(3)
    config = config._replace(estimator=config.estimator._replace(pinned=pinned))
    own = message((1.0, 1, 1))
    state = initial_state(own, config)
    for k in range(20):
        leader = message((4.0 + 0.5 * k * DT, 5, 6), (0.5, 0, 0))
        said = inputs_of(own, k * DT, mode=MODE_HOLD)
        if pinned:
            said = said._replace(leader=leader, leader_age_s=0.0)
        else:
            said = said._replace(
                leader_age_s=NEVER_RECEIVED_S,
                estimates=np.stack([leader]),
                estimate_age_s=np.array([0.0]),
            )
        state, out = step(state, said, k * DT, DT, config)
        expected = [4.0 + 0.5 * k * DT, 5, 6, 0.5, 0, 0, 0]
        np.testing.assert_allclose(vector(out.estimate), expected, atol=1e-12)
        assert out.estimate_valid
    # Nobody is heard: whether the leader flies on, nobody knows.
    alone = said._replace(estimate_age_s=np.full(1 - pinned, 9.0), leader_age_s=NEVER_RECEIVED_S)
    rest, _ = step(state, alone, 0.2, DT, config)
    assert rest.estimate == state.estimate._replace(velocity=(0.0, 0.0, 0.0))


def test_a_neighbour_that_knows_nothing_of_the_leader_is_not_asked() -> None:
    """Until it hears of the leader its estimate is its own position, metres away."""
    config = config_of(3)
    config = config._replace(estimator=config.estimator._replace(pinned=False))
    own = message((1.0, 1, 1))
    state, knows, guesses = initial_state(own, config), message((4.0, 5, 6)), np.empty(13)
    store_estimate(guesses, Estimate((9.0, 9.0, 9.0), (0.0, 0.0, 0.0), 0.0), False)
    for estimates, valid in (((guesses, guesses), False), ((guesses, knows), True)):
        said = inputs_of(own, 0.0, leader_age_s=NEVER_RECEIVED_S)
        said = said._replace(estimates=np.stack(estimates), estimate_age_s=np.full(2, 0.01))
        after, out = step(state, said, 0.0, DT, config)
        assert (after.estimate_valid, out.estimate_valid) == (valid, valid)
    np.testing.assert_allclose(vector(after.estimate), [4, 5, 6, 0, 0, 0, 0], atol=1e-12)


def test_a_new_epoch_plans_from_the_error_of_then() -> None:
    config = config_of(1)
    state = initial_state(message((0.0, 1, 1)), config)
    state, _ = step(state, inputs_of(message((0.0, 1, 1)), 0.0), 0.0, DT, config)
    first = state.start.task
    np.testing.assert_allclose(first, [0, 4, 7])
    state, _ = step(state, inputs_of(message((0.0, 2, 2)), 3.0), 3.0, DT, config)
    assert state.start.task == first
    state, _ = step(state, inputs_of(message((0.0, 3, 5)), 4.0), 0.0, DT, config)
    np.testing.assert_allclose(
        state.start.task, np.array([5 * np.sin(0.4), 5 * np.cos(0.4), 8]) - [0, 3, 5]
    )


def test_an_encounter_arms_the_time_base_of_the_way_back_and_the_next_one_anew() -> None:
    """The first tick without a row arms it, the second flies it; the command goes on where it was."""
    config, place = config_of(2), LEADER_AT + scenario_of("quadrotor").offset(2)
    flown = Flown(2, at=place + np.array([0.4, 0.4, 0.0]))
    blocked = np.array([[*(flown.own[:3] - 0.3), 0.6, 0.0, 0.0, 0.0, 0.0]])
    late = 8.0
    state = flown.agent.state
    for tick in range(3):
        inputs = inputs_of(flown.own, late, near=blocked, near_age_s=0.0)
        state, _ = step(state, inputs, late + tick * DT, DT, config)
        assert state.recovery.disturbed
    free = inputs_of(flown.own, late)
    before = state.velocity
    state, _ = step(state, free, late + 3 * DT, DT, config)
    assert not state.recovery.disturbed
    assert state.recovery.duration_s >= config.recovery.least_s
    assert state.recovery.t == pytest.approx(late + 4 * DT)
    begun = np.add(state.recovery.rest, state.recovery.moving)
    away = place - flown.own[:3]
    np.testing.assert_allclose(begun, away, atol=0.05)
    after, out = step(state, free, late + 4 * DT, DT, config)
    assert after.recovery == state.recovery
    limit = config.filter.max_acceleration * DT
    assert np.linalg.norm(np.subtract(out.velocity, before)) <= 2.0 * limit
    again, _ = step(after, inputs, late + 5 * DT, DT, config)
    assert again.recovery.disturbed


@pytest.mark.parametrize("plant", PLANTS)
def test_velocity_setpoint_is_the_filtered_command(plant: str) -> None:
    config = config_of(2, plant)
    own = message((-3.0, -1, 5), yaw=0.4)
    state = initial_state(own, config)
    for k in range(5):
        state, out = step(state, inputs_of(own, k * DT), k * DT, DT, config)
        assert out.velocity == state.velocity
    # the leader's heading is 0: the setpoint turns it back to the right
    for k in range(100, 120):
        state, out = step(state, inputs_of(own, k * DT), k * DT, DT, config)
    assert out.yaw_rate < 0.0
    if plant == "quadrotor":
        assert out.yaw_rate == pytest.approx(-0.4 * config.controller.attitude_gain[1])
    else:
        assert out.yaw_rate == state.rates[2]
