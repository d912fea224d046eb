"""Outputs of `agent.step` on random inputs; run as a script it writes them: `step_probe.py out.npz`."""

import sys

import numpy as np

from ptnsbc_core.kernel import COMPILED
from ptnsbc_core.kinematics import quaternion_from_euler
from ptnsbc_core.step import initial_state, step
from ptnsbc_core.types import AgentInputs
from ptnsbc_sim.scenario import agent_config, load_scenario

TICKS = 3
CASES = [
    (plant, task, rule, profile, uav)
    for plant in ("quadrotor", "rigid_body_6dof")
    for task, rule, profile in (
        ("distance_angles", "set_based", "soft"),
        ("parent_angle", "switched", "paper"),
        ("relative_position", "off", "reference"),
    )
    for uav in (1, 2, 4)
]


def odometry_of(rng: np.random.Generator) -> np.ndarray:
    place, speed, rates = rng.uniform(-3.0, 3.0, 3), rng.normal(size=3), rng.normal(size=3)
    attitude = quaternion_from_euler(rng.uniform(-0.6, 0.6, 3))
    return np.concatenate([place, attitude, speed, rates])


def inputs_of(rng: np.random.Generator, t: float) -> AgentInputs:
    near = np.zeros((3, 8))
    near[:, 0:3] = rng.uniform(-3.0, 3.0, (3, 3))
    near[:, 3] = rng.uniform(0.5, 3.0, 3)
    near[:, 4:7] = rng.normal(size=(3, 3))
    near[0, 7] = 3.0 * near[0, 3]
    estimates = np.stack([odometry_of(rng) for _ in range(2)])
    return AgentInputs(
        odometry_of(rng),
        odometry_of(rng),
        0.01,
        odometry_of(rng),
        0.02,
        estimates,
        np.array([0.01, 9.0]),
        near,
        0.03,
        int(rng.integers(0, 3)),
        t,
    )


def flattened(prefix: str, value, out: dict[str, np.ndarray]) -> None:
    if hasattr(value, "_fields"):
        for name in value._fields:
            flattened(f"{prefix}.{name}", getattr(value, name), out)
    else:
        out[prefix] = np.asarray(value, dtype=np.float64)


def outputs() -> dict[str, np.ndarray]:
    """Every number of every state and output, by name."""
    out: dict[str, np.ndarray] = {}
    for number, (plant, task, rule, profile, uav) in enumerate(CASES):
        changes = {
            "plant.kind": plant,
            "formation.task": task,
            "formation.avoidance": rule,
            "gains.profile": profile,
            "formation.turn_rad": 0.8 * (uav == 4),
        }
        config = agent_config(load_scenario("paper_5", changes), uav)
        rng = np.random.default_rng(number)
        state = initial_state(odometry_of(rng), config)
        for tick in range(TICKS):
            t = 1.0 + 0.01 * tick
            state, told = step(state, inputs_of(rng, t), t, 0.01, config)
            flattened(f"{number}.{tick}.state", state, out)
            flattened(f"{number}.{tick}.out", told, out)
    return out


if __name__ == "__main__":
    np.savez(sys.argv[1], compiled=np.array(COMPILED), **outputs())
