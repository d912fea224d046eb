"""Another simulator on the same machine, where PTNSBC_PEERS_PYTHON names an interpreter that has it: it is in no lock.

drone-models flies its quadrotor with rotors and drag under a constant command, by Euler steps at 500 Hz, compiled by
JAX, on two cores. Its drones are uncoupled: no laws of a formation, no sensors, no messages, nothing recorded.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bench.session import Plan
    from bench.table import Row

_DT_S, _SUBSTEPS, _CALL_TICKS, _HOVER_N = 0.002, 5, 100, 0.3  # a tick is 10 ms, as ours


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section; none where no interpreter is named."""
    from bench.table import Row

    if not (python := os.environ.get("PTNSBC_PEERS_PYTHON", "")):
        return []
    command = ["taskset", "-c", "0,1", python, __file__, str(plan.of(3.0, 0.5))]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    per_s = json.loads(done.stdout.splitlines()[-1])
    return [
        Row("drone-models, 5 drones", [per_s["5"]], "swarm-ticks/s"),
        Row("drone-models, 5000 drones", [5000 * per_s["5000"]], "drone-ticks/s"),
    ]


def _ticks_per_s(drones: int, seconds: float) -> float:
    import jax
    import jax.numpy as jnp
    from drone_models import parametrize
    from drone_models.so_rpy_rotor_drag import dynamics

    model = parametrize(dynamics, drone_model="cf2x_L250", xp=jnp)
    still = jnp.zeros((drones, 3))
    upright = jnp.tile(jnp.asarray([0.0, 0.0, 0.0, 1.0]), (drones, 1))
    state: Any = (still, upright, still, still, jnp.full((drones, 1), _HOVER_N))
    command = jnp.tile(jnp.asarray([0.0, 0.0, 0.0, _HOVER_N]), (drones, 1))

    def substep(x: Any, command: Any) -> Any:
        rates = model(*x[:4], command, x[4])
        return tuple(part + _DT_S * rate for part, rate in zip(x, rates, strict=True))

    @jax.jit
    def run(x: Any, command: Any) -> Any:
        steps = _CALL_TICKS * _SUBSTEPS
        return jax.lax.fori_loop(0, steps, lambda _, one: substep(one, command), x)

    for _ in range(2):  # compiled for the types that it takes, and for those that it returns
        state = run(state, command)
    ticks, began = 0, time.perf_counter()
    while time.perf_counter() - began < seconds:
        state = run(state, command)
        state[0].block_until_ready()
        ticks += _CALL_TICKS
    return ticks / (time.perf_counter() - began)


if __name__ == "__main__":
    os.environ["SCIPY_ARRAY_API"] = "1"
    print(json.dumps({size: _ticks_per_s(int(size), float(sys.argv[1])) for size in ("5", "5000")}))
