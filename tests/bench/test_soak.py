"""The faults that a soak draws."""

import pytest

pytest.importorskip("rclpy")

from bench.scenarios import grid
from bench.soak import drawn


@pytest.mark.parametrize("lockstep", [True, False])
def test_a_seed_draws_faults_that_the_scenario_takes(lockstep):
    base = grid(6, 50, 60.0)
    first, again, other = (drawn(base, 40, seed, lockstep=lockstep) for seed in (1, 1, 2))
    assert first == again != other
    scenario = base.with_({"faults": first})
    assert len(scenario.faults) == 40
    assert scenario.leader.id not in {fault.struck_uav for fault in scenario.faults}
    assert all(fault.rule.lockstep for fault in scenario.faults) == lockstep
