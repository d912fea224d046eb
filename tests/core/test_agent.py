"""The step as a process calls it: the vectors hold what the NamedTuples hold, and the state is kept."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptnsbc_core.agent import Agent, PackedInputs
from ptnsbc_core.kinematics import store_estimate, yaw_of
from ptnsbc_core.step import initial_state, step
from ptnsbc_core.types import MODE_HOLD, NEVER_RECEIVED_S, AgentInputs, AgentOutputs
from ptnsbc_sim.scenario import agent_config, load_scenario

DT = 0.01


def numbers(value) -> bytes:
    if hasattr(value, "_fields"):
        return b"".join(numbers(part) for part in value)
    return np.asarray(value).tobytes()


def vector(outputs: AgentOutputs) -> np.ndarray:
    estimate = np.empty(13)
    store_estimate(estimate, outputs.estimate, outputs.estimate_valid)
    moving = (*outputs.velocity, outputs.yaw_rate, *outputs.force, *outputs.torque)
    error, *rest = outputs.diagnostics
    return np.array([*moving, *estimate, *outputs.reported, *error, *map(float, rest)])


def random_inputs(rng: np.random.Generator, neighbours: int, near: int) -> AgentInputs:
    return AgentInputs(
        rng.normal(size=13),
        rng.normal(size=13),
        rng.random(),
        rng.normal(size=13),
        rng.random(),
        rng.normal(size=(neighbours, 13)),
        rng.random(neighbours),
        rng.normal(size=(near, 8)),
        rng.random(),
        int(rng.integers(0, 3)),
        rng.random(),
    )


@given(seed=st.integers(0, 2**32 - 1), neighbours=st.integers(0, 3), near=st.integers(0, 3))
def test_known_is_the_inputs_in_a_row(seed: int, neighbours: int, near: int) -> None:
    inputs = random_inputs(np.random.default_rng(seed), neighbours, near)
    assert numbers(PackedInputs.pack(inputs).unpack()) == numbers(inputs)


def test_known_has_heard_nothing_at_first() -> None:
    nothing = PackedInputs(2, np.empty((0, 8))).unpack()
    ages = (nothing.parent_age_s, nothing.leader_age_s, nothing.near_age_s)
    assert ages == (NEVER_RECEIVED_S,) * 3
    assert (nothing.estimate_age_s == NEVER_RECEIVED_S).all()
    assert nothing.mode == MODE_HOLD


def test_agent_is_step_with_its_state_kept() -> None:
    rng = np.random.default_rng(1)
    config, own = agent_config(load_scenario("paper_5"), 3), random_inputs(rng, 0, 0).own
    agent, state = Agent(config, own), initial_state(own, config)
    for k in range(3):
        inputs = random_inputs(rng, 2, 3)
        state, expected = step(state, inputs, k * DT, DT, config)
        told = agent.advance(PackedInputs.pack(inputs), k * DT, DT)
        assert told.vector.tobytes() == vector(expected).tobytes()
        assert numbers(agent.state) == numbers(state)
    again = Agent.resumed(config, state)
    assert (again.step(inputs, 1.0, DT).vector == agent.step(inputs, 1.0, DT).vector).all()


def test_near_objects_of_another_layout_are_the_same_to_a_step() -> None:
    rng = np.random.default_rng(3)
    config = agent_config(load_scenario("paper_5"), 3)
    inputs = PackedInputs.pack(random_inputs(rng, 2, 3))
    near = inputs.near.astype(np.float32)
    agents = [Agent(config, inputs.unpack().own) for _ in range(2)]
    inputs.near = near.astype(np.float64)
    expected = agents[0].advance(inputs, 0.0, DT).vector
    inputs.near = np.asfortranarray(near)
    assert agents[1].advance(inputs, 0.0, DT).vector.tobytes() == expected.tobytes()


def test_outputs_are_valid_until_the_next_step() -> None:
    rng = np.random.default_rng(4)
    config, own = agent_config(load_scenario("paper_5"), 3), random_inputs(rng, 0, 0).own
    agent = Agent(config, own)
    first = agent.step(random_inputs(rng, 2, 3), 0.0, DT)
    kept = first.vector.tolist()
    assert agent.step(random_inputs(rng, 2, 3), DT, DT) is first
    assert first.vector.tolist() != kept


def test_told_has_names_for_what_a_step_gives() -> None:
    rng = np.random.default_rng(2)
    config, own = agent_config(load_scenario("paper_5"), 3), random_inputs(rng, 0, 0).own
    inputs = random_inputs(rng, 2, 3)
    _, expected = step(initial_state(own, config), inputs, 0.0, DT, config)
    told = Agent(config, own).step(inputs, 0.0, DT)
    assert told.velocity.tolist() == [*expected.velocity, expected.yaw_rate]
    assert told.wrench.tolist() == [*expected.force, *expected.torque]
    assert told.leader_estimate[:3].tolist() == list(expected.estimate.position)
    assert told.leader_estimate[7:10].tolist() == list(expected.estimate.velocity)
    assert yaw_of(told.leader_estimate) == pytest.approx(expected.estimate.yaw)
    assert told.reported.tolist() == list(expected.reported)
    assert told.diagnostics == expected.diagnostics
