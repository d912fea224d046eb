"""drone-models: its quadrotor with rotors and drag under a constant command, by Euler steps at 500 Hz.

Compiled by JAX where that is installed, else by NumPy. A tick is 10 ms, as ours.
"""

from __future__ import annotations

import json
import os
import sys
import time
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

os.environ["SCIPY_ARRAY_API"] = "1"
from drone_models import parametrize
from drone_models.so_rpy_rotor_drag import dynamics

_JAX = find_spec("jax") is not None
_DT_S = 0.002
_SUBSTEPS = 5
_CALL_TICKS = 100
_HOVER_N = 0.3

if _JAX:
    import jax
    import jax.numpy as xp
else:
    import numpy as xp

_model = parametrize(dynamics, drone_model="cf2x_L250", xp=xp)


def _substep(state: Any, command: Any) -> Any:
    rates = _model(*state[:4], command, state[4])
    return tuple(part + _DT_S * rate for part, rate in zip(state, rates, strict=True))


def _ticks(state: Any, command: Any) -> Any:
    if _JAX:
        return jax.lax.fori_loop(
            0, _CALL_TICKS * _SUBSTEPS, lambda _, x: _substep(x, command), state
        )
    for _ in range(_SUBSTEPS * _CALL_TICKS):
        state = _substep(state, command)
    return state


def ticks_per_s(drones: int, seconds: float) -> float:
    """Ticks per second of a batch of so many drones."""
    still = xp.zeros((drones, 3))
    upright = xp.tile(xp.asarray([0.0, 0.0, 0.0, 1.0]), (drones, 1))
    state: Any = (still, upright, still, still, xp.full((drones, 1), _HOVER_N))
    command = xp.tile(xp.asarray([0.0, 0.0, 0.0, _HOVER_N]), (drones, 1))
    run = jax.jit(_ticks) if _JAX else _ticks
    for _ in range(2):  # compiled for the types that it takes, and for those that it returns
        state = run(state, command)
    ticks, began = 0, time.perf_counter()
    while not ticks or time.perf_counter() - began < seconds:
        state = run(state, command)
        if _JAX:
            state[0].block_until_ready()
        ticks += _CALL_TICKS
    return ticks / (time.perf_counter() - began)


if __name__ == "__main__":
    for_s = float(sys.argv[1])
    swarm, batch = ticks_per_s(5, for_s), ticks_per_s(5000, for_s)
    name = f"drone-models {version('drone-models')} by {'JAX' if _JAX else 'NumPy'}"
    print(json.dumps({"peer": name, "swarm": swarm, "drones": 5000 * batch}))
